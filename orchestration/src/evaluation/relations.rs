//! Compares a trajectory with relations between pairs of its poses: Kümmerle et al. 2009.

use super::spread::{SPREAD_COLUMNS, row};
use super::text::{number, parse_lines, stamp};
use super::{EvaluationError, Spread};
use crate::outputs::TrajectoryPoint;
use flockslam_geometry::Pose;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Stamps that differ by at most this are the same. Those of logs have microseconds; the tolerance is that of the
/// reference evaluator.
const TOLERANCE_NS: i64 = 20_000;
/// Poses at least this far apart in time make a relation a loop.
const LOOP_NS: u64 = 60_000_000_000;

/// Ground truth between two poses of a robot (Kümmerle et al. 2009).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relation {
    /// Stamp of the first pose, nanoseconds.
    pub from_ns: i64,
    /// Stamp of the second pose, nanoseconds.
    pub to_ns: i64,
    /// The second pose as seen from the first.
    pub motion: Pose,
}

/// Errors over one group of relations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RelationGroup {
    /// Relations with both poses in the trajectory: the figures below are over these.
    pub n: usize,
    /// Relations for which the trajectory has no pose: failures.
    pub missing: usize,
    /// Translational errors, metres; `None` (JSON null) when n is 0.
    pub translation_m: Option<Spread>,
    /// Rotational errors, degrees; `None` (JSON null) when n is 0.
    pub rotation_deg: Option<Spread>,
}

/// Errors of a trajectory over relations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RelationsReport {
    /// Over all relations.
    pub all: RelationGroup,
    /// Over those of less than 60 s.
    pub short: RelationGroup,
    /// Over those of 60 s and more: loops.
    #[serde(rename = "loop")]
    pub loops: RelationGroup,
}

/// Reads relations: lines `t1 t2 dx dy dz roll pitch yaw`, of which dz, roll and pitch are ignored.
///
/// # Errors
/// When a line is no relation, or there is none.
pub fn parse_relations(source_name: &str, bytes: &[u8]) -> Result<Vec<Relation>, EvaluationError> {
    parse_lines(source_name, bytes, "a relation", |fields| {
        let motion = Pose::new(number(fields[2])?, number(fields[3])?, number(fields[7])?);
        Ok(Relation { from_ns: stamp(fields[0])?, to_ns: stamp(fields[1])?, motion })
    })
}

/// Compares a trajectory with relations: the error of one is `rel⁻¹ · (p1⁻¹ · p2)`.
///
/// The points may come in any order. Of several with the same stamp the first counts.
///
/// ```
/// use flockslam::evaluation::{EvaluationError, evaluate_relations, parse_relations, parse_tum};
///
/// // The robot drove 3 m, and the relation says 3.3 m.
/// let points = parse_tum("a.tum", b"0 0 0 0 0 0 0 1\n1 3 0 0 0 0 0 1\n")?;
/// let relations = parse_relations("a.relations", b"0 1 3.3 0 0 0 0 0\n0 9 1 0 0 0 0 0\n")?;
/// let report = evaluate_relations(&points, &relations);
/// assert_eq!((report.short.n, report.short.missing), (1, 1));
/// assert!(report.short.translation_m.is_some_and(|errors| (errors.mean - 0.3).abs() < 1e-9));
/// # Ok::<(), EvaluationError>(())
/// ```
pub fn evaluate_relations(points: &[TrajectoryPoint], relations: &[Relation]) -> RelationsReport {
    let mut by_stamp = points.to_vec();
    by_stamp.sort_by_key(|point| point.stamp_ns);
    let (mut short, mut loops) = (Errors::default(), Errors::default());
    for relation in relations {
        let is_loop = relation.to_ns.abs_diff(relation.from_ns) >= LOOP_NS;
        let group = if is_loop { &mut loops } else { &mut short };
        match (pose_at(&by_stamp, relation.from_ns), pose_at(&by_stamp, relation.to_ns)) {
            (Some(from), Some(to)) => group.add(relation.motion.to(from.to(to))),
            _ => group.missing += 1,
        }
    }
    RelationsReport { all: short.with(&loops).group(), short: short.group(), loops: loops.group() }
}

/// The first pose within the tolerance around a stamp.
fn pose_at(by_stamp: &[TrajectoryPoint], stamp_ns: i64) -> Option<Pose> {
    let earliest_ns = stamp_ns.saturating_sub(TOLERANCE_NS);
    let point = by_stamp.get(by_stamp.partition_point(|point| point.stamp_ns < earliest_ns))?;
    (point.stamp_ns <= stamp_ns.saturating_add(TOLERANCE_NS)).then_some(point.map_from_base)
}

