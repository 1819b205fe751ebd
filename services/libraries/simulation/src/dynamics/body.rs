//! The body of a simulated person during one turn of the lidar, for ray casting and as exact truth.

use flockslam_geometry::Point;
use flockslam_geometry::elementary::hypot;

/// Radius of a person at the height of the lidar, metres.
pub(super) const RADIUS_M: f64 = 0.2;

/// People squeeze into the wall before they let the robot come nearer than this, metres.
const SQUEEZED_M: f64 = 0.45;

/// Where a person is during one turn of the lidar: on a straight line, at constant speed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    pub(super) start: Point,
    pub(super) end: Point,
    pub(super) radius_m: f64,
}

/// The exact motion of a person, in the frame of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MoverTruth {
    /// Who it is, from 0.
    pub id: u32,
    /// Centre of the body at the scan's stamp, metres.
    pub center: Point,
    /// Velocity during the scan, m/s along x and y.
    pub velocity_m_s: Point,
    /// Radius of the body, metres.
    pub radius_m: f64,
}

impl Body {
    /// Distance to the body along a beam that leaves at this share of the turn. A beam that begins inside does not see it.
    pub(super) fn cast(&self, from: Point, direction: Point, share: f64) -> Option<f64> {
        let (dx, dy) = (self.end.x_m - self.start.x_m, self.end.y_m - self.start.y_m);
        let to_center =
            Point::new(self.start.x_m + share * dx - from.x_m, self.start.y_m + share * dy - from.y_m);
        let along_m = to_center.x_m * direction.x_m + to_center.y_m * direction.y_m;
        let beside_m = to_center.x_m * direction.y_m - to_center.y_m * direction.x_m;
        let half_chord_2 = self.radius_m * self.radius_m - beside_m * beside_m;
        let near_m = along_m - half_chord_2.max(0.0).sqrt();
        (half_chord_2 > 0.0 && near_m > 0.0).then_some(near_m)
    }

    pub(super) fn truth(&self, id: u32, turn_s: f64) -> MoverTruth {
        let rate = |start: f64, end: f64| (end - start) / turn_s;
        MoverTruth {
            id,
            center: self.start,
            velocity_m_s: Point::new(rate(self.start.x_m, self.end.x_m), rate(self.start.y_m, self.end.y_m)),
            radius_m: self.radius_m,
        }
    }
}

/// Position of a person with the goal `position` who avoids the robot.
pub(super) fn squeezed(position: Point, robot: Point) -> Point {
    let (dx, dy) = (position.x_m - robot.x_m, position.y_m - robot.y_m);
    let scale = (SQUEEZED_M / hypot(dx, dy).max(1e-3)).max(1.0);
    Point::new(robot.x_m + scale * dx, robot.y_m + scale * dy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beam_ends_at_the_near_side_of_where_the_body_is_at_its_time() {
        let body = Body { start: Point::new(2.0, 0.0), end: Point::new(3.0, 0.0), radius_m: RADIUS_M };
        let (here, ahead) = (Point::new(0.0, 0.0), Point::new(1.0, 0.0));
        assert_eq!(body.cast(here, ahead, 0.0), Some(2.0 - RADIUS_M));
        assert_eq!(body.cast(here, ahead, 0.5), Some(2.5 - RADIUS_M));
        assert_eq!(body.cast(here, Point::new(-1.0, 0.0), 0.0), None);
        assert_eq!(body.cast(Point::new(0.0, 1.01 * RADIUS_M), ahead, 0.0), None);
        assert_eq!(body.cast(Point::new(2.1, 0.0), ahead, 0.0), None);
        assert_eq!(body.truth(4, 0.5).velocity_m_s, Point::new(2.0, 0.0));
    }
}
