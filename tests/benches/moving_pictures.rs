//! Pictures of worlds that move, for docs/moving-world.md: `cargo bench -p flockslam --bench moving_pictures -- $PWD/docs/images`.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use flockslam_drives::experiments::{BEARING_SIGMA_RAD, flat, one_mover};
use flockslam_drives::followed::followed_from_a_stand;
use std::path::Path;
use support::ndt_runs::{PLAIN, run_ndt};
use support::{UNCLEANED, montage, panel, picture_of_ways, store_picture};

fn experiments(to: &Path) {
    let ways = [&[PLAIN][..], &[]];
    let panels = |experiment, counts: &[usize], more: &[&str], (width, height)| {
        let of = |count: &usize| {
            let directory = tempfile::tempdir().unwrap();
            panel(&run_ndt(experiment, *count, directory.path(), more), width, height)
        };
        counts.iter().map(of).collect::<Vec<_>>()
    };
    let room = one_mover();
    let both: Vec<_> = ways.iter().flat_map(|more| panels(&room, &[8], more, (480, 360))).collect();
    store_picture(montage(&[both]), &to.join("moving-mover.png"));
    let flat = flat(BEARING_SIGMA_RAD);
    let rows = ways.map(|more| panels(&flat, &[1, 3, 6, 9, 10, 13], more, (300, 420)));
    store_picture(montage(&rows), &to.join("moving-flat.png"));
}

fn real_logs(data: &Path, to: &Path) {
    for (name, file, size) in
        [("fhw", "people/fhw-corrected.log", (340, 1240)), ("aces", "aces/aces.clf", (860, 860))]
    {
        let panels = [&UNCLEANED[..], &[]].map(|more| {
            let directory = tempfile::tempdir().unwrap();
            let mut args = vec!["map".to_owned(), data.join(file).display().to_string()];
            args.extend(more.iter().flat_map(|set| ["--set".to_owned(), (*set).to_owned()]));
            panel(&support::run_well("pictures", directory.path(), &args), size.0, size.1)
        });
        store_picture(montage(&[panels.to_vec()]), &to.join(format!("moving-{name}.png")));
    }
}

fn people(data: &Path, to: &Path) {
    let seen = followed_from_a_stand(&data.join("people/leg_tracker_stationary.bag"));
    println!("{} people followed", seen.ways.len());
    let picture = picture_of_ways(&seen.standing, seen.ways.values().map(Vec::as_slice));
    store_picture(picture, &to.join("moving-people.png"));
}

fn main() {
    // Cargo adds an option of its own.
    let to =
        std::env::args().skip(1).find(|argument| argument != "--bench").expect("where do the pictures go?");
    let to = Path::new(&to);
    std::fs::create_dir_all(to).unwrap();
    experiments(to);
    if let Some(data) = support::data_dir() {
        people(&data, to);
        real_logs(&data, to);
    }
}
