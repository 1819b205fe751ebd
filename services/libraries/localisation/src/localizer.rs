//! Finds a robot in the known map and follows it: scans and poses of the front end in, a belief out.

use crate::alignment::{Agreement, SeenPoint, Surroundings};
use crate::belief::{Belief, Hypothesis, Knowledge};
use crate::front_end_slip::corrected;
use crate::information::{carried, widest};
use crate::leading_place::LeadingPlace;
use crate::lost_place;
use crate::outdoor_state::{Outdoors, free_samples};
use crate::place_acceptance::{Acceptance, Evaluated, Listed, acceptance, acceptance_outdoors, shows_walls};
use crate::place_search::{Near, PlaceSearch, SearchRequest, is_same};
use crate::pose_hint::Hint;
use crate::recent_views::RecentViews;
use crate::search_schedule::SearchSchedule;
use flockslam_evidence::floor;
use flockslam_geometry::elementary::exp;
use flockslam_pose_graph::{Symmetric, inverse};
use flockslam_registration::cloud::{PackedPoint, Placement};

/// What was seen over this much travel is looked for in the map …
const SEARCH_M: f64 = 8.0;
/// … and is verified over this much, metres.
const VERIFIED_M: f64 = 16.0;
/// Points that are fitted and verified.
const POINTS: usize = 600;
/// Least score of a place in a search, and least share of the best.
const SCORE_MIN: f64 = 0.45;
const SHARE_MIN: f64 = 0.75;
/// A cloud of fewer points is not looked for.
const POINTS_MIN: usize = 40;
/// An unconfirmed place is accepted when it is found again after this much travel, metres.
const CONFIRMED_M: f64 = 2.0;

/// Places that were not looked at score at most this share of the place that is accepted.
const UNSEEN_MAX: f64 = 0.92;
/// Greatest standard deviation of a pose in the worst direction from one fit, metres.
const SIGMA_MAX_M: f64 = 0.1;
/// A hint within these standard deviations is an initial pose, as in AMCL: metres and radians; a wider one only where
/// to look.
const HINT_SIGMA_MAX: (f64, f64) = (1.0, 0.6);
/// The scan at the hint's pose must agree so far with the map: least share explained, greatest contradicted.
const HINT_EXPLAINED_MIN: f64 = 0.4;
const HINT_CONTRADICTED_MAX: f64 = 0.25;
/// Merit that a place loses for each squared standard deviation from the hint.
const HINT_PULL: f64 = 0.02;
/// How sharply merit separates weights.
const SHARPNESS: f64 = 40.0;
/// Hypotheses that are published and followed.
const HYPOTHESES_MAX: usize = 16;

/// Information of all points of a fit together, 1/m²: a wall seen by all fixes its distance to a centimetre.
const FIT_INFORMATION: f64 = 1e4;
/// The pose is followed with what was seen over this much travel, metres.
const FOLLOWED_M: f64 = 0.3;
/// Each point is in so many fits, one after the other.
const SHARED: f64 = 1.0 / 6.0;
/// How the front end's pose drifts: standard deviations for a metre of travel, metres and radians, and for a radian of turning.
const DRIFT: (f64, f64) = (0.015, 0.004);
const DRIFT_TURNING_RAD: f64 = 0.004;
/// What is firm is known after this much travel, metres.
const FIRM_FROM_M: f64 = 3.0;
/// A fit of fewer inliers is discarded.
const INLIERS_MIN: f64 = 0.25;
/// After this much travel a better place is looked for beside the one that is followed …
const CHECK_M: f64 = 1.0;
/// … for what was seen over this much, metres, within metres and radians, …
const BESIDE_M: f64 = 3.0;
const BESIDE_REACH: (f64, f64) = (1.0, 0.15);
/// … and taken when its merit is so much better.
const BESIDE_BETTER: f64 = 0.1;
/// How far a robot may be from where a predecessor of this process had it: standard deviations, metres and radians.
const RESUMED_SIGMA: (f64, f64) = (0.1, 0.03);
/// Finds and follows a robot in a known map. A pure function of its calls; work per call is bounded.
pub struct Localizer {
    surroundings: Surroundings,
    search: PlaceSearch,
    recent: RecentViews,
    belief: Belief,
    /// `map_from_odom` and the information of the robot's pose, while it is followed.
    followed: Option<Followed>,
    /// The best places of the last search, as `map_from_odom`: none is dropped because a later search gives others.
    kept: Vec<(Placement, Listed)>,
    /// A place that was unconfirmed, as `map_from_odom`, and the way until then, metres.
    unconfirmed: Option<(Placement, f64)>,
    /// The best place of the searches so far.
    leading: LeadingPlace,
    /// When the robot is looked for again. Every second search is at the border of what is mapped.
    schedule: SearchSchedule,
    last: Option<Placement>,
    outdoors: Outdoors,
    /// Travel since that was looked at, metres.
    since_firm_m: f64,
    /// A guess from outside that was not tried yet.
    hint: Option<Hint>,
    searches: u64,
    measured: Option<Measurement>,
    /// Travel since what was seen agreed with the map, while the robot is followed, metres.
    since_agreed_m: f64,
    /// Travel since a better place was looked for beside the one that is followed, metres.
    since_check_m: f64,
}

