//! The logic of the stage: takes a scan, its verdict and the grid, gives a pose with its covariance and quality.

use crate::contradiction::{contradicted, in_the_unknown};
use crate::motion::{Motion, Prediction};
use crate::settings::Settings;
use flockslam_evidence::{Tile, TileGrid};
use flockslam_geometry::{Covariance, Point, Pose, Twist};
use flockslam_messages::{
    BeamRange, Commit, Deskew, FlockRobots, LayoutHeader, PoseEstimate, PoseFlags, Quality, ScanView, Verdict,
};
use flockslam_registration::{Correlative, CorrelativeSearch, Fit, GridField, Ndt};
use std::iter::Peekable;
use std::ops::Deref;

/// Fewer points than this fix no pose.
const POINTS_MIN: usize = 5;
/// Fewer points than this do not tell one place from another: no wide search, and no proof that the robot is lost.
const TELLING_POINTS: usize = 30;
/// A fit whose weakest direction is below this (per m² and point) slides along it.
const WEAK_DIRECTION: f64 = 1.0;
/// A fit below this share of the running mean, with at least this share of its points in free space, is in the wrong place.
const CONTRADICTED: (f64, f64) = (0.5, 0.1);
/// A scan of which this share ends where nothing is known shows a new place.
const NEW_PLACE: f64 = 0.7;
/// Of scans with more beams than this only every n-th is matched: so that the cost of a fit is bounded.
const BEAMS_MAX: usize = 1000;
/// The first scans of a run are never dropped: with fewer the map is too thin for the running mean of the scores to say anything.
const START_SCANS: u64 = 10;
/// A drop is overruled when the standard deviation of the predicted position exceeds this, metres: a sixth of the reach of
/// the wide search, so that the place is well within it.
const SIGMA_MAX_M: f64 = 0.1;
/// Weight of the newest score in the running mean: it follows the place within some fifty scans, and no single bad one spoils it.
const MEAN_RATE: f64 = 0.02;
/// A fit below this share of the running mean is not believed: low, so that a place that has changed is.
const LOST_BELOW: f64 = 0.25;
/// A fit farther than this from the prediction must not score badly, or it is not believed, metres and radians: wheels seldom slip
/// so far within one scan.
const JUMP: (f64, f64) = (0.3, 0.3);
/// Wheels that miss a fit by more than this are slipping: metres and radians.
const SLIPPED: (f64, f64) = (0.15, 0.08);

mod bodies;
mod companions;
mod fitting;
mod movers;

/// Fits scans to the grid. A pure function of its calls.
#[derive(Debug)]
pub struct ScanMatcher {
    settings: Settings,
    motion: Motion,
    inserted: Option<Pose>,
    mean_score: f64,
    last_score: f64,
    matched: u64,
    /// Scans in a row whose fit was not believed.
    lost: u32,
    /// Whether the last fit was far from where the wheels had it.
    slips: bool,
    /// Number of the chain of submaps.
    chain: u32,
    /// Nothing but driving connects the chain with the map.
    detached: bool,
    /// The grid belongs to a chain before this one: it is not matched.
    begins_elsewhere: bool,
    /// Where a wide search found nothing.
    searched: Option<Pose>,
    generation: u64,
    active_submap: u32,
    map_from_odom: Pose,
    layout_revision: u32,
    points: Vec<Point>,
    /// The beam of each point.
    beams: Vec<u32>,
    /// Beams of the scan at hand that lie on what moves, and how many points they would be.
    moving: Vec<BeamRange>,
    aside: usize,
    /// Beams that are left out because they lie on something narrow.
    bodies: Vec<BeamRange>,
    /// Where other robots say that they are.
    companions: FlockRobots,
    /// Which of the points they were.
    set_aside: Vec<bool>,
    /// Seconds after the stamp at which each point was measured.
    times_s: Vec<f64>,
    weights: Vec<f64>,
    search: CorrelativeSearch,
    correlative: Correlative,
    ndt: Ndt,
}

/// A matched pose.
struct Match {
    pose: Pose,
    /// Velocity by which the scan was straightened, in the robot's own frame.
    twist: Twist,
    covariance: Covariance,
    score: f64,
    quality: Quality,
    rescued: bool,
}

