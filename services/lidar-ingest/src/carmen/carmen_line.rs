//! Parses one line of a CARMEN log: text in, a scan or the reason for its rejection out.

use super::Rejection;
use crate::Settings;
use crate::settings::{BEAMS_MAX, RANGE_MIN_M};
use crate::stamp::parse_stamp_ns;
use flockslam_geometry::Pose;
use flockslam_messages::{ScanBuffer, ScanHeader, ScanSections, Times};
use std::f64::consts::{FRAC_PI_2, PI};
use std::str::{FromStr, SplitAsciiWhitespace};

/// What a line of a log turned out to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Line {
    /// A scan, now in the buffer. `whole` when the unused fields were there as well.
    Scan { whole: bool },
    /// A known message that becomes no scan, with all its fields or not.
    Other { whole: bool },
    /// A message of an unknown kind.
    Unknown,
}

/// Messages that are known, with the number of fields behind the name of those that become no scan.
const OTHER_MESSAGES: [(&str, usize); 3] = [("ODOM", 9), ("PARAM", 2), ("SYNC", 1)];
const SCAN_MESSAGES: [&str; 2] = ["FLASER", "ROBOTLASER1"];

/// Stamp, host name and the logger's own stamp end every message; only the first is needed.
const TAIL_FIELDS: usize = 3;
/// Coordinates and angles beyond are garbage: metres, radians.
const ABSURD: f64 = 1e8;
/// Poses in logs have six decimals. Rounding to this, metres and radians, gives every scan the same mounting pose.
const MOUNT_STEP: f64 = 1e-5;

/// Reads one line (without its end) into `scan`. Its memory is used again; on a rejection its content is undefined.
pub(super) fn parse_line(line: &[u8], settings: &Settings, scan: &mut ScanBuffer) -> Result<Line, Rejection> {
    let text = std::str::from_utf8(line).map_err(|_| Rejection::NotText)?;
    let mut fields = Fields(text.split_ascii_whitespace());
    let Some(message) = fields.0.next() else { return Ok(Line::Other { whole: true }) };
    match message {
        "FLASER" => flaser(fields, line.len(), settings, scan),
        "ROBOTLASER1" => robotlaser(fields, line.len(), settings, scan),
        comment if comment.starts_with('#') => Ok(Line::Other { whole: true }),
        other if other.contains('\0') => Err(Rejection::NotText),
        other => Ok(match OTHER_MESSAGES.iter().find(|(name, _)| *name == other) {
            Some((_, needed)) => Line::Other { whole: fields.0.count() >= *needed },
            None => Line::Unknown,
        }),
    }
}

/// Whether the line could be the start of a known message's name.
pub(super) fn begins_a_message(line: &[u8]) -> bool {
    let names = OTHER_MESSAGES.iter().map(|(name, _)| *name).chain(SCAN_MESSAGES);
    !line.is_empty() && names.into_iter().any(|name| name.as_bytes().starts_with(line))
}

/// `FLASER n r_1 … r_n x y theta odom_x odom_y odom_theta stamp host logger_stamp`
fn flaser(
    mut fields: Fields<'_>,
    bytes: usize,
    settings: &Settings,
    scan: &mut ScanBuffer,
) -> Result<Line, Rejection> {
    let beams = fields.beam_count(bytes)?;
    scan.numbers.clear();
    fields.numbers(beams, &mut scan.numbers)?;
    let (odom_from_laser, odom_from_base) = (fields.pose()?, fields.pose()?);
    let (stamp_ns, whole) = fields.tail()?;
    scan.header = ScanHeader {
        angle_min_rad: -FRAC_PI_2,
        angle_increment_rad: half_turn_increment_rad(beams),
        range_min_m: RANGE_MIN_M,
        range_max_m: settings.range_max_m,
        ..common_header(beams, odom_from_laser, odom_from_base, stamp_ns)
    };
    Ok(Line::Scan { whole })
}

/// `ROBOTLASER1 type start_angle field_of_view resolution maximum_range accuracy remission_mode n r_1 … r_n
/// m rem_1 … rem_m laser_x laser_y laser_th robot_x robot_y robot_th tv rv forward side turn_axis stamp host logger_stamp`
fn robotlaser(
    mut fields: Fields<'_>,
    bytes: usize,
    settings: &Settings,
    scan: &mut ScanBuffer,
) -> Result<Line, Rejection> {
    fields.skip(1)?;
    let start_angle_rad = fields.sensible()?;
    let field_of_view_rad = fields.sensible()?;
    let resolution_rad = fields.sensible()?;
    let maximum_range_m: f32 = fields.parse()?;
    fields.skip(2)?;
    let beams = fields.beam_count(bytes)?;
    scan.numbers.clear();
    fields.numbers(beams, &mut scan.numbers)?;
    let has_intensities = fields.remissions(beams, &mut scan.numbers)?;
    let (odom_from_laser, odom_from_base) = (fields.pose()?, fields.pose()?);
    fields.skip(5)?;
    let (stamp_ns, whole) = fields.tail()?;
    let even_rad = field_of_view_rad / (beams.max(2) - 1) as f64;
    scan.header = ScanHeader {
        angle_min_rad: start_angle_rad,
        angle_increment_rad: if resolution_rad == 0.0 { even_rad } else { resolution_rad },
        range_min_m: RANGE_MIN_M,
        range_max_m: last_return_m(maximum_range_m, settings),
        sections: if has_intensities { ScanSections::INTENSITIES } else { 0 },
        ..common_header(beams, odom_from_laser, odom_from_base, stamp_ns)
    };
    Ok(Line::Scan { whole })
}

