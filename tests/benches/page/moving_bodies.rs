//! Sections `moving` and `movers`: maps, ghosts and tracks where people walk, and the published NDT experiment (Trubin et al. 2020).

use super::{Bench, Table, figure, mean};
use crate::support::ndt_runs::ndt_settings;
use crate::support::{BUILDINGS, MovingDrive, Outputs, later_free, moving_building, run_well, with_movers};
use flockslam_drives::experiments::{BEARING_SIGMA_RAD, flat, flat_seeded};
use flockslam_drives::followed::TrackFigures;
use flockslam_drives::ndt_system::{MoveError, ndt_cost_ms, ndt_errors};
use flockslam_dynamic_cleaner::{DynamicCleaner, Sector};
use flockslam_evidence::{Tile, TileGrid};
use flockslam_geometry::Covariance;
use flockslam_mapper::Mapper;
use flockslam_messages::{PoseEstimate, PoseFlags, ScanBuffer};
use flockslam_simulation::{Settings, Simulation, World};
use std::path::Path;
use std::time::Instant;

/// Seeds of the drives of a patient page: whose errors are compared, and whose maps are, cell by cell, which takes longer.
const SEEDS: (u64, u64) = (20, 4);
/// Drives whose tracks are counted.
const DRIVES: u64 = 12;
/// Noises that the published experiment is repeated with.
const OTHER_NOISES: u64 = 40;
/// Crowds.
const WALKERS: [u32; 2] = [2, 20];
/// Logs with people in them, and the profiles that are compared on them.
const LOGS: [(&str, &str); 2] = [("fhw-corrected", "people/fhw-corrected.log"), ("ACES", "aces/aces.clf")];
const PROFILES: [&str; 2] = ["default", "vinyslam"];

/// What moves: ghosts on real logs, its tracks, the published experiment, and what it costs.
pub fn movers(bench: &mut Bench) -> String {
    let data = bench.plan.data.clone();
    let logs = data.map_or_else(String::new, |data| real_logs(&data));
    [logs, tracks(DRIVES), experiment(), cleaning()].join("\n")
}

/// Maps of moving worlds without the traces of what moves.
pub fn worlds(bench: &mut Bench) -> String {
    let (seeds, map_seeds) = if bench.plan.patient { SEEDS } else { (1, 1) };
    let mut table = Table::new([
        "building",
        "walkers",
        "static cells kept (SA) %",
        "what has left removed (DA) %",
        "harmonic mean (HA)",
        "ATE m",
        "without anybody m",
        "ratio",
    ]);
    for name in BUILDINGS {
        let Some(map) = moving_building(name) else {
            table.row([name, "the map is absent"]);
            continue;
        };
        let error_m = |walkers: u32| {
            let errors: Vec<f64> = (1..=seeds)
                .map(|seed| {
                    let settings = Settings { seed, walkers, ..Settings::default() };
                    MovingDrive { map: Some(map.clone()), settings }.run(&[]).error_m()
                })
                .collect();
            mean(&errors)
        };
        let alone_m = error_m(0);
        for walkers in WALKERS {
            let figures: Vec<_> = (1..=map_seeds)
                .map(|seed| {
                    let drive = MovingDrive { map: Some(map.clone()), settings: with_movers(seed, walkers) };
                    drive.figures(&drive.run(&[]))
                })
                .collect();
            let of = |value: fn(&crate::support::MapFigures) -> f64| {
                mean(&figures.iter().map(value).collect::<Vec<_>>())
            };
            let among_m = error_m(walkers);
            table.row([
                name.to_owned(),
                walkers.to_string(),
                figure(of(|figures| figures.kept.percent()), 2),
                figure(of(|figures| figures.removed.percent()), 2),
                figure(of(|figures| figures.harmonic()), 2),
                figure(among_m, 4),
                figure(alone_m, 4),
                figure(among_m / alone_m, 2),
            ]);
        }
        eprintln!("  {name} done");
    }
    format!(
        "Maps of drives through real buildings with six doors and four pallets that come and go, cell by cell against exact truth: SA – cells of the world itself that the map shows, of those \
         that a map shows from which nothing is removed; DA – of cells that something has left and that were viewed free three times since, those that the map does not show as occupied; means \
         over {map_seeds} seeds. Asked: SA ≥ 99.5, DA ≥ 95, HA ≥ 97. ATE: of such drives with walkers alone, means over {seeds} seeds; asked: at most 1.2 times that without anybody.\n\n{table}"
    )
}

