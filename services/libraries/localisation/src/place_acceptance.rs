//! What is known of where the robot is, from how well each place agrees with what it has seen.

use crate::alignment::{Agreement, Fit};
use crate::belief::Knowledge;
use flockslam_registration::cloud::Placement;

/// A place is accepted when at least this share of the points is explained there, and at most this contradicted.
const EXPLAINED_MIN: f64 = 0.55;
const CONTRADICTED_MAX: f64 = 0.08;
/// The same at once, before this much travel, metres: a corner or a room has its like in every other building, …
const EARLY_M: f64 = 4.0;
const EARLY: (f64, f64) = (0.9, 0.04);
/// … or a little less where the merit elsewhere is at most this share.
const EARLY_ALONE: (f64, f64) = (0.85, 0.05);
const EARLY_ALONE_MAX: f64 = 0.6;
/// Over this much travel, metres, corridors and rooms of other buildings are distinguished: less is asked, and no more than this share elsewhere.
const FAR_M: f64 = 10.0;
const FAR: (f64, f64) = (0.5, 0.15);
const FAR_ALTERNATIVE_MAX: f64 = 0.65;
/// What is not as good is accepted when the same place is found again after some travel: most places that look like one of another building
/// soon contradict the map. So it is after at least this much travel, metres, with these shares explained and contradicted, when elsewhere is at
/// most so much of the merit, strictly and otherwise: where nothing is nearly as good, changes of the world explain the rest.
const ALONE_M: f64 = 2.0;
const ALONE: [((f64, f64), f64, f64); 2] = [((0.5, 0.15), 0.5, 0.65), ((0.7, 0.14), 0.8, 0.8)];
/// Where furniture stands that the map does not show, as in the plan of an architect, much contradicts it, but hardly anything is seen through
/// a wall: least share explained, greatest share behind them, …
const WALLS: (f64, f64) = (0.55, 0.04);
/// … greatest share contradicted, …
const FURNISHED_CONTRADICTED_MAX: f64 = 0.4;
/// … and elsewhere walls agree so much less with what was seen over at least this much travel, metres.
const FURNISHED_ALONE_MAX: f64 = 0.5;
const FURNISHED_M: f64 = 6.0;
/// Furniture that was moved contradicts the map here and there: least travel, metres, least share explained, greatest contradicted, and
/// greatest share of the merit elsewhere; equal rooms share their walls, and more travel tells them apart more surely. So it tells a bare
/// corridor of another building from one of this: much is explained there over some metres, and elsewhere in the map nearly as much.
const DRIVEN: [(f64, f64, f64, f64); 3] =
    [(4.0, 0.7, 0.12, 0.85), (4.0, 0.65, 0.15, 0.65), (10.0, 0.8, 0.2, 0.9)];
/// A robot that sees much which the map does not have: least travel, metres, least share explained, …
const BORDER_M: f64 = 3.0;
const BORDER_EXPLAINED_MIN: f64 = 0.35;
/// … greatest share contradicted of what is explained, and greatest share of the merit elsewhere.
const BORDER_CONTRADICTED_MAX: f64 = 0.15;
const BORDER_ALTERNATIVE_MAX: f64 = 0.5;
/// Outdoors: least travel, metres, least share explained and greatest contradicted, both strictly, and greatest share of the merit elsewhere.
/// Where nothing stands but a few trees, places some metres off explain much, and the true one nearly all.
const OUTDOORS: [(f64, f64, f64, f64); 2] = [(3.0, 0.65, 0.3, 0.5), (8.0, 0.85, 0.12, 0.8)];
/// The same for a place that has been the best at all searches over so much travel, metres. Places that only look like it, and those of another
/// campus, lead over 9 m at most when they explain this much.
const LEADING: [(f64, f64, f64, f64); 2] = [(10.0, 0.65, 0.25, 0.9), (12.0, 0.55, 0.3, 0.7)];
/// Nearer than this, metres, it is the same place, a step of the search off.
const OUTDOORS_APART_M: f64 = 2.0;
/// Elsewhere at most this share of the merit is found.
const ALTERNATIVE_MAX: f64 = 0.8;
/// A search gives so many places at most. Where more score alike, a place as good as one that so many searches gave was in one of them, too.
const LISTED_MIN: u32 = 3;

/// A pose hypothesis with its scores.
#[derive(Clone, Copy)]
pub(crate) struct Evaluated {
    pub(crate) at: Placement,
    pub(crate) score: f64,
    pub(crate) listed: Listed,
    pub(crate) fit: Option<Fit>,
    pub(crate) agreement: Agreement,
}

/// Whether a place as good as this one would have been found, too.
#[derive(Clone, Copy, Default)]
pub(crate) struct Listed {
    /// A search has shown that no place which it did not give is nearly as good.
    pub(crate) is_among_all: bool,
    /// Searches, each from another place of the drive, that gave this one.
    pub(crate) times: u32,
}

