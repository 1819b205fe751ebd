//! The logic of the stage: takes a scan, its pose and the grid, gives the cells to clear and the tracks of moving bodies.

use crate::Settings;
use crate::cells::{Reach, for_each_occupied};
use crate::moving::find_moving;
use crate::sector::Sector;
use crate::sector_share::SectorShare;
use crate::settings::Method;
use crate::tracking::Tracker;
use crate::votes::{Counts, Votes};
use flockslam_evidence::{CellIndex, Tile, TileGrid};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{
    ClearedCell, Deskew, JudgedCell, MarksHeader, PoseEstimate, PoseFlags, Quality, ScanId, ScanView, Track,
};
use flockslam_published_methods::{Ray, SectorScan};
use flockslam_visibility::{Horizon, Margins, PassThrough, PolarRangeImage, Visibility};
use std::ops::Deref;

/// Method `sectors`: neighbouring points of a scan nearer than this are joined (the published dR), metres; a map point this near to a
/// segment is taken to be shown by it.
const JOIN_M: f64 = 0.05;
/// Two votes count as different when the lidar has moved this far between them, metres: by several cells …
const VOTE_DISTANCE_M: f64 = 0.15;
/// … or turned this far, radians.
const VOTE_TURN_RAD: f64 = 0.3;
/// A beam passes through a cell when it ends this far behind it, metres: about three cells, for the errors of range and pose …
const MARGIN_M: f64 = 0.15;
/// … plus this share of the cell's distance, for the error of heading; three standard deviations of the pose are added.
const MARGIN_SHARE: f64 = 0.015;
/// All beams that pass within this distance beside a cell must pass through as well, metres: two cells.
const LATERAL_MARGIN_M: f64 = 0.1;
/// Most cells that one scan may clear; more than these wait for the next scan.
const SEEN_THROUGH_MAX: usize = 1 << 14;
/// Of a robot that stands, scans so far apart vote, nanoseconds …
const STANDING_APART_NS: u64 = 300_000_000;
/// … and it stands when it has moved less than this since the last vote, metres and radians.
const STANDING: (f64, f64) = (0.05, 0.05);

/// Finds cells whose evidence for "occupied" is stale.
///
/// ```
/// use flockslam_dynamic_cleaner::{DynamicCleaner, Settings};
/// use flockslam_evidence::{CellIndex, Tile, TileGrid};
/// use flockslam_messages::{ClearedCell, PoseEstimate, PoseFlags, ScanBuffer};
/// use std::f64::consts::{PI, TAU};
///
/// // The map has something at 2 m; the scan sees a wall at 5 m all around.
/// let mut grid = TileGrid::<Box<Tile>>::new(0.05);
/// let (cell, mut tile) = (CellIndex::new(40, 0), Tile::unknown(0));
/// tile.set_score(cell.offset(), 60_000);
/// grid.set(cell.tile(), tile).unwrap();
/// let scan = ScanBuffer::from_ranges(&[5.0; 720], -PI, TAU / 720.0);
///
/// // By default three views from different places are needed, and most of the map must be confirmed.
/// let mut cleaner = DynamicCleaner::new(Settings::sectors());
/// let unmatched = PoseEstimate::default();
/// assert!(cleaner.handle(scan.view()?, &unmatched, &grid).cleared.is_empty());
/// let matched = PoseEstimate { flags: PoseFlags::MATCHED, ..unmatched };
/// assert_eq!(cleaner.handle(scan.view()?, &matched, &grid).cleared, [ClearedCell { x: 40, y: 0 }]);
/// # Ok::<(), flockslam_messages::ScanProblem>(())
/// ```
#[derive(Clone, Debug)]
pub struct DynamicCleaner {
    settings: Settings,
    sight: PolarRangeImage,
    /// What the scan in `sight` cannot see.
    horizon: Horizon,
    sectors: SectorScan,
    votes: Votes,
    scans: u32,
    /// Where the lidar was at the present scan.
    odom_from_laser: Pose,
    /// Judgements of occupied cells by the present scan.
    found: Vec<JudgedCell>,
    /// Pose and time of the last scan that classified cells.
    classified: Option<(Pose, i64)>,
    seen_through: Vec<CellIndex>,
    cleared: Vec<ClearedCell>,
    tracker: Tracker,
    /// End points of the present scan's beams on objects that were not there before.
    moving: Vec<Point>,
    /// The scan that they were found in.
    watched: Option<ScanId>,
}

/// The results of the cleaner for a scan.
#[derive(Clone, Copy, Debug)]
pub struct Marks<'a> {
    /// Its header; `cleared` is the length of the slice.
    pub header: MarksHeader,
    /// Cells to clear, in a fixed order.
    pub cleared: &'a [ClearedCell],
}

