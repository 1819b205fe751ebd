//! Reads the text formats of evaluation line by line: TUM trajectories, and what relations share with them.

use crate::outputs::TrajectoryPoint;
use flockslam_geometry::Pose;
use flockslam_geometry::elementary::atan2;
use flockslam_lidar_ingest::stamp::parse_stamp_ns;

/// Why there is nothing to evaluate.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EvaluationError {
    /// A line that is no pose or relation.
    #[error("{source_name}:{line}: {reason}")]
    Line {
        /// The file.
        source_name: String,
        /// The line, from 1.
        line: usize,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// Nothing but comments.
    #[error("{source_name}:1: no line with {what}")]
    Empty {
        /// The file.
        source_name: String,
        /// What was expected.
        what: &'static str,
    },
    /// Two trajectories with nothing in common.
    #[error("the trajectory and the truth have {0} stamps in common, at least 2 are needed")]
    NoCommonStamps(usize),
}

/// Reads a TUM trajectory: lines `t x y z qx qy qz qw`, separated by blanks, `#` comments. z and the tilt are ignored, as
/// the robot drives in a plane. `source_name` stands for the file in errors.
///
/// # Errors
/// When a line is no pose, or there is none.
pub fn parse_tum(source_name: &str, bytes: &[u8]) -> Result<Vec<TrajectoryPoint>, EvaluationError> {
    parse_lines(source_name, bytes, "a pose", |fields| {
        let stamp_ns = stamp(fields[0])?;
        let [x_m, y_m, qz, qw] = [1, 2, 6, 7].map(|i| number(fields[i]));
        let heading_rad = 2.0 * atan2(qz?, qw?);
        Ok(TrajectoryPoint { stamp_ns, map_from_base: Pose::new(x_m?, y_m?, heading_rad) })
    })
}

/// Reads lines of at least eight fields; empty ones and comments are passed over.
pub(super) fn parse_lines<T>(
    source_name: &str,
    bytes: &[u8],
    what: &'static str,
    parse: impl Fn(&[&str]) -> Result<T, &'static str>,
) -> Result<Vec<T>, EvaluationError> {
    let mut items = Vec::new();
    for (index, line) in bytes.split(|byte| *byte == b'\n').enumerate() {
        let error =
            |reason| EvaluationError::Line { source_name: source_name.to_owned(), line: index + 1, reason };
        let text = std::str::from_utf8(line).map_err(|_| error("not text"))?;
        let fields: Vec<&str> = text.split_ascii_whitespace().collect();
        if fields.first().is_none_or(|first| first.starts_with('#')) {
            continue;
        }
        if fields.len() < 8 {
            return Err(error("the line has fewer than 8 fields"));
        }
        items.push(parse(&fields).map_err(error)?);
    }
    if items.is_empty() {
        return Err(EvaluationError::Empty { source_name: source_name.to_owned(), what });
    }
    Ok(items)
}

/// A stamp in nanoseconds.
pub(super) fn stamp(field: &str) -> Result<i64, &'static str> {
    parse_stamp_ns(field).ok_or("the time stamp is not a number")
}

/// A finite number.
pub(super) fn number(field: &str) -> Result<f64, &'static str> {
    field.parse().ok().filter(|value: &f64| value.is_finite()).ok_or("a field is not a finite number")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn error(text: &str) -> String {
        parse_tum("a.tum", text.as_bytes()).unwrap_err().to_string()
    }

    #[test]
    fn poses_are_read() {
        let text = "# t x y z qx qy qz qw\n\n976052905.167303 1 2 0 0 0 0.707106781 0.707106781\r\n";
        let points = parse_tum("a.tum", text.as_bytes()).unwrap();
        assert_eq!((points.len(), points[0].stamp_ns), (1, 976_052_905_167_303_000));
        let pose = points[0].map_from_base;
        assert!(
            (pose.heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-8
                && (pose.x_m, pose.y_m) == (1.0, 2.0)
        );
    }

    #[test]
    fn errors_name_file_and_line() {
        assert_eq!(error("# nothing\n"), "a.tum:1: no line with a pose");
        assert_eq!(error("1 2 3 0 0 0 0 1\n1 2 3\n"), "a.tum:2: the line has fewer than 8 fields");
        assert_eq!(error("1 nan 3 0 0 0 0 1"), "a.tum:1: a field is not a finite number");
        assert_eq!(error("x 2 3 0 0 0 0 1"), "a.tum:1: the time stamp is not a number");
        assert_eq!(parse_tum("a.tum", b"\xff").unwrap_err().to_string(), "a.tum:1: not text");
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse_tum("a.tum", &bytes);
        }
    }
}
