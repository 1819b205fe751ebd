use crate::Settings;
use crate::cells::for_each_occupied;
use crate::moving::moving_beams;
use crate::sector::Sector;
use crate::sight::Sight;
use crate::votes::{Baseline, Votes};
use flockslam_evidence::{CellIndex, Tile, TileGrid};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{
    ClearedCell, Deskew, JudgedCell, MarksHeader, PoseEstimate, PoseFlags, Quality, ScanView,
};
use std::f64::consts::SQRT_2;
use std::ops::Deref;

/// Nearer cells are not judged, metres: they fill too much of the view, and the robot may see itself.
const NEAR_M: f64 = 0.3;
/// Cells that one scan may look through; more than these wait for the next scan.
const SEEN_THROUGH_MAX: usize = 1 << 14;

/// Finds cells whose evidence for "occupied" is stale.
#[derive(Clone, Debug)]
pub struct DynamicCleaner {
    settings: Settings,
    sight: Sight,
    votes: Votes,
    scans: u32,
    /// Where the lidar was at the present scan.
    odom_from_laser: Pose,
    /// What the present scan says of occupied cells.
    judged: Vec<JudgedCell>,
    moving_beams: u32,
    seen_through: Vec<CellIndex>,
    cleared: Vec<ClearedCell>,
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
            votes: Votes::new(),
            scans: 0,
            odom_from_laser: Pose::IDENTITY,
            judged: Vec::with_capacity(SEEN_THROUGH_MAX),
            moving_beams: 0,
            seen_through: Vec::with_capacity(SEEN_THROUGH_MAX),
            cleared: Vec::with_capacity(settings.cleared_max),
            settings,
        }
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
        self.look(scan, pose, grid, Sector::WHOLE);
        self.conclude(pose)
    }

    /// Whether anything is judged by a scan with this pose.
    pub fn judges(&self, pose: &PoseEstimate) -> bool {
        self.settings.enabled && is_certain(pose)
    }

    /// Begins with an inserted scan. [`Self::look`] follows for each sector of the circle, or [`Self::take`] for what another
    /// process has found there, in any order, and then [`Self::conclude`]: the marks are the same however the circle was divided.
    pub fn begin(&mut self, scan: ScanView<'_>, pose: &PoseEstimate) {
        self.judged.clear();
        self.moving_beams = 0;
        self.odom_from_laser = pose.odom_from_base * scan.header().base_from_laser;
        if self.judges(pose) {
            self.sight.look(scan, &Deskew::new(scan, pose.twist));
        }
    }

    /// Judges the occupied cells of `grid` in a sector.
    pub fn look<H: Deref<Target = Tile>>(
        &mut self,
        scan: ScanView<'_>,
        pose: &PoseEstimate,
        grid: &TileGrid<H>,
        sector: Sector,
    ) {
        if !self.judges(pose) {
            return;
        }
        let (at, radius_m) = (self.odom_from_laser, self.settings.radius_m);
        let deskew = Deskew::new(scan, pose.twist);
        let beams = sector.beams(scan.len());
        self.moving_beams += moving_beams(scan, beams, &deskew, at, grid, radius_m);
        let view = View::new(&self.settings, &self.sight, pose, at, grid.cell_size_m());
        let (mut place, mut seen_through) = (0, 0);
        for_each_occupied(grid, at.position(), radius_m, |cell, center| {
            place += 1;
            let finding = view.judge(center, sector);
            let is_through = finding == Finding::SeenThrough;
            if finding == Finding::Open || (is_through && seen_through == SEEN_THROUGH_MAX) {
                return;
            }
            seen_through += usize::from(is_through);
            self.judged.push(JudgedCell { x: cell.x, y: cell.y, place, seen_through: u32::from(is_through) });
        });
    }

    /// What was found so far: beams on moving objects, and cells.
    pub fn found(&self) -> (u32, &[JudgedCell]) {
        (self.moving_beams, &self.judged)
    }

    /// Takes in what another process has found in a sector.
    pub fn take(&mut self, moving_beams: u32, judged: &[JudgedCell]) {
        self.moving_beams += moving_beams;
        self.judged.extend_from_slice(judged);
    }

    /// The marks of the scan.
    pub fn conclude(&mut self, pose: &PoseEstimate) -> Marks<'_> {
        self.cleared.clear();
        self.weigh(self.judges(pose));
        let header = MarksHeader {
            id: pose.id,
            times: pose.times,
            generation: pose.generation,
            moving_beams: self.moving_beams,
            cleared: self.cleared.len() as u32,
        };
        Marks { header, cleared: &self.cleared }
    }

    /// Takes back votes against cells that the scan supports, and gives its votes against those that it looks through.
    fn weigh(&mut self, judges: bool) {
        if !self.judged.is_sorted_by_key(|cell| cell.place) {
            self.judged.sort_unstable_by_key(|cell| cell.place);
        }
        self.seen_through.clear();
        let mut supported = 0;
        for judged in &self.judged {
            let cell = CellIndex::new(judged.x, judged.y);
            if judged.seen_through == 0 {
                supported += 1;
                self.votes.forget(cell);
            } else if self.seen_through.len() < SEEN_THROUGH_MAX {
                self.seen_through.push(cell);
            }
        }
        if judges && self.is_plausible(supported) {
            self.vote(self.odom_from_laser);
        }
    }

    /// What went away is a small part of what is there. When much of the grid is looked through, the scan or the grid
    /// is in the wrong place.
    fn is_plausible(&self, supported: usize) -> bool {
        let (contradicted, judged) = (self.seen_through.len(), self.seen_through.len() + supported);
        contradicted as f64 <= self.settings.contradiction_max * judged as f64
    }

    fn vote(&mut self, odom_from_laser: Pose) {
        self.scans = self.scans.saturating_add(1);
        let Settings { vote_distance_m: distance_m, vote_turn_rad: turn_rad, .. } = self.settings;
        let baseline = Baseline { distance_m, turn_rad };
        for cell in &self.seen_through {
            let votes = self.votes.add(*cell, odom_from_laser, self.scans, baseline);
            if votes >= self.settings.votes && self.cleared.len() < self.settings.cleared_max {
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
    fn judge(&self, center: Point, sector: Sector) -> Finding {
        let (dx, dy) = (center.x_m - self.odom_from_laser.x_m, center.y_m - self.odom_from_laser.y_m);
        let distance_m = (dx * dx + dy * dy).sqrt();
        if distance_m < NEAR_M {
            return Finding::Open;
        }
        let direction = dy.atan2(dx) - self.odom_from_laser.heading_rad;
        if !sector.has(direction) {
            return Finding::Open;
        }
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

fn is_certain(pose: &PoseEstimate) -> bool {
    let covariance = pose.covariance;
    pose.has(PoseFlags::MATCHED)
        && pose.quality == Quality::Tracking as u32
        && pose.odom_from_base.is_finite()
        && [covariance.xx, covariance.yy, covariance.tt].into_iter().all(|v| v.is_finite() && v >= 0.0)
}