impl DynamicCleaner {
    /// A cleaner that has seen nothing.
    pub fn new(settings: Settings) -> Self {
        Self {
            sight: PolarRangeImage::new(),
            horizon: Horizon::new(),
            sectors: SectorScan::default(),
            votes: Votes::new(),
            scans: 0,
            odom_from_laser: Pose::IDENTITY,
            found: Vec::with_capacity(SEEN_THROUGH_MAX),
            classified: None,
            seen_through: Vec::with_capacity(SEEN_THROUGH_MAX),
            cleared: Vec::with_capacity(settings.method.cleared_max()),
            tracker: Tracker::default(),
            moving: Vec::new(),
            watched: None,
            settings,
        }
    }

    /// Tracks moving bodies, by any scan with a certain pose, matched or not; gives the confirmed tracks.
    pub fn watch<H: Deref<Target = Tile>>(
        &mut self,
        scan: ScanView<'_>,
        pose: &PoseEstimate,
        grid: &TileGrid<H>,
    ) -> &[Track] {
        self.moving.clear();
        self.watched = Some(pose.id);
        let odom_from_laser = pose.odom_from_base * scan.header().base_from_laser;
        if is_tracked(pose) {
            let deskew = Deskew::new(scan, pose.twist);
            find_moving(scan, &deskew, odom_from_laser, grid, self.settings.radius_m, &mut self.moving);
        }
        self.tracker.follow(pose.times.sensor_ns, &self.moving, odom_from_laser.position())
    }

