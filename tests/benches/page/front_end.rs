//! Section `front-end`: times of matcher and mapper in one process, and of the publication of tiles.

use super::machine::copy_line;
use super::{Bench, SharedMemory, Table};
use flockslam::configuration::Configuration;
use flockslam_bus::TilePublisher;
use flockslam_drives::matching::matched;
use flockslam_evidence::{Tile, TileGrid, TileKey};
use flockslam_lidar_ingest::carmen::CarmenReader;
use flockslam_mapper::Mapper;
use flockslam_messages::{Commit, PoseFlags, ScanBuffer, TileMessage, Verdict};
use flockslam_scan_matcher::ScanMatcher;
use flockslam_simulation::{Simulation, World};
use flockslam_telemetry::{LatencyHistogram, monotonic_ns};
use std::io::BufReader;
use std::path::Path;

/// Matching, insertion and publication, without the processes around them.
pub fn section(bench: &mut Bench) -> String {
    let main = bench.main_subject();
    let scans = match &main.log {
        Some((log, _)) => scans_of(log),
        None => Ok(simulated_scans(bench.plan.simulated_s)),
    };
    let scans = match scans {
        Ok(scans) => scans,
        Err(reason) => return format!("Not measured: {reason}."),
    };
    let times = Times::of(&scans, bench.shared_memory());
    format!(
        "Matcher and mapper in one process, one thread, {} scans of {}, every one matched, {} inserted; changed tiles published into shared memory with a reader that takes \
         them ({} tiles an insertion). Beside it: {}. Asked: a mean of at most 60 µs a scan for all three.\n\n{}",
        scans.len(),
        main.name,
        times.insertion.count(),
        times.tiles / times.insertion.count().max(1),
        copy_line(),
        times.table(scans.len())
    )
}

fn scans_of(log: &Path) -> Result<Vec<ScanBuffer>, String> {
    let file = std::fs::File::open(log).map_err(|error| error.to_string())?;
    let settings = Configuration::default().lidar_ingest;
    let mut reader = CarmenReader::new(BufReader::new(file), log.display().to_string(), settings);
    let (mut scan, mut scans) = (ScanBuffer::default(), Vec::new());
    while reader.next_scan(&mut scan).map_err(|error| error.to_string())? {
        scans.push(scan.clone());
    }
    Ok(scans)
}

fn simulated_scans(duration_s: f64) -> Vec<ScanBuffer> {
    let mut settings = Configuration::default().simulation;
    settings.duration_s = duration_s;
    let mut simulation = Simulation::new(&settings, World::floor_plan()).expect("the building is good");
    let (mut scan, mut scans) = (ScanBuffer::default(), Vec::new());
    while simulation.next_scan(&mut scan).is_some() {
        scans.push(scan.clone());
    }
    scans
}

#[derive(Default)]
struct Times {
    matching: LatencyHistogram,
    insertion: LatencyHistogram,
    publication: LatencyHistogram,
    sums_ns: [u64; 3],
    tiles: u64,
}

impl Times {
    fn of(scans: &[ScanBuffer], shared: &SharedMemory) -> Self {
        let configuration = Configuration::default();
        let mut times = Self::default();
        let unknown_score = f64::from(configuration.mapper.read_out().unknown()) / f64::from(u16::MAX);
        let mut matcher = ScanMatcher::new(configuration.scan_matcher).with_unknown_score(unknown_score);
        let mut grid: TileGrid<Box<Tile>> = TileGrid::new(configuration.mapper.cell_size_m);
        let mut mapper = Mapper::new(configuration.mapper);
        let publisher = TilePublisher::open(&shared.bus).expect("the topic is there");
        let reader = shared.bus.subscriber::<TileMessage>().expect("the topic is there");
        for scan in scans {
            let view = scan.view().expect("sources make whole scans");
            let verdict = Verdict { id: scan.header.id, keep: 1, ..Verdict::default() };
            let started = monotonic_ns();
            let pose = matched(&mut matcher, view, &verdict, &grid);
            times.record(0, monotonic_ns() - started);
            if !pose.has(PoseFlags::INSERT) {
                continue;
            }
            let started = monotonic_ns();
            let inserted = mapper.insert(view, &pose, &[]);
            let (generation, active_submap) = (inserted.generation, inserted.active_submap);
            let (changed, retired) = (inserted.changed.to_vec(), inserted.retired.to_vec());
            times.record(1, monotonic_ns() - started);
            let started = monotonic_ns();
            for key in &changed {
                let fill = |message: &mut TileMessage| assert!(mapper.write_tile(*key, &mut message.tile));
                publisher.send_with(*key, fill).expect("memory is free");
            }
            times.record(2, monotonic_ns() - started);
            times.tiles += changed.len() as u64;
            while reader.receive().expect("the topic works").is_some() {}
            take_in(&mut grid, &mapper, &changed, &retired);
            matcher.committed(&Commit { generation, active_submap, ..Commit::default() });
        }
        times
    }

    fn record(&mut self, part: usize, took_ns: u64) {
        [&mut self.matching, &mut self.insertion, &mut self.publication][part].record(took_ns);
        self.sums_ns[part] += took_ns;
    }

    fn table(&self, scans: usize) -> Table {
        let mut table = Table::new(["", "times", "p50 µs", "p99 µs", "max µs", "mean over all scans µs"]);
        let us = |ns: u64| format!("{:.1}", ns as f64 * 1e-3);
        let per_scan = |ns: u64| format!("{:.1}", ns as f64 * 1e-3 / scans.max(1) as f64);
        let rows =
            [("match", &self.matching), ("insertion", &self.insertion), ("publication", &self.publication)];
        for ((name, histogram), sum_ns) in rows.into_iter().zip(self.sums_ns) {
            table.row([
                name.to_owned(),
                histogram.count().to_string(),
                us(histogram.quantile_ns(0.5)),
                us(histogram.quantile_ns(0.99)),
                us(histogram.max_ns()),
                per_scan(sum_ns),
            ]);
        }
        let none = || "–".to_owned();
        let all = per_scan(self.sums_ns.iter().sum());
        table.row(["**all**".to_owned(), scans.to_string(), none(), none(), none(), all]);
        table
    }
}

/// What a reader of tiles does by holding samples.
fn take_in(grid: &mut TileGrid<Box<Tile>>, mapper: &Mapper, changed: &[TileKey], retired: &[TileKey]) {
    for key in changed {
        let mut tile = Tile::unknown(0);
        mapper.write_tile(*key, &mut tile);
        grid.set(*key, tile).expect("buildings are small");
    }
    for key in retired {
        grid.remove(*key);
    }
}