impl Evaluated {
    /// Share explained less share contradicted.
    pub(crate) fn merit(&self) -> f64 {
        (self.agreement.explained - self.agreement.contradicted).max(0.0)
    }

    /// Share explained and contradicted if nothing was taken away since the map was made: whatever is behind something contradicts it.
    fn strictly(&self) -> (f64, f64) {
        let Agreement { contradicted, clear, behind, through, .. } = self.agreement;
        (clear, contradicted - through + behind)
    }

    fn strict_merit(&self) -> f64 {
        let (explained, contradicted) = self.strictly();
        (explained - contradicted).max(0.0)
    }
}

/// Whether the best place of a search is accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Acceptance {
    /// It is not good enough.
    Rejected,
    /// It is good enough, and others may be as good.
    Ambiguous,
    /// It is the only one, once it is found again after some travel.
    Unconfirmed,
    /// It is the only one.
    Accepted,
}

impl Acceptance {
    /// What the robot knows by it, as long as no search after some travel has found the place again.
    pub(crate) fn knowledge(self) -> Knowledge {
        match self {
            Self::Rejected => Knowledge::Unknown,
            Self::Ambiguous | Self::Unconfirmed => Knowledge::Ambiguous,
            Self::Accepted => Knowledge::Localized,
        }
    }
}

/// Whether the best place is accepted after so much travel, metres, when these are the best, the best first. `is_held`: surfaces hold it
/// in all directions.
pub(crate) fn acceptance(evaluated: &[Evaluated], travel_m: f64, is_held: bool) -> Acceptance {
    let Some((best, others)) = evaluated.split_first() else { return Acceptance::Rejected };
    // The greatest share of the best place's merit that is found elsewhere, by both measures.
    let greatest = |of: fn(&Evaluated) -> f64| {
        let most = others.iter().map(of).fold(0.0, f64::max);
        if most > 0.0 { most / of(best) } else { 0.0 }
    };
    let (alternative, strict_alternative) = (greatest(Evaluated::merit), greatest(Evaluated::strict_merit));
    let most_alike = alternative.max(strict_alternative);
    let (explained, contradicted) = best.strictly();
    let is_within = |(least, most): (f64, f64)| explained >= least && contradicted <= most;
    let is_good = is_within((EXPLAINED_MIN, CONTRADICTED_MAX));
    let is_best = is_good && most_alike <= ALTERNATIVE_MAX;
    let is_clear = is_within(EARLY) || (is_within(EARLY_ALONE) && most_alike <= EARLY_ALONE_MAX);
    let is_at_border = travel_m >= BORDER_M
        && explained >= BORDER_EXPLAINED_MIN
        && contradicted <= BORDER_CONTRADICTED_MAX * explained
        && strict_alternative <= BORDER_ALTERNATIVE_MAX;
    // Each way to be good enough has its own measure of how much worse all others are.
    let is_alone = travel_m >= ALONE_M
        && ALONE.iter().any(|(shares, strict_most, most)| {
            is_within(*shares) && strict_alternative <= *strict_most && alternative <= *most
        });
    let is_far = travel_m >= FAR_M && is_within(FAR) && most_alike <= FAR_ALTERNATIVE_MAX;
    let is_among_furniture =
        is_among_furniture(best, others, travel_m) && strict_alternative <= ALTERNATIVE_MAX;
    let is_driven = |(m, least, most, _): &(f64, f64, f64, f64)| {
        travel_m >= *m && best.agreement.explained >= *least && best.agreement.contradicted <= *most
    };
    let stands_out = |of: &(f64, f64, f64, f64)| is_driven(of) && alternative <= of.3;
    let would_be_known = is_held && (best.listed.is_among_all || best.listed.times >= LISTED_MIN);
    if would_be_known && ((is_best && (is_clear || travel_m >= EARLY_M)) || is_at_border || is_far) {
        Acceptance::Accepted
    } else if would_be_known && (is_best || is_alone || is_among_furniture || DRIVEN.iter().any(stands_out)) {
        Acceptance::Unconfirmed
    } else if is_good || is_alone || is_among_furniture || DRIVEN.iter().any(is_driven) {
        Acceptance::Ambiguous
    } else {
        Acceptance::Rejected
    }
}

