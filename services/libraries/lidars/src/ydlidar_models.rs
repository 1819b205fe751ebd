//! Models of YDLIDAR, and how their numbers are to be read.
//!
//! Source: `YDLIDAR/YDLidar-SDK`: model numbers of `DriverInterface.h`, scales of `CYdLidar.cpp`, corrections of `YDlidarDriver.cpp`.

use flockslam_geometry::elementary::atan;

/// How a model measures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Optics {
    /// Millimetres of one count of a distance.
    pub mm_per_count: f64,
    /// The beam leaves beside the axis: directions are corrected by the distance.
    pub corrected: bool,
    /// The two lowest bits of a distance belong to the strength, if there is one.
    pub long_intensity: bool,
    /// Ranges above are no returns, metres.
    pub range_max_m: f32,
}

/// Triangulation: quarters of a millimetre, corrected.
pub(crate) const TRIANGLE: Optics =
    Optics { mm_per_count: 0.25, corrected: true, long_intensity: true, range_max_m: 12.0 };
/// Triangulation at the double rate: halves of a millimetre, corrected.
const OCTAVE: Optics = Optics { mm_per_count: 0.5, corrected: true, long_intensity: true, range_max_m: 25.0 };
/// The T-mini series: quarters of a millimetre, not corrected; the lowest bits of a distance mark glass and sunlight.
pub(crate) const T_MINI: Optics =
    Optics { mm_per_count: 0.25, corrected: false, long_intensity: false, range_max_m: 12.0 };
/// Time of flight: millimetres, not corrected.
const TIME_OF_FLIGHT: Optics =
    Optics { mm_per_count: 1.0, corrected: false, long_intensity: false, range_max_m: 50.0 };

/// The number of a model in its answer, its name, how it measures.
const MODELS: [(u8, &str, Optics); 27] = [
    (1, "F4", TRIANGLE),
    (2, "T1", TRIANGLE),
    (3, "F2", TRIANGLE),
    (4, "S4", TRIANGLE),
    (5, "G4", TRIANGLE),
    (6, "X4", TRIANGLE),
    (7, "G4PRO", TRIANGLE),
    (8, "F4PRO", TRIANGLE),
    (9, "R2", TRIANGLE),
    (10, "G10", TRIANGLE),
    (11, "S4B", TRIANGLE),
    (12, "S2", TRIANGLE),
    (13, "G6", OCTAVE),
    (14, "G2A", TRIANGLE),
    (15, "G2B", TRIANGLE),
    (16, "G2C", TRIANGLE),
    (17, "G4B", TRIANGLE),
    (18, "G4C", TRIANGLE),
    (19, "G1", TRIANGLE),
    (20, "G5", TRIANGLE),
    (21, "G7", OCTAVE),
    (100, "TG15", TIME_OF_FLIGHT),
    (101, "TG30", TIME_OF_FLIGHT),
    (102, "TG50", TIME_OF_FLIGHT),
    (140, "T-mini", T_MINI),
    (150, "T-mini Pro", T_MINI),
    (151, "T-mini Plus", T_MINI),
];

/// The X2 does not identify itself; it measures as the X4 does.
const X2: &str = "X2";

/// A model by the number in its answer.
pub(crate) fn by_number(number: u8) -> Option<(&'static str, Optics)> {
    MODELS.iter().find(|(model, _, _)| *model == number).map(|(_, name, optics)| (*name, *optics))
}

/// A model by its name, without regard to case, blanks and `-`.
pub(crate) fn by_name(name: &str) -> Option<(&'static str, Optics)> {
    let plain = |name: &str| name.replace([' ', '-', '_'], "").to_uppercase();
    let found = MODELS.iter().find(|(_, model, _)| plain(model) == plain(name));
    let x2 = (plain(name) == X2).then_some((X2, TRIANGLE));
    found.map(|(_, name, optics)| (*name, *optics)).or(x2)
}

/// By how much a beam of a lidar that triangulates goes beside where its head looks, degrees; `range_mm` of the return.
pub(crate) fn correction_deg(range_mm: f64) -> f64 {
    if range_mm <= 0.0 {
        return 0.0;
    }
    atan(21.8 * (155.3 - range_mm) / (155.3 * range_mm)).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_have_numbers_and_names() {
        assert_eq!(by_number(6).map(|(name, _)| name), Some("X4"));
        assert_eq!(by_name("tmini plus"), by_number(151));
        assert_eq!(by_name("x2"), Some(("X2", TRIANGLE)));
        assert_eq!((by_number(0), by_name("A1")), (None, None));
    }

    #[test]
    fn the_correction_is_that_of_the_protocol_document() {
        // YDLidar-SDK, Communication Protocol, "Angle analysis": its example has 1000 mm and 8000 mm.
        assert!((correction_deg(1000.0) + 6.7622).abs() < 1e-3);
        assert!((correction_deg(8000.0) + 7.8374).abs() < 1e-3);
        assert_eq!(correction_deg(0.0), 0.0);
    }
}
