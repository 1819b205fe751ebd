//! A scan that takes time, fitted together with the velocity of the robot during it (continuous-time registration as in
//! CT-ICP, Dellenbach et al. 2022, with a constant velocity within the scan).

use crate::batch::TimedEquations;
use crate::field::ScoreField;
use crate::gauss_newton::{PRIOR_HEADING, PRIOR_XY, of_pose, shared_variance};
use flockslam_evidence::Level;
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Covariance, Point, Pose, Twist, wrap_angle};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// How far the velocity during a scan may be from the one that odometry gave before it: standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwistSigma {
    /// Along x, m/s.
    pub x_m_s: f64,
    /// Along y, m/s.
    pub y_m_s: f64,
    /// Turning, rad/s.
    pub turn_rad_s: f64,
}

/// A scan straightened by a velocity: where its beams end, in the robot's frame at the stamp, and how long after the
/// stamp each left.
#[derive(Clone, Copy, Debug)]
pub struct Sweep<'a> {
    /// Metres.
    pub points: &'a [Point],
    /// Seconds, one for each point.
    pub times_s: &'a [f64],
}

/// Pose and velocity of a robot that took a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionState {
    /// Frame of the field from the robot at the stamp.
    pub pose: Pose,
    /// Velocity during the scan, in the robot's own frame.
    pub twist: Twist,
}

impl MotionState {
    /// Whether two states differ by nothing that can be seen in a scan: 0.1 mm and 1 mm/s, 0.02 mrad and 0.2 mrad/s.
    pub fn is_near(self, other: MotionState) -> bool {
        let (a, b) = (self.twist, other.twist);
        self.pose.distance_m(other.pose) < 1e-4
            && self.pose.turn_rad(other.pose) < 2e-5
            && (a.x_m_s - b.x_m_s).abs().max((a.y_m_s - b.y_m_s).abs()) < 1e-3
            && (a.turn_rad_s - b.turn_rad_s).abs() < 2e-4
    }
}

/// The linearised problem in pose and velocity, both along the axes of the field.
struct System {
    hessian: Matrix6<f64>,
    gradient: Vector6<f64>,
    noise: f64,
    points: f64,
}

impl Sweep<'_> {
    /// One step of Gauss–Newton on pose and velocity from `now`, pulled towards `predicted`: the velocity as `sigma` weighs it, the
    /// pose as in a fit of the pose alone.
    /// The scan is to be deskewed again with the returned velocity.
    pub fn step<F: ScoreField>(
        &self,
        field: &F,
        now: MotionState,
        predicted: MotionState,
        sigma: TwistSigma,
    ) -> MotionState {
        let mut system = System::of(field, *self, now.pose);
        let (pull_xy, pull_heading) = (system.points * PRIOR_XY, system.points * PRIOR_HEADING);
        let variance = shared_variance(system.noise);
        let pull_twist = variance * sigma.precision(now.pose);
        let [vx, vy] = in_field(now.pose, predicted.twist, now.twist);
        let missed = Vector6::new(
            predicted.pose.x_m - now.pose.x_m,
            predicted.pose.y_m - now.pose.y_m,
            wrap_angle(predicted.pose.heading_rad - now.pose.heading_rad),
            vx,
            vy,
            predicted.twist.turn_rad_s - now.twist.turn_rad_s,
        );
        let pull = weights([pull_xy, pull_xy, pull_heading], pull_twist);
        system.hessian += pull;
        system.gradient += pull * missed;
        let Some(factor) = system.hessian.cholesky() else { return now };
        let step = factor.solve(&system.gradient);
        let (sin, cos) = sin_cos(now.pose.heading_rad);
        MotionState {
            pose: Pose::new(now.pose.x_m + step[0], now.pose.y_m + step[1], now.pose.heading_rad + step[2]),
            twist: Twist {
                x_m_s: now.twist.x_m_s + cos * step[3] + sin * step[4],
                y_m_s: now.twist.y_m_s - sin * step[3] + cos * step[4],
                turn_rad_s: now.twist.turn_rad_s + step[5],
            },
        }
    }

    /// Covariance of the pose with the velocity left free within `sigma`; directions that the points do not determine get
    /// the prior's standard deviations (metres, radians).
    pub fn covariance<F: ScoreField>(
        &self,
        field: &F,
        pose: Pose,
        sigma: TwistSigma,
        prior: (f64, f64),
    ) -> Covariance {
        let system = System::of(field, *self, pose);
        let [xy, heading] = [prior.0, prior.1].map(|sigma: f64| sigma.powi(-2));
        let precision = system.hessian / shared_variance(system.noise)
            + weights([xy, xy, heading], sigma.precision(pose));
        let Some(factor) = precision.cholesky() else { return Covariance::diagonal(prior.0, prior.1) };
        of_pose(&factor.inverse())
    }
}

impl TwistSigma {
    /// Inverse covariance along the axes of the field, of a robot at `pose`.
    fn precision(&self, pose: Pose) -> Matrix3<f64> {
        let (sin, cos) = sin_cos(pose.heading_rad);
        let turned = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        let own = Vector3::new(self.x_m_s.powi(-2), self.y_m_s.powi(-2), self.turn_rad_s.powi(-2));
        turned * Matrix3::from_diagonal(&own) * turned.transpose()
    }
}

