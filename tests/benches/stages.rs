//! What the pieces cost, printed: a hop of a scan between two processes, a match, an insertion, a publication of the
//! grid, and the same stages as threads of one process against six processes. Run with `cargo bench`.

use flockslam::configuration::Configuration;
use flockslam::supervisor::{SetFile, run_in};
use flockslam_bus::{Bus, Capacity, RuntimeDir};
use flockslam_evidence::{Tile, TileGrid};
use flockslam_lidar_ingest::process::Source;
use flockslam_lidar_ingest::simulation::{Simulation, World};
use flockslam_mapper::Mapper;
use flockslam_messages::{Commit, Control, ControlKind, PoseFlags, ScanBuffer, Stage, TileMessage, Verdict};
use flockslam_scan_matcher::ScanMatcher;
use flockslam_stage::{Mode, StageContext, StopFlag};
use flockslam_telemetry::{LatencyHistogram, monotonic_ns};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const HOPS: u64 = 2000;

fn main() {
    let args: Vec<String> = std::env::args().collect();
    if let Some(at) = args.iter().position(|arg| arg == "--echo") {
        return echo(Path::new(&args[at + 1]));
    }
    let runtime =
        RuntimeDir::create(&format!("bench-{}", std::process::id())).expect("shared memory can be used");
    let bus = Bus::host(&runtime, Capacity::default()).expect("the bus can be created");
    for beams in [180, 1000, 8000] {
        hop(&runtime, &bus, beams);
    }
    front_end(&bus);
    drop(bus);
    drop(runtime);
    separation(Source::Simulation, "simulated building");
    match intel_log() {
        Some(path) => separation(Source::Log(path), "Intel log"),
        None => println!("NOT MEASURED: no logs in FLOCKSLAM_DATA or ../shared/data"),
    }
}

