//! Processes of a stage that come and go while the set runs.

use super::{ProcessSet, StageChild};
use flockslam_messages::Stage;
use flockslam_stage::leader;

/// Whether one process of the stage acts and the others are on standby; those of other stages have a share of the work each.
fn takes_turns(stage: Stage) -> bool {
    matches!(stage, Stage::LidarIngest | Stage::ScanMatcher | Stage::SyncManager)
}

impl ProcessSet {
    /// Changes the number of processes of a stage. Where each has its share of the work all of them start anew; where one is active and
    /// the others are on standby, that one goes on. The other stages wait for none of them.
    ///
    /// # Errors
    /// When the stage cannot have so many, or they cannot be started: why.
    pub fn scale(&mut self, stage: Stage, replicas: usize) -> Result<(), String> {
        let at_most = self.set.options.replicas;
        if replicas == 0 || replicas > at_most {
            return Err(format!("{} can have 1 to {at_most} processes in this set", stage.name()));
        }
        let present = self.of_stage(stage).count();
        if present == replicas {
            return Ok(());
        }
        self.set.configuration.set_replicas(stage, replicas);
        self.set.write(&self.runtime.configuration()).map_err(|error| error.to_string())?;
        if takes_turns(stage) {
            self.let_go(stage, present.saturating_sub(replicas));
        } else {
            self.let_go(stage, present);
        }
        self.fill_up(stage, replicas)
    }

    fn of_stage(&self, stage: Stage) -> impl Iterator<Item = &StageChild> {
        self.children.iter().filter(move |child| child.stage == stage)
    }

    /// Ends so many processes of a stage, the active one last.
    fn let_go(&mut self, stage: Stage, count: usize) {
        let active = leader(&self.runtime.status(), stage.name());
        for _ in 0..count {
            let of_stage = self.children.iter().enumerate().filter(|(_, child)| child.stage == stage);
            let spare = |child: &StageChild| active.is_none() || child.pids.last().copied() != active;
            let Some((at, _)) = of_stage.max_by_key(|(_, child)| (spare(child), child.replica)) else {
                break;
            };
            self.children.remove(at).end();
        }
        self.clean();
    }

    /// Starts processes of a stage until there are so many.
    fn fill_up(&mut self, stage: Stage, replicas: usize) -> Result<(), String> {
        while self.of_stage(stage).count() < replicas {
            let is_free = |number: &u32| self.of_stage(stage).all(|child| child.replica != *number);
            let number = (0..).find(is_free).expect("a stage has few processes");
            let place = self.children.iter().position(|child| child.stage == Stage::LidarIngest).unwrap_or(0);
            self.children.insert(place, StageChild::new(stage, number));
            self.spawn(place).map_err(|error| error.to_string())?;
        }
        Ok(())
    }

    /// Before all stages end in good order: no standby shall take over from one that has ended.
    pub(super) fn dismiss_standbys(&mut self) {
        for stage in Stage::ALL.into_iter().filter(|stage| takes_turns(*stage)) {
            let active = leader(&self.runtime.status(), stage.name());
            let is_standby =
                |child: &&mut StageChild| child.stage == stage && child.pids.last().copied() != active;
            if active.is_some() && self.of_stage(stage).count() > 1 {
                self.children.iter_mut().filter(is_standby).for_each(StageChild::end);
            }
        }
    }
}