impl ScanMatcher {
    /// A matcher at the origin of its odom frame.
    pub fn new(settings: Settings) -> Self {
        Self {
            motion: Motion::new(),
            inserted: None,
            mean_score: 0.0,
            last_score: 0.0,
            matched: 0,
            lost: 0,
            slips: false,
            chain: 0,
            detached: false,
            begins_elsewhere: false,
            searched: None,
            generation: 0,
            active_submap: 0,
            map_from_odom: Pose::IDENTITY,
            layout_revision: 0,
            points: Vec::new(),
            beams: Vec::new(),
            moving: Vec::new(),
            aside: 0,
            bodies: Vec::new(),
            companions: FlockRobots::default(),
            set_aside: Vec::new(),
            times_s: Vec::new(),
            weights: Vec::new(),
            search: CorrelativeSearch::default(),
            correlative: Correlative::default(),
            ndt: Ndt::default(),
            settings,
        }
    }

    /// The pose of a scan against the grid as it was last committed.
    pub fn handle<H: Deref<Target = Tile>>(
        &mut self,
        scan: ScanView<'_>,
        verdict: &Verdict,
        grid: &TileGrid<H>,
    ) -> PoseEstimate {
        let mut prediction = self.motion.predict(scan);
        if self.settings.rescue.below == 0.0 {
            // Nothing is searched: the wheels alone say where the scan is matched from.
            prediction.steady = None;
        }
        self.moving.clear();
        self.bodies.clear();
        self.aside = 0;
        let withheld = scan.header().withheld == 1;
        let overridden = verdict.keep == 0 && !withheld && self.overrules(&prediction);
        let mut estimate = self.predicted(scan, verdict, &prediction);
        if withheld || (verdict.keep == 0 && !overridden) {
            self.motion.advance(scan, prediction.pose, prediction.covariance, false);
            return estimate;
        }
        if overridden {
            estimate.flags |= PoseFlags::OVERRIDDEN;
        }
        self.take_points(scan, prediction.twist);
        if self.points.len() < POINTS_MIN {
            estimate.quality = Quality::Degraded as u32;
            self.motion.advance(scan, prediction.pose, prediction.covariance, false);
            return estimate;
        }
        if grid.is_empty() || self.begins_elsewhere {
            estimate.quality = if self.detached { Quality::Degraded } else { Quality::Tracking } as u32;
            self.begins_elsewhere = false;
        } else {
            self.set_movers_aside(scan, &prediction, grid);
            self.leave_out_bodies(scan);
            let field = GridField::new(grid, self.settings.unknown_score);
            let (prediction, fit) = self.settled(&field, prediction, scan);
            let found = self.match_scan(&field, &prediction, fit, scan);
            let found = self.believed(grid, found, &prediction);
            self.count(found.score, found.quality);
            self.slips = found.pose.distance_m(prediction.pose) > SLIPPED.0
                || found.pose.turn_rad(prediction.pose) > SLIPPED.1;
            self.fill(&mut estimate, &found);
            if self.lost > self.settings.rescue.lost_scans_max {
                self.begin_chain(&mut estimate);
            }
        }
        let lost = estimate.quality == Quality::Lost as u32;
        self.motion.advance(scan, estimate.odom_from_base, estimate.covariance, lost);
        if self.enters_map(&estimate) {
            estimate.flags |= PoseFlags::INSERT;
            self.inserted = Some(estimate.odom_from_base);
        }
        estimate
    }

    /// A generation of the grid became valid.
    pub fn committed(&mut self, commit: &Commit) {
        self.generation = commit.generation;
        self.active_submap = commit.active_submap;
    }

    /// Other robots have said where they are.
    pub fn companions_are(&mut self, robots: &FlockRobots) {
        self.companions = *robots;
    }

    /// sync-manager has a new correction.
    pub fn corrected(&mut self, layout: &LayoutHeader) {
        self.map_from_odom = layout.map_from_odom;
        self.layout_revision = layout.revision;
        if layout.chain == self.chain {
            self.detached = layout.attached == 0;
        }
    }

