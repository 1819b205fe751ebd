use flockslam_geometry::wrap_angle;
use flockslam_messages::ScanView;
use std::f64::consts::FRAC_PI_2;

/// How much a scan looks like one taken along a corridor, 0 … 1: `|Σ sgn(r_i − r_{i+1}) · front · left| / N` over
/// neighbouring valid beams, where `front` and `left` are ±1 in the robot's frame (An. Filatov 2021, chapter 4).
/// Between two parallel walls ranges grow towards front and back on both sides, so all terms have one sign.
pub(crate) fn corridor_share(scan: ScanView<'_>) -> f64 {
    let mounted_rad = scan.header().base_from_laser.heading_rad;
    let (mut sum, mut count) = (0_i64, 0_i64);
    let mut last: Option<f64> = None;
    for beam in 0..scan.len() {
        let range_m = scan.valid_range_m(beam);
        if let (Some(before), Some(here)) = (last, range_m) {
            let angle = wrap_angle(scan.angle_rad(beam) + mounted_rad);
            let same_sign = (angle.abs() < FRAC_PI_2) == (angle > 0.0);
            let falls = i64::from(before > here) - i64::from(before < here);
            sum += if same_sign { falls } else { -falls };
            count += 1;
        }
        last = range_m;
    }
    sum.abs() as f64 / count.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanBuffer;

    /// Ranges from a point between two walls at y = ±1.5 m, seen by 360 beams over the circle.
    fn between_walls(heading_rad: f64) -> ScanBuffer {
        let step = std::f64::consts::TAU / 360.0;
        let range = |i: i32| {
            let angle = f64::from(i) * step - std::f64::consts::PI + heading_rad;
            (1.5 / angle.sin().abs()).min(60.0) as f32
        };
        ScanBuffer::from_ranges(&(0..360).map(range).collect::<Vec<_>>(), -std::f64::consts::PI, step)
    }

    #[test]
    fn a_corridor_is_recognised_along_its_axis_and_a_circle_is_not_one() {
        assert!(corridor_share(between_walls(0.0).view().unwrap()) > 0.9);
        let circle = ScanBuffer::from_ranges(&[2.0; 360], -3.1, 0.017);
        assert_eq!(corridor_share(circle.view().unwrap()), 0.0);
    }

    #[test]
    fn the_mounting_is_taken_into_account() {
        let mut turned = between_walls(0.7);
        turned.header.base_from_laser.heading_rad = 0.7;
        assert!(corridor_share(turned.view().unwrap()) > 0.9);
    }

    #[test]
    fn scans_with_hardly_a_beam_are_defined() {
        for ranges in [&[][..], &[1.0], &[f32::NAN, 1.0, f32::INFINITY]] {
            assert_eq!(corridor_share(ScanBuffer::from_ranges(ranges, 0.0, 0.1).view().unwrap()), 0.0);
        }
    }
}
