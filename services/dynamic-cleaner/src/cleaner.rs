use crate::Settings;
use crate::cells::for_each_occupied;
use crate::moving::find_moving;
use crate::sectors::{Ray, SectorScan};
use crate::settings::Method;
use crate::sight::Sight;
use crate::tracking::Tracker;
use crate::votes::{Counts, Votes};
use flockslam_evidence::{CellIndex, Tile, TileGrid};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{
    ClearedCell, Deskew, MarksHeader, PoseEstimate, PoseFlags, Quality, ScanId, ScanView, Track,
};
use std::f64::consts::SQRT_2;
use std::ops::Deref;

/// Nearer cells are not judged, metres: they fill too much of the view, and the robot may see itself.
const NEAR_M: f64 = 0.3;
/// Cells that one scan may look through; more than these wait for the next scan.
const SEEN_THROUGH_MAX: usize = 1 << 14;
/// Of a robot that stands, scans so far apart vote, nanoseconds …
const STANDING_APART_NS: u64 = 300_000_000;
/// … and it stands when it has moved less than this since the last vote, metres and radians.
const STANDING: (f64, f64) = (0.05, 0.05);

/// Finds cells whose evidence for "occupied" is stale.
#[derive(Clone, Debug)]
pub struct DynamicCleaner {
    settings: Settings,
    sight: Sight,
    sectors: SectorScan,
    votes: Votes,
    scans: u32,
    /// Where and when the last scan was judged.
    judged: Option<(Pose, i64)>,
    seen_through: Vec<CellIndex>,
    /// Cells that the present scan supports.
    supported: usize,
    cleared: Vec<ClearedCell>,
    tracker: Tracker,
    /// Ends of the present scan's beams that lie on something that was not there before.
    moving: Vec<Point>,
    /// The scan that they were found in.
    watched: Option<ScanId>,
}

/// What the cleaner says of a scan.
#[derive(Clone, Copy, Debug)]
pub struct Marks<'a> {
    /// Its header; `cleared` is the length of the slice.
    pub header: MarksHeader,
    /// Cells to clear, in a fixed order.
    pub cleared: &'a [ClearedCell],
}

/// What a scan says of an occupied cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Finding {
    /// A beam through it and every beam near it end far behind it.
    SeenThrough,
    /// A beam ends at it.
    Supported,
    /// Hidden, out of view, or too close to call.
    Open,
}

/// A scan at its place, ready to judge cells.
struct View<'a> {
    sight: &'a Sight,
    odom_from_laser: Pose,
    cell_size_m: f64,
    /// What a beam must go beyond a cell: metres, and metres per metre of distance.
    margin_m: f64,
    margin_share: f64,
    lateral_margin_m: f64,
    /// Uncertainty of direction, radians.
    heading_margin_rad: f64,
}

impl DynamicCleaner {
    /// A cleaner that has seen nothing.
    pub fn new(settings: Settings) -> Self {
        Self {
            sight: Sight::new(),
            sectors: SectorScan::new(),
            votes: Votes::new(),
            scans: 0,
            judged: None,
            seen_through: Vec::with_capacity(SEEN_THROUGH_MAX),
            supported: 0,
            cleared: Vec::with_capacity(settings.cleared_max),
            tracker: Tracker::default(),
            moving: Vec::new(),
            watched: None,
            settings,
        }
    }

