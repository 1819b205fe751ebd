//! Prediction of the next pose from odometry or the last velocity, with its covariance.

use crate::prediction::{Coasting, Prediction, Steady, matrix};
use crate::scan_steps::{PERIOD_MAX_S, ScanSteps};
use crate::turn_scale::TurnScale;
use crate::twist_weights::TwistWeights;
use crate::velocity_noise::VelocityNoise;
use crate::wheel_scale::WheelScale;
use flockslam_geometry::elementary::hypot;
use flockslam_geometry::{Covariance, Pose, Twist, wrap_angle};
use flockslam_messages::{PoseEstimate, PoseFlags, Quality, ScanView};
use flockslam_odometry_noise::OdometryNoise;
use flockslam_registration::TwistSigma;
use nalgebra::{Matrix3, Vector3};

/// A first odometry pose farther from the origin than this is not taken over, metres.
const START_MAX_M: f64 = 1e4;
/// Odometry below this counts as standing, metres and radians.
const STOOD: (f64, f64) = (0.3, 0.3);
/// Odometry that differs by more than this from the velocity so far, metres and radians within one scan, may have jumped.
const SURPRISE: (f64, f64) = (0.15, 0.15);

/// Added in each step, standard deviations in metres and radians: for usual odometry.
const STEP_SIGMA: (f64, f64) = (0.01, 0.005);
/// The same of the heading for the velocity so far, without odometry, radians.
const STEP_SIGMA_BLIND_RAD: f64 = 0.1;
/// The same of the heading where a gyroscope measures it, radians.
const STEP_SIGMA_GYRO_RAD: f64 = 0.01;

/// Greatest scales of the variances of odometry, of positions and of headings, where surfaces that move with the robot, as the ground
/// does, could pass poor fits off as poor wheels: 0.03 m and 0.7° over a metre.
const STEP_SCALES_MAX: (f64, f64) = (0.05, 0.5);

/// Without odometry the velocity takes over at most this share of what a fit corrects: taken over whole, the noise of each fit would be a
/// velocity.
const SHARE_MAX: f64 = 0.8;

/// Standard deviation of the change of velocity between two scans while wheels slip, m/s. Of 24 simulated warehouses all come out right with
/// 0.3 to 0.5; with 0.7 scans along racks pull one robot to a wrong place.
const COASTING_NOISE_M_S: f64 = 0.4;
/// The standard deviation of a position that follows from the velocity is within these bounds, metres: stamps of scans may be too near one
/// another, and surfaces decide after a long step.
const COASTING_SIGMA_M: (f64, f64) = (0.03, 0.1);
/// A change of the turn between scans that may be noise of odometry, radians a second.
const TURN_NOISE_RAD_S: f64 = 0.1;

/// A velocity that odometry measured during a scan: what is off at rest, standard deviations in m/s and rad/s, and the share of the
/// velocity that is: stamps of odometry jitter, and its scale is not quite known.
const MEASURED_NOISE: (f64, f64) = (0.01, 0.01);
const MEASURED_SHARE: f64 = 0.02;

/// Share of the velocity that remains after each rejected scan.
const KEPT_WHEN_LOST: f64 = 0.5;

fn scaled(twist: Twist, share: f64) -> Twist {
    Twist { x_m_s: share * twist.x_m_s, y_m_s: share * twist.y_m_s, turn_rad_s: share * twist.turn_rad_s }
}

/// Predicts the pose from the last pose and odometry, or from the last velocity without odometry.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    pub(crate) pose: Pose,
    pub(crate) covariance: Covariance,
    odometry: Option<Pose>,
    /// The heading by the gyroscope, where there is no odometry.
    gyro_rad: Option<f64>,
    steps: ScanSteps,
    /// The last scan fitted nowhere.
    is_lost: bool,
    velocity: Twist,
    /// How far the robot went from the stamp of the last scan to its middle, and how long after the stamp that is, seconds: of scans
    /// without odometry that take time.
    to_middle: (Pose, f64),
    /// How fast the robot turned between the last two scans, by odometry.
    odometry_turn_rad_s: Option<f64>,
    /// The error of odometry, as fits have shown it.
    noise: OdometryNoise,
    /// The scale of odometry, as surfaces in the open have shown it.
    scale: WheelScale,
    /// The scale of its turns, as fits have shown it.
    turn_scale: TurnScale,
    /// How well the velocity so far predicts, without odometry.
    velocity_noise: VelocityNoise,
    /// The velocity from the middle of one scan that took time to that of the next, with odometry, and that middle.
    shown: Option<(Twist, Pose)>,
    /// How well that velocity and odometry predict the next one.
    twist_weights: TwistWeights,
}

