//! `cargo bench -p flockslam --bench unknown_starts -- MAP.yaml LOG TRAJECTORY.tum STARTS [elsewhere]`: robots that are switched on at unknown
//! poses in the second half of a CARMEN log look for themselves in a map, which was made of the first half; each drives up to 40 m. The
//! trajectory of the whole log serves as their front end and as the truth. With `elsewhere`, the map is of another building: robots start in
//! all of the log, and whatever they find is false. Prints each robot, how far they had to drive in mapped space, and what was false.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, reason = "another benchmark reads the rest")]
#[path = "../support/start_trials.rs"]
mod start_trials;

use flockslam::store::read_nav2_map;
use flockslam_evidence::CellState;
use flockslam_geometry::{Pose, Twist};
use flockslam_localisation::{KnownMap, Localizer, Surroundings};
use flockslam_loop_closure::scans::ScanStore;
use flockslam_messages::ScanBuffer;
use flockslam_registration::cloud::Placement;
use start_trials::{StartTrial, start_trial};
use std::error::Error;
use std::path::Path;

/// What is found farther from the truth is false, metres and radians; the map of half of ACES is up to 2.1 m from that of the whole.
const FALSE: (f64, f64) = (2.5, 0.15);

fn scans(log: &str, store: &mut ScanStore) -> Result<Vec<usize>, Box<dyn Error>> {
    let mut numbers = Vec::new();
    for line in log.lines().filter(|line| line.starts_with("FLASER ")) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let beams: usize = words[1].parse()?;
        let ranges: Result<Vec<f32>, _> = words[2..2 + beams].iter().map(|word| word.parse()).collect();
        let tail: Result<Vec<f64>, _> = words[2 + beams..8 + beams].iter().map(|word| word.parse()).collect();
        let tail = tail?;
        let step = 180.0 / if beams % 2 == 1 { beams - 1 } else { beams } as f64;
        let mut scan = ScanBuffer::from_ranges(&ranges?, (-90f64).to_radians(), step.to_radians());
        scan.header.range_max_m = 49.9;
        let (laser, robot) = (Pose::new(tail[0], tail[1], tail[2]), Pose::new(tail[3], tail[4], tail[5]));
        scan.header.base_from_laser = robot.to(laser);
        numbers.push(store.keep(scan.view()?, Twist::default(), &[], false));
    }
    Ok(numbers)
}

fn trajectory(text: &str) -> Result<Vec<Placement>, Box<dyn Error>> {
    let pose = |line: &str| -> Result<Placement, Box<dyn Error>> {
        let v: Vec<f64> = line.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        Ok(Placement::new(v[1], v[2], 2.0 * v[6].atan2(v[7])))
    };
    text.lines().filter(|line| !line.starts_with('#')).map(pose).collect()
}

/// Outcome of a robot's drive, in words.
fn outcome(trial: &StartTrial) -> String {
    let found = trial.found_after_m.map_or("not found".into(), |m| format!("found after {m:.1} m"));
    let lost = if trial.was_lost { ", lost again" } else { "" };
    let wrong = trial
        .false_place
        .map_or(String::new(), |(truth, said)| format!(", FALSE: at {truth:?} said to be at {said:?}"));
    format!("{found}{lost}{wrong}; {:.1} m in mapped space", trial.mapped_m)
}

fn main() -> Result<(), Box<dyn Error>> {
    // Cargo adds an option of its own.
    let arguments: Vec<String> = std::env::args().filter(|argument| argument != "--bench").collect();
    let (map, log, truth, starts, is_elsewhere) = match arguments.as_slice() {
        [_, map, log, truth, starts] => (map, log, truth, starts, false),
        [_, map, log, truth, starts, word] if word == "elsewhere" => (map, log, truth, starts, true),
        _ => {
            println!("unknown_starts needs MAP.yaml LOG TRAJECTORY.tum STARTS [elsewhere]");
            return Ok(());
        }
    };
    let stored = read_nav2_map(Path::new(map))?;
    let mut known = KnownMap::of_width(stored.width, stored.cell_size_m, stored.origin);
    stored.for_each_row(|row| known.push_row(row.iter().map(CellState::of)));
    let mut localizer = Localizer::new(Surroundings::new(known.measured()));
    let mut store = ScanStore::default();
    let scans = scans(&std::fs::read_to_string(log)?, &mut store)?;
    let way = trajectory(&std::fs::read_to_string(truth)?)?;
    let starts = starts.parse::<usize>()?;
    let (begin, false_from) = if is_elsewhere { (0, None) } else { (scans.len() / 2, Some(FALSE)) };
    let searches: Vec<StartTrial> = (0..starts)
        .map(|k| begin + (scans.len() - begin) * k / starts)
        .map(|first| {
            let trial = start_trial(&mut localizer, &way[first..], &scans[first..], &store, false_from);
            println!("scan {first}: {}", outcome(&trial));
            trial
        })
        .collect();
    let mut found_m: Vec<f64> = searches.iter().filter_map(|search| search.found_after_m).collect();
    found_m.sort_by(f64::total_cmp);
    let quantile = |share: f64| found_m.get((share * found_m.len() as f64) as usize).copied();
    let count = |is: fn(&StartTrial) -> bool| searches.iter().filter(|search| is(search)).count();
    println!(
        "{starts} starts: {} found after p50 {:.1?} m, p95 {:.1?} m in mapped space; {} false, {} lost again, {} not found in 5 m or more of mapped space; slowest step {:.2?}",
        found_m.len(),
        quantile(0.5),
        quantile(0.95),
        count(|search| search.false_place.is_some()),
        count(|search| search.was_lost),
        count(|search| search.found_after_m.is_none() && search.mapped_m >= 5.0),
        searches.iter().map(|search| search.slowest).max().unwrap_or_default(),
    );
    Ok(())
}