fn common_header(beams: usize, odom_from_laser: Pose, odom_from_base: Pose, stamp_ns: i64) -> ScanHeader {
    let mount = odom_from_base.to(odom_from_laser);
    // Adding zero turns -0 into 0.
    let round = |value: f64| (value / MOUNT_STEP).round() * MOUNT_STEP + 0.0;
    ScanHeader {
        times: Times { sensor_ns: stamp_ns, ..Times::default() },
        base_from_laser: Pose::new(round(mount.x_m), round(mount.y_m), round(mount.heading_rad)),
        odometry: odom_from_base,
        has_odometry: 1,
        beam_count: u32::try_from(beams).expect("the number of beams is bounded by a u32"),
        ..ScanHeader::default()
    }
}

/// The step of a scanner with a field of 180°: an even number of beams leaves out the last one (180 end at +89°), an odd
/// number has it (181 and 361 end at +90°).
fn half_turn_increment_rad(beams: usize) -> f64 {
    let steps = if beams.is_multiple_of(2) { beams } else { beams - 1 };
    PI / steps.max(1) as f64
}

/// A sensor writes its maximum range, or more, where nothing came back: real returns lie below.
fn last_return_m(maximum_range_m: f32, settings: &Settings) -> f32 {
    let given = maximum_range_m.is_finite() && maximum_range_m > 0.0;
    if given { maximum_range_m.next_down() } else { settings.range_max_m }
}

/// What is left of a line.
struct Fields<'a>(SplitAsciiWhitespace<'a>);

