//! Groups the ends of beams on movers into bodies and estimates the middle of each.

use flockslam_geometry::Point;
use std::f64::consts::FRAC_PI_4;

/// Neighbouring points nearer than this belong together, metres.
const JOIN_M: f64 = 0.3;
/// Fewer points are noise.
const POINTS_MIN: usize = 2;
/// Radius of a person at the height of a lidar, metres.
const BODY_RADIUS_M: f64 = 0.2;
/// A cluster wider than this is not one person, metres.
const BODY_WIDTH_MAX_M: f64 = 0.6;

/// Fills `centers` with the middle of each cluster of points, which are in the order of the beams, as seen from the lidar.
pub(crate) fn find_centers(points: &[Point], laser: Point, centers: &mut Vec<Point>) {
    centers.clear();
    let mut first = 0;
    for end in 1..=points.len() {
        if end == points.len() || points[end - 1].distance_m(points[end]) > JOIN_M {
            if end - first >= POINTS_MIN {
                centers.push(center(&points[first..end], laser));
            }
            first = end;
        }
    }
}

/// The middle of a body of which the near side is seen: behind the mean of the points.
fn center(points: &[Point], laser: Point) -> Point {
    let sum = points.iter().fold((0.0, 0.0), |sum, point| (sum.0 + point.x_m, sum.1 + point.y_m));
    let mean = Point::new(sum.0 / points.len() as f64, sum.1 / points.len() as f64);
    if points[0].distance_m(points[points.len() - 1]) > BODY_WIDTH_MAX_M {
        return mean;
    }
    // The mean depth of a half circle of parallel beams is π/4 of its radius.
    let (distance_m, depth_m) = (mean.distance_m(laser).max(1e-3), FRAC_PI_4 * BODY_RADIUS_M);
    let share = depth_m / distance_m;
    Point::new(mean.x_m + share * (mean.x_m - laser.x_m), mean.y_m + share * (mean.y_m - laser.y_m))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_body_has_its_middle_behind_its_near_side() {
        let body = |x: f64, y: f64| {
            let near = (-4..=4).map(move |i| f64::from(i) * BODY_RADIUS_M / 4.5);
            near.map(move |side| Point::new(x - (BODY_RADIUS_M.powi(2) - side * side).sqrt(), y + side))
        };
        let noise = [Point::new(7.0, -2.0)];
        let points: Vec<_> = body(4.0, 0.0).chain(noise).chain(body(5.0, 1.0)).collect();
        let mut centers = vec![Point::default()];
        find_centers(&points, Point::new(-100.0, 0.0), &mut centers);
        assert_eq!(centers.len(), 2);
        assert!(centers[0].distance_m(Point::new(4.0, 0.0)) < 0.02, "{centers:?}");
        assert!(centers[1].distance_m(Point::new(5.0, 1.0)) < 0.02, "{centers:?}");
        find_centers(&[], Point::default(), &mut centers);
        assert!(centers.is_empty());
    }
}
