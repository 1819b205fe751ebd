//! Reads a saved map and says which guarantees about accepted scans and poses it breaks.

use flockslam::store::SavedMap;
use flockslam_messages::{PoseEstimate, PoseFlags};
use flockslam_stage::JournalReader;

/// A pose may differ from the one before by so much for other reasons than driving (a wheel that slips), metres and radians …
const STEP: (f64, f64) = (0.3, 0.35);
/// … and by so much for each second between them: faster than any robot here.
const SPEED: (f64, f64) = (1.5, 2.0);

/// What a set has left behind, as far as guarantees are about it.
#[derive(Clone)]
pub struct Evidence {
    /// Every pose, in the order of the journal.
    pub poses: Vec<PoseEstimate>,
    /// Scans whose evidence is in the submaps.
    pub inserted: u64,
    /// What is wrong with the files.
    pub damage: Vec<String>,
}

impl Evidence {
    /// Of the map that a set has saved at its end.
    pub fn of(map: &SavedMap) -> Self {
        let damage = map.check().unwrap().problems;
        let mut journal = JournalReader::open(map.directory()).unwrap();
        let mut poses = Vec::new();
        while let Some(record) = journal.read_next().unwrap() {
            poses.push(record.pose);
        }
        let store = map.submaps();
        let insertions = |number| store.load(number).map_or(0, |submap| u64::from(submap.insertions));
        Self { poses, inserted: (0..store.count()).map(insertions).sum(), damage }
    }

    /// Accepted scans.
    pub fn accepted(&self) -> u64 {
        self.poses.iter().filter(|pose| pose.has(PoseFlags::INSERT)).count() as u64
    }

    /// Accepted scans that are not in the map.
    pub fn lost(&self) -> u64 {
        self.accepted().saturating_sub(self.inserted)
    }

    /// What must not be: one line each.
    pub fn violations(&self) -> Vec<String> {
        let mut violations = self.damage.clone();
        if self.lost() > 0 {
            violations.push(format!("{} accepted scans are not in the map", self.lost()));
        }
        if self.inserted > self.accepted() {
            violations.push(format!("{} scans are in the map twice", self.inserted - self.accepted()));
        }
        for pair in self.poses.windows(2) {
            let (before, after) = (&pair[0], &pair[1]);
            let (from, to) = (before.id.sequence, after.id.sequence);
            if to <= from {
                violations.push(format!("scan {to} comes after scan {from}"));
            }
            let between_s = (after.times.sensor_ns - before.times.sensor_ns).max(0) as f64 * 1e-9;
            let step_m = before.odom_from_base.distance_m(after.odom_from_base);
            let turn_rad = before.odom_from_base.turn_rad(after.odom_from_base);
            if step_m > STEP.0 + SPEED.0 * between_s || turn_rad > STEP.1 + SPEED.1 * between_s {
                violations.push(format!("the pose jumps by {step_m:.2} m, {turn_rad:.2} rad at scan {to}"));
            }
        }
        violations
    }
}
