//! The fused map of the flock: the evidence of all recorded submaps at their places in a solution, without the cells that were found stale.

use super::{Flock, FlockSolution};
use flockslam_evidence::Submap;
use flockslam_map_fusion::FusedMap;
use flockslam_records::{Clearance, Content, RobotId};
use std::collections::BTreeMap;

/// Clearances by the submap that they are of.
type Cleared<'a> = BTreeMap<(&'a RobotId, u64, u32), Vec<&'a Clearance>>;

/// A fused map of the flock, and what could not be brought into it.
#[derive(Debug, Default)]
pub struct FlockMap {
    /// The map; `None` when there is no evidence.
    pub map: Option<FusedMap>,
    /// Submaps in it.
    pub submaps: u64,
    /// Submaps that are no submaps, have cells of another size than the first, or lie absurdly far away.
    pub left_out: u64,
}

impl Flock {
    /// The sum of the evidence of all robots that are part of the flock's frame, each submap once, without the cells that a robot
    /// found stale (Dempster's rule; the order does not matter).
    pub fn map(&self, solution: &FlockSolution) -> FlockMap {
        let cleared = self.cleared();
        let mut fused = FlockMap::default();
        for record in self.collection().records() {
            let Content::Submap(content) = &record.content else { continue };
            let key = (record.name.robot.clone(), record.name.epoch);
            let placed = solution.submaps.get(&key).and_then(|submaps| {
                let place = submaps.binary_search_by_key(&content.number, |placed| placed.submap).ok()?;
                Some(submaps[place]).filter(|placed| placed.part == solution.main_part)
            });
            let Some(placed) = placed else { continue };
            let Ok(mut submap) = content.submap() else {
                fused.left_out += 1;
                continue;
            };
            let stale = cleared.get(&(&record.name.robot, record.name.epoch, content.number));
            stale.into_iter().flatten().for_each(|clearance| mask(&mut submap, clearance));
            let map = fused.map.get_or_insert_with(|| FusedMap::new(submap.cell_size_m));
            let fits = map.cell_size_m() == submap.cell_size_m;
            if fits && map.add(&submap, placed.flock_from_odom * submap.odom_from_submap).is_ok() {
                fused.submaps += 1;
            } else {
                fused.left_out += 1;
            }
        }
        fused
    }

    fn cleared(&self) -> Cleared<'_> {
        let mut cleared = Cleared::new();
        for record in self.collection().records() {
            if let Content::Clearance(clearance) = &record.content {
                let key = (&clearance.robot, clearance.epoch, clearance.submap);
                cleared.entry(key).or_default().push(clearance);
            }
        }
        cleared
    }
}

fn mask(submap: &mut Submap, clearance: &Clearance) {
    if let Some(tile) = submap.tile_mut(clearance.tile) {
        tile.cleared.iter_mut().zip(clearance.rows.iter()).for_each(|(row, more)| *row |= more);
    }
}
