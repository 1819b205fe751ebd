//! Reads the bus and the files of a set and puts what is new into the view.

use crate::followed_map::FollowedMap;
use crate::health::{Event, EventKind};
use crate::path::Path;
use crate::shade::{Shader, Shades};
use crate::shared_view::{Place, Shared};
use crate::view::{Graph, OtherRobot, RobotNow, SCAN_UNIT_M, ScanNow, Track, numbers};
use flockslam_bus::{
    Bus, Publisher, RuntimeDir, Sample, ScanSample, ScanSubscriber, SliceSubscriber, Subscriber,
};
use flockslam_evidence::{TILE_CELLS, TileKey};
use flockslam_geometry::elementary::hypot;
use flockslam_messages::{
    Control, ControlKind, Deskew, FlockRobot, FlockRobots, PoseEstimate, PoseFlags, Quality, ScanView, Stage,
    TileMessage, TracksHeader,
};
use flockslam_results::LivePoses;
use flockslam_stage::{JournalReader, StageError};
use flockslam_telemetry::monotonic_ns;
use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

/// Records of the journal are read for no longer than this at a time.
const JOURNAL_TIME: Duration = Duration::from_millis(20);
/// Scans that wait for their pose.
const SCANS_WAITING: usize = 16;
/// Beams of a scan that are shown.
const BEAMS_MAX: usize = 720;
/// Radius of a body that moves, metres.
const BODY_RADIUS_M: f64 = 0.25;
/// Tiles of closed submaps that are drawn anew at a time.
const MAP_TILES_PER_TICK: usize = 128;
/// The solution, and whether stored submaps were replaced, is looked at every so many ticks.
const FILES_EVERY: u64 = 5;
/// Closed loops are reported no oftener than this: there may be many, one after the other.
const LOOPS_EVERY_MS: u64 = 20_000;

/// A connection to the bus: joined with the first browser, left after the last one.
pub struct Session {
    poses: Subscriber<PoseEstimate>,
    scans: ScanSubscriber,
    tiles: Subscriber<TileMessage>,
    tracks: SliceSubscriber<TracksHeader>,
    other_robots: Subscriber<FlockRobots>,
    waiting_scans: VecDeque<ScanSample>,
    journal: JournalReader,
    /// The journal was read to its end once.
    has_caught_up: bool,
    followed: FollowedMap,
    /// Loops that have been reported, and when; `None` before the first look.
    loops: Option<(u64, u64)>,
    shader: Shader,
    ticks: u64,
    /// The publisher of the request for all tiles: the request ends with it.
    _tile_request: Publisher<Control>,
    // The bus goes last.
    _bus: Bus,
}

impl Session {
    /// Joins the bus and asks for the grid that is being built.
    ///
    /// # Errors
    /// When the set does not exist, or was made by another build.
    pub fn open(place: &Place) -> Result<Self, StageError> {
        let runtime = RuntimeDir::open(&place.set_dir)?;
        let bus = Bus::join(&runtime, "page", place.capacity)?;
        Ok(Self {
            poses: bus.subscriber()?,
            scans: bus.scan_subscriber()?,
            tiles: bus.subscriber()?,
            // Once they are received.
            _tile_request: request_tiles(&bus)?,
            tracks: bus.slice_subscriber()?,
            other_robots: bus.subscriber()?,
            waiting_scans: VecDeque::new(),
            journal: JournalReader::open(&runtime.journal())?,
            has_caught_up: false,
            followed: FollowedMap::new(&runtime, place.optimises, place.cell_size_m),
            loops: None,
            shader: Shader::default(),
            ticks: 0,
            _bus: bus,
        })
    }

