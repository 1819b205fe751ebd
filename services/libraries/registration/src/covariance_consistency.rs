//! Consistency of the covariance of a fit: NEES over independent rooms, maps, scans and poses.

use crate::field::GridField;
use crate::gauss_newton::{Fit, GaussNewton};
use flockslam_evidence::{Cell, CellIndex, Tile, TileGrid, TileKey};
use flockslam_geometry::{Point, Pose, wrap_angle};
use flockslam_ray_insertion::{ObservedCells, SensorModel};
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeSet;

/// A linear congruential generator (Knuth's MMIX constants) with a sum of twelve as normal numbers.
pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / (1u64 << 24) as f64
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// A turned room with a pillar: walls as (normal x, normal y, offset).
pub(crate) struct World {
    walls: [(f64, f64, f64); 4],
    pillar: Point,
}

impl World {
    pub(crate) fn new(noise: &mut Noise) -> Self {
        let (sin, cos) = noise.between(-3.0, 3.0).sin_cos();
        let mut away = |low, high| noise.between(low, high);
        Self {
            walls: [
                (cos, sin, away(3.0, 6.0)),
                (-cos, -sin, away(3.0, 6.0)),
                (-sin, cos, away(2.0, 4.0)),
                (sin, -cos, away(2.0, 4.0)),
            ],
            pillar: Point::new(away(-1.8, -1.4), away(-1.8, -1.4)),
        }
    }

    /// Points that a lidar at `pose` sees, in its frame, with 1 cm of noise on each range.
    pub(crate) fn scan(&self, pose: Pose, noise: &mut Noise) -> Vec<Point> {
        let beam = |i: i32| {
            let angle = f64::from(i) * std::f64::consts::TAU / 360.0;
            let (sin, cos) = (pose.heading_rad + angle).sin_cos();
            let to_wall = |(nx, ny, offset): (f64, f64, f64)| {
                let range = (offset - nx * pose.x_m - ny * pose.y_m) / (nx * cos + ny * sin);
                if range > 0.0 { range } else { f64::INFINITY }
            };
            let (px, py) = (self.pillar.x_m - pose.x_m, self.pillar.y_m - pose.y_m);
            let (along, inside) = (px * cos + py * sin, 0.09 - (px * sin - py * cos).powi(2));
            let pillar = if along > 0.0 && inside > 0.0 { along - inside.sqrt() } else { f64::INFINITY };
            let range = self.walls.into_iter().map(to_wall).fold(pillar, f64::min) + 0.01 * noise.normal();
            Point::new(range * angle.cos(), range * angle.sin())
        };
        (0..360).map(beam).collect()
    }
}

struct Evidence(TileGrid<Box<Tile>>, BTreeSet<(i32, i32)>);

impl ObservedCells for Evidence {
    fn observe(&mut self, cell: CellIndex, evidence: Cell) {
        if self.0.tile(cell.tile()).is_none() {
            self.0.set(cell.tile(), Tile::unknown(0)).expect("near");
        }
        // Once per scan and cell; the hits come first.
        if self.1.insert((cell.x, cell.y)) {
            let key: TileKey = cell.tile();
            let mut tile = self.0.remove(key).expect("made above");
            tile.cells[cell.offset()] = tile.cells[cell.offset()].unpack().combine(evidence).pack();
            let occupied = tile.cells[cell.offset()].masses().occupied;
            tile.set_score(cell.offset(), (occupied * 65_535.0).round() as u16);
            self.0.set(key, tile).expect("near");
        }
    }
}

/// A map of the room from twelve scans at known poses.
pub(crate) fn map(world: &World, noise: &mut Noise) -> TileGrid<Box<Tile>> {
    let model = SensorModel::new(Cell::from_weights(1.5, 0.0), Cell::from_weights(0.0, 0.3));
    let mut evidence = Evidence(TileGrid::new(0.045), BTreeSet::new());
    for _ in 0..12 {
        let pose = random_pose(noise);
        let ends: Vec<Point> = world.scan(pose, noise).into_iter().map(|p| pose.apply(p)).collect();
        evidence.1.clear();
        model.insert(0.045, pose.position(), &ends, &mut evidence);
    }
    evidence.0
}

pub(crate) fn random_pose(noise: &mut Noise) -> Pose {
    Pose::new(noise.between(-1.0, 1.0), noise.between(-1.0, 1.0), noise.between(-3.0, 3.0))
}

fn nees(fit: &Fit, truth: Pose) -> f64 {
    let error = Vector3::new(
        fit.pose.x_m - truth.x_m,
        fit.pose.y_m - truth.y_m,
        wrap_angle(fit.pose.heading_rad - truth.heading_rad),
    );
    let c = fit.covariance(0.3, 0.15);
    let covariance = Matrix3::new(c.xx, c.xy, c.xt, c.xy, c.yy, c.yt, c.xt, c.yt, c.tt);
    error.dot(&(covariance.try_inverse().expect("positive") * error))
}

#[test]
fn errors_match_the_covariance() {
    let runs = 50;
    let mut sum = 0.0;
    for seed in 0..runs {
        let mut noise = Noise(seed * 7919 + 17);
        let world = World::new(&mut noise);
        let grid = map(&world, &mut noise);
        let field = GridField::new(&grid, 0.0);
        let truth = random_pose(&mut noise);
        let points = world.scan(truth, &mut noise);
        let start = Pose::new(truth.x_m + 0.05, truth.y_m - 0.04, truth.heading_rad + 0.02);
        let fit = GaussNewton::default().fit(&field, &points, start, start);
        assert!(fit.pose.distance_m(truth) < 0.03, "{seed}: {:?} for {truth:?}", fit.pose);
        sum += nees(&fit, truth);
    }
    let mean = sum / runs as f64;
    assert!((2.36..=3.72).contains(&mean), "mean NEES {mean}");
}
