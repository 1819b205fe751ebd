//! Writes a scan as a line of a CARMEN log.

use crate::stamp::StampText;
use flockslam_messages::ScanView;
use std::io::{self, Write};

/// Writes a scan as a ROBOTLASER1 line, its end included.
///
/// All numbers are written so that reading gives them back to the bit; NaN and infinities as `NaN`, `inf`, `-inf`. The
/// format has no place for explicit angles, beam times and the smallest range: these are lost, and a scan without odometry
/// is written as if the robot stood at the origin.
///
/// # Errors
/// Those of `out`.
pub fn write_scan(out: &mut impl Write, scan: ScanView<'_>) -> io::Result<()> {
    let header = scan.header();
    let beams = scan.len();
    let field_of_view_rad = header.angle_increment_rad * (beams.max(1) - 1) as f64;
    write!(
        out,
        "ROBOTLASER1 0 {} {field_of_view_rad} {} {} 0 0 {beams}",
        header.angle_min_rad,
        header.angle_increment_rad,
        // The field is the first range that is no return.
        header.range_max_m.next_up(),
    )?;
    scan.ranges().iter().try_for_each(|range| write!(out, " {range}"))?;
    match scan.intensities() {
        Some(intensities) => {
            write!(out, " {beams}")?;
            intensities.iter().try_for_each(|intensity| write!(out, " {intensity}"))?;
        }
        None => write!(out, " 0")?,
    }
    for pose in [header.odometry * header.base_from_laser, header.odometry] {
        write!(out, " {} {} {}", pose.x_m, pose.y_m, pose.heading_rad)?;
    }
    let stamp = StampText(header.times.sensor_ns);
    writeln!(out, " 0 0 0 0 0 {stamp} localhost {stamp}")
}

#[cfg(test)]
mod tests {
    use crate::Settings;
    use crate::carmen::{CarmenReader, write_scan};
    use crate::settings::RANGE_MIN_M;
    use flockslam_geometry::Pose;
    use flockslam_messages::{ScanBuffer, ScanSections};
    use proptest::prelude::*;

    fn number() -> impl Strategy<Value = f32> {
        prop_oneof![8 => 0.0f32..100.0, 1 => Just(f32::INFINITY), 1 => any::<f32>().prop_filter("no NaN", |v| !v.is_nan())]
    }

    fn pose(size_m: f64) -> impl Strategy<Value = Pose> {
        (-size_m..size_m, -size_m..size_m, -3.0..3.0f64).prop_map(|(x, y, heading)| Pose::new(x, y, heading))
    }

    prop_compose! {
        fn scan()(ranges in prop::collection::vec(number(), 2..50))(
            intensities in prop::option::of(prop::collection::vec(number(), ranges.len())),
            ranges in Just(ranges),
            angle_min_rad in -4.0..4.0f64,
            angle_increment_rad in 0.001..0.1f64,
            range_max_m in 1.0f32..200.0,
            odometry in pose(1000.0),
            mount in pose(1.0),
            stamp_us in -1_000_000_000_000i64..2_000_000_000_000_000,
        ) -> ScanBuffer {
            let mut scan = ScanBuffer::from_ranges(&ranges, angle_min_rad, angle_increment_rad);
            scan.header.range_min_m = RANGE_MIN_M;
            (scan.header.range_max_m, scan.header.odometry, scan.header.has_odometry) = (range_max_m, odometry, 1);
            (scan.header.base_from_laser, scan.header.times.sensor_ns) = (mount, stamp_us * 1000);
            if let Some(intensities) = intensities {
                scan.header.sections = ScanSections::INTENSITIES;
                scan.numbers.extend(intensities);
            }
            scan
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(written in scan()) {
            let mut text = Vec::new();
            write_scan(&mut text, written.view().unwrap()).unwrap();
            let mut read = ScanBuffer::default();
            let mut reader = CarmenReader::new(&text[..], "pipe", Settings::default());
            prop_assert!(reader.next_scan(&mut read).unwrap());
            let (mount, expected) = (read.header.base_from_laser, written.header.base_from_laser);
            // Mounting poses are read to 0.01 mm.
            prop_assert!(mount.distance_m(expected) < 1e-5 && mount.turn_rad(expected) < 1e-5);
            read.header.base_from_laser = expected;
            prop_assert_eq!(&read, &written);
            prop_assert!(!reader.next_scan(&mut read).unwrap());
        }
    }
}
