//! Simulated drives whose poses are compared with the covariance that is published beside them.

use flockslam_evidence::{Tile, TileGrid};
use flockslam_geometry::{Pose, wrap_angle};
use flockslam_mapper::Mapper;
use flockslam_messages::{Commit, PoseEstimate, PoseFlags, ScanBuffer, ScanView, Verdict};
use flockslam_scan_matcher::ScanMatcher;
use flockslam_simulation::{Settings, Simulation, World, WorldName};
use nalgebra::{Matrix3, Vector3};

/// Seeds of these drives alone: nothing was fitted to them.
const FIRST_SEED: u64 = 20_260;

/// The mean normalised error squared of the poses of one drive; each drive takes 2.5 s longer than the one before.
pub fn nees_of_run(run: u64) -> f64 {
    let world = if run.is_multiple_of(2) { WorldName::Office } else { WorldName::Hotel };
    let settings = Settings {
        seed: FIRST_SEED + run,
        duration_s: 20.0 + 2.5 * run as f64,
        world,
        ..Settings::default()
    };
    let mut simulation = Simulation::new(&settings, World::built_in(&settings)).unwrap();
    let mut front_end = FrontEnd::new();
    let (mut scan, mut start) = (ScanBuffer::default(), None);
    let (mut sum, mut count) = (0.0, 0u32);
    while let Some(truth) = simulation.next_scan(&mut scan) {
        // The odom frame begins where the robot does.
        let truth = start.get_or_insert(truth).to(truth);
        let estimate = front_end.step(scan.view().unwrap(), truth);
        assert!(estimate.odom_from_base.distance_m(truth) < 0.5, "run {run} is lost");
        if estimate.has(PoseFlags::MATCHED) {
            sum += nees(&estimate, truth);
            count += 1;
        }
    }
    assert!(count > 100, "run {run} has few fits");
    sum / f64::from(count)
}

fn nees(estimate: &PoseEstimate, truth: Pose) -> f64 {
    let (pose, c) = (estimate.odom_from_base, estimate.covariance);
    let error = Vector3::new(
        pose.x_m - truth.x_m,
        pose.y_m - truth.y_m,
        wrap_angle(pose.heading_rad - truth.heading_rad),
    );
    let covariance = Matrix3::new(c.xx, c.xy, c.xt, c.xy, c.yy, c.yt, c.xt, c.yt, c.tt);
    error.dot(&(covariance.try_inverse().expect("positive") * error))
}

/// The matcher's and the mapper's logic, the map made with true poses.
struct FrontEnd {
    matcher: ScanMatcher,
    mapper: Mapper,
    grid: TileGrid<Box<Tile>>,
}

impl FrontEnd {
    fn new() -> Self {
        let settings = flockslam_mapper::Settings::default();
        Self {
            matcher: ScanMatcher::new(flockslam_scan_matcher::Settings::default()),
            grid: TileGrid::new(settings.cell_size_m),
            mapper: Mapper::new(settings),
        }
    }

    fn step(&mut self, scan: ScanView<'_>, truth: Pose) -> PoseEstimate {
        let id = scan.header().id;
        let estimate = self.matcher.handle(scan, &Verdict { id, keep: 1, ..Verdict::default() }, &self.grid);
        if estimate.has(PoseFlags::INSERT) {
            let placed = PoseEstimate { odom_from_base: truth, ..estimate };
            let insertion = self.mapper.insert(scan, &placed, &[]);
            let (generation, active_submap) = (insertion.generation, insertion.active_submap);
            let (changed, retired) = (insertion.changed.to_vec(), insertion.retired.to_vec());
            retired.iter().for_each(|key| drop(self.grid.remove(*key)));
            for key in changed {
                let mut tile = Tile::unknown(0);
                assert!(self.mapper.write_tile(key, &mut tile), "a changed tile is live");
                self.grid.set(key, tile).unwrap();
            }
            self.matcher.committed(&Commit { id, generation, active_submap, ..Commit::default() });
        }
        estimate
    }
}
