//! The state of the flock as others see it: the status file and the metrics.

use super::{FlockExchange, kept};
use crate::link::hexadecimal;
use crate::thread_state::locked;
use flockslam_geometry::Pose;
use flockslam_results::FlockStatus;
use flockslam_stage::StageError;
use std::time::{Duration, Instant};

/// What others can see is brought up to date this often.
const PERIOD: Duration = Duration::from_millis(250);

impl FlockExchange {
    pub(super) fn show(&mut self) {
        if self.shown.is_some_and(|at| at.elapsed() < PERIOD) {
            return;
        }
        self.shown = Some(Instant::now());
        let status = self.status();
        self.metrics.show(&status, self.drops.counts());
        kept(status.write(&self.status_dir).map_err(StageError::from));
    }

    fn status(&self) -> FlockStatus {
        let (flock, known) = (self.publisher.flock(), self.known());
        let frame = *locked(&self.shared.frame);
        let records = flock.collection().records().count() as u64;
        let traffic = self.traffic.by_peer();
        FlockStatus {
            flock: self.settings.flock.clone(),
            robot: flock.robot().name().to_owned(),
            public_key: hexadecimal(flock.robot().public_key()),
            epoch: self.publisher.epoch(),
            problem: self.problem.clone(),
            peers: self.connected.iter().cloned().collect(),
            near: self.near.keys().cloned().collect(),
            robots: flock.collection().robots().map(|robot| robot.name().to_owned()).collect(),
            records: (records, flock.collection().bytes()),
            records_hash: hexadecimal(&known[..16]),
            converged: known == self.searched && (self.is_alone() || known == self.common.of_records),
            members: self.common.members.clone(),
            merged: self.common.merged,
            map_hash: match self.common.map_hash {
                0 => String::new(),
                hash => format!("{hash:016x}"),
            },
            flock_from_map: frame.map(|frame| {
                let Pose { x_m, y_m, heading_rad } = frame.flock_from_map;
                [x_m, y_m, heading_rad]
            }),
            searches: flock.searches(),
            received_bytes: traffic.values().map(|(received, _)| received).sum(),
            said_bytes: traffic.values().map(|(_, sent)| sent).sum(),
            traffic,
            across: self.common.across,
            dropped: self.drops.by_name(),
            has_ended: self.ending.is_some(),
        }
    }
}
