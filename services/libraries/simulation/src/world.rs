//! The worlds that can be simulated, built-in plans and map images, behind one interface.

use super::floor_plan::FloorPlan;
use super::tour::Tour;
use super::{ImageWorld, SimulationError, WorldName, built_in};
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
    /// The world of this name.
    pub fn built_in(name: WorldName) -> Self {
        Self::FloorPlan(match name {
            WorldName::Office => built_in::office(),
            WorldName::Hotel => built_in::hotel(),
            WorldName::Warehouse => built_in::warehouse(),
            WorldName::Yard => built_in::yard(),
        })
    }

    /// The office.
    pub fn floor_plan() -> Self {
        Self::built_in(WorldName::Office)
    }

    /// Distance from a point to what a beam in `direction` (a unit vector) hits first, metres; `None` when nothing is
    /// within `max_m`.
    pub fn cast(&self, from: Point, direction: Point, max_m: f64) -> Option<f64> {
        match self {
            Self::FloorPlan(plan) => plan.cast(from, direction, max_m),
            Self::Image(image) => image.cast(from, direction, max_m),
        }
    }

    /// A way without end, clear of walls, that returns to places visited before.
    pub(super) fn tour(&self, random: Random) -> Result<Tour, SimulationError> {
        match self {
            Self::FloorPlan(plan) => Tour::guided(plan.planning_grid(), plan.way_points()),
            Self::Image(image) => Tour::random(image.planning_grid(), random),
        }
    }
}
