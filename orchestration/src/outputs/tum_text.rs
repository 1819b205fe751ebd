//! Trajectories as TUM text. Stamps are written by integer arithmetic, so they lose nothing down to the microsecond.

use super::{OutputError, put_by};
use flockslam_geometry::Pose;
use flockslam_geometry::elementary::sin_cos;
use std::fmt::Write;
use std::io::{self, BufWriter};
use std::path::Path;

/// Where the robot was at a stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryPoint {
    /// Sensor stamp, nanoseconds.
    pub stamp_ns: i64,
    /// `map_from_base`.
    pub map_from_base: Pose,
}

/// A trajectory as TUM text: `t x y z qx qy qz qw`, one line for each point in the given order.
pub fn render_trajectory(points: &[TrajectoryPoint]) -> Vec<u8> {
    let mut text = String::with_capacity(points.len() * 96);
    for point in points {
        write_line(&mut text, point).expect("a string takes any text");
    }
    text.into_bytes()
}

/// Writes [`render_trajectory`] to `path`.
///
/// # Errors
/// When the disk refuses.
pub fn write_trajectory(path: &Path, points: &[TrajectoryPoint]) -> Result<(), OutputError> {
    // Line by line: the text of a long drive takes more memory than its poses.
    put_by(path, |file| {
        let (mut file, mut line) = (BufWriter::new(file), String::new());
        for point in points {
            line.clear();
            write_line(&mut line, point).expect("a string takes any text");
            io::Write::write_all(&mut file, line.as_bytes())?;
        }
        io::Write::flush(&mut file)
    })
}

fn write_line(text: &mut String, point: &TrajectoryPoint) -> std::fmt::Result {
    write_stamp(text, point.stamp_ns)?;
    let Pose { x_m, y_m, heading_rad } = point.map_from_base;
    let (sin, cos) = sin_cos(0.5 * heading_rad);
    writeln!(
        text,
        " {:.6} {:.6} 0.000000 0.000000000 0.000000000 {:.9} {:.9}",
        without_minus_zero(x_m, 1e6),
        without_minus_zero(y_m, 1e6),
        without_minus_zero(sin, 1e9),
        without_minus_zero(cos, 1e9)
    )
}

/// Seconds with exactly six decimals, by integers alone: stamps of logs come back as they were.
fn write_stamp(text: &mut String, stamp_ns: i64) -> std::fmt::Result {
    let microseconds = (i128::from(stamp_ns) + 500).div_euclid(1000);
    let sign = if microseconds < 0 { "-" } else { "" };
    let size = microseconds.unsigned_abs();
    write!(text, "{sign}{}.{:06}", size / 1_000_000, size % 1_000_000)
}

/// A value that would be printed as `-0.000` becomes plain zero.
fn without_minus_zero(value: f64, scale: f64) -> f64 {
    if (value * scale).abs() < 0.5 { 0.0 } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn line(stamp_ns: i64, pose: Pose) -> String {
        String::from_utf8(render_trajectory(&[TrajectoryPoint { stamp_ns, map_from_base: pose }])).unwrap()
    }

    fn stamp(stamp_ns: i64) -> String {
        line(stamp_ns, Pose::IDENTITY).split(' ').next().unwrap().to_owned()
    }

    #[test]
    fn lines_are_tum_lines() {
        assert_eq!(
            line(976_052_857_338_429_000, Pose::new(1.25, -1e-9, std::f64::consts::FRAC_PI_2)),
            "976052857.338429 1.250000 0.000000 0.000000 0.000000000 0.000000000 0.707106781 0.707106781\n"
        );
    }

    #[test]
    fn stamps_are_rounded_to_microseconds_whatever_their_sign() {
        for (ns, text) in [
            (0, "0.000000"),
            (499, "0.000000"),
            (500, "0.000001"),
            (-500, "0.000000"),
            (-501, "-0.000001"),
            (-1_000_000_001, "-1.000000"),
            (999_999_999, "1.000000"),
            (i64::MAX, "9223372036.854776"),
            (i64::MIN, "-9223372036.854776"),
        ] {
            assert_eq!(stamp(ns), text, "{ns}");
        }
    }

    proptest! {
        #[test]
        fn microseconds_round_trip_exactly(microseconds in -4_000_000_000_000_000_i64..4_000_000_000_000_000) {
            let digits = stamp(microseconds * 1000).replace('.', "");
            prop_assert_eq!(digits.parse::<i64>().unwrap(), microseconds);
        }
    }
}