    /// Continues, after a restart, from the last pose that was published.
    pub fn resume(&mut self, last: &PoseEstimate) {
        let odometry = last.has(PoseFlags::HAS_ODOMETRY).then_some(last.odometry);
        self.motion.resume(last.odom_from_base, last.covariance, odometry, last.times.sensor_ns);
        self.map_from_odom = last.map_from_odom;
        self.layout_revision = last.layout_revision;
        self.generation = last.generation;
        self.active_submap = last.submap;
        self.inserted = Some(last.odom_from_base);
        self.chain = last.chain;
        (self.mean_score, self.last_score) = (last.score, last.score);
    }

    /// Continues a saved map: the robot may be anywhere by now, so a new chain of submaps begins at its next scan, which a closure
    /// may attach.
    pub fn resume_elsewhere(&mut self, last: &PoseEstimate) {
        self.resume(last);
        self.motion.resume(last.odom_from_base, Covariance::default(), None, last.times.sensor_ns);
        (self.chain, self.detached, self.begins_elsewhere) = (last.chain + 1, true, true);
        (self.inserted, self.mean_score, self.last_score) = (None, 0.0, 0.0);
    }

    /// The pose of a scan by the wheels alone: for when there is nothing to match it with.
    pub fn follow_wheels(&mut self, scan: ScanView<'_>) -> PoseEstimate {
        let header = scan.header();
        let verdict = Verdict { id: header.id, times: header.times, ..Verdict::default() };
        let prediction = self.motion.predict(scan);
        self.motion.advance(scan, prediction.pose, prediction.covariance, false);
        let quality = Quality::Degraded as u32;
        PoseEstimate { quality, ..self.predicted(scan, &verdict, &prediction) }
    }

    fn take_points(&mut self, scan: ScanView<'_>, twist: Twist) {
        let deskew = Deskew::new(scan, twist);
        let limits = self.settings.range_min_m..=self.settings.range_max_m;
        let skips = self.settings.skip_isolated;
        self.points.clear();
        self.beams.clear();
        self.times_s.clear();
        let [mut moving, mut bodies] = [&self.moving, &self.bodies].map(|ranges| ranges.iter().peekable());
        for beam in (0..scan.len()).step_by(self.stride(scan)) {
            let number = beam as u32;
            if holds(&mut moving, number) || holds(&mut bodies, number) {
                continue;
            }
            let Some(range) = scan.valid_range_m(beam) else { continue };
            if limits.contains(&range) && !(skips && scan.is_isolated(beam)) {
                self.points.push(deskew.end_in_base(scan, beam, range));
                self.beams.push(number);
                self.times_s.push(scan.time_s(beam));
            }
        }
    }

    /// Of the scan's beams every so many-th is matched.
    fn stride(&self, scan: ScanView<'_>) -> usize {
        scan.len().div_ceil(BEAMS_MAX).max(1)
    }

    /// Whether a scan that the filter would drop is needed nevertheless.
    fn overrules(&self, prediction: &Prediction) -> bool {
        let variance = SIGMA_MAX_M * SIGMA_MAX_M;
        self.matched < START_SCANS
            || prediction.steady.is_some()
            || self.slips
            || self.last_score < self.settings.rescue.below * self.mean_score
            || prediction.covariance.xx.max(prediction.covariance.yy) > variance
    }

    fn count(&mut self, score: f64, quality: Quality) {
        self.last_score = score;
        if quality == Quality::Lost {
            self.lost += u32::from(self.points.len() >= TELLING_POINTS);
            return;
        }
        self.lost = 0;
        self.matched += 1;
        let rate = MEAN_RATE.max(1.0 / self.matched as f64);
        self.mean_score += rate * (score - self.mean_score);
    }

    fn judge(&self, fit: &Fit, prediction: Pose) -> Quality {
        let rescue = &self.settings.rescue;
        let share = fit.score / self.mean_score.max(f64::MIN_POSITIVE);
        let jumps = fit.pose.distance_m(prediction) > JUMP.0 || fit.pose.turn_rad(prediction) > JUMP.1;
        let believed = share >= if jumps { rescue.below } else { LOST_BELOW };
        if !believed && rescue.lost_scans_max > 0 {
            Quality::Lost
        } else if share < rescue.below || fit.weakest_direction() < WEAK_DIRECTION {
            Quality::Degraded
        } else {
            Quality::Tracking
        }
    }