/// Where the robot was measured to be by what it saw last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// The pose.
    pub map_from_base: Placement,
    /// What the points say of it, without what was known before, in the map's axes.
    pub information: Symmetric,
}

#[derive(Clone, Copy)]
struct Followed {
    map_from_odom: Placement,
    information: Symmetric,
}

impl Localizer {
    /// A robot that may be anywhere in the map.
    pub fn new(surroundings: Surroundings) -> Self {
        Self {
            surroundings,
            search: PlaceSearch::default(),
            recent: RecentViews::default(),
            belief: Belief::default(),
            followed: None,
            kept: Vec::new(),
            outdoors: Outdoors::default(),
            since_firm_m: 0.0,
            unconfirmed: None,
            leading: LeadingPlace::default(),
            schedule: SearchSchedule::default(),
            last: None,
            hint: None,
            searches: 0,
            measured: None,
            since_agreed_m: 0.0,
            since_check_m: 0.0,
        }
    }

    /// The known map.
    pub fn surroundings(&self) -> &Surroundings {
        &self.surroundings
    }

    /// The belief.
    pub fn belief(&self) -> &Belief {
        &self.belief
    }

    /// `map_from_odom`, while the robot is localized.
    pub fn map_from_odom(&self) -> Option<Placement> {
        self.followed.map(|followed| followed.map_from_odom)
    }

    /// Where the robot was measured to be at the last view; `None` when it is not localized or saw nothing of the map.
    pub fn measured(&self) -> Option<Measurement> {
        self.measured
    }

    /// How often the map was searched.
    pub fn searches(&self) -> u64 {
        self.searches
    }

    /// Drops the pose of the robot and searches again, near a hint when there is one.
    pub fn relocalize(&mut self, hint: Option<Hint>) {
        self.followed = None;
        self.belief = Belief::default();
        self.kept.clear();
        self.unconfirmed = None;
        self.leading.end();
        self.since_agreed_m = 0.0;
        self.schedule = SearchSchedule::default();
        self.hint = hint;
    }

    /// Goes on where a predecessor had the robot: its correction, which the next view has to bear out.
    pub fn resume(&mut self, map_from_odom: Placement) {
        let (position, heading) = (RESUMED_SIGMA.0.powi(-2), RESUMED_SIGMA.1.powi(-2));
        self.followed =
            Some(Followed { map_from_odom, information: [position, 0.0, 0.0, position, 0.0, heading] });
        self.belief.knowledge = Knowledge::Localized;
    }

    /// The front end has begun a trajectory that is not known relative to the one before.
    pub fn odometry_breaks(&mut self) {
        self.recent.clear();
        self.last = None;
        self.relocalize(None);
    }

