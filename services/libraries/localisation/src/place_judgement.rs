//! What is known of where the robot is, from how well each place agrees with what it has seen.

use crate::alignment::{Agreement, Fit};
use crate::belief::Knowledge;
use flockslam_registration::cloud::Placement;

/// A place is accepted when at least this share of the points is explained there, and at most this contradicted.
const EXPLAINED_MIN: f64 = 0.55;
const CONTRADICTED_MAX: f64 = 0.08;
/// Where nothing else is nearly as good, at most this share of the merit elsewhere, less is asked: changes of the world explain it.
const ALONE_MAX: f64 = 0.5;
const ALONE: (f64, f64) = (0.5, 0.15);
/// The same for what a robot has seen without having driven this far, metres.
const STANDING_M: f64 = 0.7;
const STANDING: (f64, f64) = (0.9, 0.04);
const STANDING_ALONE: (f64, f64) = (0.8, 0.06);
/// Where furniture stands that the map does not show, as in the plan of an architect, much contradicts it, but hardly anything is seen through
/// a wall: least share explained, greatest share behind them, …
const WALLS: (f64, f64) = (0.55, 0.04);
/// … greatest share contradicted, …
const FURNISHED_CONTRADICTED_MAX: f64 = 0.4;
/// … and elsewhere walls agree so much less with what was seen over at least this much travel, metres.
const FURNISHED_ALONE_MAX: f64 = 0.5;
const FURNISHED_M: f64 = 6.0;
/// Over at least this much travel furniture that was moved contradicts the map here and there: least share explained, greatest
/// contradicted, and greatest share of the merit elsewhere; equal rooms share their walls, and more travel tells them apart more surely.
const DRIVEN_M: f64 = 4.0;
const DRIVEN: (f64, f64) = (0.7, 0.2);
const DRIVEN_ALTERNATIVE_MAX: f64 = 0.9;
/// A robot that sees much which the map does not have: least travel, metres, least share explained, …
const BORDER_M: f64 = 3.0;
const BORDER_EXPLAINED_MIN: f64 = 0.35;
/// … greatest share contradicted of what is explained, and greatest share of the merit elsewhere.
const BORDER_CONTRADICTED_MAX: f64 = 0.15;
const BORDER_ALTERNATIVE_MAX: f64 = 0.5;
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

/// What is known after so much travel, metres, when these are the best places, the best first. `is_held`: surfaces hold the best one in
/// all directions.
pub(crate) fn knowledge(evaluated: &[Evaluated], travel_m: f64, is_held: bool) -> Knowledge {
    let Some((best, others)) = evaluated.split_first() else { return Knowledge::Unknown };
    let greatest = |of: fn(&Evaluated) -> f64| others.iter().map(of).fold(0.0, f64::max);
    let (alternative, strict_alternative) = (greatest(Evaluated::merit), greatest(Evaluated::strict_merit));
    let (explained, contradicted) = best.strictly();
    let (least, most) = match (travel_m < STANDING_M, strict_alternative <= ALONE_MAX * best.strict_merit()) {
        (true, true) => STANDING_ALONE,
        (true, false) => STANDING,
        (false, true) => ALONE,
        (false, false) => (EXPLAINED_MIN, CONTRADICTED_MAX),
    };
    let is_good = (explained >= least && contradicted <= most) || is_among_furniture(best, others, travel_m);
    let is_driven = travel_m >= DRIVEN_M
        && best.agreement.explained >= DRIVEN.0
        && best.agreement.contradicted <= DRIVEN.1;
    let is_at_border = travel_m >= BORDER_M
        && explained >= BORDER_EXPLAINED_MIN
        && contradicted <= BORDER_CONTRADICTED_MAX * explained;
    // Each way to be good enough has its own measure of how much worse all others are.
    let stands_out = (is_good && strict_alternative <= ALTERNATIVE_MAX * best.strict_merit())
        || (is_driven && alternative <= DRIVEN_ALTERNATIVE_MAX * best.merit())
        || (is_at_border && strict_alternative <= BORDER_ALTERNATIVE_MAX * best.strict_merit());
    let is_unique = stands_out && (best.listed.is_among_all || best.listed.times >= LISTED_MIN);
    match (is_unique && is_held, is_good || is_driven) {
        (true, _) => Knowledge::Localized,
        (false, true) => Knowledge::Ambiguous,
        (false, false) => Knowledge::Unknown,
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
        let places = [place(0.85, 0.13, LISTED), place(0.76, 0.16, LISTED)];
        let of = |travel_m| knowledge(&places, travel_m, true);
        assert_eq!([2.0, 5.0].map(of), [Knowledge::Unknown, Knowledge::Localized]);
        let alike = [place(0.85, 0.13, LISTED), place(0.82, 0.14, LISTED)];
        assert_eq!(knowledge(&alike, 16.0, true), Knowledge::Ambiguous);
        let changed = [place(0.75, 0.22, LISTED), place(0.5, 0.4, LISTED)];
        assert_eq!(knowledge(&changed, 16.0, true), Knowledge::Unknown);
    }

    #[test]
    fn who_sees_much_that_the_map_does_not_have_is_found_where_nothing_contradicts() {
        let at = |contradicted: f64, other: f64| {
            let places = [place(0.42, contradicted, LISTED), place(0.55, 0.55 - other, LISTED)];
            knowledge(&places, 8.0, true)
        };
        assert_eq!(at(0.03, 0.15), Knowledge::Localized);
        assert_eq!(at(0.08, 0.15), Knowledge::Unknown, "much contradicts");
        assert_eq!(at(0.03, 0.3), Knowledge::Unknown, "another place is nearly as good");
        assert_eq!(
            knowledge(&[place(0.42, 0.03, LISTED)], 2.0, true),
            Knowledge::Unknown,
            "it has hardly driven"
        );
        assert_eq!(
            knowledge(&[place(0.42, 0.03, LISTED)], 8.0, false),
            Knowledge::Unknown,
            "nothing holds it"
        );
    }

    /// Where more places score alike than a search gives, an equal one may be among those that it does not give.
    #[test]
    fn a_place_is_accepted_once_equal_ones_would_have_been_found() {
        let after = |times| knowledge(&[place(0.9, 0.02, Listed { is_among_all: false, times })], 5.0, true);
        assert_eq!(
            [0, 1, 2, 3].map(after),
            [Knowledge::Ambiguous, Knowledge::Ambiguous, Knowledge::Ambiguous, Knowledge::Localized]
        );
    }
}