/// The same where most of what is seen is ground, grass and leaves: what is firm is explained by the map in part only, and still stands out.
/// The best place has been the best over `lead_m`, metres. A place is confirmed before it is accepted.
pub(crate) fn acceptance_outdoors(
    evaluated: &[Evaluated],
    travel_m: f64,
    lead_m: f64,
    is_held: bool,
) -> Acceptance {
    let Some((best, others)) = evaluated.split_first() else { return Acceptance::Rejected };
    let (explained, contradicted) = best.strictly();
    let is_elsewhere = |other: &&Evaluated| other.at.distance_m(&best.at) > OUTDOORS_APART_M;
    let most = others.iter().filter(is_elsewhere).map(Evaluated::strict_merit).fold(0.0, f64::max);
    let is_good = |way_m: f64, (least_m, least, greatest, _): &(f64, f64, f64, f64)| {
        way_m >= *least_m && explained >= *least && contradicted <= *greatest
    };
    let is_alone = |way_m: f64, of: &(f64, f64, f64, f64)| {
        is_good(way_m, of) && most <= of.3 * (explained - contradicted).max(0.0)
    };
    let would_be_known = is_held && (best.listed.is_among_all || best.listed.times >= LISTED_MIN);
    let stands_out = OUTDOORS.iter().any(|of| is_alone(travel_m, of));
    let leads = LEADING.iter().any(|of| is_alone(lead_m, of));
    if would_be_known && (stands_out || leads) {
        Acceptance::Unconfirmed
    } else if OUTDOORS.iter().any(|of| is_good(travel_m, of)) {
        Acceptance::Ambiguous
    } else {
        Acceptance::Rejected
    }
}

/// Whether all walls say that the robot is here, and only things between them that the map does not show say otherwise.
fn is_among_furniture(best: &Evaluated, others: &[Evaluated], travel_m: f64) -> bool {
    let by_walls = |evaluated: &Evaluated| evaluated.agreement.clear - evaluated.agreement.behind;
    travel_m >= FURNISHED_M
        && shows_walls(&best.agreement)
        && best.agreement.contradicted <= FURNISHED_CONTRADICTED_MAX
        && others.iter().all(|other| by_walls(other) <= FURNISHED_ALONE_MAX * by_walls(best))
}

/// Whether the map's walls are seen, and nothing through them.
pub(crate) fn shows_walls(agreement: &Agreement) -> bool {
    let (explained, behind) = WALLS;
    agreement.clear >= explained && agreement.behind <= behind
}

#[cfg(test)]
mod tests {
    use super::*;

    const LISTED: Listed = Listed { is_among_all: true, times: 0 };

    fn place(explained: f64, contradicted: f64, listed: Listed) -> Evaluated {
        let agreement = Agreement {
            explained,
            contradicted,
            clear: explained,
            behind: 0.5 * contradicted,
            through: 0.5 * contradicted,
        };
        Evaluated { at: Placement::IDENTITY, score: explained, listed, fit: None, agreement }
    }

    /// In a hotel, all rooms have the same walls, and a third of the furniture has moved.
    #[test]
    fn furniture_tells_equal_rooms_apart_after_some_metres() {
        let places = [place(0.85, 0.11, LISTED), place(0.76, 0.14, LISTED)];
        let of = |travel_m| acceptance(&places, travel_m, true);
        assert_eq!([2.0, 5.0].map(of), [Acceptance::Rejected, Acceptance::Unconfirmed]);
        let changed = [place(0.85, 0.16, LISTED), place(0.76, 0.16, LISTED)];
        let of = |travel_m| acceptance(&changed, travel_m, true);
        assert_eq!([5.0, 11.0].map(of), [Acceptance::Rejected, Acceptance::Unconfirmed]);
        let alike = [place(0.85, 0.13, LISTED), place(0.82, 0.14, LISTED)];
        assert_eq!(acceptance(&alike, 16.0, true), Acceptance::Ambiguous);
        let changed = [place(0.75, 0.22, LISTED), place(0.5, 0.4, LISTED)];
        assert_eq!(acceptance(&changed, 16.0, true), Acceptance::Rejected);
    }

    /// As Intel's log and that of ACES fit best in the map of FR079: what is explained and contradicted there, and the merit elsewhere.
    #[test]
    fn places_that_look_like_those_of_another_building_are_not_accepted_at_once() {
        let of = |explained: f64, contradicted: f64, alternative: f64, travel_m| {
            let other = alternative * (explained - contradicted);
            acceptance(&[place(explained, contradicted, LISTED), place(other, 0.0, LISTED)], travel_m, true)
        };
        assert_eq!(of(0.654, 0.137, 0.462, 1.8), Acceptance::Rejected, "a room of Intel");
        assert_eq!(of(0.624, 0.133, 0.898, 2.4), Acceptance::Rejected, "another one");
        assert_eq!(of(0.816, 0.071, 0.467, 0.9), Acceptance::Unconfirmed, "the same room before that");
        assert_eq!(
            of(0.730, 0.056, 0.795, 1.9),
            Acceptance::Unconfirmed,
            "a room of FR079 in the map of Intel"
        );
        assert_eq!(of(0.806, 0.116, 0.876, 4.0), Acceptance::Ambiguous, "a corridor of ACES");
        assert_eq!(of(0.742, 0.110, 0.718, 5.2), Acceptance::Unconfirmed, "it contradicts more 2 m later");
        assert_eq!(of(0.601, 0.172, 0.65, 10.6), Acceptance::Rejected, "much contradicts");
        assert_eq!(of(0.592, 0.132, 0.58, 14.1), Acceptance::Accepted, "ACES in its own map");
        assert_eq!(of(0.718, 0.151, 0.831, 8.3), Acceptance::Rejected, "as it does here");
    }