    /// A poor fit whose points end in free space is not believed: there the robot is somewhere else. One whose points end
    /// where nothing is known is a new place, and the wheels say where it is.
    fn believed<H: Deref<Target = Tile>>(
        &self,
        grid: &TileGrid<H>,
        found: Match,
        prediction: &Prediction,
    ) -> Match {
        let is_poor = found.score < CONTRADICTED.0 * self.mean_score;
        if self.settings.rescue.lost_scans_max == 0 || !is_poor {
            return found;
        }
        // Where the wheels have the robot, a good part of a scan may be new or have changed; anywhere else it must fit.
        let share_max = if found.rescued { CONTRADICTED.1 } else { CONTRADICTED.1.max(found.score) };
        let (matched, aside) = (self.points.len() as f64, self.aside as f64);
        let contradicting = matched * contradicted(grid, &self.points, found.pose) + aside;
        if contradicting >= share_max * (matched + aside) {
            return Match { quality: Quality::Lost, ..found };
        }
        let is_new = found.quality == Quality::Lost
            && in_the_unknown(grid, &self.points, prediction.pose) >= NEW_PLACE;
        if is_new {
            let Prediction { pose, twist, covariance, .. } = *prediction;
            return Match { pose, twist, covariance, quality: Quality::Degraded, ..found };
        }
        found
    }

    /// A robot that stays lost maps anew from where it believes to be; the map so far is left as it is, and a closure may
    /// connect the two.
    fn begin_chain(&mut self, estimate: &mut PoseEstimate) {
        self.chain += 1;
        self.detached = true;
        (self.matched, self.lost, self.mean_score, self.last_score) = (0, 0, 0.0, 0.0);
        (self.inserted, self.searched) = (None, None);
        estimate.chain = self.chain;
        estimate.quality = Quality::Degraded as u32;
    }

    fn enters_map(&self, estimate: &PoseEstimate) -> bool {
        if estimate.quality == Quality::Lost as u32 {
            return false;
        }
        let Some(last) = self.inserted else { return true };
        let gate = &self.settings.gate;
        let pose = estimate.odom_from_base;
        last.distance_m(pose) >= gate.travel_m || last.turn_rad(pose) >= gate.turn_rad
    }

    fn predicted(&self, scan: ScanView<'_>, verdict: &Verdict, prediction: &Prediction) -> PoseEstimate {
        let header = scan.header();
        PoseEstimate {
            id: header.id,
            times: header.times,
            odom_from_base: prediction.pose,
            map_from_odom: self.map_from_odom,
            odometry: scan.odometry().unwrap_or(Pose::IDENTITY),
            covariance: prediction.covariance,
            twist: prediction.twist,
            generation: self.generation,
            submap: self.active_submap,
            layout_revision: self.layout_revision,
            flags: if scan.odometry().is_some() { PoseFlags::HAS_ODOMETRY } else { 0 },
            drop_reason: verdict.drop_reason(),
            chain: self.chain,
            ..PoseEstimate::default()
        }
    }

    /// Takes a match over into the prediction; from a fit that is not believed only its score.
    fn fill(&self, estimate: &mut PoseEstimate, found: &Match) {
        estimate.score = found.score;
        estimate.twist = found.twist;
        let guessed = self.detached && found.quality == Quality::Tracking;
        estimate.quality = if guessed { Quality::Degraded } else { found.quality } as u32;
        if found.quality == Quality::Lost {
            return;
        }
        estimate.odom_from_base = found.pose;
        estimate.covariance = found.covariance;
        estimate.flags |= PoseFlags::MATCHED;
        if found.rescued {
            estimate.flags |= PoseFlags::RESCUED;
        }
    }
}

/// Whether ranges in order, asked for numbers in order, hold this one.
fn holds<'a>(ranges: &mut Peekable<impl Iterator<Item = &'a BeamRange>>, number: u32) -> bool {
    while ranges.next_if(|range| range.end <= number).is_some() {}
    ranges.peek().is_some_and(|range| range.first <= number)
}

#[cfg(test)]
mod corridor;
#[cfg(test)]
mod tests;