impl<'a> Fields<'a> {
    fn text(&mut self) -> Result<&'a str, Rejection> {
        self.0.next().ok_or(Rejection::TooFewFields)
    }

    fn skip(&mut self, count: usize) -> Result<(), Rejection> {
        (0..count).try_for_each(|_| self.text().map(drop))
    }

    fn parse<T: FromStr>(&mut self) -> Result<T, Rejection> {
        self.text()?.parse().map_err(|_| Rejection::BadNumber)
    }

    /// An angle or coordinate.
    fn sensible(&mut self) -> Result<f64, Rejection> {
        let value: f64 = self.parse()?;
        if value.abs() <= ABSURD { Ok(value) } else { Err(Rejection::BadPose) }
    }

    fn pose(&mut self) -> Result<Pose, Rejection> {
        Ok(Pose::new(self.sensible()?, self.sensible()?, self.sensible()?))
    }

    /// The number of beams, bounded, also by what the line can hold: two bytes a beam.
    fn beam_count(&mut self, bytes: usize) -> Result<usize, Rejection> {
        let count: u32 = self.text()?.parse().map_err(|_| Rejection::BeamCount)?;
        match count as usize {
            0 => Err(Rejection::BeamCount),
            _ if count > BEAMS_MAX => Err(Rejection::BeamCount),
            beams if beams > bytes / 2 => Err(Rejection::TooFewFields),
            beams => Ok(beams),
        }
    }

    fn numbers(&mut self, count: usize, into: &mut Vec<f32>) -> Result<(), Rejection> {
        into.reserve(count);
        for _ in 0..count {
            into.push(self.parse()?);
        }
        Ok(())
    }

    /// `m rem_1 … rem_m`, kept only when there is one for each beam.
    fn remissions(&mut self, beams: usize, into: &mut Vec<f32>) -> Result<bool, Rejection> {
        let count: u32 = self.text()?.parse().map_err(|_| Rejection::BeamCount)?;
        if count as usize == beams {
            self.numbers(beams, into)?;
            return Ok(true);
        }
        self.skip(count as usize)?;
        Ok(false)
    }

    /// The stamp, and whether host and logger's stamp follow.
    fn tail(mut self) -> Result<(i64, bool), Rejection> {
        let stamp_ns = parse_stamp_ns(self.text()?).ok_or(Rejection::BadStamp)?;
        match 1 + self.0.count() {
            fields if fields > TAIL_FIELDS => Err(Rejection::TooManyFields),
            fields => Ok((stamp_ns, fields == TAIL_FIELDS)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(line: &str) -> Result<ScanBuffer, Rejection> {
        let mut scan = ScanBuffer::default();
        let found = parse_line(line.as_bytes(), &Settings::default(), &mut scan)?;
        assert!(matches!(found, Line::Scan { .. }), "{found:?}");
        Ok(scan)
    }

    fn flaser_line(beams: usize) -> String {
        format!("FLASER {beams} {} 1.0 2.04 1.570796 1.0 2.0 1.570796 12.25 host 0.1", "1.5 ".repeat(beams))
    }

    #[test]
    fn flaser_becomes_a_scan() {
        let scan =
            parse("FLASER 4 1.5 81.83 nan 0.01 1.002829 1.960100 -1.5 1.0 2.0 -1.5 976052905.167303 h 0.1")
                .unwrap();
        let view = scan.view().unwrap();
        assert_eq!((0..4).map(|i| view.valid_range_m(i)).collect::<Vec<_>>(), [Some(1.5), None, None, None]);
        assert_eq!(scan.header.times.sensor_ns, 976_052_905_167_303_000);
        assert!(scan.header.base_from_laser.distance_m(Pose::new(0.04, 0.0, 0.0)) < 1e-12);
        assert_eq!(view.odometry(), Some(Pose::new(1.0, 2.0, -1.5)));
    }

    #[test]
    fn beam_counts_decide_the_angles() {
        for (beams, step_deg, last_deg) in
            [(180, 1.0, 89.0), (181, 1.0, 90.0), (360, 0.5, 89.5), (361, 0.5, 90.0), (1, 180.0, -90.0)]
        {
            let scan = parse(&flaser_line(beams)).unwrap();
            let view = scan.view().unwrap();
            assert!((view.header().angle_increment_rad.to_degrees() - step_deg).abs() < 1e-9);
            assert!((view.angle_rad(beams - 1).to_degrees() - last_deg).abs() < 1e-9);
        }
    }

    #[test]
    fn robotlaser_gives_its_own_angles_limit_and_remissions() {
        let line = "ROBOTLASER1 0 -1.2 2.0 0.5 80.0 0.01 0 3 1.0 80.0 81.9 3 10 20 30 0.1 0 0 0 0 0 \
                    0.5 0.1 0.2 0.2 0 7.000001 host 0.1";
        let scan = parse(line).unwrap();
        let view = scan.view().unwrap();
        assert!((view.angle_rad(2) + 0.2).abs() < 1e-12);
        assert_eq!(scan.header.times.sensor_ns, 7_000_001_000);
        assert_eq!((0..3).map(|i| view.valid_range_m(i)).collect::<Vec<_>>(), [Some(1.0), None, None]);
        assert_eq!(view.intensities(), Some(&[10.0, 20.0, 30.0][..]));
        assert!((scan.header.base_from_laser.x_m - 0.1).abs() < 1e-12);
        let without = line.replace(" 3 10 20 30 ", " 0 ").replace(" 0.5 80.0 ", " 0 80.0 ");
        let scan = parse(&without).unwrap();
        assert_eq!((scan.view().unwrap().intensities(), scan.header.angle_increment_rad), (None, 1.0));
    }

    #[test]
    fn bad_lines_give_the_reason() {
        let cases = [
            ("FLASER", Rejection::TooFewFields),
            ("FLASER 0 1 2 3 4 5 6 7", Rejection::BeamCount),
            ("FLASER -3 1", Rejection::BeamCount),
            ("FLASER 4000000000 1 2 3", Rejection::BeamCount),
            ("FLASER 9000000 1 2 3", Rejection::TooFewFields),
            ("FLASER 2 1.0 2.0 0 0 0 0 0", Rejection::TooFewFields),
            ("FLASER 2 1.0 x 0 0 0 0 0 0 1.0 h 1", Rejection::BadNumber),
            ("FLASER 2 1.0 2.0 3.0 0 0 0 0 0 0 1.0 h 1", Rejection::TooManyFields),
            ("FLASER 2 1.0 0 0 0 0 0 0 1.0 h 1", Rejection::BadStamp),
            ("FLASER 2 1.0 2.0 nan 0 0 0 0 0 1.0 h 1", Rejection::BadPose),
            ("FLASER 2 1.0 2.0 0 0 0 0 inf 0 1.0 h 1", Rejection::BadPose),
            ("FLASER 2 1.0 2.0 0 0 0 0 0 0 nan h 1", Rejection::BadStamp),
            ("ROBOTLASER1 0 nan 3 0.01 80 0 0 1 1.0 0", Rejection::BadPose),
        ];
        for (line, reason) in cases {
            assert_eq!(parse(line).unwrap_err(), reason, "{line}");
        }
        let mut scan = ScanBuffer::default();
        assert_eq!(parse_line(b"FLASER 1 \xff", &Settings::default(), &mut scan), Err(Rejection::NotText));
    }

    #[test]
    fn a_count_that_is_off_by_a_few_is_noticed() {
        for announced in (170..180).chain(181..190) {
            let line = flaser_line(180).replacen("180", &announced.to_string(), 1);
            assert!(parse(&line).is_err(), "{announced}");
        }
    }
}
