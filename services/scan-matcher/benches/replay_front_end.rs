//! Replays a CARMEN log through matcher and mapper in one process: writes a TUM trajectory, prints processor times per
//! scan, and beside them what copying 64 MiB takes.
//!
//! `cargo bench -p flockslam-scan-matcher --bench replay_front_end -- LOG [--tum FILE] [--poses FILE] [--heading RAD] [--vinyslam] [--no-odometry] [--beam-noise SHARE]
//! [--set matcher.KEY=VALUE | mapper.KEY=VALUE …]`
//!
//! `--no-odometry` takes odometry away, `--beam-noise` replaces that share of all beams by random ranges.

#![allow(clippy::disallowed_methods, reason = "no result depends on it")]

use flockslam_evidence::{Tile, TileGrid, TileKey};
use flockslam_geometry::Pose;
use flockslam_mapper::Mapper;
use flockslam_messages::{Commit, PoseFlags, ScanBuffer, Verdict};
use flockslam_scan_matcher::ScanMatcher;
use rustix::time::{ClockId, clock_gettime};
use std::io::{BufWriter, Write};

type Failure = Box<dyn std::error::Error>;

struct Options {
    log: String,
    tum: Option<String>,
    poses: Option<String>,
    heading_rad: f64,
    odometry: bool,
    beam_noise_share: f64,
    matcher: flockslam_scan_matcher::Settings,
    mapper: flockslam_mapper::Settings,
}

fn main() -> Result<(), Failure> {
    let options = Options::from_arguments()?;
    let mut scans = read_log(&options.log, options.heading_rad)?;
    spoil(&mut scans, &options);
    let mut run = Run::new(&options);
    for scan in &scans {
        run.step(scan)?;
    }
    run.report(scans.len());
    if let Some(path) = &options.tum {
        run.write(path, tum_line)?;
    }
    if let Some(path) = &options.poses {
        run.write(path, pose_line)?;
    }
    Ok(())
}

impl Options {
    fn from_arguments() -> Result<Self, Failure> {
        // Cargo adds an option of its own.
        let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
        let mut options = Self {
            log: arguments.next().ok_or("which log?")?,
            tum: None,
            poses: None,
            heading_rad: 0.0,
            odometry: true,
            beam_noise_share: 0.0,
            matcher: flockslam_scan_matcher::Settings::default(),
            mapper: flockslam_mapper::Settings::default(),
        };
        while let Some(name) = arguments.next() {
            if name == "--vinyslam" {
                options.matcher = flockslam_scan_matcher::Settings::vinyslam();
                options.mapper = flockslam_mapper::Settings::vinyslam();
                continue;
            }
            if name == "--no-odometry" {
                options.odometry = false;
                continue;
            }
            let value = arguments.next().ok_or_else(|| format!("{name} needs a value"))?;
            match name.as_str() {
                "--tum" => options.tum = Some(value),
                "--poses" => options.poses = Some(value),
                "--heading" => options.heading_rad = value.parse()?,
                "--beam-noise" => options.beam_noise_share = value.parse()?,
                "--set" => options.set(&value)?,
                _ => return Err(format!("unknown option {name}").into()),
            }
        }
        Ok(options)
    }

    fn set(&mut self, assignment: &str) -> Result<(), Failure> {
        let (key, value) = assignment.split_once('=').ok_or("KEY=VALUE")?;
        let (section, key) = key.split_once('.').ok_or("matcher.KEY or mapper.KEY")?;
        match section {
            "matcher" => self.matcher = changed(&self.matcher, key, value)?,
            "mapper" => self.mapper = changed(&self.mapper, key, value)?,
            _ => return Err(format!("unknown section {section}").into()),
        }
        Ok(())
    }
}

/// `settings` with the value at a dotted key replaced.
fn changed<T: serde::Serialize + serde::de::DeserializeOwned>(
    settings: &T,
    key: &str,
    value: &str,
) -> Result<T, Failure> {
    let mut tree = serde_json::to_value(settings)?;
    let place = tree
        .pointer_mut(&format!("/{}", key.replace('.', "/")))
        .ok_or_else(|| format!("unknown key {key}"))?;
    *place = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    Ok(serde_json::from_value(tree)?)
}

