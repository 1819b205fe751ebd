//! People who walk around the robot are followed: against the exact truth of simulated drives.

mod support;

use support::TrackFigures;

#[test]
fn people_are_followed() {
    let figures = TrackFigures::of_drives(1..=4);
    let (rmse_m, speed_error_m_s) = (figures.rmse_m(), figures.speed_error_m_s());
    let TrackFigures { positions, hidden, recognised, nobodys, .. } = figures;
    println!(
        "{positions} sightings: centre {rmse_m:.3} m RMSE, speed off by {speed_error_m_s:.3} m/s, {recognised} of {hidden} \
         recognised after being hidden, {nobodys} sightings of nobody"
    );
    assert!(positions > 2000 && rmse_m < 0.10, "{positions}: {rmse_m} m");
    assert!(speed_error_m_s < 0.15, "{speed_error_m_s} m/s");
    // Who turns or stops while hidden is not where a constant velocity looks for them.
    assert!(hidden > 20 && recognised * 10 >= hidden * 7, "{recognised} of {hidden}");
    assert!(nobodys * 10 < positions, "{nobodys} of {positions}");
}