    /// Takes the points of a scan (in the robot's frame) at its pose by the front end, some decimetres after the last one.
    pub fn see(&mut self, odom_from_base: Placement, points: &[PackedPoint]) -> &Belief {
        self.recent.push(odom_from_base, points, VERIFIED_M);
        self.measured = None;
        let last = self.last.replace(odom_from_base).unwrap_or(odom_from_base);
        if let Some(followed) = self.followed {
            self.follow(followed, last, odom_from_base);
        }
        if self.followed.is_none() && self.schedule.is_due(&odom_from_base) {
            let has_moved = self.schedule.begin(odom_from_base);
            self.look(odom_from_base, has_moved);
        }
        &self.belief
    }

    /// Whether a robot that is followed is outdoors, after so much more travel, metres: is looked at once in a while.
    fn follows_outdoors(&mut self, way_m: f64) -> bool {
        self.since_firm_m += way_m;
        if self.since_firm_m >= FOLLOWED_M && self.recent.travel_m() >= FIRM_FROM_M {
            let (firm, share) = self.recent.firm_cloud(FOLLOWED_M, POINTS);
            self.outdoors = self.outdoors.after(self.since_firm_m, firm.len(), share);
            self.since_firm_m = 0.0;
        }
        self.outdoors.is_so()
    }

    /// What was seen over the last metres; outdoors what of it is firm, if enough is.
    fn seen(&self, length_m: f64, most: usize) -> Vec<SeenPoint> {
        let firm = if self.outdoors.is_so() { self.recent.firm_cloud(length_m, most).0 } else { Vec::new() };
        if firm.len() >= POINTS_MIN { firm } else { self.recent.cloud(length_m, most) }
    }

    fn agreement(&self, cloud: &[SeenPoint], at: &Placement) -> Agreement {
        if self.outdoors.is_so() {
            self.surroundings.agreement_outdoors(cloud, at)
        } else {
            self.surroundings.agreement(cloud, at)
        }
    }

    /// Follows the robot by fitting what it sees to the map.
    fn follow(&mut self, followed: Followed, last: Placement, odom: Placement) {
        let (way_m, turn_rad) = (last.distance_m(&odom), last.turn_rad(&odom));
        let expected = followed.map_from_odom.compose(odom);
        let position = DRIFT.0 * DRIFT.0 * way_m;
        let heading = DRIFT.1 * DRIFT.1 * way_m + DRIFT_TURNING_RAD * DRIFT_TURNING_RAD * turn_rad;
        let prior = carried(&followed.information, position, heading);
        let is_outdoors = self.follows_outdoors(way_m);
        let cloud = self.seen(FOLLOWED_M, POINTS);
        let unit = SHARED * FIT_INFORMATION / cloud.len().max(1) as f64;
        let fit = self.surroundings.fit(&cloud, expected, &prior.map(|v| v / unit));
        let fit = fit.filter(|fit| fit.inliers >= INLIERS_MIN);
        let mut now = Followed { map_from_odom: followed.map_from_odom, information: prior };
        if let Some(fit) = fit {
            now.map_from_odom = fit.map_from_cloud.compose(odom.inverse());
            let information = fit.information.map(|h| unit * h);
            self.measured = Some(Measurement { map_from_base: fit.map_from_cloud, information });
            now.information.iter_mut().zip(fit.information).for_each(|(sum, h)| *sum += unit * h);
        }
        self.followed = Some(now);
        self.since_check_m += way_m;
        if self.since_check_m >= CHECK_M {
            self.since_check_m = 0.0;
            if let Some(better) = self.better_beside(now.map_from_odom.compose(odom)) {
                now = Followed { map_from_odom: better.compose(odom.inverse()), information: prior };
                self.followed = Some(now);
                self.measured = None;
            }
        }
        let mut at = now.map_from_odom.compose(odom);
        let newest = if is_outdoors { Vec::new() } else { self.recent.cloud(0.0, POINTS) };
        if let Some((place, information)) = corrected(&self.surroundings, &newest, expected, at, unit) {
            (at, self.measured) = (place, None);
            now = Followed { map_from_odom: at.compose(odom.inverse()), information };
            self.followed = Some(now);
        }
        let agreement = self.agreement(&cloud, &at);
        self.belief = Belief {
            knowledge: Knowledge::Localized,
            hypotheses: vec![Hypothesis { map_from_base: at, weight: 1.0, agreement }],
            covariance: inverse(&now.information),
        };
        let before_m = self.since_agreed_m;
        self.since_agreed_m += way_m;
        if !lost_place::contradicts(&agreement, is_outdoors) {
            self.since_agreed_m = 0.0;
        } else if !shows_walls(&agreement) && self.is_lost(&at, before_m) {
            // A kidnapped robot has no odometry from the last agreeing scans to the contradicting ones.
            self.recent.keep(self.since_agreed_m);
            self.relocalize(None);
            self.measured = None;
        }
    }