#[derive(Clone, Debug, Default)]
struct Errors {
    translation_m: Vec<f64>,
    rotation_deg: Vec<f64>,
    missing: usize,
}

impl Errors {
    fn add(&mut self, error: Pose) {
        self.translation_m.push(error.position().norm_m());
        self.rotation_deg.push(error.heading_rad.abs().to_degrees());
    }

    fn with(&self, other: &Self) -> Self {
        Self {
            translation_m: [&self.translation_m[..], &other.translation_m].concat(),
            rotation_deg: [&self.rotation_deg[..], &other.rotation_deg].concat(),
            missing: self.missing + other.missing,
        }
    }

    fn group(&self) -> RelationGroup {
        RelationGroup {
            n: self.translation_m.len(),
            missing: self.missing,
            translation_m: Spread::of(&self.translation_m),
            rotation_deg: Spread::of(&self.rotation_deg),
        }
    }
}

impl fmt::Display for RelationsReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let groups = [("all", &self.all), ("short (< 60 s)", &self.short), ("loop (>= 60 s)", &self.loops)];
        writeln!(f, "{:<16}{:>7} {:>7}  {SPREAD_COLUMNS}", "translation [m]", "n", "missing")?;
        for (name, group) in groups {
            writeln!(f, "{name:<16}{:>7} {:>7}  {}", group.n, group.missing, row(group.translation_m, 4))?;
        }
        writeln!(f, "{:<16}{:>7} {:>7}  {SPREAD_COLUMNS}", "rotation [deg]", "n", "missing")?;
        for (name, group) in groups {
            writeln!(f, "{name:<16}{:>7} {:>7}  {}", group.n, group.missing, row(group.rotation_deg, 3))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::parse_tum;
    use crate::outputs::render_trajectory;
    use std::fmt::Write;
    use std::path::PathBuf;
    use std::process::Command;

    fn report(tum: &str, relations: &str) -> RelationsReport {
        let points = parse_tum("a.tum", tum.as_bytes()).unwrap();
        evaluate_relations(&points, &parse_relations("a.relations", relations.as_bytes()).unwrap())
    }

    /// Worked out by hand: the robot moved 1 m ahead and 1 m to the left and turned left by 90°, then drove 3 m ahead.
    /// For the second motion a relation says 3.3 m. For the first one a relation is 0.1 m and 0.1 rad off, and one is
    /// exact. Two name a stamp without a pose.
    #[test]
    fn errors_are_those_worked_out_by_hand() {
        let tum = "0 0 0 0 0 0 0 1\n1 1 1 0 0 0 0.7071067811865476 0.7071067811865476\n\
                   100 1 4 0 0 0 0.7071067811865476 0.7071067811865476\n";
        let relations = "1.000005 99.999995 3.3 0 0 0 0 0\n0 1 1 1.1 0 0 0 1.470796327\n0 1 1 1 0 0 0 1.570796327\n\
                         0 2 1 0 0 0 0 0\n1 500 0 0 0 0 0 0\n";
        let found = report(tum, relations);
        assert_eq!((found.all.n, found.all.missing), (3, 2));
        assert_eq!((found.short.n, found.short.missing, found.loops.n, found.loops.missing), (2, 1, 1, 1));
        let close = |a: f64, b: f64| (a - b).abs() < 1e-6;
        let metres = |group: RelationGroup| group.translation_m.unwrap();
        assert!(close(metres(found.loops).mean, 0.3) && close(metres(found.short).mean, 0.05));
        assert!(close(metres(found.short).std, 0.05) && close(metres(found.all).max, 0.3));
        assert!(close(metres(found.all).median, 0.1));
        assert!(close(found.short.rotation_deg.unwrap().max, 0.1f64.to_degrees()));
        assert!(found.to_string().contains("loop (>= 60 s)        1       1"), "{found}");
    }

    #[test]
    fn the_report_is_json_with_the_documented_names() {
        let json = serde_json::to_value(report("0 0 0 0 0 0 0 1\n", "0 0 1 0 0 0 0 0\n")).unwrap();
        assert_eq!(json["all"]["translation_m"]["mean"], 1.0);
        assert!(json["loop"]["translation_m"].is_null());
        assert_eq!((&json["loop"]["n"], &json["short"]["missing"]), (&0.into(), &0.into()));
        let names = |value: &serde_json::Value| {
            let mut names: Vec<String> = value.as_object().unwrap().keys().cloned().collect();
            names.sort();
            names
        };
        assert_eq!(names(&json), ["all", "loop", "short"]);
        assert_eq!(names(&json["loop"]), ["missing", "n", "rotation_deg", "translation_m"]);
        assert_eq!(names(&json["all"]["rotation_deg"]), ["max", "mean", "median", "rmse", "std"]);
    }

    /// Wavy trajectories with duplicate, unsorted and missing stamps, at the size of real ones.
    fn case(seed: f64, start_us: i64) -> (String, String) {
        let wave = |i: usize| Pose::new((seed + i as f64 * 0.1).sin() * 5.0, i as f64 * 0.05, i as f64 * 0.3);
        let stamp_ns = |i: usize| (start_us + i as i64 * 833_337) * 1000;
        let mut points: Vec<TrajectoryPoint> = (0..300)
            .filter(|i| i % 37 != 5)
            .map(|i| TrajectoryPoint { stamp_ns: stamp_ns(i * 7 % 300), map_from_base: wave(i * 7 % 300) })
            .collect();
        points
            .push(TrajectoryPoint { stamp_ns: points[3].stamp_ns, map_from_base: Pose::new(9.0, 9.0, 1.0) });
        points.push(TrajectoryPoint {
            stamp_ns: points[9].stamp_ns - 7_000,
            map_from_base: Pose::new(8.0, 9.0, 1.0),
        });
        let mut relations = String::from("# t1 t2 dx dy dz roll pitch yaw\n");
        for i in 0..250 {
            let (from, to) = (i, (i * i + 3) % 300);
            let motion =
                wave(from).to(wave(to)) * Pose::new(0.02 * seed.cos(), 0.01 * (i as f64).sin(), 0.01);
            let seconds = |i: usize| {
                let us = stamp_ns(i) / 1000 + 3;
                format!("{}.{:06}", us / 1_000_000, us % 1_000_000)
            };
            let Pose { x_m, y_m, heading_rad } = motion;
            writeln!(relations, "{} {} {x_m:.6} {y_m:.6} 0 0 0 {heading_rad:.6}", seconds(from), seconds(to))
                .unwrap();
        }
        (String::from_utf8(render_trajectory(&points)).unwrap(), relations)
    }

    fn reference_evaluator() -> Option<PathBuf> {
        let default = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
        let data = std::env::var_os("FLOCKSLAM_DATA").map_or(default, PathBuf::from);
        let tool = data.join("../tools/relations.py");
        let python =
            Command::new("python3").arg("--version").output().is_ok_and(|output| output.status.success());
        (python && tool.exists()).then_some(tool)
    }

    #[test]
    fn agrees_with_the_reference_evaluator() {
        let Some(tool) = reference_evaluator() else {
            eprintln!("NOT TESTED: python3 or ../shared/tools/relations.py is absent");
            return;
        };
        let directory = tempfile::tempdir().unwrap();
        let paths = ["a.tum", "a.relations"].map(|name| directory.path().join(name));
        for (seed, start_us) in [(0.3, 976_052_857_337_860), (1.7, 90_239_599)] {
            let (tum, relations) = case(seed, start_us);
            std::fs::write(&paths[0], &tum).unwrap();
            std::fs::write(&paths[1], &relations).unwrap();
            let output = Command::new("python3").arg(&tool).args(&paths).output().unwrap();
            let expected: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            let found = report(&tum, &relations);
            assert!(found.all.missing > 0 && found.loops.n > 0 && found.short.n > 0);
            for (name, group) in [("all", found.all), ("short", found.short), ("loop", found.loops)] {
                agree(&expected[name], &group);
            }
        }
    }

    fn agree(expected: &serde_json::Value, found: &RelationGroup) {
        assert_eq!((&expected["n"], &expected["missing"]), (&found.n.into(), &found.missing.into()));
        for (prefix, spread, tolerance) in
            [("t", found.translation_m.unwrap(), 2e-5), ("r", found.rotation_deg.unwrap(), 2e-4)]
        {
            let figures =
                [("mean", spread.mean), ("std", spread.std), ("median", spread.median), ("max", spread.max)];
            for (figure, value) in figures {
                // The evaluator prints maxima with one decimal less.
                let tolerance = if figure == "max" { 10.0 * tolerance } else { tolerance };
                // Nor does it print the median rotation.
                let Some(expected) = expected[format!("{prefix}_{figure}")].as_f64() else {
                    assert_eq!((prefix, figure), ("r", "median"));
                    continue;
                };
                assert!((expected - value).abs() < tolerance, "{prefix}_{figure}: {expected} {value}");
            }
        }
    }
}