    /// Follows who moves, by any scan whose place is certain, matched or not: gives everybody believed to be there.
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
        self.cleared.clear();
        let mut moving = 0;
        if self.settings.enabled && is_certain(pose) {
            let odom_from_laser = pose.odom_from_base * scan.header().base_from_laser;
            let deskew = Deskew::new(scan, pose.twist);
            if self.watched != Some(pose.id) {
                let radius_m = self.settings.radius_m;
                find_moving(scan, &deskew, odom_from_laser, grid, radius_m, &mut self.moving);
            }
            moving = self.moving.len() as u32;
            self.look(scan, &deskew);
            self.judge(pose, odom_from_laser, grid);
            if self.is_plausible() {
                let Settings { vote_distance_m: distance_m, vote_turn_rad: turn_rad, .. } = self.settings;
                self.vote(odom_from_laser, Counts::FromElsewhere { distance_m, turn_rad });
            }
        }
        let header = MarksHeader {
            id: pose.id,
            times: pose.times,
            generation: pose.generation,
            moving_beams: moving,
            cleared: self.cleared.len() as u32,
        };
        Marks { header, cleared: &self.cleared }
    }

    /// Lets a scan vote that does not enter the map, while the robot stands. What it looks through is cleared once an inserted scan
    /// looks through it too.
    pub fn look_on<H: Deref<Target = Tile>>(
        &mut self,
        scan: ScanView<'_>,
        pose: &PoseEstimate,
        grid: &TileGrid<H>,
    ) {
        let odom_from_laser = pose.odom_from_base * scan.header().base_from_laser;
        let stands = self.judged.is_some_and(|(last, stamp_ns)| {
            last.distance_m(odom_from_laser) < STANDING.0
                && last.turn_rad(odom_from_laser) < STANDING.1
                && pose.times.sensor_ns.abs_diff(stamp_ns) >= STANDING_APART_NS
        });
        if !self.settings.enabled || !stands || !is_certain(pose) {
            return;
        }
        self.look(scan, &Deskew::new(scan, pose.twist));
        self.judge(pose, odom_from_laser, grid);
        if self.is_plausible() {
            self.vote(odom_from_laser, Counts::UpTo(self.settings.votes.saturating_sub(1)));
        }
    }

    fn look(&mut self, scan: ScanView<'_>, deskew: &Deskew) {
        match self.settings.method {
            Method::Beams => self.sight.look(scan, deskew),
            Method::Sectors => self.sectors.look(scan, deskew, self.settings.join_m),
        }
    }

    /// Collects the cells that the scan looks through and takes back votes against cells that it supports.
    fn judge<H: Deref<Target = Tile>>(
        &mut self,
        pose: &PoseEstimate,
        odom_from_laser: Pose,
        grid: &TileGrid<H>,
    ) {
        self.seen_through.clear();
        self.supported = 0;
        self.judged = Some((odom_from_laser, pose.times.sensor_ns));
        let view = View::new(&self.settings, &self.sight, pose, odom_from_laser, grid.cell_size_m());
        let laser_from_odom = odom_from_laser.inverse();
        let judge = |center: Point| match self.settings.method {
            Method::Beams => view.judge(center),
            Method::Sectors => match self.sectors.ray_to(laser_from_odom.apply(center)) {
                Ray::Free => Finding::SeenThrough,
                Ray::Met => Finding::Supported,
                Ray::Shadowed | Ray::Unseen => Finding::Open,
            },
        };
        for_each_occupied(
            grid,
            odom_from_laser.position(),
            self.settings.radius_m,
            |cell, center| match judge(center) {
                Finding::SeenThrough if self.seen_through.len() < SEEN_THROUGH_MAX => {
                    self.seen_through.push(cell)
                }
                Finding::Supported => {
                    self.supported += 1;
                    self.votes.forget(cell);
                }
                Finding::SeenThrough | Finding::Open => (),
            },
        );
    }

    /// What went away is a small part of what is there. When much of the grid is looked through, the scan or the grid
    /// is in the wrong place.
    fn is_plausible(&self) -> bool {
        let (contradicted, judged) = (self.seen_through.len(), self.seen_through.len() + self.supported);
        contradicted as f64 <= self.settings.contradiction_max * judged as f64
    }

    fn vote(&mut self, odom_from_laser: Pose, counts: Counts) {
        self.scans = self.scans.saturating_add(1);
        let decides = matches!(counts, Counts::FromElsewhere { .. });
        for cell in &self.seen_through {
            let votes = self.votes.add(*cell, odom_from_laser, self.scans, counts);
            if decides && votes >= self.settings.votes && self.cleared.len() < self.settings.cleared_max {
                self.cleared.push(ClearedCell { x: cell.x, y: cell.y });
                self.votes.forget(*cell);
            }
        }
    }
}

impl<'a> View<'a> {
    fn new(
        settings: &Settings,
        sight: &'a Sight,
        pose: &PoseEstimate,
        odom_from_laser: Pose,
        cell_size_m: f64,
    ) -> Self {
        let position_3_sigma_m = 3.0 * pose.covariance.xx.max(pose.covariance.yy).sqrt();
        let heading_3_sigma = 3.0 * pose.covariance.tt.sqrt();
        Self {
            sight,
            odom_from_laser,
            cell_size_m,
            margin_m: settings.margin_m + position_3_sigma_m,
            margin_share: settings.margin_share + heading_3_sigma,
            lateral_margin_m: settings.lateral_margin_m,
            heading_margin_rad: heading_3_sigma,
        }
    }

    /// Whether the scan looks through the cell with its centre at `center`. Beside the beams through the cell itself
    /// those next to it must pass too: at a grazing angle one of them ends on the wall to which the cell belongs.
    fn judge(&self, center: Point) -> Finding {
        let (dx, dy) = (center.x_m - self.odom_from_laser.x_m, center.y_m - self.odom_from_laser.y_m);
        let distance_m = (dx * dx + dy * dy).sqrt();
        if distance_m < NEAR_M {
            return Finding::Open;
        }
        let direction = dy.atan2(dx) - self.odom_from_laser.heading_rad;
        let half_width_rad = 0.5 * self.cell_size_m / distance_m;
        let margin_m = self.margin_m + self.margin_share * distance_m;
        if self.sight.range_m(direction) > distance_m + margin_m {
            let beside_rad = SQRT_2 * half_width_rad
                + self.lateral_margin_m / distance_m
                + self.sight.spacing_rad()
                + self.heading_margin_rad;
            let all_pass = self.sight.beam_goes(direction, half_width_rad)
                && self.sight.nearest_m(direction, beside_rad) > distance_m + margin_m;
            return if all_pass { Finding::SeenThrough } else { Finding::Open };
        }
        let near_m = (2.0 * self.cell_size_m).min(margin_m);
        let (from_m, to_m) = (distance_m - near_m, distance_m + near_m);
        match self.sight.ends_between(direction, SQRT_2 * half_width_rad, from_m, to_m) {
            true => Finding::Supported,
            false => Finding::Open,
        }
    }
}

/// Whether the robot knows where it is: lost, it takes walls for movers.
fn is_tracked(pose: &PoseEstimate) -> bool {
    pose.quality == Quality::Tracking as u32 && pose.odom_from_base.is_finite()
}

fn is_certain(pose: &PoseEstimate) -> bool {
    let covariance = pose.covariance;
    pose.has(PoseFlags::MATCHED)
        && is_tracked(pose)
        && [covariance.xx, covariance.yy, covariance.tt].into_iter().all(|v| v.is_finite() && v >= 0.0)
}
