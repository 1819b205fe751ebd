//! People who walk around the robot are followed: against the exact truth of simulated drives, and in a real hall.

use crate::support::data_dir;
use flockslam_drives::followed::{TrackFigures, followed_from_a_stand};

#[test]
fn people_are_followed() {
    let figures = TrackFigures::of_drives(1..=12);
    let (rmse_m, speed_error_m_s) = (figures.rmse_m(), figures.speed_error_m_s());
    let TrackFigures { positions, hidden, recognised, false_tracks, .. } = figures;
    println!(
        "{positions} sightings: centre {rmse_m:.3} m RMSE, speed off by {speed_error_m_s:.3} m/s, {recognised} of {hidden} \
         recognised after being hidden, {false_tracks} sightings of nobody"
    );
    assert!(positions > 6000 && rmse_m < 0.10, "{positions}: {rmse_m} m");
    assert!(speed_error_m_s < 0.15, "{speed_error_m_s} m/s");
    assert!(hidden > 100 && recognised * 10 >= hidden * 9, "{recognised} of {hidden}");
    assert!(false_tracks * 10 < positions, "{false_tracks} of {positions}");
}

/// In a real hall, from a lidar that stands still: tracked people walk, and no track stands still on the walls.
#[test]
fn people_in_a_hall_are_followed_from_a_stand() {
    let Some(data) = data_dir() else { return };
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
