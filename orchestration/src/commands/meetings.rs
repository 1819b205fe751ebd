//! Robots that have mapped for themselves meet once at the end of their ways, and take over each other's maps.

use super::CommandError;
use super::joined_map::{Member, alone, stored_or_empty, track, write};
use crate::arguments::FusionArg;
use crate::outputs::{TrajectoryPoint, map_hash};
use flockslam_geometry::Pose;
use flockslam_published_methods::{MeetingCounts, Meetings, Snapshot};
use serde::Serialize;
use std::path::Path;

/// What became of the meetings, as written to `flock.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Met {
    /// Names of all robots, in order.
    pub robots: Vec<String>,
    /// The robot whose map and frame the outputs are: the first of those that have most of the others' maps.
    pub seen_by: String,
    /// Robots in its map.
    pub members: Vec<String>,
    /// How cells were fused.
    pub fusion: FusionArg,
    /// Meetings in which maps were exchanged, those in which no scan was found in the other's map, and those in which the two contradicted
    /// each other.
    pub meetings: (u64, u64, u64),
    /// Bytes of the maps that a robot hands over, all robots together, without those of others.
    pub map_bytes: u64,
    /// Hash of the fused map.
    pub map_hash: String,
}

impl Met {
    /// For people.
    pub fn summary(&self, out: &Path) -> String {
        format!(
            "{} of {} robots in the map of {}: {}\n{} meetings exchanged maps, {} found nothing, {} contradicted themselves; maps of {:.0} kB\n\
             map {}\nwrote trajectory.tum, map.pgm, map.yaml, map.png, flock.json to {}\n",
            self.members.len(),
            self.robots.len(),
            self.seen_by,
            self.members.join(", "),
            self.meetings.0,
            self.meetings.1,
            self.meetings.2,
            self.map_bytes as f64 * 1e-3,
            self.map_hash,
            out.display()
        )
    }
}

/// Lets the robots meet in pairs until no robot receives anything new, and writes the map of one of them.
///
/// # Errors
/// When the disk refuses.
pub fn meet(out: &Path, members: &[Member], fusion: FusionArg) -> Result<Met, CommandError> {
    let (mut robots, mut own_tracks) = (Vec::new(), Vec::new());
    for member in members {
        let flock = alone(member)?;
        let snapshot = Snapshot::of(&flock).ok_or_else(|| {
            CommandError::failed(format!("robot {} has no map to hand over", member.name()))
        })?;
        own_tracks.push(track(member, &flock.solution(true)));
        robots.push(Meetings::new(snapshot));
    }
    let map_bytes = robots.iter().map(|robot| robot.snapshot().map.encode().len() as u64).sum();
    for _ in 1..robots.len() {
        for k in 0..robots.len() {
            for other in (0..robots.len()).filter(|other| *other != k) {
                let handed_over = robots[other].snapshot().clone();
                robots[k].meet(&handed_over);
            }
        }
    }
    let layers = |robot: &&Meetings| robot.snapshot().layers.len();
    let Some(best) = robots.iter().rev().max_by_key(layers) else {
        return Err(CommandError::user("a flock needs a robot"));
    };
    let map = stored_or_empty(Some(&best.map(fusion.into())));
    let own = best.snapshot();
    let frame = |robot: &Meetings| {
        let robot = &robot.snapshot().robot;
        if *robot == own.robot {
            return Some(Pose::IDENTITY);
        }
        own.layers.get(robot).map(|layer| layer.own_from_origin)
    };
    let (mut tracks, mut inside) = (Vec::new(), Vec::new());
    for ((robot, member), track) in robots.iter().zip(members).zip(own_tracks) {
        let Some(own_from_origin) = frame(robot) else { continue };
        let carried = |p: TrajectoryPoint| TrajectoryPoint {
            stamp_ns: p.stamp_ns,
            map_from_base: own_from_origin * p.map_from_base,
        };
        tracks.push(track.into_iter().map(carried).collect());
        inside.push(member.name().to_owned());
    }
    let sum =
        |count: fn(&MeetingCounts) -> u64| -> u64 { robots.iter().map(|robot| count(&robot.counts())).sum() };
    let met = Met {
        robots: members.iter().map(|member| member.name().to_owned()).collect(),
        seen_by: own.robot.name().to_owned(),
        members: inside,
        fusion,
        meetings: (sum(|c| c.merged), sum(|c| c.unmatched), sum(|c| c.contradicting)),
        map_bytes,
        map_hash: map_hash(&map),
    };
    write(out, &met, &map, &tracks)?;
    Ok(met)
}
