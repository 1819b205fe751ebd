//! What the bridge publishes besides the map: transforms, poses, and diagnostics.

use super::BridgeError;
use super::bridge_parameters::BridgeParameters;
use super::set_diagnostics::status;
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Covariance, Pose};
use flockslam_messages::{PoseEstimate, PoseFlags, Quality};
use flockslam_ros::messages::{
    BondStatus, DiagnosticArray, DiagnosticStatus, Header, MarkerArray, Pose as RosPose, PoseWithCovariance,
    PoseWithCovarianceStamped, Quaternion, TFMessage, Transform, TransformStamped, TransitionEvent, Vector3,
};
use flockslam_ros::{Node, Publisher, QualityOfService};

/// Publishers of the bridge.
pub struct BridgePublishers {
    /// Transforms.
    pub transforms: Publisher<TFMessage>,
    /// Poses of scans.
    pub poses: Publisher<PoseWithCovarianceStamped>,
    /// How far each of them can be trusted.
    pub quality: Publisher<DiagnosticArray>,
    /// Moving bodies.
    pub tracks: Publisher<MarkerArray>,
    /// Transitions of the node.
    pub transitions: Publisher<TransitionEvent>,
    /// Heartbeats; only with a manager.
    pub bond: Option<Publisher<BondStatus>>,
}

impl BridgePublishers {
    /// Opens them.
    ///
    /// # Errors
    /// When DDS refuses.
    pub fn open(node: &mut Node, parameters: &BridgeParameters) -> Result<Self, BridgeError> {
        let reliable = |depth| QualityOfService::Reliable { depth };
        let bond =
            parameters.use_lifecycle_manager.then(|| node.publisher("bond", reliable(100))).transpose()?;
        Ok(Self {
            transforms: node.publisher("/tf", reliable(100))?,
            poses: node.publisher("pose", reliable(10))?,
            quality: node.publisher("flockslam/quality", reliable(10))?,
            tracks: node.publisher("flockslam/tracks", reliable(10))?,
            transitions: node.publisher("~/transition_event", reliable(10))?,
            bond,
        })
    }

    /// Sends the pose of a frame in another.
    pub fn send_transform(&self, stamp_ns: i64, parent: &str, child: &str, pose: Pose) {
        let transform = Transform {
            translation: Vector3 { x: pose.x_m, y: pose.y_m, z: 0.0 },
            rotation: Quaternion::about_z(pose.heading_rad),
        };
        let header = Header::new(stamp_ns, parent);
        let transform = TransformStamped { header, child_frame_id: child.to_owned(), transform };
        self.transforms.send(TFMessage { transforms: vec![transform] });
    }

    /// Sends the pose of a scan in the map.
    pub fn send_pose(&self, estimate: &PoseEstimate, map_frame: &str) {
        let pose = estimate.map_from_base();
        self.poses.send(PoseWithCovarianceStamped {
            header: Header::new(estimate.times.sensor_ns, map_frame),
            pose: PoseWithCovariance {
                pose: RosPose::planar(pose.x_m, pose.y_m, pose.heading_rad),
                covariance: turned(estimate.covariance, estimate.map_from_odom.heading_rad),
            },
        });
    }
}

/// How far the pose of a scan can be trusted: one status, stamped as the scan.
pub fn quality(estimate: &PoseEstimate, robot: &str) -> DiagnosticArray {
    let (level, message) = match estimate.quality {
        quality if quality == Quality::Tracking as u32 => (DiagnosticStatus::OK, "tracking"),
        quality if quality == Quality::Degraded as u32 => (DiagnosticStatus::WARN, "degraded"),
        _ => (DiagnosticStatus::ERROR, "lost"),
    };
    let Covariance { xx, yy, tt, .. } = estimate.covariance;
    let figures = [
        ("score", format!("{:.3}", estimate.score)),
        ("position_std_m", format!("{:.4}", (xx + yy).max(0.0).sqrt())),
        ("heading_std_rad", format!("{:.5}", tt.max(0.0).sqrt())),
        ("matched", estimate.has(PoseFlags::MATCHED).to_string()),
        ("inserted", estimate.has(PoseFlags::INSERT).to_string()),
        ("corrections", estimate.corrections.to_string()),
        ("trajectory", estimate.trajectory.to_string()),
    ];
    let status = status(level, "flockslam: quality".to_owned(), message, robot, &figures);
    DiagnosticArray { header: Header::new(estimate.times.sensor_ns, ""), status: vec![status] }
}

/// A covariance in the plane, turned by an angle, among the six of space: those of z, roll and pitch are zero.
fn turned(covariance: Covariance, angle_rad: f64) -> [[f64; 6]; 6] {
    let (sin, cos) = sin_cos(angle_rad);
    let Covariance { xx, xy, yy, xt, yt, tt } = covariance;
    let mut found = [[0.0; 6]; 6];
    found[0][0] = cos * cos * xx - 2.0 * sin * cos * xy + sin * sin * yy;
    found[1][1] = sin * sin * xx + 2.0 * sin * cos * xy + cos * cos * yy;
    found[0][1] = sin * cos * (xx - yy) + (cos * cos - sin * sin) * xy;
    found[0][5] = cos * xt - sin * yt;
    found[1][5] = sin * xt + cos * yt;
    found[5][5] = tt;
    (found[1][0], found[5][0], found[5][1]) = (found[0][1], found[0][5], found[1][5]);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_covariance_is_turned_with_its_frame() {
        let along_x = Covariance { xx: 4.0, yy: 1.0, xt: 0.5, tt: 0.1, ..Covariance::default() };
        let found = turned(along_x, std::f64::consts::FRAC_PI_2);
        assert!((found[0][0] - 1.0).abs() < 1e-9 && (found[1][1] - 4.0).abs() < 1e-9);
        assert!(found[0][1].abs() < 1e-9 && (found[1][5] - 0.5).abs() < 1e-9 && found[0][5].abs() < 1e-9);
        assert_eq!((found[5][5], found[5][1], found[2][2]), (0.1, found[1][5], 0.0));
        let diagonal = turned(along_x, std::f64::consts::FRAC_PI_4);
        assert!((diagonal[0][1] - 1.5).abs() < 1e-9 && (diagonal[0][0] - 2.5).abs() < 1e-9);
    }

    #[test]
    fn the_quality_of_a_pose_is_a_status_with_its_figures() {
        let covariance = Covariance { xx: 0.0009, yy: 0.0016, tt: 0.0001, ..Covariance::default() };
        let of = |quality: Quality| PoseEstimate {
            quality: quality as u32,
            covariance,
            ..PoseEstimate::default()
        };
        let levels = [Quality::Tracking, Quality::Degraded, Quality::Lost]
            .map(|kind| quality(&of(kind), "r1").status[0].level);
        assert_eq!(levels, [DiagnosticStatus::OK, DiagnosticStatus::WARN, DiagnosticStatus::ERROR]);
        let values = &quality(&of(Quality::Tracking), "r1").status[0].values;
        assert_eq!((values[1].value.as_str(), values[2].value.as_str()), ("0.0500", "0.01000"));
    }
}
