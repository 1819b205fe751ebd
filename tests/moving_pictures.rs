//! Pictures of worlds that move, for docs/moving-world.md.

use crate::support;
use crate::support::experiments::{BEARING_SIGMA_RAD, flat, one_mover};
use crate::support::ndt_system::{PLAIN, run_ndt};
use crate::support::{UNCLEANED, followed_from_a_stand, montage, panel, picture_of_ways, store_picture};
use std::path::Path;

/// Where the pictures go.
const PICTURES: &str = "FLOCKSLAM_PICTURES";

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

/// `FLOCKSLAM_PICTURES=docs/images cargo test --test moving_pictures -- --ignored --nocapture`; the path is seen from `orchestration`,
/// or absolute.
#[test]
#[ignore = "pictures for people"]
fn pictures_of_worlds_that_move() {
    let Some(to) = std::env::var_os(PICTURES) else { return };
    let to = Path::new(&to);
    std::fs::create_dir_all(to).unwrap();
    experiments(to);
    let Some(data) = support::data_dir() else { return };
    people(&data, to);
    real_logs(&data, to);
}

/// In a real hall, from a lidar that stands still: whoever is followed walks, and nobody is followed at rest on the walls.
#[test]
fn people_in_a_hall_are_followed_from_a_stand() {
    let Some(data) = support::data_dir() else { return };
    let seen = followed_from_a_stand(&data.join("people/leg_tracker_stationary.bag"));
    let walked = seen.ways.values().filter(|way| {
        let farthest_m = way.iter().map(|at| at.distance_m(way[0])).fold(0.0, f64::max);
        farthest_m > 2.0
    });
    let walked = walked.count();
    println!("{} tracks of a second and more, {walked} of them over two metres", seen.ways.len());
    assert!(walked >= 5, "{walked} of {}", seen.ways.len());
    assert!(2 * walked >= seen.ways.len(), "{walked} of {}", seen.ways.len());
}