    #[test]
    fn who_sees_much_that_the_map_does_not_have_is_found_where_nothing_contradicts() {
        let at = |contradicted: f64, other: f64| {
            let places = [place(0.42, contradicted, LISTED), place(0.55, 0.55 - other, LISTED)];
            acceptance(&places, 8.0, true)
        };
        assert_eq!(at(0.03, 0.15), Acceptance::Accepted);
        assert_eq!(at(0.08, 0.15), Acceptance::Rejected, "much contradicts");
        assert_eq!(at(0.03, 0.3), Acceptance::Rejected, "another place is nearly as good");
        assert_eq!(
            acceptance(&[place(0.42, 0.03, LISTED)], 2.0, true),
            Acceptance::Rejected,
            "it has hardly driven"
        );
        assert_eq!(
            acceptance(&[place(0.42, 0.03, LISTED)], 8.0, false),
            Acceptance::Rejected,
            "nothing holds it"
        );
    }

    /// What is firm on a campus, seen over some metres: a place of its own map, and the best of another one's.
    #[test]
    fn outdoors_a_place_is_accepted_that_stands_out_though_some_of_what_is_seen_contradicts() {
        let of = |explained: f64, contradicted: f64, alternative: f64, travel_m| {
            let best = place(explained, contradicted, Listed { is_among_all: false, times: 4 });
            let other = place(alternative * best.strict_merit(), 0.0, LISTED);
            let beside = Evaluated { at: Placement::new(1.0, 0.0, 0.0), ..best };
            let other = Evaluated { at: Placement::new(40.0, 0.0, 0.0), ..other };
            acceptance_outdoors(&[best, beside, other], travel_m, 0.0, true)
        };
        assert_eq!(of(0.75, 0.24, 0.4, 5.0), Acceptance::Unconfirmed);
        assert_eq!(of(0.75, 0.24, 0.4, 1.0), Acceptance::Rejected, "it has hardly driven");
        assert_eq!(of(0.75, 0.24, 0.7, 5.0), Acceptance::Ambiguous, "another place is nearly as good");
        assert_eq!(of(0.6, 0.2, 0.1, 5.0), Acceptance::Rejected, "little is explained");
        assert_eq!(of(0.75, 0.35, 0.1, 5.0), Acceptance::Rejected, "much contradicts");
    }

    /// A crossing of paths looks like the next one: what tells them apart is little, and it is there all the time.
    #[test]
    fn outdoors_a_place_is_accepted_that_has_been_the_best_for_long() {
        let of = |explained: f64, contradicted: f64, alternative: f64, lead_m| {
            let best = place(explained, contradicted, LISTED);
            let other = place(alternative * best.strict_merit(), 0.0, LISTED);
            let other = Evaluated { at: Placement::new(40.0, 0.0, 0.0), ..other };
            acceptance_outdoors(&[best, other], 16.0, lead_m, true)
        };
        assert_eq!(of(0.78, 0.15, 0.85, 10.5), Acceptance::Unconfirmed);
        assert_eq!(of(0.78, 0.15, 0.85, 9.0), Acceptance::Ambiguous, "other places lead for as long");
        assert_eq!(of(0.78, 0.15, 0.95, 20.0), Acceptance::Ambiguous, "the other one is as good");
        assert_eq!(of(0.6, 0.27, 0.65, 12.5), Acceptance::Unconfirmed);
        assert_eq!(of(0.6, 0.27, 0.75, 12.5), Acceptance::Rejected, "another place is nearly as good");
        assert_eq!(of(0.5, 0.3, 0.1, 30.0), Acceptance::Rejected, "as on another campus");
    }

    /// Where more places score alike than a search gives, an equal one may be among those that it does not give.
    #[test]
    fn a_place_is_accepted_once_equal_ones_would_have_been_found() {
        let after = |times| acceptance(&[place(0.9, 0.02, Listed { is_among_all: false, times })], 5.0, true);
        assert_eq!(
            [0, 1, 2, 3].map(after),
            [Acceptance::Ambiguous, Acceptance::Ambiguous, Acceptance::Ambiguous, Acceptance::Accepted]
        );
    }
}