/// How long after the stamp half of a scan without odometry was taken, seconds. Velocities are measured from middle to middle: there a scan
/// has the pose that it shows whatever velocity straightens it, while a wrong velocity moves its pose at the stamp the other way, and
/// would be taken up by the next one.
fn middle_s(scan: ScanView<'_>) -> f64 {
    if scan.odometry().is_some() || scan.is_empty() { 0.0 } else { 0.5 * scan.time_s(scan.len() - 1) }
}

/// Whether a first pose is near enough to the origin to count in centimetres from there.
fn is_near(pose: Pose) -> bool {
    pose.x_m.abs() < START_MAX_M && pose.y_m.abs() < START_MAX_M
}

impl Motion {
    pub(crate) fn new() -> Self {
        Self {
            pose: Pose::IDENTITY,
            covariance: Covariance::default(),
            odometry: None,
            gyro_rad: None,
            steps: ScanSteps::default(),
            is_lost: false,
            velocity: Twist::default(),
            to_middle: (Pose::IDENTITY, 0.0),
            odometry_turn_rad_s: None,
            noise: OdometryNoise::default(),
            scale: WheelScale::default(),
            turn_scale: TurnScale::default(),
            velocity_noise: VelocityNoise::default(),
            shown: None,
            twist_weights: TwistWeights::default(),
        }
    }

    /// Continues at the last published pose, whose robot may have gone on as it moved there.
    pub(crate) fn resume(&mut self, last: &PoseEstimate) {
        let is_lost = last.quality == Quality::Lost as u32;
        *self = Self {
            pose: last.odom_from_base,
            covariance: last.covariance,
            odometry: last.has(PoseFlags::HAS_ODOMETRY).then_some(last.odometry),
            is_lost,
            velocity: if is_lost { Twist::default() } else { last.twist },
            steps: self.steps.resumed(last),
            ..Self::new()
        };
    }

    /// Takes in when a predecessor's scan was taken, before [`Self::resume`].
    pub(crate) fn restore(&mut self, published: &PoseEstimate) {
        self.steps.restore(published);
        self.pose = published.odom_from_base;
    }

    /// Continues at a pose from which the robot may have gone anywhere.
    pub(crate) fn resume_detached(&mut self, last: &PoseEstimate) {
        *self = Self { pose: last.odom_from_base, steps: ScanSteps::stamped(last), ..Self::new() };
    }

    /// Nothing connects the next scan with the last one. What was learned of the robot's odometry holds.
    pub(crate) fn break_off(&mut self) {
        self.noise.break_off();
        self.is_lost = false;
        (self.covariance, self.velocity) = (Covariance::default(), Twist::default());
        (self.odometry, self.gyro_rad, self.odometry_turn_rad_s) = (None, None, None);
        self.steps.break_off();
        self.to_middle = (Pose::IDENTITY, 0.0);
        self.shown = None;
    }