/// FLASER lines of a log; the greatest range in it means "no return".
fn read_log(path: &str, heading_rad: f64) -> Result<Vec<ScanBuffer>, Failure> {
    // A base frame turned against the robot starts the run turned against the grid.
    let turn = Pose::new(0.0, 0.0, heading_rad);
    let mut scans = Vec::new();
    for line in std::fs::read_to_string(path)?.lines().filter(|line| line.starts_with("FLASER ")) {
        let mut numbers = line.split_ascii_whitespace().skip(1).map_while(|word| word.parse::<f64>().ok());
        let count = numbers.next().ok_or("no beam count")? as usize;
        let ranges: Vec<f32> = numbers.by_ref().take(count).map(|range| range as f32).collect();
        let rest: Vec<f64> = numbers.take(7).collect();
        let &[lx, ly, lt, x, y, heading, stamp] = rest.as_slice() else {
            return Err("a short FLASER line".into());
        };
        let (laser, odometry) = (Pose::new(lx, ly, lt), Pose::new(x, y, heading));
        let step = std::f64::consts::PI / if count % 2 == 1 { count - 1 } else { count } as f64;
        let mut scan = ScanBuffer::from_ranges(&ranges, -std::f64::consts::FRAC_PI_2, step);
        scan.header.base_from_laser = turn * odometry.to(laser);
        scan.header.odometry = odometry * turn.inverse();
        scan.header.has_odometry = 1;
        scan.header.id.sequence = scans.len() as u64;
        scan.header.times.sensor_ns = (stamp * 1e9).round() as i64;
        scans.push(scan);
    }
    let greatest = scans.iter().flat_map(|scan| &scan.numbers).fold(0.0f32, |a, b| a.max(*b));
    for scan in &mut scans {
        scan.header.range_max_m = greatest - 0.01;
    }
    Ok(scans)
}

/// Removes odometry, replaces beams by noise, as the options select.
fn spoil(scans: &mut [ScanBuffer], options: &Options) {
    let mut state = 1u64;
    // A linear congruential generator (Knuth's MMIX constants), uniform in 0 … 1.
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    for scan in scans {
        scan.header.has_odometry = u32::from(options.odometry);
        for range in scan.numbers.iter_mut().filter(|_| options.beam_noise_share > 0.0) {
            if f64::from(uniform()) < options.beam_noise_share {
                *range = 0.5 + uniform() * (scan.header.range_max_m.min(30.0) - 0.5);
            }
        }
    }
}

struct Done {
    stamp_s: f64,
    pose: Pose,
    odometry: Pose,
    inserted: bool,
}

struct Run {
    matcher: ScanMatcher,
    mapper: Mapper,
    grid: TileGrid<Box<Tile>>,
    spare: Vec<Box<Tile>>,
    base_from_robot: Pose,
    done: Vec<Done>,
    match_us: Vec<f64>,
    insert_us: Vec<f64>,
    publish_us: Vec<f64>,
    tiles: usize,
    rescued: usize,
    qualities: [usize; 3],
    submaps: usize,
}

impl Run {
    fn new(options: &Options) -> Self {
        let unknown_score = f64::from(options.mapper.read_out().unknown()) / f64::from(u16::MAX);
        Self {
            matcher: ScanMatcher::new(options.matcher.clone()).with_unknown_score(unknown_score),
            mapper: Mapper::new(options.mapper.clone()),
            grid: TileGrid::new(options.mapper.cell_size_m),
            spare: Vec::new(),
            base_from_robot: Pose::new(0.0, 0.0, options.heading_rad),
            done: Vec::new(),
            match_us: Vec::new(),
            insert_us: Vec::new(),
            publish_us: Vec::new(),
            tiles: 0,
            rescued: 0,
            qualities: [0; 3],
            submaps: 0,
        }
    }

    fn step(&mut self, buffer: &ScanBuffer) -> Result<(), Failure> {
        let scan = buffer.view()?;
        let verdict = Verdict { id: scan.header().id, keep: 1, ..Verdict::default() };
        let before = processor_us();
        let estimate = self.matcher.handle(scan, &verdict, &self.grid);
        self.match_us.push(processor_us() - before);
        let inserted = estimate.has(PoseFlags::INSERT);
        self.rescued += usize::from(estimate.has(PoseFlags::RESCUED));
        self.qualities[estimate.quality as usize] += 1;
        if inserted {
            let before = processor_us();
            let insertion = self.mapper.insert(scan, &estimate, &[]);
            self.insert_us.push(processor_us() - before);
            let commit = Commit {
                id: scan.header().id,
                generation: insertion.generation,
                active_submap: insertion.active_submap,
                ..Commit::default()
            };
            self.submaps += insertion.closed.len();
            let (changed, retired) = (insertion.changed.to_vec(), insertion.retired.to_vec());
            self.publish(&changed, &retired)?;
            self.matcher.committed(&commit);
        }
        self.done.push(Done {
            stamp_s: scan.header().times.sensor_ns as f64 * 1e-9,
            pose: estimate.odom_from_base * self.base_from_robot,
            odometry: buffer.header.odometry * self.base_from_robot,
            inserted,
        });
        Ok(())
    }

