//! The worlds that can be simulated, built-in plans and map images, behind one interface.

use super::floor_plan::FloorPlan;
use super::outdoors::{Outdoors, Tilt};
use super::tour::Tour;
use super::{ImageWorld, Settings, SimulationError, WorldName, built_in};
use flockslam_geometry::Point;
use flockslam_random::Random;

/// The world.
#[derive(Clone, Debug)]
pub enum World {
    /// A built-in world.
    FloorPlan(FloorPlan),
    /// A map image.
    Image(ImageWorld),
}

impl World {
    /// The world that the settings name.
    pub fn built_in(settings: &Settings) -> Self {
        Self::named(settings.world, settings.world_seed)
    }

    fn named(name: WorldName, seed: u64) -> Self {
        Self::FloorPlan(match name {
            WorldName::Office => built_in::office(),
            WorldName::Hotel => built_in::hotel(),
            WorldName::Warehouse => built_in::warehouse(),
            WorldName::Yard => built_in::yard(),
            WorldName::Campus => built_in::campus(seed),
        })
    }

    /// The office.
    pub fn floor_plan() -> Self {
        Self::named(WorldName::Office, 0)
    }

    /// Distance from a point to what a beam in `direction` (a unit vector) hits first, metres; `None` when nothing is
    /// within `max_m`.
    pub fn cast(&self, from: Point, direction: Point, max_m: f64) -> Option<f64> {
        match self {
            Self::FloorPlan(plan) => plan.cast(from, direction, max_m),
            Self::Image(image) => image.cast(from, direction, max_m),
        }
    }

    /// The range that a beam of a lidar gives before the lidar's own errors, metres; `None` without a return within `max_m`.
    /// Indoors it is that of [`Self::cast`].
    pub(super) fn range_m(
        &self,
        (from, direction): (Point, Point),
        tilt: Tilt,
        max_m: f64,
        random: &mut Random,
    ) -> Option<f64> {
        match self {
            Self::FloorPlan(plan) => match plan.open_air() {
                Some(outdoors) => {
                    let range_m = outdoors.range_m(plan, (from, direction), tilt, max_m, random);
                    (range_m <= max_m).then_some(range_m)
                }
                None => plan.cast(from, direction, max_m),
            },
            Self::Image(image) => image.cast(from, direction, max_m),
        }
    }

    /// Both ends of each path that has traffic.
    pub(super) fn paths(&self) -> &[(Point, Point)] {
        match self {
            Self::FloorPlan(plan) => plan.open_air().map_or(&[], Outdoors::paths),
            Self::Image(_) => &[],
        }
    }

    /// Whether it is outdoors.
    pub(super) fn is_outdoors(&self) -> bool {
        matches!(self, Self::FloorPlan(plan) if plan.open_air().is_some())
    }

    /// A way without end, clear of walls, that returns to places visited before.
    pub(super) fn tour(&self, random: Random) -> Result<Tour, SimulationError> {
        match self {
            Self::FloorPlan(plan) => Tour::guided(plan.planning_grid(), plan.way_points()),
            Self::Image(image) => Tour::random(image.planning_grid(), random),
        }
    }
}