    /// The pose at this scan as it follows from the one before. Odometry is a motion in the robot's own frame, so
    /// composing it turns it into the corrected heading.
    pub(crate) fn predict(&self, scan: ScanView<'_>) -> Prediction {
        let placed = scan.header().starts_at_odometry == 1;
        if let (false, true, Some(start)) =
            (self.steps.has_begun(), placed, scan.odometry().filter(|start| is_near(*start)))
        {
            let (twist, covariance) = (Twist::default(), self.covariance);
            let step = Covariance::default();
            return Prediction {
                pose: start,
                twist,
                measured: None,
                after_gap: false,
                covariance,
                step,
                steady: None,
                coasting: None,
                is_coasting: false,
            };
        }
        let step_s = self.steps.step_s(scan);
        let (to_middle, middle_s) = self.to_middle;
        let unchanged_s = self.steps.even_s(scan, step_s).min(PERIOD_MAX_S);
        let unchanged = to_middle * self.velocity.motion_after(unchanged_s - middle_s);
        let is_brief = self.steps.is_brief(scan, step_s);
        let (motion, twist) = match (self.odometry, scan.odometry()) {
            (Some(before), Some(now)) => {
                let by_odometry = before.to(now);
                let motion = Pose { x_m: self.scale.factor() * by_odometry.x_m, ..by_odometry };
                let twist = match self.measured(scan) {
                    Some(twist) => twist,
                    None if is_brief => self.velocity,
                    None => self.twist_during(scan, motion, step_s),
                };
                (motion, twist)
            }
            _ => match self.turned_rad(scan) {
                Some(turned_rad) => {
                    let turn_rad_s = if is_brief { self.velocity.turn_rad_s } else { turned_rad / step_s };
                    (Pose { heading_rad: turned_rad, ..unchanged }, Twist { turn_rad_s, ..self.velocity })
                }
                None => (unchanged, self.velocity),
            },
        };
        let is_gap = self.steps.elapsed_s(scan).is_some_and(|elapsed_s| elapsed_s > PERIOD_MAX_S);
        let has_stood = scan.odometry().is_some()
            && motion.distance_m(Pose::IDENTITY) < STOOD.0
            && motion.turn_rad(Pose::IDENTITY) < STOOD.1;
        let after_gap = is_gap && !has_stood;
        // A velocity holds for a while only.
        let goes_on = !(is_gap && self.steps.missing(scan) > 0);
        let surprises =
            goes_on && (motion.distance_m(unchanged) > SURPRISE.0 || motion.turn_rad(unchanged) > SURPRISE.1);
        let steady = surprises.then(|| Steady { pose: self.pose * unchanged, twist: self.velocity });
        let (travel, turn) = (hypot(motion.x_m, motion.y_m), motion.heading_rad.abs());
        let mut covariance = self.covariance;
        let (drift_m2, drift_rad2) = self.drift(scan, travel, turn);
        let position = drift_m2 + self.covariance.tt * travel * travel;
        covariance.xx += position;
        covariance.yy += position;
        covariance.tt += drift_rad2;
        let coasting = self.odometry.filter(|_| goes_on).map(|_| Coasting {
            pose: unchanged,
            twist: self.velocity,
            sigma_m: (COASTING_NOISE_M_S * unchanged_s).clamp(COASTING_SIGMA_M.0, COASTING_SIGMA_M.1),
        });
        let scales = self.noise.scales();
        let position = drift_m2 * (STEP_SCALES_MAX.0 / scales.0).min(1.0);
        let heading = drift_rad2 * (STEP_SCALES_MAX.1 / scales.1).min(1.0);
        let step = Covariance { xx: position, yy: position, tt: heading, ..Covariance::default() };
        let pose = self.pose * motion;
        let measured = self.measured(scan).map(|_| self.measured_sigma(twist));
        Prediction {
            pose,
            twist,
            measured,
            after_gap,
            covariance,
            step,
            steady,
            coasting,
            is_coasting: false,
        }
    }

    /// The velocity during a scan as odometry measured it, unless it may have jumped.
    fn measured(&self, scan: ScanView<'_>) -> Option<Twist> {
        let odometry_twist = scan.odometry_twist()?;
        let twist = Twist {
            x_m_s: self.scale.factor() * odometry_twist.x_m_s,
            turn_rad_s: self.turn_scale.factor() * odometry_twist.turn_rad_s,
            ..odometry_twist
        };
        let duration_s = scan.time_s(scan.len() - 1);
        let [measured, steady] = [twist, self.velocity].map(|twist| twist.motion_after(duration_s));
        let jumps = measured.distance_m(steady) > SURPRISE.0 || measured.turn_rad(steady) > SURPRISE.1;
        (!jumps).then_some(twist)
    }

