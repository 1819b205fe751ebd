//! Symmetric 3 × 3 matrices over (x, y, heading): information and covariance of planar motions.

use flockslam_registration::cloud::Placement;

/// A symmetric 3 × 3 matrix over (x, y, heading), upper triangle: xx, xy, xθ, yy, yθ, θθ.
pub type Symmetric = [f64; 6];

/// The inverse of a positive definite matrix; `None` when it is not.
pub fn inverse(m: &Symmetric) -> Option<Symmetric> {
    let [a, b, c, d, e, f] = *m;
    let (ca, cb, cc) = (d * f - e * e, c * e - b * f, b * e - c * d);
    let determinant = a * ca + b * cb + c * cc;
    if !(determinant > 0.0 && a > 0.0 && f > 0.0) {
        return None;
    }
    let s = 1.0 / determinant;
    Some([s * ca, s * cb, s * cc, s * (a * f - c * c), s * (b * c - a * e), s * (a * d - b * b)])
}

/// The same information with the translation in the axes of `frame` in place of its parent's.
pub fn in_frame(m: &Symmetric, frame: &Placement) -> Symmetric {
    let (cx, cy) = frame.unrotate(m[2], m[4]);
    // Columns, then rows, of the translation block.
    let (ax, ay) = frame.unrotate(m[0], m[1]);
    let (bx, by) = frame.unrotate(m[1], m[3]);
    let (xx, xy) = frame.unrotate(ax, bx);
    let (_, yy) = frame.unrotate(ay, by);
    [xx, xy, cx, yy, cy, m[5]]
}

/// `vᵀ m v`.
pub fn quadratic(m: &Symmetric, v: &[f64; 3]) -> f64 {
    let w = times(m, v);
    v[0] * w[0] + v[1] * w[1] + v[2] * w[2]
}

/// `m v`.
pub fn times(m: &Symmetric, v: &[f64; 3]) -> [f64; 3] {
    [
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[1] * v[0] + m[3] * v[1] + m[4] * v[2],
        m[2] * v[0] + m[4] * v[1] + m[5] * v[2],
    ]
}

/// Information of a measurement whose own information is `m`, with independent further errors of these
/// standard deviations.
pub fn inflated(m: &Symmetric, sigma_m: f64, sigma_rad: f64) -> Option<Symmetric> {
    let mut covariance = inverse(m)?;
    covariance[0] += sigma_m * sigma_m;
    covariance[3] += sigma_m * sigma_m;
    covariance[5] += sigma_rad * sigma_rad;
    inverse(&covariance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn inverse_and_rotation_are_consistent(a in prop::array::uniform6(-2.0..2.0f64), turn in -3.0..3.0f64) {
            // AᵀA + I of a lower triangle is positive definite.
            let m = [
                1.0 + a[0] * a[0] + a[1] * a[1] + a[2] * a[2],
                a[1] * a[3] + a[2] * a[4],
                a[2] * a[5],
                1.0 + a[3] * a[3] + a[4] * a[4],
                a[4] * a[5],
                1.0 + a[5] * a[5],
            ];
            let v = [0.3, -0.7, 0.2];
            let back = times(&inverse(&m).unwrap(), &times(&m, &v));
            prop_assert!((0..3).all(|i| (back[i] - v[i]).abs() < 1e-9));
            let frame = Placement::new(0.0, 0.0, turn);
            let (x, y) = frame.unrotate(v[0], v[1]);
            prop_assert!((quadratic(&in_frame(&m, &frame), &[x, y, v[2]]) - quadratic(&m, &v)).abs() < 1e-9);
        }
    }
}
