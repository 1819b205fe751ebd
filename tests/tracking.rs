//! People who walk around the robot are followed: against the exact truth of simulated drives.

use crate::support::TrackFigures;

#[test]
fn people_are_followed() {
    let figures = TrackFigures::of_drives(1..=12);
    let (rmse_m, speed_error_m_s) = (figures.rmse_m(), figures.speed_error_m_s());
    let TrackFigures { positions, hidden, recognised, nobodys, .. } = figures;
    println!(
        "{positions} sightings: centre {rmse_m:.3} m RMSE, speed off by {speed_error_m_s:.3} m/s, {recognised} of {hidden} \
         recognised after being hidden, {nobodys} sightings of nobody"
    );
    assert!(positions > 6000 && rmse_m < 0.10, "{positions}: {rmse_m} m");
    assert!(speed_error_m_s < 0.15, "{speed_error_m_s} m/s");
    assert!(hidden > 100 && recognised * 10 >= hidden * 9, "{recognised} of {hidden}");
    assert!(nobodys * 10 < positions, "{nobodys} of {positions}");
}
