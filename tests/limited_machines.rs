//! A set on one processor and little memory maps live without losing a scan.

use crate::support::limited_machine::{Machine, office_on};
use crate::support::{machine_share, truth_error_m};

const DURATION_S: u32 = 45;
/// Mean distance of the final trajectory from the truth, metres: as on any machine.
const ERROR_MAX_M: f64 = 0.05;

#[test]
fn one_processor_and_256_mib_map_the_office_live_without_the_loss_of_a_scan() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let machine = Machine { processors: 1.0, memory_mib: 256 };
    let Some(limited) = office_on(&machine, DURATION_S, directory.path()) else { return };
    let report = &limited.outputs.report;
    println!("{:?} MiB at most, held up {:?}", limited.peak_mib, limited.held_up);
    println!("dropped {:?}, kept {:?}", report.dropped, report.kept_by_reason);
    assert_eq!(report.scans, u64::from(10 * DURATION_S));
    assert_eq!(report.kept + report.dropped.values().sum::<u64>(), report.scans);
    for reason in ["overload", "deadline", "lost"] {
        assert!(!report.dropped.contains_key(reason), "{:?}", report.dropped);
    }
    assert!(report.stages.values().all(|stage| stage.restarts == 0), "{:?}", report.stages);
    let error_m = truth_error_m(&limited.outputs);
    assert!(error_m < ERROR_MAX_M, "{error_m} m");
}