fn real_logs(data: &Path) -> String {
    let mut table = Table::new(["log", "profile", "occupied cells", "later viewed free", "%"]);
    for (name, file) in LOGS {
        let log = data.join(file);
        for profile in PROFILES.iter().filter(|_| log.is_file()) {
            let directory = tempfile::tempdir().expect("a directory for the outputs");
            let args = ["map", &log.display().to_string(), "--profile", profile].map(str::to_owned);
            let outputs: Outputs = run_well("later-free", directory.path(), &args);
            let share = later_free(&outputs, &log);
            table.row([
                name.to_owned(),
                (*profile).to_owned(),
                share.of.to_string(),
                share.good.to_string(),
                figure(share.percent(), 2),
            ]);
        }
    }
    format!(
        "Logs of places with people: cells that stand occupied in the map although beams have gone through them, in at least three views since they were last hit. Asked: at most 0.5 %, \
         and 90 % fewer than with `--profile vinyslam`.\n\n{table}"
    )
}

fn tracks(seeds: u64) -> String {
    let figures = TrackFigures::of_drives(1..=seeds);
    let mut table = Table::new([
        "",
        "centre RMSE m",
        "speed error m/s",
        "name kept through up to 1 s of occlusion",
        "sightings",
        "of nobody",
    ]);
    table.row([
        "measured".to_owned(),
        figure(figures.rmse_m(), 3),
        figure(figures.speed_error_m_s(), 3),
        format!("{} of {}", figures.recognised, figures.hidden),
        figures.positions.to_string(),
        figures.false_tracks.to_string(),
    ]);
    table.row(["asked", "0.10", "0.15", "90 %"]);
    format!(
        "Tracks of six people around a robot that drives through the office, against exact truth, {seeds} drives. Tracks belong to people as CLEAR MOT has it: who was behind a track stays, as long as \
         they are within 0.5 m, others are the nearest, everybody once; *of nobody* are sightings that are left over.\n\n{table}"
    )
}

fn experiment() -> String {
    let noisy = flat(BEARING_SIGMA_RAD);
    let (with, without) = (ndt_errors(&noisy, &ndt_settings()), ndt_errors(&flat(0.0), &ndt_settings()));
    let mut table = Table::new([
        "scan",
        "way off by mm",
        "turn off by °",
        "end off by mm",
        "without noise of directions: way mm",
        "turn °",
        "end mm",
    ]);
    let cells = |error: &MoveError| {
        [figure(1e3 * error.way_m, 1), figure(error.turn_deg, 2), figure(1e3 * error.end_m, 1)]
    };
    let worst = |errors: &[MoveError]| errors.iter().copied().fold(MoveError::default(), MoveError::max);
    for (i, (noisy, clean)) in with.iter().zip(&without).enumerate() {
        table.row([vec![(i + 2).to_string()], cells(noisy).to_vec(), cells(clean).to_vec()].concat());
    }
    let last = [vec!["worst".to_owned()], cells(&worst(&with)).to_vec(), cells(&worst(&without)).to_vec()];
    table.row(last.concat());
    let others: Vec<MoveError> = (0..OTHER_NOISES)
        .flat_map(|seed| ndt_errors(&flat_seeded(BEARING_SIGMA_RAD, seed), &ndt_settings()))
        .collect();
    let share = |is: fn(&MoveError) -> bool| {
        100.0 * others.iter().filter(|error| is(error)).count() as f64 / others.len() as f64
    };
    let [way, turn, end] = cells(&worst(&others));
    let (turns, ends) = (share(|error| error.turn_deg <= 0.5), share(|error| error.end_m <= 0.01));
    let [matching, cleaning, mapping] = ndt_cost_ms(&noisy, &ndt_settings());
    format!(
        "`--profile ndt` on thirteen scans in a flat (1000 beams, 2 mm of range, each beam 1° of direction; a door closes, an operator follows): each of the twelve moves against the true one, its length \
         and its turn as the published table gives them; its *end* is seen from the pose before, so that the heading of that one counts with the length of the move. Asked: 10 mm and 0.5°. A scan takes \
         {matching:.2} ms to match, {cleaning:.2} ms to clean, {mapping:.2} ms to map in one process (asked: 2 ms together, cleaning at most as much as matching; published: 98 ms).\n\n{table}\n\
         With {OTHER_NOISES} other noises: ways at most {way} mm off, turns {turn}° ({turns:.1} % within 0.5°), ends {end} mm ({ends:.0} % within 10 mm).\n"
    )
}

