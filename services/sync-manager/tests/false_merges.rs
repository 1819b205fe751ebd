//! Robots that share a place are merged, and no others, with as many lies as truths.

#[path = "support/flocks.rs"]
mod flocks;
#[allow(dead_code, reason = "what several tests share, one of them does not need all of")]
mod support;
#[path = "support/trials.rs"]
mod trials;

#[test]
fn meetings_merge_and_strangers_stay_apart() {
    // One trial of each kind; the example of this name runs any number.
    for number in [0, 2, 3, 4, 5, 6, 7] {
        let trial = trials::trial(number);
        let outcome = trials::run(&trial);
        assert!(!outcome.is_false_merge(), "{number} ({}): {} m", trial.kind, outcome.worst_m);
        assert_eq!(outcome.merged, trial.is_meeting, "{number} ({}), {:?} told", trial.kind, outcome.told);
        assert!(outcome.searches > 0);
    }
}
