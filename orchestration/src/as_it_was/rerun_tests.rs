//! Tests of running a recording again, on recordings of a few scans.

use super::*;
use crate::configuration::Configuration;
use crate::supervisor::SetFile;
use flockslam_lidar_ingest::process::Source;
use flockslam_messages::{ScanBuffer, ScanId};
use flockslam_stage::Mode;

fn recording() -> BlackBox {
    let configuration = Configuration::default();
    let set = SetFile {
        version: crate::VERSION.to_owned(),
        options: configuration.stage_options(Mode::Live),
        source: Source::Simulation,
        rate: None,
        world: None,
        configuration,
    };
    let (scans, poses, marks) = Default::default();
    let (matcher, cleaner, commits) = Default::default();
    BlackBox {
        set,
        scans,
        poses,
        matcher,
        cleaner,
        commits,
        marks,
        cut_short: None,
        places: Default::default(),
    }
}

fn id(sequence: u64) -> ScanId {
    ScanId { sequence, ..ScanId::default() }
}

fn inputs(process: u64, handled: u64, sequence: u64) -> StageInputs {
    StageInputs { process, handled, id: id(sequence), keep: 1, ..StageInputs::default() }
}

#[test]
fn a_scan_whose_pose_a_killed_matcher_did_not_publish_is_in_no_result() {
    let mut recorded = recording();
    for sequence in 0..6 {
        let mut scan = ScanBuffer::from_ranges(&[2.0; 90], -1.0, 0.02);
        scan.header.id = id(sequence);
        scan.header.times.sensor_ns = 100_000_000 * sequence as i64;
        recorded.scans.insert(sequence, scan);
    }
    // The first process is killed with scan 2 in hand, which its successor does not receive. The second is killed with scan 4 in hand,
    // which the third handles.
    let successor = |process, handled, sequence, resumed_after| StageInputs {
        start: StageStart::Resumed as u32,
        resumed_after,
        ..inputs(process, handled, sequence)
    };
    recorded.matcher = vec![
        inputs(1, 1, 0),
        inputs(1, 2, 1),
        inputs(1, 3, 2),
        successor(2, 1, 3, 1),
        successor(2, 2, 4, 1),
        successor(3, 1, 4, 3),
        successor(3, 2, 5, 3),
    ];
    for sequence in [0, 1, 3, 4, 5] {
        recorded.poses.insert(sequence, PoseEstimate { id: id(sequence), ..PoseEstimate::default() });
    }
    let (poses, comparison) = run_as_it_was(&recorded);
    let sequences: Vec<u64> = poses.iter().map(|pose| pose.id.sequence).collect();
    assert_eq!(sequences, [0, 1, 3, 4, 5]);
    assert_eq!((comparison.computed, comparison.restarts), (5, 2));

    // A pose that a recorder has missed is computed, though it was published: the successor went on after it.
    recorded.poses.remove(&1);
    assert_eq!(run_as_it_was(&recorded).0.iter().map(|pose| pose.id.sequence).collect::<Vec<_>>(), sequences);
}
