//! Whether a robot that is followed has lost its place, by how well what it saw of late agrees with the map there.

use crate::alignment::Agreement;

/// It has when more than this of what it has seen contradicts the map, and less than three times as much is explained …
const CONTRADICTED: f64 = 0.1;
const EXPLAINED: f64 = 3.0;
/// … over at least this much travel, metres.
const OVER_M: f64 = 2.0;
/// Outdoors ground may look as if it were firm over a few metres, and kerbs are seen from afar only: it is enough when so much is explained of
/// those metres, …
const EXPLAINED_OUTDOORS: f64 = 0.3;
/// … and half as much as in buildings of all that a place is judged by.
const EXPLAINED_FAR: f64 = 1.5;

/// Whether a view contradicts the map. More must do so until the place is lost.
pub(crate) fn contradicts(agreement: &Agreement, is_outdoors: bool) -> bool {
    is_against(agreement, if is_outdoors { EXPLAINED_FAR } else { EXPLAINED })
}

/// Whether the place is lost, by how what was seen over so much travel, metres, agrees with the map there: over a little, and
/// outdoors over all that a place is judged by, `far_m`, when that is to be looked at.
pub(crate) fn is_lost(over: impl Fn(f64) -> Agreement, far_m: Option<f64>, is_outdoors: bool) -> bool {
    if is_outdoors {
        let is_lost_far = || far_m.is_some_and(|far_m| is_against(&over(far_m), EXPLAINED_FAR));
        is_against(&over(OVER_M), EXPLAINED_OUTDOORS) || is_lost_far()
    } else {
        is_against(&over(OVER_M), EXPLAINED)
    }
}

/// Whether more contradicts the map than a little, and less than so many times as much is explained.
fn is_against(agreement: &Agreement, explained: f64) -> bool {
    agreement.contradicted > CONTRADICTED && agreement.explained < explained * agreement.contradicted
}

#[cfg(test)]
mod tests {
    use super::*;

    fn agreement(explained: f64, contradicted: f64) -> Agreement {
        Agreement { explained, contradicted, ..Agreement::default() }
    }

    /// As they were on a campus: among kerbs, and where the robot was not.
    #[test]
    fn outdoors_kerbs_do_not_lose_a_place_and_nothing_of_it_does() {
        let lost = |near: (f64, f64), far: (f64, f64), is_outdoors| {
            let over = |length_m: f64| {
                let (explained, contradicted) = if length_m <= OVER_M { near } else { far };
                agreement(explained, contradicted)
            };
            is_lost(over, Some(16.0), is_outdoors)
        };
        assert!(!lost((0.36, 0.59), (0.73, 0.19), true));
        assert!(lost((0.36, 0.59), (0.73, 0.19), false));
        assert!(lost((0.08, 0.56), (0.93, 0.07), true));
        assert!(lost((0.46, 0.54), (0.45, 0.50), true));
        assert!(!lost((0.5, 0.08), (0.0, 1.0), false), "a little contradicts");
    }
}