    /// How sure a velocity is that odometry measured during a scan.
    fn measured_sigma(&self, twist: Twist) -> TwistSigma {
        let (noise_m_s, noise_rad_s) = MEASURED_NOISE;
        let speed_m_s = hypot(noise_m_s, MEASURED_SHARE * twist.x_m_s);
        TwistSigma {
            x_m_s: speed_m_s,
            y_m_s: speed_m_s,
            turn_rad_s: hypot(noise_rad_s, self.turn_scale.share() * twist.turn_rad_s),
        }
    }

    /// The velocity during a scan that comes after this motion by odometry, from odometry and the velocity so far.
    fn twist_during(&self, scan: ScanView<'_>, motion: Pose, step_s: f64) -> Twist {
        let by_odometry = self.twist_after(scan, motion, step_s);
        self.shown.map_or(by_odometry, |(so_far, _)| self.twist_weights.blended(by_odometry, so_far))
    }

    /// The velocity during a scan that comes after this motion by odometry. A turn that has become faster goes on becoming so; what may be
    /// noise of odometry is no such change.
    fn twist_after(&self, scan: ScanView<'_>, motion: Pose, step_s: f64) -> Twist {
        let turned_rad = self.turn_scale.factor() * motion.heading_rad;
        let now = Twist::from_motion(Pose { heading_rad: turned_rad, ..motion }, step_s);
        let before_rad_s = self.odometry_turn_rad_s.filter(|_| !self.steps.is_of_another(scan));
        let Some(before_rad_s) = before_rad_s else { return now };
        let change_rad_s = now.turn_rad_s - before_rad_s;
        let beyond_rad_s = change_rad_s - change_rad_s.clamp(-TURN_NOISE_RAD_S, TURN_NOISE_RAD_S);
        Twist { turn_rad_s: now.turn_rad_s + beyond_rad_s, ..now }
    }

    /// Rotation by the gyroscope since the scan before, where there is no odometry.
    fn turned_rad(&self, scan: ScanView<'_>) -> Option<f64> {
        self.gyro_rad.zip(scan.gyro_heading_rad()).map(|(before, now)| wrap_angle(now - before))
    }

    /// Variances that one step adds: of the position along each axis, m², and of the heading, rad².
    fn drift(&self, scan: ScanView<'_>, travel_m: f64, turn_rad: f64) -> (f64, f64) {
        let has_odometry = scan.odometry().is_some();
        let (step_m, step_rad) = match self.turned_rad(scan) {
            _ if has_odometry => STEP_SIGMA,
            Some(_) => (self.velocity_noise.sigma_m(), STEP_SIGMA_GYRO_RAD),
            None => (self.velocity_noise.sigma_m(), STEP_SIGMA_BLIND_RAD),
        };
        let (scale_xy, scale_heading) = if has_odometry { self.noise.scales() } else { (1.0, 1.0) };
        let (position, heading) = self.noise.variances(travel_m, turn_rad);
        (position + scale_xy * step_m * step_m, heading + scale_heading * step_rad * step_rad)
    }

    /// Learns the errors of odometry and of fits from a fit that nothing else took part in.
    pub(crate) fn learn(&mut self, scan: ScanView<'_>, fit: Pose, claimed: Covariance) {
        let Some(odometry) = scan.odometry() else { return };
        self.noise.learn(fit, odometry, claimed);
        if let Some(before) = self.odometry {
            self.turn_scale.learn(before.to(odometry).heading_rad, self.pose.to(fit).heading_rad);
        }
    }

    /// Learns the scale of odometry from the pose at which surfaces hold a scan, beside the predicted one.
    pub(crate) fn learn_scale(&mut self, predicted: Pose, held: Pose) {
        self.scale.learn(self.pose.to(predicted).x_m, predicted.to(held).x_m);
    }

    /// Learns how well the velocity so far predicts a robot without odometry, from the fit of a scan that holds it.
    pub(crate) fn learn_velocity(&mut self, predicted: Pose, fit: Pose) {
        self.velocity_noise.learn(self.pose, predicted, fit);
    }

    /// The errors of odometry and of fits.
    pub(crate) fn noise(&self) -> &OdometryNoise {
        &self.noise
    }