    /// Whether what was seen over some metres contradicts a pose so much that the robot is elsewhere; at the last view the map had been
    /// contradicted for `before_m` metres.
    fn is_lost(&self, at: &Placement, before_m: f64) -> bool {
        let over = |length_m: f64| self.agreement(&self.seen(length_m, POINTS), at);
        // To look far back is much work.
        let is_next_metre = floor(self.since_agreed_m) > floor(before_m);
        lost_place::is_lost(over, is_next_metre.then_some(VERIFIED_M), self.outdoors.is_so())
    }

    /// A pose beside this one with which what was seen last agrees clearly better: the front end may slip along a bare corridor by more
    /// than a fit finds.
    fn better_beside(&mut self, at: Placement) -> Option<Placement> {
        let cloud = self.recent.cloud(BESIDE_M, POINTS);
        let points: Vec<(f64, f64)> = cloud.iter().map(|p| (p.x_m, p.y_m)).collect();
        let near = Near { pose: at, reach_m: BESIDE_REACH.0, turn_rad: BESIDE_REACH.1 };
        let request = SearchRequest { score_min: SCORE_MIN, share_min: SHARE_MIN, near: Some(near) };
        let present = self.agreement(&cloud, &at);
        let merit = |agreement: &Agreement| agreement.explained - agreement.contradicted;
        let places = self.search.find(self.surroundings.field(), &points, &request);
        let evaluated =
            places.found.iter().map(|place| self.evaluate(&cloud, place.map_from_cloud, place.score));
        let best = evaluated.max_by(|a, b| merit(&a.agreement).total_cmp(&merit(&b.agreement)))?;
        let is_better = merit(&best.agreement) >= merit(&present) + BESIDE_BETTER
            && best.agreement.contradicted <= present.contradicted;
        is_better.then_some(best.at)
    }

