//! Returns from the robot's own body.

use flockslam_geometry::Pose;
use flockslam_geometry::elementary::{cos, sin};
use flockslam_messages::ScanBuffer;

/// Takes away the returns within boxes in the frame of the robot: the least and the greatest x, the least and the greatest y, metres.
/// A beam that ends on the robot has no information about the cells behind: it is invalid, not free.
pub fn mask(scan: &mut ScanBuffer, boxes: &[[f64; 4]]) {
    if boxes.is_empty() {
        return;
    }
    for beam in 0..scan.header.beam_count as usize {
        let Ok(view) = scan.view() else { return };
        let Some(range_m) = view.valid_range_m(beam) else { continue };
        let angle_rad = view.angle_rad(beam);
        let end =
            scan.header.base_from_laser * Pose::new(range_m * cos(angle_rad), range_m * sin(angle_rad), 0.0);
        let is_within = |[x, to_x, y, to_y]: &[f64; 4]| {
            (*x..=*to_x).contains(&end.x_m) && (*y..=*to_y).contains(&end.y_m)
        };
        if boxes.iter().any(is_within) {
            scan.numbers[beam] = f32::NAN;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn returns_from_the_robot_are_none() {
        let mut scan = ScanBuffer::from_ranges(&[0.4, 0.4, 0.6, 3.0], -1.0, 0.5);
        scan.header.base_from_laser = Pose::new(-0.2, 0.0, 1.0);
        mask(&mut scan, &[[-0.1, 0.3, -0.2, 0.2], [0.1, 0.4, 0.4, 0.6]]);
        let view = scan.view().unwrap();
        let found = [0, 1, 2, 3].map(|beam| view.valid_range_m(beam).is_some());
        // Twice into the first box, once into the second, once past both.
        assert_eq!(found, [false, false, false, true]);
    }
}