    /// Updates the state after a scan. The velocity of a `lost` robot is unknown: it fades, or
    /// without odometry it would be predicted out of the map.
    pub(crate) fn advance(&mut self, scan: ScanView<'_>, estimate: &PoseEstimate) {
        let (pose, covariance) = (estimate.odom_from_base, estimate.covariance);
        let lost = estimate.quality == Quality::Lost as u32;
        // A jump is no motion; nor is the way from where a lost robot was taken to be.
        let jumped = estimate.has(PoseFlags::RESCUED) && scan.odometry().is_some();
        let step_s = self.steps.step_s(scan);
        let middle_s = middle_s(scan);
        let to_middle = estimate.twist.motion_after(middle_s);
        self.shown = self.shown_with_odometry(scan, estimate, step_s).filter(|_| !lost && !jumped);
        if self.steps.has_begun() && !self.steps.is_brief(scan, step_s) {
            let kept = if lost { KEPT_WHEN_LOST } else { 1.0 };
            let middle_before = self.pose * self.to_middle.0;
            let motion = match (self.odometry, scan.odometry()) {
                (Some(before), Some(now)) if jumped => before.to(now),
                (_, None) if self.is_lost && !lost => Pose::IDENTITY,
                (_, None) if !lost => middle_before.to(self.shown(scan, estimate, middle_s)),
                _ => middle_before.to(pose * to_middle),
            };
            self.velocity = scaled(Twist::from_motion(motion, self.steps.even_s(scan, step_s)), kept);
            self.odometry_turn_rad_s = self
                .odometry
                .zip(scan.odometry())
                .map(|(before, now)| self.turn_scale.factor() * before.to(now).heading_rad / step_s);
            self.steps.count(scan, step_s);
        }
        self.is_lost = lost;
        self.pose = pose;
        self.to_middle = (to_middle, middle_s);
        self.covariance = covariance;
        self.odometry = scan.odometry();
        self.gyro_rad = scan.gyro_heading_rad();
        self.steps.advance(scan);
    }

    /// The velocity from the middle of the scan before to that of this one, and that middle; what it says of odometry is learned.
    fn shown_with_odometry(
        &mut self,
        scan: ScanView<'_>,
        estimate: &PoseEstimate,
        step_s: f64,
    ) -> Option<(Twist, Pose)> {
        let odometry = scan.odometry().filter(|_| scan.takes_time() && estimate.has(PoseFlags::MATCHED))?;
        let after_s = 0.5 * scan.time_s(scan.len() - 1);
        let middle = estimate.odom_from_base * estimate.twist.motion_after(after_s);
        let fresh = (self.velocity, middle);
        let Some((so_far, before)) = self.shown else { return Some(fresh) };
        if self.steps.is_brief(scan, step_s) || self.steps.is_of_another(scan) {
            return None;
        }
        let shown = Twist::from_motion(before.to(middle), self.steps.even_s(scan, step_s));
        if let Some(last) = self.odometry {
            let by_odometry = last.to(odometry);
            let motion = Pose { x_m: self.scale.factor() * by_odometry.x_m, ..by_odometry };
            self.twist_weights.learn(shown, self.twist_after(scan, motion, step_s), so_far);
        }
        Some((shown, middle))
    }