/// What the cleaner's logic takes for a scan, whole and in two halves, microseconds.
struct Cost {
    whole_us: Vec<f64>,
    halves_us: Vec<f64>,
}

/// A drive with so many beams all around, matched at the true poses, every scan classified.
fn cost(beams: u32, scans: usize) -> Cost {
    let settings = Settings { beams, range_max_m: 12.0, walkers: 6, ..Settings::default() };
    let mut simulation =
        Simulation::new(&settings, World::floor_plan()).expect("the office can be driven through");
    let mapping = flockslam_mapper::Settings::default();
    let mut grid: TileGrid<Box<Tile>> = TileGrid::new(mapping.cell_size_m);
    let mut mapper = Mapper::new(mapping);
    let mut cleaner = DynamicCleaner::new(flockslam_dynamic_cleaner::Settings::default());
    let (mut scan, mut cost) = (ScanBuffer::default(), Cost { whole_us: Vec::new(), halves_us: Vec::new() });
    while let Some(truth) = simulation.next_scan(&mut scan).filter(|_| cost.whole_us.len() < scans) {
        let view = scan.view().expect("a scan of the simulation");
        let pose = PoseEstimate {
            id: scan.header.id,
            times: scan.header.times,
            odom_from_base: truth,
            covariance: Covariance::diagonal(0.01, 0.003),
            twist: simulation.twist(),
            flags: PoseFlags::MATCHED,
            ..PoseEstimate::default()
        };
        let mut judge = |sector: Sector| {
            let started = Instant::now();
            cleaner.begin(view, &pose);
            cleaner.look(view, &pose, &grid, sector);
            1e6 * started.elapsed().as_secs_f64()
        };
        let halves = [0, 1].map(|part| judge(Sector::new(part, 2)));
        let whole_us = judge(Sector::WHOLE);
        let started = Instant::now();
        let cleared = cleaner.conclude(&pose).cleared.to_vec();
        let conclude_us = 1e6 * started.elapsed().as_secs_f64();
        cost.whole_us.push(whole_us + conclude_us);
        cost.halves_us.push(halves[0].max(halves[1]) + conclude_us);
        let insertion = mapper.insert(view, &pose, &cleared);
        let (changed, retired) = (insertion.changed.to_vec(), insertion.retired.to_vec());
        retired.into_iter().for_each(|key| drop(grid.remove(key)));
        for key in changed {
            let mut tile = grid.remove(key).unwrap_or_else(|| Tile::unknown(0));
            mapper.write_tile(key, &mut tile);
            grid.set(key, tile).expect("the office is small");
        }
    }
    cost
}

fn cleaning() -> String {
    let quantile = |values: &[f64], share: f64| {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted[((sorted.len() - 1) as f64 * share) as usize]
    };
    let mut table = Table::new([
        "beams",
        "p50 µs",
        "p99 µs",
        "two replicas, the slower half p50 µs",
        "throughput of two",
    ]);
    for (beams, scans) in [(1000, 1000), (8000, 300)] {
        let cost = cost(beams, scans);
        let gain = mean(&cost.whole_us) / mean(&cost.halves_us);
        table.row([
            beams.to_string(),
            figure(quantile(&cost.whole_us, 0.5), 0),
            figure(quantile(&cost.whole_us, 0.99), 0),
            figure(quantile(&cost.halves_us, 0.5), 0),
            format!("{gain:.2} ×"),
        ]);
    }
    format!(
        "The cleaner's logic on every scan of a drive through the office, 360° and 12 m; asked: p99 under 1 ms with 1000 beams, 1.6 times the throughput with two replicas on 8000 beams. Of two \
         replicas each judges half of the circle; their throughput is taken from the slower of the two and what is concluded from both.\n\n{table}"
    )
}