fn intel_log() -> Option<PathBuf> {
    let folder = std::env::var_os("FLOCKSLAM_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
    let path = folder.join("intel/intel.clf");
    path.exists().then_some(path)
}

fn row(what: &str, histogram: &LatencyHistogram) {
    let us = |ns: u64| ns as f64 * 1e-3;
    println!(
        "{what:<56} p50 {:>8.1} µs   p99 {:>8.1} µs   max {:>8.1} µs   n {}",
        us(histogram.quantile_ns(0.5)),
        us(histogram.quantile_ns(0.99)),
        us(histogram.max_ns()),
        histogram.count()
    );
}

/// The other process of the hop: answers each scan with the time that it took to get here.
fn echo(directory: &Path) {
    let runtime = RuntimeDir::open(directory).expect("the bench has made it");
    let bus = Bus::join(&runtime, "echo", Capacity::default()).expect("the bus is there");
    let scans = bus.scan_subscriber().expect("the topic is there");
    let answers = bus.publisher::<Verdict>().expect("the topic is there");
    let bell = bus.listener(Stage::CorrelationFilter.name()).expect("the bell is there");
    answers.send(&Verdict::default()).expect("the bench listens");
    loop {
        bell.wait(Duration::from_secs(1)).expect("the bell works");
        while let Some(sample) = scans.receive().expect("the topic works") {
            let coefficient = monotonic_ns().saturating_sub(sample.header().times.monotonic_ns) as f64;
            answers
                .send(&Verdict { id: sample.header().id, coefficient, ..Verdict::default() })
                .expect("it is heard");
        }
    }
}

struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn hop(runtime: &RuntimeDir, bus: &Bus, beams: usize) {
    let answers = bus.subscriber::<Verdict>().expect("the topic is there");
    let scans = bus.scan_publisher().expect("the topic is there");
    let bell = bus.ringer(Stage::CorrelationFilter.name()).expect("the bell is there");
    let this = std::env::current_exe().expect("a program knows itself");
    let mut command = Command::new(this);
    let child =
        command.arg("--echo").arg(runtime.path()).stdin(Stdio::null()).spawn().expect("it can start itself");
    let _child = Killed(child);
    let mut scan = ScanBuffer::from_ranges(&vec![2.0; beams], 0.0, 0.01);
    let mut histogram = LatencyHistogram::default();
    let next = || loop {
        match answers.receive().expect("the topic works") {
            Some(answer) => return answer.coefficient,
            None => std::thread::sleep(Duration::from_micros(200)),
        }
    };
    next();
    for sequence in 0..HOPS {
        std::thread::sleep(Duration::from_micros(500));
        (scan.header.id.sequence, scan.header.times.monotonic_ns) = (sequence, monotonic_ns());
        scans.send(scan.view().expect("it is whole")).expect("memory is free");
        bell.ring();
        histogram.record(next() as u64);
    }
    row(&format!("hop of a scan of {beams} beams to another process"), &histogram);
    bus.clean_dead_nodes();
}

/// Matching, insertion and publication over the simulated drive, in this process.
fn front_end(bus: &Bus) {
    let configuration = Configuration::default();
    let mut simulation =
        Simulation::new(&configuration.simulation, World::floor_plan()).expect("the building is good");
    let mut matcher = ScanMatcher::new(configuration.scan_matcher);
    let mut grid: TileGrid<Box<Tile>> = TileGrid::new(configuration.mapper.cell_size_m);
    let mut mapper = Mapper::new(configuration.mapper);
    let publisher = bus.publisher::<TileMessage>().expect("the topic is there");
    let reader = bus.subscriber::<TileMessage>().expect("the topic is there");
    let [mut matching, mut insertion, mut publication] = [(); 3].map(|()| LatencyHistogram::default());
    let mut tiles = 0;
    let mut scan = ScanBuffer::default();
    while simulation.next_scan(&mut scan).is_some() {
        let view = scan.view().expect("the simulation makes whole scans");
        let verdict = Verdict { id: scan.header.id, keep: 1, ..Verdict::default() };
        let started = monotonic_ns();
        let pose = matcher.handle(view, &verdict, &grid);
        matching.record(monotonic_ns() - started);
        if !pose.has(PoseFlags::INSERT) {
            continue;
        }
        let started = monotonic_ns();
        let inserted = mapper.insert(view, &pose, &[]);
        let (changed, generation, active_submap) =
            (inserted.changed.to_vec(), inserted.generation, inserted.active_submap);
        let retired = inserted.retired.to_vec();
        insertion.record(monotonic_ns() - started);
        let started = monotonic_ns();
        for key in &changed {
            let fill = |message: &mut TileMessage| assert!(mapper.write_tile(*key, &mut message.tile));
            publisher.send_with(fill).expect("memory is free");
        }
        publication.record(monotonic_ns() - started);
        tiles += changed.len();
        while reader.receive().expect("the topic works").is_some() {}
        for key in &changed {
            let mut tile = Tile::unknown(0);
            mapper.write_tile(*key, &mut tile);
            grid.set(*key, tile).expect("the building is small");
        }
        for key in &retired {
            grid.remove(*key);
        }
        matcher.committed(&Commit { generation, active_submap, ..Commit::default() });
    }
    row("match of a scan of 360 beams", &matching);
    row("insertion of a scan of 360 beams", &insertion);
    let each = tiles as f64 / publication.count().max(1) as f64;
    row(&format!("publication of the changed tiles ({each:.0} each)"), &publication);
}

/// The whole set over one source: as threads over the in-memory bus, then as six processes.
fn separation(source: Source, name: &str) {
    let mut configuration = Configuration::default();
    configuration.correlation_filter.mode = flockslam_correlation_filter::Mode::Off;
    let file = SetFile {
        version: flockslam::VERSION.to_owned(),
        options: configuration.stage_options(Mode::Exact),
        source,
        rate: None,
        world: None,
        configuration,
    };
    let threads = one_process(&file);
    let processes = six_processes(&file);
    for (how, (scans, wall)) in [("six threads of one process", threads), ("six processes", processes)] {
        println!("{name}, {how:<28} {:>8.0} scans/s ({scans} scans in {:.2} s)", scans as f64 / wall, wall);
    }
}

fn one_process(file: &SetFile) -> (u64, f64) {
    let runtime =
        RuntimeDir::create(&format!("bench-threads-{}", std::process::id())).expect("tmpfs can be used");
    let bus = Bus::in_memory();
    let control = bus.subscriber::<Control>().expect("memory has every topic");
    let stop = StopFlag::default();
    let started = Instant::now();
    let scans = std::thread::scope(|scope| {
        for stage in Stage::ALL {
            let join = bus.memory_joiner().expect("it is in memory");
            let (stop, file, runtime) = (stop.clone(), file.clone(), &runtime);
            scope.spawn(move || {
                let mut context = StageContext::on_bus(stage, 0, join(), runtime, &file.options, stop)
                    .expect("it can start");
                run_in(&mut context, file).expect("the stage works");
            });
            // Consumers listen before the source speaks.
            let beat = flockslam_stage::heartbeat_file(&runtime.status(), &format!("{}-0", stage.name()));
            while !matches!(flockslam_telemetry::read_heartbeat(&beat), Ok(Some(_))) {
                std::thread::sleep(Duration::from_micros(100));
            }
        }
        let scans = loop {
            match control.receive().expect("memory works") {
                Some(message) if message.kind == ControlKind::Finished as u32 => break message.value,
                Some(_) => {}
                None => std::thread::sleep(Duration::from_millis(1)),
            }
        };
        stop.stop();
        scans
    });
    (scans, started.elapsed().as_secs_f64())
}

/// The set as a user runs it, with all outputs written: a process belongs to one set only, so it is not this one.
fn six_processes(file: &SetFile) -> (u64, f64) {
    let out = std::env::temp_dir().join(format!("flockslam-bench-{}", std::process::id()));
    let mut command = Command::new(env!("CARGO_BIN_EXE_flockslam"));
    match &file.source {
        Source::Log(path) => command.arg("map").arg(path),
        _ => command.arg("demo"),
    };
    command.arg("--out").arg(&out).args(["--set", "correlation_filter.mode=off"]).stdout(Stdio::null());
    assert!(command.status().expect("flockslam can be started").success());
    let report = std::fs::read(out.join("report.json")).expect("a run leaves a report");
    let report: serde_json::Value = serde_json::from_slice(&report).expect("the report is JSON");
    let _ = std::fs::remove_dir_all(&out);
    (
        report["scans"].as_u64().expect("scans are counted"),
        report["wall_s"].as_f64().expect("time is measured"),
    )
}