/// Weights of the pose, each for itself, and of the velocity.
fn weights(pose: [f64; 3], twist: Matrix3<f64>) -> Matrix6<f64> {
    let mut all = Matrix6::zeros();
    all.fixed_view_mut::<3, 3>(0, 0).set_diagonal(&Vector3::from(pose));
    all.fixed_view_mut::<3, 3>(3, 3).copy_from(&twist);
    all
}

/// Difference of two velocities of the robot along the axes of the field, m/s.
fn in_field(pose: Pose, to: Twist, from: Twist) -> [f64; 2] {
    let (sin, cos) = sin_cos(pose.heading_rad);
    let (x, y) = (to.x_m_s - from.x_m_s, to.y_m_s - from.y_m_s);
    [cos * x - sin * y, sin * x + cos * y]
}

impl System {
    /// A velocity moves the end of a beam by its time as much as a shift and a turn of the pose do.
    fn of<F: ScoreField>(field: &F, sweep: Sweep<'_>, pose: Pose) -> Self {
        let mut read = field.reader(Level::Full);
        let TimedEquations { blocks, gradients, squares } =
            TimedEquations::of(&mut read, sweep.points, sweep.times_s, pose);
        let mut hessian = Matrix6::zeros();
        hessian.fixed_view_mut::<3, 3>(0, 0).copy_from(&blocks[0]);
        hessian.fixed_view_mut::<3, 3>(0, 3).copy_from(&blocks[1]);
        hessian.fixed_view_mut::<3, 3>(3, 0).copy_from(&blocks[1]);
        hessian.fixed_view_mut::<3, 3>(3, 3).copy_from(&blocks[2]);
        let mut gradient = Vector6::zeros();
        gradient.fixed_rows_mut::<3>(0).copy_from(&gradients[0]);
        gradient.fixed_rows_mut::<3>(3).copy_from(&gradients[1]);
        let points = sweep.points.len().max(1) as f64;
        Self { hessian, gradient, noise: squares / points, points }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_room;

    const SIGMA: TwistSigma = TwistSigma { x_m_s: 0.1, y_m_s: 0.05, turn_rad_s: 0.5 };
    const PERIOD_S: f64 = 0.1;

    /// The room seen while moving, each beam from where the robot was by then, straightened by `assumed`.
    fn sweep(truth: MotionState, assumed: Twist) -> (Vec<Point>, Vec<f64>) {
        let at_once = test_room::scan(truth.pose);
        let step_s = PERIOD_S / at_once.len() as f64;
        let seen = |(i, point): (usize, &Point)| {
            let time_s = i as f64 * step_s;
            let then = truth.twist.motion_after(time_s).inverse().apply(*point);
            (assumed.motion_after(time_s).apply(then), time_s)
        };
        at_once.iter().enumerate().map(seen).unzip()
    }

    #[test]
    fn pose_and_turn_rate_are_found_when_odometry_is_wrong() {
        let grid = test_room::grid(&test_room::ROOM);
        let field = test_room::field(&grid);
        let start = Pose::new(0.3, -0.2, 0.4);
        for (forward, turn) in [(0.5, 0.0), (0.6, 0.4), (0.45, -0.5)] {
            let odometry = Twist { x_m_s: 0.5, ..Twist::default() };
            let truth =
                MotionState { pose: start, twist: Twist { x_m_s: forward, turn_rad_s: turn, ..odometry } };
            let predicted = MotionState { pose: start, twist: odometry };
            let mut now = predicted;
            for _ in 0..12 {
                let (points, times_s) = sweep(truth, now.twist);
                let sweep = Sweep { points: &points, times_s: &times_s };
                now = sweep.step(&field, now, predicted, SIGMA);
            }
            // Scores of whole cells place a wall to about a centimetre.
            assert!(now.pose.distance_m(truth.pose) < 0.02, "{now:?}");
            assert!(now.pose.turn_rad(truth.pose) < 0.006, "{now:?}");
            assert!((now.twist.turn_rad_s - turn).abs() < 0.12, "{now:?}");
        }
    }

    #[test]
    fn a_velocity_that_is_not_known_makes_the_pose_less_certain() {
        let grid = test_room::grid(&test_room::ROOM);
        let field = test_room::field(&grid);
        let still = MotionState { pose: Pose::new(0.3, -0.2, 0.4), twist: Twist::default() };
        let (points, times_s) = sweep(still, still.twist);
        let sweep = Sweep { points: &points, times_s: &times_s };
        let known = TwistSigma { x_m_s: 1e-4, y_m_s: 1e-4, turn_rad_s: 1e-4 };
        let prior = (0.3, 0.15);
        let fit = crate::Fit::at(&field, &points, still.pose).covariance(prior.0, prior.1);
        let tight = sweep.covariance(&field, still.pose, known, prior);
        let loose = sweep.covariance(&field, still.pose, SIGMA, prior);
        assert!((tight.xx - fit.xx).abs() < 0.01 * fit.xx && (tight.tt - fit.tt).abs() < 0.01 * fit.tt);
        assert!(loose.xx > 1.2 * fit.xx && loose.yy > 1.2 * fit.yy && loose.tt > 1.5 * fit.tt);
    }
}
