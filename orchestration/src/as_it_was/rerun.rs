//! Runs the stages of a recorded set again, in the order in which they have used their inputs.

use super::black_box::BlackBox;
use super::cleaner_rerun::CleanerRerun;
use super::comparison::{Comparison, Gap};
use super::grid_copy::CommitChanges;
use super::mapper_rerun::MapperRerun;
use super::matcher_rerun::MatcherRerun;
use flockslam_messages::{
    ClearedCell, Commit, DropReason, KeepReason, PoseEstimate, PoseFlags, ScanView, Stage, StageInputs,
    StageStart,
};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;
use zerocopy::IntoBytes;

/// Runs a recording again; gives the poses, and how they compare with those that were published.
pub fn run_as_it_was(recorded: &BlackBox) -> (Vec<PoseEstimate>, Comparison) {
    let mut rerun = Rerun::new(recorded);
    for inputs in &recorded.matcher {
        rerun.match_scan(inputs);
    }
    rerun.finish();
    rerun.compare();
    (rerun.poses.into_values().collect(), rerun.comparison)
}

struct Rerun<'a> {
    recorded: &'a BlackBox,
    matcher: MatcherRerun,
    mapper: MapperRerun,
    cleaner: CleanerRerun,
    /// The next inputs of the cleaner.
    next_cleaned: usize,
    /// Commits as they are now computed, by their places.
    commits: Vec<Commit>,
    changes: CommitChanges,
    /// By the sequence of the scan; where the recording has a gap, those that were published.
    poses: BTreeMap<u64, PoseEstimate>,
    /// Scans whose poses are the published ones for want of more.
    taken_over: BTreeSet<u64>,
    /// Cleared cells by the sequence of the scan, until they are used.
    marks: BTreeMap<u64, Vec<ClearedCell>>,
    has_other_robots: bool,
    /// A pose was another than the published one.
    deviates: bool,
    comparison: Comparison,
}

impl<'a> Rerun<'a> {
    fn new(recorded: &'a BlackBox) -> Self {
        let configuration = &recorded.set.configuration;
        let cell_size_m = configuration.mapper.cell_size_m;
        let comparison = Comparison {
            poses: recorded.poses.len() as u64,
            cut_short: recorded.cut_short.clone(),
            ..Comparison::default()
        };
        Self {
            recorded,
            matcher: MatcherRerun::new(configuration.scan_matcher.clone(), cell_size_m),
            mapper: MapperRerun::new(configuration.mapper.clone()),
            cleaner: CleanerRerun::new(configuration.dynamic_cleaner.clone(), cell_size_m),
            next_cleaned: 0,
            commits: Vec::with_capacity(recorded.commits.len()),
            changes: CommitChanges::default(),
            poses: BTreeMap::new(),
            taken_over: BTreeSet::new(),
            marks: BTreeMap::new(),
            has_other_robots: false,
            deviates: false,
            comparison,
        }
    }

    /// The pose of a scan, by what the matcher had in hand.
    fn match_scan(&mut self, inputs: &StageInputs) {
        let sequence = inputs.id.sequence;
        let is_known = self.follow_matcher(inputs);
        self.advance_matcher(inputs);
        self.comparison.late_verdicts += u64::from(inputs.reason == KeepReason::Late as u32);
        self.comparison.overload +=
            u64::from(inputs.keep == 0 && inputs.reason == DropReason::Overload as u32);
        if inputs.flock_robots > 0 && !self.has_other_robots {
            self.has_other_robots = true;
            self.comparison.lacks(Gap::OtherRobots { scan: sequence });
        }
        let scan = self.scan(sequence);
        let published = self.recorded.poses.get(&sequence);
        if let (None, Some(_)) = (scan, published) {
            self.comparison.lacks(Gap::Scan { scan: sequence });
        }
        match (scan.filter(|_| is_known), published) {
            (Some(scan), _) => {
                self.note_tiles(Stage::ScanMatcher, inputs, self.matcher.tiles());
                let pose = self.matcher.handle(scan, inputs);
                if published.is_some_and(|published| published.as_bytes() != pose.as_bytes()) {
                    self.note_several_mappers();
                    self.deviates = true;
                }
                self.poses.insert(sequence, pose);
            }
            (None, Some(published)) => {
                self.matcher.take_over(published);
                self.poses.insert(sequence, *published);
                self.taken_over.insert(sequence);
            }
            (None, None) => {}
        }
    }

    /// Names what may be behind the first other pose: of several mappers one that was started again has rebuilt its share of the tiles.
    fn note_several_mappers(&mut self) {
        let several = self.recorded.set.configuration.mapper.replicas > 1;
        let again = self.commits.iter().rev().find(|commit| commit.all_tiles == 1);
        if let Some(commit) = again.filter(|_| several && !self.deviates) {
            self.comparison.lacks(Gap::SeveralMappers { scan: commit.id.sequence });
        }
    }

