//! Robots that share a place are merged, and no others, despite false constraints on their relative poses.

use super::meeting_trials::{run, trial};

/// One trial of each kind: 0 – two robots in one office; 2 – in an office, on opposite ways; 3 – in an office of equal rooms; 4 –
/// in a ring of corridors; 5 – in two different offices; 6 – in two different offices of equal rooms; 7 – in one corridor of equal
/// niches, at places that do not overlap. The first four are meetings, the others are not.
///
/// Trial 1 is left out: it is of the kind of trial 0, and a trial takes seconds. The example `false_merges` runs any number of them.
#[test]
fn meetings_merge_and_different_buildings_stay_apart() {
    let numbers = [0, 2, 3, 4, 5, 6, 7];
    let kinds = numbers.map(|number| trial(number).kind);
    assert!((1..kinds.len()).all(|i| !kinds[..i].contains(&kinds[i])), "each kind once: {kinds:?}");
    assert_eq!(trial(1).kind, kinds[0]);
    for number in numbers {
        let trial = trial(number);
        let outcome = run(&trial);
        assert!(!outcome.is_false_merge(), "{number} ({}): {} m", trial.kind, outcome.worst_m);
        assert_eq!(trial.is_meeting, number <= 4, "{number} ({})", trial.kind);
        assert_eq!(
            outcome.merged, trial.is_meeting,
            "{number} ({}), {:?} closures",
            trial.kind, outcome.closures
        );
        assert!(
            outcome.closures.1 >= outcome.closures.0.max(12),
            "{number}: false closures are added, {:?}",
            outcome.closures
        );
        assert!(outcome.searches > 0);
    }
}
