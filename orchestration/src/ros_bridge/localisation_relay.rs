//! What a localising set publishes to the graph and receives from it, by the names of AMCL: hints in; the pose and the hypotheses out.

use super::BridgeError;
use flockslam_bus::{Bus, Publisher as BusPublisher, RuntimeDir};
use flockslam_geometry::Pose;
use flockslam_messages::{LocalisationOrder, PoseEstimate, PoseFlags};
use flockslam_page::{Version, version_of};
use flockslam_results::{LocalisationStatus, ModeWatch};
use flockslam_ros::messages::{
    Header, Particle, ParticleCloud, Pose as RosPose, PoseWithCovariance, PoseWithCovarianceStamped,
};
use flockslam_ros::{Node, Publisher, QualityOfService};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// The belief is looked at so often.
const LOOK: Duration = Duration::from_millis(200);
/// A hint without a covariance means this: metres and radians, as RViz sends it.
pub const USUAL_SIGMA: (f64, f64) = (0.5, std::f64::consts::PI / 12.0);

/// The part of the bridge for a set that localizes in a known map; while it makes one it only says that hints have no effect.
pub struct LocalisationRelay {
    orders: BusPublisher<LocalisationOrder>,
    topics: Topics,
    mode: ModeWatch,
    status_dir: PathBuf,
    status: LocalisationStatus,
    version: Option<Version>,
    look_due: Instant,
    has_warned: bool,
}

struct Topics {
    pose: Publisher<PoseWithCovarianceStamped>,
    particles: Publisher<ParticleCloud>,
}

impl LocalisationRelay {
    /// Opens the topics. Nothing comes on them while the set makes a map.
    ///
    /// # Errors
    /// When the graph or the bus refuses.
    pub fn open(
        node: &mut Node,
        bus: &Bus,
        runtime: &RuntimeDir,
        localizes: bool,
    ) -> Result<Self, BridgeError> {
        let topics = Topics {
            pose: node.publisher("amcl_pose", QualityOfService::Latched { depth: 1 })?,
            particles: node.publisher("particle_cloud", QualityOfService::Sensor { depth: 1 })?,
        };
        Ok(Self {
            orders: bus.publisher()?,
            topics,
            mode: ModeWatch::of(&runtime.results(), localizes),
            status_dir: runtime.status(),
            status: LocalisationStatus::default(),
            version: None,
            look_due: Instant::now(),
            has_warned: false,
        })
    }

    /// Somebody says where the robot is.
    ///
    /// # Errors
    /// When the bus refuses.
    pub fn take_hint(&mut self, hint: &PoseWithCovariance) -> Result<(), BridgeError> {
        if !self.mode.localizes() {
            if !std::mem::replace(&mut self.has_warned, true) {
                tracing::warn!("/initialpose has no effect while the map is being made");
            }
            return Ok(());
        }
        self.orders.send(&order_near(hint))?;
        Ok(())
    }

    /// Whether the place of the robot in the map is known at this pose: without it there is no transform from the map.
    pub fn places(&self, estimate: &PoseEstimate) -> bool {
        !estimate.has(PoseFlags::UNPLACED)
    }

    /// Sends the pose of a scan, while the robot is localized.
    pub fn send_pose(&self, estimate: &PoseEstimate, map_frame: &str) {
        let (topics, Some(covariance)) = (&self.topics, self.status.covariance) else { return };
        if !self.places(estimate) || !estimate.has(PoseFlags::LOCALIZING) {
            return;
        }
        let Pose { x_m, y_m, heading_rad } = estimate.map_from_base();
        topics.pose.send(PoseWithCovarianceStamped {
            header: Header::new(estimate.times.sensor_ns, map_frame),
            pose: PoseWithCovariance {
                pose: RosPose::planar(x_m, y_m, heading_rad),
                covariance: in_space(&covariance),
            },
        });
    }

    /// Looks at the belief, and sends it when it is new.
    pub fn tick(&mut self, map_frame: &str) {
        if self.look_due > Instant::now() || !self.mode.localizes() {
            return;
        }
        let topics = &self.topics;
        self.look_due = Instant::now() + LOOK;
        let version = version_of(&LocalisationStatus::file(&self.status_dir));
        if version == self.version {
            return;
        }
        let Some(status) = LocalisationStatus::read(&self.status_dir) else { return };
        self.version = version;
        let particle = |row: &flockslam_results::HypothesisRow| {
            let [x_m, y_m, heading_rad] = row.pose;
            Particle { pose: RosPose::planar(x_m, y_m, heading_rad), weight: row.weight }
        };
        topics.particles.send(ParticleCloud {
            header: Header::new(status.stamp_ns, map_frame),
            particles: status.hypotheses.iter().map(particle).collect(),
        });
        self.status = status;
    }
}

/// The order to look for the robot where a hint says, within its covariance.
pub fn order_near(hint: &PoseWithCovariance) -> LocalisationOrder {
    let RosPose { position, orientation } = hint.pose;
    let sigma = |variance: f64, usual: f64| if variance > 0.0 { variance.sqrt() } else { usual };
    let position_variance = hint.covariance[0][0].max(hint.covariance[1][1]);
    LocalisationOrder {
        map_from_base: Pose::new(position.x, position.y, orientation.heading_rad()),
        sigma_m: sigma(position_variance, USUAL_SIGMA.0),
        sigma_rad: sigma(hint.covariance[5][5], USUAL_SIGMA.1),
    }
}

/// A covariance over (x, y, heading) among the six of space.
fn in_space([xx, xy, xt, yy, yt, tt]: &[f64; 6]) -> [[f64; 6]; 6] {
    let mut found = [[0.0; 6]; 6];
    for (row, column, value) in [(0, 0, xx), (0, 1, xy), (0, 5, xt), (1, 1, yy), (1, 5, yt), (5, 5, tt)] {
        found[row][column] = *value;
        found[column][row] = *value;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hint_counts_within_its_covariance_and_without_one_as_rviz_means_it() {
        let mut hint = PoseWithCovariance { pose: RosPose::planar(1.0, 2.0, 0.5), ..Default::default() };
        let order = order_near(&hint);
        assert_eq!((order.map_from_base.x_m, order.map_from_base.y_m), (1.0, 2.0));
        assert!((order.map_from_base.heading_rad - 0.5).abs() < 1e-9);
        assert_eq!((order.sigma_m, order.sigma_rad), USUAL_SIGMA);
        (hint.covariance[0][0], hint.covariance[1][1], hint.covariance[5][5]) = (0.04, 0.09, 0.01);
        assert_eq!((order_near(&hint).sigma_m, order_near(&hint).sigma_rad), (0.3, 0.1));
    }

    #[test]
    fn a_covariance_of_the_plane_lies_among_those_of_space() {
        let found = in_space(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(
            (found[0][1], found[1][0], found[5][1], found[5][5], found[2][2]),
            (2.0, 2.0, 5.0, 6.0, 0.0)
        );
    }
}