    fn scan(&self, sequence: u64) -> Option<ScanView<'a>> {
        self.recorded.scans.get(&sequence)?.view().ok()
    }

    /// Names a grid that is not the one that the stage had. Where poses are others already, so are grids.
    fn note_tiles(&mut self, stage: Stage, inputs: &StageInputs, tiles: usize) {
        if inputs.tiles as usize != tiles && !self.deviates {
            self.comparison.lacks(Gap::OtherGrid { stage: stage.name(), scan: inputs.id.sequence });
        }
    }

    /// Goes on with the matcher's process; false when its state is not known.
    fn follow_matcher(&mut self, inputs: &StageInputs) -> bool {
        let (sequence, is_first) = (inputs.id.sequence, self.poses.is_empty());
        let is_new = self.matcher.is_new(inputs);
        let began_anew = inputs.start == StageStart::Anew as u32;
        if is_new {
            self.forget_unpublished(inputs);
        }
        let before = if is_new && !began_anew { self.poses_until(inputs.resumed_after) } else { Vec::new() };
        let first_grid = self.recorded.place_of(inputs.first_grid);
        let has_followed = first_grid.is_some_and(|first| first < self.commits.len());
        let missing = self.matcher.follow(inputs, &before, has_followed);
        if is_first && (missing > 0 || inputs.start == StageStart::Resumed as u32) {
            self.comparison.lacks(Gap::BeginsLate { scan: sequence });
            return false;
        }
        if is_first && !began_anew {
            self.comparison.lacks(Gap::SavedMap);
            return false;
        }
        self.comparison.restarts += u64::from(is_new && !is_first);
        self.comparison.lacks_inputs(Stage::ScanMatcher, sequence, missing);
        true
    }

    /// A process that is killed may have said what it used for a scan, and not have published its pose. When its successor has not
    /// received that scan, no pose of it was ever published.
    fn forget_unpublished(&mut self, inputs: &StageInputs) {
        let has_predecessor = inputs.start != StageStart::Anew as u32;
        let published = &self.recorded.poses;
        self.poses.retain(|sequence, _| {
            published.contains_key(sequence) || (has_predecessor && *sequence <= inputs.resumed_after)
        });
    }

    /// The poses up to that of this scan, in order.
    fn poses_until(&self, sequence: u64) -> Vec<PoseEstimate> {
        let published = self.recorded.poses.range(..=sequence).map(|(sequence, pose)| (*sequence, *pose));
        let mut poses: BTreeMap<u64, PoseEstimate> = published.collect();
        poses.extend(self.poses.range(..=sequence).map(|(sequence, pose)| (*sequence, *pose)));
        poses.into_values().collect()
    }

    fn pose_at(&self, sequence: u64) -> Option<&PoseEstimate> {
        self.poses.get(&sequence).or_else(|| self.recorded.poses.get(&sequence))
    }

    /// Computes the grid that the matcher had.
    fn advance_matcher(&mut self, inputs: &StageInputs) {
        let places = self.recorded.place_of(inputs.grid).zip(self.recorded.place_of(inputs.first_grid));
        let Some((to, first)) = places else { return };
        while self.commits.len() <= to {
            self.clean_before(self.commits.len());
            self.make_commit(self.commits.len());
            // The matcher takes each at once, so only the cleaner lags behind.
            let made = self.commits.len() - 1;
            if made >= first {
                self.matcher.take_grid(&self.changes, first, made, &self.commits[made]);
            }
            let is_cleaned = self.next_cleaned == self.recorded.cleaner.len();
            let needed = if is_cleaned { made } else { self.cleaner.next_commit().unwrap_or(0) };
            self.changes.drop_before(needed);
        }
        self.matcher.take_grid(&self.changes, first, to, &self.commits[to]);
    }

    /// Computes the commit at a place.
    fn make_commit(&mut self, place: usize) {
        let commit = &self.recorded.commits[place];
        let sequence = commit.id.sequence;
        let is_new = self.mapper.is_new(commit);
        let missing = self.mapper.follow(commit);
        if missing > 0 && (place > 0 || !self.comparison.gaps.iter().any(is_late)) {
            self.comparison.lacks(Gap::Commits { scan: sequence, missing });
        }
        self.comparison.restarts += u64::from(is_new && place > 0);
        if let Some(scans) = self.mapper.recovered_scans(commit) {
            self.recover(commit, scans);
        }
        let (made, changes) = match (self.scan(sequence), self.pose_at(sequence).copied()) {
            _ if commit.all_tiles == 1 => self.mapper.publish_again(commit),
            (Some(scan), Some(pose)) => {
                let cleared = self.cleared(commit);
                self.mapper.insert(commit, scan, &pose, &cleared)
            }
            _ => {
                self.comparison.lacks(Gap::Scan { scan: sequence });
                (*commit, Vec::new())
            }
        };
        self.commits.push(made);
        self.changes.push(changes);
    }

    /// A new process of the mapper inserts again what its predecessor had inserted since its last stored submap, without marks.
    fn recover(&mut self, commit: &Commit, scans: RangeInclusive<u64>) {
        for sequence in scans {
            let Some(pose) = self.pose_at(sequence).filter(|pose| pose.has(PoseFlags::INSERT)).copied()
            else {
                continue;
            };
            match self.scan(sequence) {
                Some(scan) => drop(self.mapper.insert(commit, scan, &pose, &[])),
                None => self.comparison.lacks(Gap::Scan { scan: sequence }),
            }
        }
    }

    /// The cells that were cleared before a scan was inserted; none where the marks came too late.
    fn cleared(&mut self, commit: &Commit) -> Vec<ClearedCell> {
        let sequence = commit.id.sequence;
        let computed = self.marks.remove(&sequence);
        if commit.cleared == 0 {
            return Vec::new();
        }
        computed.or_else(|| self.recorded.marks.get(&sequence).cloned()).unwrap_or_else(|| {
            self.comparison.lacks(Gap::Marks { scan: sequence });
            Vec::new()
        })
    }

    /// Lets the cleaner handle the scans that it has handled with grids before the commit at a place.
    fn clean_before(&mut self, place: usize) {
        while let Some(inputs) = self.recorded.cleaner.get(self.next_cleaned) {
            let to = self.recorded.place_of(inputs.grid);
            let Some(pose) = self.poses.get(&inputs.id.sequence).copied() else {
                if self.poses.last_key_value().is_some_and(|(last, _)| *last > inputs.id.sequence) {
                    // Its pose is not in the recording, which is named where it lacks.
                    self.cleaner.follow(inputs);
                    self.next_cleaned += 1;
                    continue;
                }
                return;
            };
            if to >= Some(place) {
                return;
            }
            self.next_cleaned += 1;
            self.clean(inputs, &pose, to);
        }
    }

    fn clean(&mut self, inputs: &StageInputs, pose: &PoseEstimate, to: Option<usize>) {
        let sequence = inputs.id.sequence;
        let (is_first, is_new) = (self.next_cleaned == 1, self.cleaner.is_new(inputs));
        let missing = self.cleaner.follow(inputs);
        self.comparison.restarts += u64::from(is_new && !is_first);
        self.comparison.lacks_inputs(Stage::DynamicCleaner, sequence, missing);
        if let Some((to, first)) = to.zip(self.recorded.place_of(inputs.first_grid)) {
            self.cleaner.take_grid(&self.changes, first, to);
        }
        let Some(scan) = self.scan(sequence) else { return };
        self.note_tiles(Stage::DynamicCleaner, inputs, self.cleaner.tiles());
        if let Some(cleared) = self.cleaner.handle(scan, pose, inputs) {
            let published = self.recorded.marks.get(&sequence);
            let differ = published.is_some_and(|published| *published != cleared);
            self.comparison.different_marks += u64::from(differ);
            self.marks.insert(sequence, cleared);
        }
    }

    /// Computes what follows the last pose, as far as the recording goes: the marks are compared too.
    fn finish(&mut self) {
        for commit in &self.recorded.commits[self.commits.len()..] {
            self.clean_before(self.commits.len());
            let is_there = commit.all_tiles == 1 || self.scan(commit.id.sequence).is_some();
            if !is_there || self.pose_at(commit.id.sequence).is_none() {
                return;
            }
            self.make_commit(self.commits.len());
        }
        self.clean_before(self.commits.len());
    }

    /// Compares the poses with those that were published, and names those that nothing explains.
    fn compare(&mut self) {
        let first = self.recorded.matcher.first().map(|inputs| inputs.id.sequence);
        for (sequence, published) in &self.recorded.poses {
            match self.poses.get(sequence) {
                Some(pose) if !self.taken_over.contains(sequence) => self.comparison.compare(pose, published),
                // Why is named already.
                Some(_) => {}
                None if Some(*sequence) < first => {}
                None => self.comparison.lacks(Gap::NoInputs { scan: *sequence }),
            }
        }
    }
}

fn is_late(gap: &Gap) -> bool {
    matches!(gap, Gap::BeginsLate { .. } | Gap::SavedMap)
}

#[cfg(test)]
#[path = "rerun_tests.rs"]
mod tests;