    fn publish(&mut self, changed: &[TileKey], retired: &[TileKey]) -> Result<(), Failure> {
        let before = processor_us();
        for key in retired {
            self.spare.extend(self.grid.remove(*key));
        }
        for key in changed {
            let mut tile = self.spare.pop().unwrap_or_else(|| Tile::unknown(0));
            assert!(self.mapper.write_tile(*key, &mut tile), "a changed tile is live");
            self.spare.extend(self.grid.set(*key, tile)?);
        }
        self.tiles += changed.len();
        self.publish_us.push(processor_us() - before);
        Ok(())
    }

    fn report(&mut self, scans: usize) {
        let count = scans as f64;
        let each = [&self.match_us, &self.insert_us, &self.publish_us]
            .map(|times| times.iter().sum::<f64>() / count);
        eprintln!(
            "a scan {:.1} µs = match {:.1} + insertion {:.1} + publication {:.1}; 64 MiB copied in {:.2} ms",
            each.iter().sum::<f64>(),
            each[0],
            each[1],
            each[2],
            1e-3 * copying_us(),
        );
        eprintln!(
            "match {}; {} insertions {}; publication {}, {:.1} tiles each; {} rescued; quality {:?}; {} submaps",
            summary(&mut self.match_us),
            self.insert_us.len(),
            summary(&mut self.insert_us),
            summary(&mut self.publish_us),
            self.tiles as f64 / self.insert_us.len() as f64,
            self.rescued,
            self.qualities,
            self.submaps,
        );
    }

    fn write(&self, path: &str, line: fn(&Done) -> String) -> Result<(), Failure> {
        let mut out = BufWriter::new(std::fs::File::create(path)?);
        for done in &self.done {
            writeln!(out, "{}", line(done))?;
        }
        Ok(out.flush()?)
    }
}

/// Time that a processor has spent on this thread: other programs on the machine do not count.
fn processor_us() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e6 + time.tv_nsec as f64 * 1e-3
}

/// What copying 64 MiB takes on this machine now: the median of nine times, into memory that is there already.
fn copying_us() -> f64 {
    let (from, mut to) = (vec![1u8; 64 << 20], vec![2u8; 64 << 20]);
    let mut times = [0.0; 9];
    for time in &mut times {
        let before = processor_us();
        to.copy_from_slice(std::hint::black_box(&from));
        std::hint::black_box(&mut to);
        *time = processor_us() - before;
    }
    times.sort_unstable_by(f64::total_cmp);
    times[4]
}

fn summary(times_us: &mut [f64]) -> String {
    times_us.sort_unstable_by(f64::total_cmp);
    let count = times_us.len().max(1);
    let at = |share: f64| times_us.get((share * count as f64) as usize).copied().unwrap_or(0.0);
    format!(
        "mean {:.1} p50 {:.1} p99 {:.1} max {:.0} µs",
        times_us.iter().sum::<f64>() / count as f64,
        at(0.5),
        at(0.99),
        times_us.last().copied().unwrap_or(0.0)
    )
}

fn tum_line(done: &Done) -> String {
    let (sin, cos) = (0.5 * done.pose.heading_rad).sin_cos();
    format!("{:.6} {:.6} {:.6} 0 0 0 {sin:.9} {cos:.9}", done.stamp_s, done.pose.x_m, done.pose.y_m)
}

fn pose_line(done: &Done) -> String {
    let (p, o) = (done.pose, done.odometry);
    format!(
        "{:.6} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {}",
        done.stamp_s,
        p.x_m,
        p.y_m,
        p.heading_rad,
        o.x_m,
        o.y_m,
        o.heading_rad,
        u8::from(done.inserted)
    )
}
