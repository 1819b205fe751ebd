//! The shape of a scan: which direction its surfaces leave open, as along a bare corridor.

use flockslam_geometry::Point;
use flockslam_geometry::elementary::{atan2, hypot, sin_cos};
use nalgebra::Vector2;

/// Points of a wall are compared over at least this much of it, and at most that, metres.
const CHORD_MIN_M: f64 = 0.3;
const CHORD_MAX_M: f64 = 0.8;
/// Points looked at behind each point.
const AHEAD_MAX: usize = 40;

/// The direction in which a scan (points in order of their beams, metres) has least to hold on to: a unit vector in the
/// frame of the points, and the mean of (n·direction)² over the normals n of its surfaces – 0 in a bare corridor, ½ where
/// surfaces face all ways alike. The grid's own slopes do not show this: single cells along a bare wall have slopes too.
pub fn degenerate_direction(points: &[Point]) -> Option<(f64, Vector2<f64>)> {
    let (mut xx, mut xy, mut yy, mut count) = (0.0, 0.0, 0.0, 0u32);
    for (i, from) in points.iter().enumerate() {
        let ahead = points[i + 1..].iter().take(AHEAD_MAX);
        let mut chords =
            ahead.map(|to| (to.x_m - from.x_m, to.y_m - from.y_m)).map(|(x, y)| (x, y, x * x + y * y));
        let Some((x, y, square)) = chords.find(|chord| chord.2 >= CHORD_MIN_M * CHORD_MIN_M) else {
            continue;
        };
        if square <= CHORD_MAX_M * CHORD_MAX_M {
            xx += y * y / square;
            xy -= x * y / square;
            yy += x * x / square;
            count += 1;
        }
    }
    if count == 0 {
        return None;
    }
    let share = 1.0 / f64::from(count);
    let (mean, half) = (0.5 * (xx + yy) * share, 0.5 * (xx - yy) * share);
    // The axis of the larger eigenvalue is at half the angle of (half, xy); the smaller one's is across.
    let (sin, cos) = sin_cos(0.5 * atan2(xy * share, half));
    Some(((mean - hypot(half, xy * share)).max(0.0), Vector2::new(-sin, cos)))
}