    /// Reads what is new and puts it into the view that browsers get.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn tick(&mut self, shared: &Shared) -> Result<(), StageError> {
        self.take_tiles(shared)?;
        let pose = self.take_poses()?;
        self.take_scans(pose.as_ref(), shared)?;
        self.take_tracks(shared)?;
        self.take_other_robots(shared)?;
        self.read_journal(&mut shared.view().path)?;
        if let Some(pose) = pose {
            let mut view = shared.view();
            let length_m = view.path.length_m;
            view.robot.set(Some(robot_now(&pose, length_m)));
        }
        shared.view().is_catching_up.set(!self.has_caught_up);
        if self.ticks.is_multiple_of(FILES_EVERY) {
            self.look_at_files(shared);
        }
        self.followed.step();
        self.draw_map(shared);
        self.ticks += 1;
        Ok(())
    }

    /// The newest state of each tile of the grid that is being built. Samples go back at once.
    fn take_tiles(&mut self, shared: &Shared) -> Result<(), StageError> {
        let mut newest: BTreeMap<TileKey, Sample<TileMessage>> = BTreeMap::new();
        while let Some(tile) = self.tiles.receive()? {
            newest.insert(tile.key, tile);
        }
        for (key, sample) in newest {
            if sample.retired == 1 {
                shared.view().live.remove(key);
                continue;
            }
            let shades: Shades = std::array::from_fn(|place| {
                let cell = sample.tile.cells[place];
                self.shader.shade(u32::from(cell.occupied), u32::from(cell.free))
            });
            drop(sample);
            shared.view().live.set(key, &shades);
        }
        Ok(())
    }

    fn take_poses(&mut self) -> Result<Option<PoseEstimate>, StageError> {
        let mut newest: Option<PoseEstimate> = None;
        while let Some(pose) = self.poses.receive()? {
            newest = Some(*pose);
        }
        Ok(newest)
    }

    /// The scan of the newest pose is shown; older ones are let go.
    fn take_scans(&mut self, pose: Option<&PoseEstimate>, shared: &Shared) -> Result<(), StageError> {
        while let Some(scan) = self.scans.receive()? {
            self.waiting_scans.push_back(scan);
            if self.waiting_scans.len() > SCANS_WAITING {
                self.waiting_scans.pop_front();
            }
        }
        let Some(pose) = pose else { return Ok(()) };
        let own = self.waiting_scans.iter().find(|scan| scan.header().id == pose.id);
        if let Some(Ok(scan)) = own.map(ScanSample::view) {
            shared.view().scan.set(scan_now(scan, pose));
        }
        self.waiting_scans.retain(|scan| scan.header().id.sequence > pose.id.sequence);
        Ok(())
    }

    fn take_tracks(&mut self, shared: &Shared) -> Result<(), StageError> {
        let mut newest = None;
        while let Some(tracks) = self.tracks.receive()? {
            newest = Some(tracks);
        }
        let Some(tracks) = newest else { return Ok(()) };
        let moving: Vec<Track> = tracks.elements().iter().map(track_now).collect();
        let mut view = shared.view();
        if view.tracks.get().as_ref() != Some(&moving) {
            view.tracks.set(Some(moving));
        }
        Ok(())
    }

    fn take_other_robots(&mut self, shared: &Shared) -> Result<(), StageError> {
        let mut newest = None;
        while let Some(robots) = self.other_robots.receive()? {
            newest = Some(*robots);
        }
        let Some(robots) = newest else { return Ok(()) };
        let now_ns = monotonic_ns();
        shared
            .view()
            .other_robots
            .set(robots.as_slice().iter().map(|robot| other_robot(robot, now_ns)).collect());
        Ok(())
    }

    fn read_journal(&mut self, path: &mut Path) -> Result<(), StageError> {
        let began = Instant::now();
        while let Some(record) = self.journal.read_next()? {
            if !record.pose.has(PoseFlags::IMPORTED) {
                path.push(&record.pose);
            }
            if began.elapsed() > JOURNAL_TIME {
                return Ok(());
            }
        }
        self.has_caught_up = true;
        Ok(())
    }

    /// Looks at what stages have stored. What cannot be read now is read later.
    fn look_at_files(&mut self, shared: &Shared) {
        let stored = self.followed.look();
        let poses = stored.poses.unwrap_or_else(|| {
            let view = shared.view();
            let known = view.graph.get();
            LivePoses {
                closures: known.closures.clone(),
                searches: known.searches,
                accepted: known.accepted,
                ..LivePoses::default()
            }
        });
        self.show_loops(poses.accepted, shared);
        if stored.is_new {
            let places = self.followed.submap_poses().iter();
            let origins = self.followed.origins().iter();
            shared.view().graph.set(Graph {
                submaps: places.map(|(number, pose)| (*number, numbers(*pose))).collect(),
                origins: origins.map(|(number, pose)| (*number, numbers(*pose))).collect(),
                closures: poses.closures,
                searches: poses.searches,
                accepted: poses.accepted,
            });
        }
    }

    fn show_loops(&mut self, loops: u64, shared: &Shared) {
        let now_ms = shared.now_ms();
        let (before, shown_ms) = *self.loops.get_or_insert((loops, 0));
        if loops > before && now_ms >= shown_ms + LOOPS_EVERY_MS {
            self.loops = Some((loops, now_ms));
            let text = match loops - before {
                1 => "a loop was closed".to_owned(),
                more => format!("{more} loops were closed"),
            };
            let event = Event { at_ms: now_ms, kind: EventKind::Closure, stage: None, text };
            shared.view().events.push(event);
        }
    }

    fn draw_map(&mut self, shared: &Shared) {
        for _ in 0..MAP_TILES_PER_TICK {
            let Some(key) = self.followed.next_changed() else { return };
            let Some(cells) = self.followed.map().and_then(|map| map.tile(key)) else {
                shared.view().map.remove(key);
                continue;
            };
            let mut shades = [0; TILE_CELLS];
            for (shade, cell) in shades.iter_mut().zip(cells.iter()) {
                *shade = self.shader.shade(cell.occupied, cell.free);
            }
            shared.view().map.set(key, &shades);
        }
    }
}