    /// The pose in the middle of a scan to which the velocity would have brought a robot without odometry. Where a scan hardly measures, as
    /// along a corridor, a step hardly constrains the velocity: the filter of constant velocity (Kalata's relation β = α² ∕ (2 − α)) gives the
    /// velocity the share α ∕ (2 − α) of what the fit has corrected, with the gain α of the position.
    fn shown(&self, scan: ScanView<'_>, estimate: &PoseEstimate, middle_s: f64) -> Pose {
        let predicted = self.predict(scan);
        let left =
            matrix(predicted.covariance).try_inverse().map(|inverse| matrix(estimate.covariance) * inverse);
        let share = left.and_then(|left| {
            let gain = Matrix3::identity() - left;
            Some(gain * (Matrix3::identity() + left).try_inverse()? * SHARE_MAX)
        });
        let [from, to] = [(predicted.pose, predicted.twist), (estimate.odom_from_base, estimate.twist)]
            .map(|(pose, twist)| pose * twist.motion_after(middle_s));
        let Some(share) = share else { return to };
        let corrected =
            Vector3::new(to.x_m - from.x_m, to.y_m - from.y_m, wrap_angle(to.heading_rad - from.heading_rad));
        let step = share * corrected;
        Pose::new(from.x_m + step.x, from.y_m + step.y, from.heading_rad + step.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanBuffer;

    /// A scan so many scans after the first, of a robot whose odometry moves 0.1 m from scan to scan and by `slipped` beyond.
    fn scan_after(number: u64, slipped: Pose) -> ScanBuffer {
        let mut scan = ScanBuffer::from_ranges(&[2.0; 101], -1.0, 0.02);
        scan.header.id.sequence = number;
        scan.header.times.sensor_ns = number as i64 * 100_000_000;
        scan.header.odometry = Pose::new(0.1 * number as f64, 0.0, 0.0) * slipped;
        scan.header.has_odometry = 1;
        scan
    }

    /// What a robot that went 1 m/s published of a scan.
    fn published(number: u64) -> PoseEstimate {
        let pose = Pose::new(0.1 * number as f64, 0.0, 0.0);
        let mut estimate = PoseEstimate {
            odom_from_base: pose,
            odometry: pose,
            twist: Twist { x_m_s: 1.0, ..Twist::default() },
            flags: PoseFlags::HAS_ODOMETRY | PoseFlags::MATCHED,
            ..PoseEstimate::default()
        };
        (estimate.id.sequence, estimate.times.sensor_ns) = (number, number as i64 * 100_000_000);
        estimate
    }

    #[test]
    fn a_robot_goes_on_at_its_velocity_while_a_restart_loses_scans() {
        let mut motion = Motion::new();
        motion.resume(&published(20));
        let slip = Pose::new(0.4, 0.0, 0.5);
        let prediction = motion.predict(scan_after(36, slip).view().unwrap());
        let steady = prediction.steady.unwrap().pose;
        assert!(steady.distance_m(Pose::new(3.6, 0.0, 0.0)) < 1e-6, "{steady:?}");
        let prediction = motion.predict(scan_after(60, slip).view().unwrap());
        assert!(prediction.steady.is_none() && prediction.after_gap, "nobody knows for how long");
        assert!(prediction.twist.x_m_s < 1.2, "it drove 4.4 m in 4 s: {:?}", prediction.twist);
    }

    #[test]
    fn the_period_of_a_predecessor_is_restored() {
        let mut motion = Motion::new();
        let every_half_second = |number: u64| {
            let mut estimate = published(number);
            estimate.times.sensor_ns *= 5;
            estimate
        };
        (0..100).for_each(|number| motion.restore(&every_half_second(number)));
        motion.resume(&every_half_second(100));
        assert!((motion.steps.period_s() - 0.5).abs() < 0.01, "{}", motion.steps.period_s());
    }

    /// A robot without odometry stands, and is taken to move. Each scan takes as long as the time between two, so that a false velocity
    /// moves the pose at its stamp by half a step, the other way.
    #[test]
    fn a_false_velocity_of_a_robot_that_stands_dies_away_and_does_not_swing() {
        let mut scan = ScanBuffer::from_ranges(&[2.0; 101], -1.0, 0.02);
        scan.header.time_increment_s = 0.001;
        let mut motion = Motion::new();
        motion.velocity = Twist { x_m_s: 0.5, turn_rad_s: 0.4, ..Twist::default() };
        let mut speeds_m_s = Vec::new();
        for number in 0..12 {
            scan.header.times.sensor_ns = number * 100_000_000;
            let view = scan.view().unwrap();
            let twist = motion.predict(view).twist;
            let estimate = PoseEstimate {
                odom_from_base: twist.motion_after(0.05).inverse(),
                covariance: Covariance::diagonal(0.002, 0.001),
                twist,
                ..PoseEstimate::default()
            };
            motion.advance(view, &estimate);
            speeds_m_s.push(motion.velocity.x_m_s);
        }
        assert!(speeds_m_s.iter().all(|speed_m_s| *speed_m_s > -0.01), "{speeds_m_s:?}");
        assert!(speeds_m_s[5] < 0.01, "{speeds_m_s:?}");
    }
}
