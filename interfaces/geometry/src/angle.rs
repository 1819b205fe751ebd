//! Angles: the one function that brings a heading into its range.

use std::f64::consts::{PI, TAU};

/// Brings an angle in radians into `[-π, π)`. A NaN or infinite angle stays NaN.
pub fn wrap_angle(angle_rad: f64) -> f64 {
    if (-PI..PI).contains(&angle_rad) {
        return angle_rad;
    }
    let wrapped = (angle_rad + PI).rem_euclid(TAU) - PI;
    // `rem_euclid` may round up to TAU itself for tiny negative arguments.
    if wrapped >= PI { wrapped - TAU } else { wrapped }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stays_in_the_half_open_interval_and_keeps_the_direction() {
        for i in -10_000..10_000 {
            let angle = f64::from(i) * 0.01;
            let wrapped = wrap_angle(angle);
            assert!((-PI..PI).contains(&wrapped), "{angle} -> {wrapped}");
            assert!((wrapped.sin() - angle.sin()).abs() < 1e-9 && (wrapped.cos() - angle.cos()).abs() < 1e-9);
        }
        assert_eq!(wrap_angle(PI), -PI);
        assert!((-PI..PI).contains(&wrap_angle(-PI - 1e-17)));
        assert!(wrap_angle(f64::NAN).is_nan());
    }
}