/// The mapper sends all its tiles once more; otherwise only those came that change.
fn request_tiles(bus: &Bus) -> Result<Publisher<Control>, StageError> {
    let control = bus.publisher()?;
    control.send(&Control { kind: ControlKind::TilesWanted as u32, run: 0, value: 0 })?;
    bus.notifier(Stage::Mapper.name())?.notify();
    Ok(control)
}

fn robot_now(pose: &PoseEstimate, length_m: f64) -> RobotNow {
    let covariance = pose.covariance;
    let (mean, half) = (0.5 * (covariance.xx + covariance.yy), 0.5 * (covariance.xx - covariance.yy));
    let quality = match pose.quality {
        n if n == Quality::Tracking as u32 => "tracking",
        n if n == Quality::Degraded as u32 => "degraded",
        _ => "lost",
    };
    RobotNow {
        sequence: pose.id.sequence,
        map_from_base: numbers(pose.map_from_base()),
        map_from_odom: numbers(pose.map_from_odom),
        quality,
        sigma_m: (mean + hypot(half, covariance.xy)).max(0.0).sqrt(),
        sigma_rad: covariance.tt.max(0.0).sqrt(),
        speed_m_s: hypot(pose.twist.x_m_s, pose.twist.y_m_s),
        turn_rad_s: pose.twist.turn_rad_s,
        score: pose.score,
        length_m,
        submap: pose.submap,
    }
}

/// A track with a circle that holds its body and what is not known of its place.
fn track_now(track: &flockslam_messages::Track) -> Track {
    Track {
        id: track.id,
        at: [track.position.x_m, track.position.y_m],
        velocity: [track.velocity_m_s.x_m, track.velocity_m_s.y_m],
        radius_m: BODY_RADIUS_M + track.position_variance.max(0.0).sqrt(),
    }
}

fn other_robot(robot: &FlockRobot, now_ns: u64) -> OtherRobot {
    OtherRobot {
        name: robot.name().to_owned(),
        map_from_base: numbers(robot.map_from_base),
        age_s: now_ns.saturating_sub(robot.received_ns) as f64 * 1e-9,
    }
}

fn scan_now(scan: ScanView<'_>, pose: &PoseEstimate) -> ScanNow {
    let deskew = Deskew::new(scan, pose.twist);
    let beams = (0..scan.len()).step_by(scan.len().div_ceil(BEAMS_MAX).max(1));
    // A float cast saturates.
    let unit = |metres: f64| (metres / SCAN_UNIT_M).round() as i16;
    let end = |beam: usize| {
        let end = deskew.end_in_base(scan, beam, scan.valid_range_m(beam)?);
        Some([unit(end.x_m), unit(end.y_m)])
    };
    ScanNow { points: beams.filter_map(end).collect(), map_from_base: numbers(pose.map_from_base()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::Pose;
    use flockslam_messages::ScanBuffer;

    #[test]
    fn a_large_scan_is_thinned_out_and_beams_without_return_are_left_out() {
        let mut ranges = vec![2.0; 10_000];
        ranges[5_000..].fill(f32::NAN);
        let scan = ScanBuffer::from_ranges(&ranges, 0.0, 1e-4);
        let pose = PoseEstimate { odom_from_base: Pose::new(1.0, 2.0, 0.5), ..PoseEstimate::default() };
        let now = scan_now(scan.view().unwrap(), &pose);
        // Every 14th beam, and half of them have a return.
        assert_eq!(now.points.len(), 358);
        assert_eq!((now.points[0], now.map_from_base), ([400, 0], [1.0, 2.0, 0.5]));
    }

    #[test]
    fn the_weakest_direction_is_shown() {
        let mut pose = PoseEstimate::default();
        (pose.covariance.xx, pose.covariance.yy, pose.covariance.xy) = (0.02, 0.02, 0.02);
        let now = robot_now(&pose, 0.0);
        assert!((now.sigma_m - 0.2).abs() < 1e-9 && now.quality == "tracking");
    }
}