    /// Accepts a hint, as far as the scans agree with it: it decides between places that are otherwise ambiguous.
    fn follow_hint(&mut self, odom: Placement, hint: &Hint) -> bool {
        if hint.sigma_rad > HINT_SIGMA_MAX.1 || hint.sigma_m > HINT_SIGMA_MAX.0 {
            return false;
        }
        let (position, heading) = (hint.sigma_m.powi(-2), hint.sigma_rad.powi(-2));
        let prior = [position, 0.0, 0.0, position, 0.0, heading];
        let cloud = self.recent.cloud(SEARCH_M, POINTS);
        if cloud.len() < POINTS_MIN {
            return false;
        }
        let points: Vec<(f64, f64)> = cloud.iter().map(|p| (p.x_m, p.y_m)).collect();
        let request = SearchRequest { score_min: 0.0, share_min: SHARE_MIN, near: Some(hint.near()) };
        let places = self.search.find(self.surroundings.field(), &points, &request);
        let starts = places.found.iter().map(|place| place.map_from_cloud).chain([hint.map_from_base]);
        let unit = FIT_INFORMATION / cloud.len() as f64;
        let fitted = starts.filter_map(|start| {
            // A fit is drawn to its start; how far that is from the hint counts in its merit.
            let fit = self.surroundings.fit(&cloud, start, &prior.map(|v| v / unit))?;
            let agreement = self.agreement(&cloud, &fit.map_from_cloud);
            let moved = hint.map_from_base.to(fit.map_from_cloud);
            let off = (moved.x_m * moved.x_m + moved.y_m * moved.y_m) * position
                + moved.heading_rad * moved.heading_rad * heading;
            let merit = agreement.explained - agreement.contradicted - HINT_PULL * off;
            Some((merit, fit, agreement))
        });
        let best = fitted.max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, fit, agreement)) = best.filter(|(_, _, agreement)| {
            agreement.explained >= HINT_EXPLAINED_MIN && agreement.contradicted <= HINT_CONTRADICTED_MAX
        }) else {
            return false;
        };
        let mut information = prior;
        information.iter_mut().zip(fit.information).for_each(|(sum, h)| *sum += unit * h);
        self.followed =
            Some(Followed { map_from_odom: fit.map_from_cloud.compose(odom.inverse()), information });
        self.belief = Belief {
            knowledge: Knowledge::Localized,
            hypotheses: vec![Hypothesis { map_from_base: fit.map_from_cloud, weight: 1.0, agreement }],
            covariance: inverse(&information),
        };
        true
    }

    /// Looks for the robot in the map. `has_moved`: it sees other things than at the last search.
    fn look(&mut self, odom: Placement, has_moved: bool) {
        self.searches += 1;
        if let Some(hint) = self.hint
            && self.follow_hint(odom, &hint)
        {
            self.hint = None;
            return;
        }
        // A hint without a result is not used twice.
        let near = self.hint.take().map(|hint| hint.near());
        let cloud = self.recent.cloud(SEARCH_M, 2 * POINTS);
        if cloud.len() < POINTS_MIN {
            self.belief = Belief::default();
            return;
        }
        let (firm, firm_share) = self.recent.firm_cloud(SEARCH_M, 2 * POINTS);
        self.outdoors = Outdoors::by_search(firm.len(), firm_share);
        let cloud = if self.outdoors.is_so() { firm } else { cloud };
        let is_outdoors = self.outdoors.is_so();
        let points: Vec<(f64, f64)> = cloud.iter().map(|p| (p.x_m, p.y_m)).collect();
        let request = SearchRequest { score_min: SCORE_MIN, share_min: SHARE_MIN, near };
        let is_at_border = near.is_none() && self.schedule.searches() % 2 == 1;
        let places = if is_outdoors {
            let free = free_samples(&cloud);
            self.search.find_seen(self.surroundings.outdoor_field(), &points, &free, &request)
        } else if is_at_border {
            self.search.find(self.surroundings.border_field(), &points, &request)
        } else {
            self.search.find(self.surroundings.field(), &points, &request)
        };
        self.schedule.searched(places.blocks);
        let verification_cloud = self.seen(VERIFIED_M, POINTS);
        let mut evaluated: Vec<Evaluated> = Vec::new();
        for place in &places.found {
            let mut at = place.map_from_cloud;
            if is_outdoors {
                at = self.surroundings.nearest_outdoors(&verification_cloud, at);
            }
            let mut candidate = self.evaluate(&verification_cloud, at, place.score);
            candidate.listed.is_among_all = places.others_max <= UNSEEN_MAX * place.score;
            candidate.listed.times = u32::from(has_moved);
            if !evaluated.iter().any(|better| is_same(&better.at, &candidate.at)) {
                evaluated.push(candidate);
            }
        }
        for (map_from_odom, listed) in std::mem::take(&mut self.kept) {
            let mut candidate = self.evaluate(&verification_cloud, map_from_odom.compose(odom), 0.0);
            match evaluated.iter_mut().find(|other| is_same(&other.at, &candidate.at)) {
                Some(Evaluated { listed: now, .. }) => {
                    now.is_among_all |= listed.is_among_all;
                    now.times += listed.times;
                }
                None => {
                    candidate.listed = listed;
                    evaluated.push(candidate);
                }
            }
        }
        // A stable sort: of equals the one with the better score.
        evaluated.sort_by(|a, b| b.merit().total_cmp(&a.merit()));
        let from_odom = odom.inverse();
        // A search near a hint gives no result for other places.
        let listed = |j: &Evaluated| if near.is_some() { Listed::default() } else { j.listed };
        let kept = evaluated.iter().take(HYPOTHESES_MAX).map(|j| (j.at.compose(from_odom), listed(j)));
        self.kept = kept.collect();
        self.conclude(odom, &evaluated, places.others_max);
    }

    fn evaluate(&self, cloud: &[SeenPoint], at: Placement, score: f64) -> Evaluated {
        let weak = [1.0, 0.0, 0.0, 1.0, 0.0, 4.0];
        let fit = self.surroundings.fit(cloud, at, &weak);
        let at = fit.map_or(at, |fit| fit.map_from_cloud);
        Evaluated { at, score, listed: Listed::default(), fit, agreement: self.agreement(cloud, &at) }
    }

    /// Whether an unconfirmed place was found before, too, far enough from here; remembers it otherwise.
    fn confirms(&mut self, odom: &Placement, at: &Placement) -> bool {
        let way_m = self.recent.way_m();
        let before = self.unconfirmed.filter(|(from, _)| is_same(&from.compose(*odom), at));
        let (_, since_m) = *self.unconfirmed.insert(before.unwrap_or((at.compose(odom.inverse()), way_m)));
        way_m - since_m >= CONFIRMED_M
    }

    fn conclude(&mut self, odom: Placement, evaluated: &[Evaluated], others_max: f64) {
        let Some(best) = evaluated.first() else {
            self.belief = Belief::default();
            self.leading.end();
            return;
        };
        let lead_m = self.leading.after(&best.at, &odom, self.recent.way_m());
        let worth = |merit: f64| exp(SHARPNESS * (merit - best.merit()));
        let unseen = exp(SHARPNESS * (others_max - best.score));
        let sum: f64 = evaluated.iter().map(|j| worth(j.merit())).sum::<f64>() + unseen.min(1.0);
        let hypothesis = |j: &Evaluated| Hypothesis {
            map_from_base: j.at,
            weight: worth(j.merit()) / sum,
            agreement: j.agreement,
        };
        self.belief.hypotheses = evaluated.iter().take(HYPOTHESES_MAX).map(hypothesis).collect();
        self.belief.covariance = None;
        let covariance = best.fit.and_then(|fit| {
            let unit = FIT_INFORMATION / POINTS as f64;
            inverse(&fit.information.map(|h| unit * h))
        });
        let is_held = covariance.is_some_and(|c| widest(&c) <= SIGMA_MAX_M * SIGMA_MAX_M);
        let travel_m = self.recent.travel_m();
        let acceptance = if self.outdoors.is_so() {
            acceptance_outdoors(evaluated, travel_m, lead_m, is_held)
        } else {
            acceptance(evaluated, travel_m, is_held)
        };
        let is_confirmed = acceptance == Acceptance::Unconfirmed && self.confirms(&odom, &best.at);
        self.belief.knowledge = if is_confirmed { Knowledge::Localized } else { acceptance.knowledge() };
        if let (Knowledge::Localized, Some(fit), Some(covariance)) =
            (self.belief.knowledge, best.fit, covariance)
        {
            self.belief.covariance = Some(covariance);
            let information = fit.information.map(|h| SHARED * FIT_INFORMATION / POINTS as f64 * h);
            self.measured = Some(Measurement { map_from_base: best.at, information });
            let information = inverse(&covariance).unwrap_or(fit.information);
            self.followed = Some(Followed { map_from_odom: best.at.compose(odom.inverse()), information });
        }
    }
}

#[cfg(test)]
mod outdoor_tests;
#[cfg(test)]
mod tests;
