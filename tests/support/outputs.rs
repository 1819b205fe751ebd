//! The files that a run has written, read back, and the error of its trajectory against the truth.

use flockslam::evaluation::{evaluate_truth, parse_tum};
use flockslam::outputs::{Report, TrajectoryPoint};
use flockslam_geometry::{Point, Pose};
use std::path::{Path, PathBuf};

/// What a run left in its directory, read back.
pub struct Outputs {
    pub directory: PathBuf,
    pub report: Report,
}

impl Outputs {
    /// Reads the report; the rest is read when it is asked for.
    pub fn read(directory: &Path) -> Self {
        let report = serde_json::from_slice(&bytes_of(directory, "report.json")).unwrap();
        Self { directory: directory.to_owned(), report }
    }

    /// The bytes of one output.
    pub fn bytes(&self, name: &str) -> Vec<u8> {
        bytes_of(&self.directory, name)
    }

    /// The lines of one output.
    pub fn lines(&self, name: &str) -> Vec<String> {
        String::from_utf8(self.bytes(name)).unwrap().lines().map(str::to_owned).collect()
    }

    /// The first field of every line of a trajectory.
    pub fn stamps(&self, name: &str) -> Vec<String> {
        self.lines(name).iter().map(|line| line.split(' ').next().unwrap().to_owned()).collect()
    }

    /// Each final pose with the true one.
    pub fn with_truth(&self) -> Vec<(TrajectoryPoint, TrajectoryPoint)> {
        let (last, truth) = (self.trajectory("trajectory.tum"), self.trajectory("truth.tum"));
        let exact = |pose: TrajectoryPoint| {
            let place = truth.binary_search_by_key(&pose.stamp_ns, |truth| truth.stamp_ns).ok()?;
            Some((pose, truth[place]))
        };
        last.into_iter().filter_map(exact).collect()
    }

    /// Where the world of the truth is in the map, by all poses: least squares.
    pub fn frame_from_truth(&self) -> Pose {
        let pairs: Vec<(Point, Point)> = self
            .with_truth()
            .iter()
            .map(|(pose, truth)| (pose.map_from_base.position(), truth.map_from_base.position()))
            .collect();
        let mean = |of: fn(&(Point, Point)) -> f64| pairs.iter().map(of).sum::<f64>() / pairs.len() as f64;
        let (x, y) = (mean(|pair| pair.0.x_m), mean(|pair| pair.0.y_m));
        let (world_x, world_y) = (mean(|pair| pair.1.x_m), mean(|pair| pair.1.y_m));
        let (mut cos, mut sin) = (0.0, 0.0);
        for (map, world) in &pairs {
            let (ax, ay, bx, by) = (world.x_m - world_x, world.y_m - world_y, map.x_m - x, map.y_m - y);
            (cos, sin) = (cos + ax * bx + ay * by, sin + ax * by - ay * bx);
        }
        let turned = Pose::new(0.0, 0.0, sin.atan2(cos));
        let at = turned.apply(Point::new(world_x, world_y));
        Pose::new(x - at.x_m, y - at.y_m, turned.heading_rad)
    }

    /// A trajectory.
    pub fn trajectory(&self, name: &str) -> Vec<TrajectoryPoint> {
        parse_tum(name, &self.bytes(name)).unwrap()
    }
}

/// Root mean square of the absolute translational error of the final trajectory, metres.
pub fn truth_error_m(outputs: &Outputs) -> f64 {
    known_truth_error_m(outputs).unwrap()
}

/// As [`truth_error_m`]; `None` when the trajectory is not one that can be compared.
pub fn known_truth_error_m(outputs: &Outputs) -> Option<f64> {
    let report = evaluate_truth(&outputs.trajectory("trajectory.tum"), &outputs.trajectory("truth.tum"));
    Some(report.ok()?.absolute.translation_m?.rmse)
}

/// Distance of each final pose from where the truth has it, so many seconds after the first and later, metres: nothing is aligned,
/// `map_from_world` is where the world of the truth is.
pub fn truth_offsets_m(outputs: &Outputs, map_from_world: Pose, after_s: f64) -> Vec<f64> {
    let pairs = outputs.with_truth();
    let begin_ns = pairs[0].0.stamp_ns + (1e9 * after_s) as i64;
    let late = pairs.iter().filter(|(pose, _)| pose.stamp_ns >= begin_ns);
    late.map(|(pose, truth)| pose.map_from_base.distance_m(map_from_world * truth.map_from_base)).collect()
}

fn bytes_of(directory: &Path, name: &str) -> Vec<u8> {
    let path = directory.join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