    /// Judges the occupied cells of `grid` (the grid that the scan was matched to, in the odom lattice) by an inserted
    /// scan at its pose.
    ///
    /// A scan that was not matched, or is not tracked, clears nothing: its place is not certain enough.
    pub fn handle<H: Deref<Target = Tile>>(
        &mut self,
        scan: ScanView<'_>,
        pose: &PoseEstimate,
        grid: &TileGrid<H>,
    ) -> Marks<'_> {
        self.begin(scan, pose);
        if self.classifies(pose) && self.watched != Some(pose.id) {
            let (deskew, radius_m) = (Deskew::new(scan, pose.twist), self.settings.radius_m);
            find_moving(scan, &deskew, self.odom_from_laser, grid, radius_m, &mut self.moving);
        }
        self.look(scan, pose, grid, Sector::WHOLE);
        self.conclude(pose)
    }

    /// Whether a scan with this pose classifies cells.
    pub fn classifies(&self, pose: &PoseEstimate) -> bool {
        self.settings.enabled && is_certain(pose)
    }

    /// Begins with an inserted scan. [`Self::look`] follows for each sector of the circle, or [`Self::take`] for what another
    /// process has found there, in any order, and then [`Self::conclude`]: the marks are the same however the circle was divided.
    pub fn begin(&mut self, scan: ScanView<'_>, pose: &PoseEstimate) {
        self.found.clear();
        self.odom_from_laser = pose.odom_from_base * scan.header().base_from_laser;
        if self.classifies(pose) {
            if self.settings.method == Method::Sectors {
                self.sectors.look(scan, &Deskew::new(scan, pose.twist), JOIN_M);
            }
            self.classified = Some((self.odom_from_laser, pose.times.sensor_ns));
        }
    }

    /// Judges the occupied cells of `grid` in a sector by the scan that was begun with. The sectors of a circle begin where they share
    /// these cells best: sectors of one circle are to be looked at in equal grids.
    pub fn look<H: Deref<Target = Tile>>(
        &mut self,
        scan: ScanView<'_>,
        pose: &PoseEstimate,
        grid: &TileGrid<H>,
        sector: Sector,
    ) {
        if !self.classifies(pose) {
            return;
        }
        let at = self.odom_from_laser;
        let share = SectorShare::new(grid, at, self.settings.radius_m, sector.parts());
        let sector = sector.turned(share.turned);
        if self.settings.method == Method::Beams {
            let beside_rad = margins(pose).beside_max_rad(grid.cell_size_m(), share.nearest_m);
            let toward = sector.directions(beside_rad);
            self.sight.look_toward(scan, &Deskew::new(scan, pose.twist), toward);
            self.horizon.look(&self.sight, at.heading_rad, grid.cell_size_m());
        }
        let view =
            PassThrough::new(&self.sight, at, grid.cell_size_m(), margins(pose)).with_horizon(&self.horizon);
        let laser_from_odom = at.inverse();
        let classify = |center: Point| match self.settings.method {
            Method::Beams => view.classify(center),
            Method::Sectors => match self.sectors.ray_to(laser_from_odom.apply(center)) {
                Ray::Free => Visibility::SeenThrough,
                Ray::Met => Visibility::Supported,
                Ray::Shadowed | Ray::Unseen => Visibility::Open,
            },
        };
        let mut seen_through = 0;
        let reach =
            Reach { around: at.position(), radius_m: self.settings.radius_m, wedge: sector.wedge(at) };
        // Hidden cells are classified as open.
        let hides = |low: Point, high: Point| {
            self.settings.method == Method::Beams && self.horizon.hides_all(low, high)
        };
        for_each_occupied(grid, reach, hides, |cell, center, place| {
            let is_through = match classify(center) {
                Visibility::SeenThrough => true,
                Visibility::Supported => false,
                // A return near an edge may come from the object beside it.
                Visibility::Open | Visibility::Passed | Visibility::Touched => return,
            };
            if is_through && seen_through == SEEN_THROUGH_MAX {
                return;
            }
            seen_through += usize::from(is_through);
            self.found.push(JudgedCell { x: cell.x, y: cell.y, place, seen_through: u32::from(is_through) });
        });
    }

    /// Judgements of cells so far.
    pub fn found(&self) -> &[JudgedCell] {
        &self.found
    }

    /// Adds the classified cells of another process for its sector.
    pub fn take(&mut self, found: &[JudgedCell]) {
        self.found.extend_from_slice(found);
    }

    /// The marks of the scan.
    pub fn conclude(&mut self, pose: &PoseEstimate) -> Marks<'_> {
        self.cleared.clear();
        let classifies = self.classifies(pose);
        if classifies {
            self.weigh(Counts::FromOtherPlaces { distance_m: VOTE_DISTANCE_M, turn_rad: VOTE_TURN_RAD });
        }
        let header = MarksHeader {
            id: pose.id,
            times: pose.times,
            generation: pose.generation,
            moving_beams: if classifies { self.moving.len() as u32 } else { 0 },
            cleared: self.cleared.len() as u32,
        };
        Marks { header, cleared: &self.cleared }
    }

    /// Counts the votes of a scan that does not enter the map, while the robot stands. Cells are cleared once an inserted scan
    /// passes through them too.
    pub fn look_on<H: Deref<Target = Tile>>(
        &mut self,
        scan: ScanView<'_>,
        pose: &PoseEstimate,
        grid: &TileGrid<H>,
    ) {
        let odom_from_laser = pose.odom_from_base * scan.header().base_from_laser;
        let stands = self.classified.is_some_and(|(last, stamp_ns)| {
            last.distance_m(odom_from_laser) < STANDING.0
                && last.turn_rad(odom_from_laser) < STANDING.1
                && pose.times.sensor_ns.abs_diff(stamp_ns) >= STANDING_APART_NS
        });
        if stands && self.classifies(pose) {
            self.begin(scan, pose);
            self.look(scan, pose, grid, Sector::WHOLE);
            self.weigh(Counts::UpTo(self.settings.votes.saturating_sub(1)));
        }
    }

    /// Removes votes against cells that the scan supports, and adds votes against those that it passes through.
    fn weigh(&mut self, counts: Counts) {
        if !self.found.is_sorted_by_key(|cell| cell.place) {
            self.found.sort_unstable_by_key(|cell| cell.place);
        }
        self.seen_through.clear();
        let mut supported = 0;
        for classified in &self.found {
            let cell = CellIndex::new(classified.x, classified.y);
            if classified.seen_through == 0 {
                supported += 1;
                self.votes.remove(cell);
            } else if self.seen_through.len() < SEEN_THROUGH_MAX {
                self.seen_through.push(cell);
            }
        }
        if self.is_plausible(supported) {
            self.vote(self.odom_from_laser, counts);
        }
    }

    /// What went away is a small part of what is there. When much of the grid is looked through, the scan or the grid
    /// is in the wrong place.
    fn is_plausible(&self, supported: usize) -> bool {
        let (contradicted, classified) = (self.seen_through.len(), self.seen_through.len() + supported);
        contradicted as f64 <= self.settings.method.contradiction_max() * classified as f64
    }

    fn vote(&mut self, odom_from_laser: Pose, counts: Counts) {
        self.scans = self.scans.saturating_add(1);
        let decides = matches!(counts, Counts::FromOtherPlaces { .. });
        for cell in &self.seen_through {
            let votes = self.votes.add(*cell, odom_from_laser, self.scans, counts);
            if decides
                && votes >= self.settings.votes
                && self.cleared.len() < self.settings.method.cleared_max()
            {
                self.cleared.push(ClearedCell { x: cell.x, y: cell.y });
                self.votes.remove(*cell);
            }
        }
    }
}

/// Margins for the errors of a pose.
fn margins(pose: &PoseEstimate) -> Margins {
    let position_3_sigma_m = 3.0 * pose.covariance.xx.max(pose.covariance.yy).sqrt();
    let heading_3_sigma_rad = 3.0 * pose.covariance.tt.sqrt();
    Margins {
        behind_m: MARGIN_M + position_3_sigma_m,
        behind_share: MARGIN_SHARE + heading_3_sigma_rad,
        beside_m: LATERAL_MARGIN_M,
        beside_rad: heading_3_sigma_rad,
    }
}

/// Whether the robot is localised: a lost robot would take walls for moving bodies.
fn is_tracked(pose: &PoseEstimate) -> bool {
    pose.quality == Quality::Tracking as u32 && pose.odom_from_base.is_finite()
}

fn is_certain(pose: &PoseEstimate) -> bool {
    let covariance = pose.covariance;
    pose.has(PoseFlags::MATCHED)
        && is_tracked(pose)
        && [covariance.xx, covariance.yy, covariance.tt].into_iter().all(|v| v.is_finite() && v >= 0.0)
}
