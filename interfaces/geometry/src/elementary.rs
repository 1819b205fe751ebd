//! Sine, arc tangent and their like, with the same bits on every machine.
//!
//! Those of the system's library choose their instructions by the processor, so their last bits differ between machines.
//! These are made of additions, multiplications, divisions and square roots, which IEEE 754 defines to the bit, or come
//! from crate `libm`, which is. `clippy.toml` refuses the methods of `f64` and `f32` in their place.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

pub use libm::{acos, atan, exp, expm1 as exp_m1, log as ln, tan};

/// Half a right angle and beyond up to here is brought back by [`sin_cos`] itself, radians.
const REDUCED_MAX_RAD: f64 = 1e5;
/// Adding it rounds to an integer, which then stands in the lowest bits.
const TO_INTEGER: f64 = 6_755_399_441_055_744.0;
/// A right angle in two parts, of which the first has so few bits that its multiples up to 2¹⁷ are exact.
const QUARTER_HIGH: f64 = f64::from_bits(FRAC_PI_2.to_bits() & !0xf_ffff);
/// What the first part lacks: the angle itself is known to twice the bits of an `f64`.
const QUARTER_LOW: f64 = (FRAC_PI_2 - QUARTER_HIGH) + 6.123_233_995_736_766e-17;

/// Sine and cosine of an angle in radians, each within two units of the last place of 1.
#[inline]
pub fn sin_cos(angle_rad: f64) -> (f64, f64) {
    // A NaN is not in the range either.
    if angle_rad.abs() <= REDUCED_MAX_RAD { near_sin_cos(angle_rad) } else { libm::sincos(angle_rad) }
}

#[inline]
fn near_sin_cos(angle_rad: f64) -> (f64, f64) {
    let shifted = angle_rad * (1.0 / FRAC_PI_2) + TO_INTEGER;
    let quarters = shifted - TO_INTEGER;
    let (x, quadrant) = ((angle_rad - quarters * QUARTER_HIGH) - quarters * QUARTER_LOW, shifted.to_bits());
    let square = x * x;
    // Taylor's series: what is left out is below 5e-17 up to half a right angle.
    let sine = SINE.iter().rev().fold(0.0, |sum, part| sum * square + part);
    let cosine = COSINE.iter().rev().fold(0.0, |sum, part| sum * square + part);
    let (sine, cosine) = (x + x * (square * sine), 1.0 + square * cosine);
    let (first, second) = if quadrant & 1 == 0 { (sine, cosine) } else { (cosine, sine) };
    let signed = |value: f64, bit: u64| f64::from_bits(value.to_bits() ^ (bit & 2) << 62);
    (signed(first, quadrant), signed(second, quadrant.wrapping_add(1)))
}

/// Coefficients of x³, x⁵, … of the sine: signed inverse factorials.
const SINE: [f64; 7] = inverse_factorials(3);
/// Those of x², x⁴, … of the cosine.
const COSINE: [f64; 8] = inverse_factorials(2);

const fn inverse_factorials<const COUNT: usize>(first: u64) -> [f64; COUNT] {
    let mut parts = [0.0; COUNT];
    let (mut factorial, mut factor, mut sign, mut place) = (1_u64, 1, -1.0, 0);
    while place < COUNT {
        while factor < first + 2 * place as u64 {
            factor += 1;
            factorial *= factor;
        }
        parts[place] = sign / factorial as f64;
        sign = -sign;
        place += 1;
    }
    parts
}

/// Sine of an angle in radians.
#[inline]
pub fn sin(angle_rad: f64) -> f64 {
    sin_cos(angle_rad).0
}

/// Cosine of an angle in radians.
#[inline]
pub fn cos(angle_rad: f64) -> f64 {
    sin_cos(angle_rad).1
}

/// Coefficients of w, w², … in atan(z) / z − 1, where w = z² and z is at most √2 − 1: the polynomial that agrees in twelve
/// Chebyshev points. It errs by less than 1e-17.
const ARC: [f64; 11] = [
    -0.333_333_333_333_333_3,
    0.199_999_999_999_955_2,
    -0.142_857_142_846_665_42,
    0.111_111_110_152_563_49,
    -0.090_909_045_781_234_9,
    0.076_921_831_908_182_61,
    -0.066_645_114_472_886_43,
    0.058_581_489_120_995_554,
    -0.050_854_497_346_951_2,
    0.039_231_658_211_687_78,
    -0.019_176_887_026_081_436,
];

/// The direction of (x, y) in radians, from −π to π; 0 or ±π of the zero vector, by the sign of x. Of infinite numbers it is
/// NaN.
#[inline]
pub fn atan2(y: f64, x: f64) -> f64 {
    let (across, along) = (y.abs(), x.abs());
    let (low, high) = if across < along { (across, along) } else { (along, across) };
    // Near the diagonal the angle to it is smaller than that to the axis.
    let is_near_diagonal = low > (std::f64::consts::SQRT_2 - 1.0) * high;
    let (up, down, start) =
        if is_near_diagonal { (low - high, low + high, FRAC_PI_4) } else { (low, high, 0.0) };
    let z = if down == 0.0 { 0.0 } else { up / down };
    let square = z * z;
    let series = ARC.iter().rev().fold(0.0, |sum, part| sum * square + part);
    let to_axis = start + (z + z * (square * series));
    let to_x = if across < along {
        to_axis
    } else if down == 0.0 {
        0.0
    } else {
        FRAC_PI_2 - to_axis
    };
    let angle_rad = if x.is_sign_negative() { PI - to_x } else { to_x };
    angle_rad.copysign(y)
}

/// The length of the vector (x, y). Both are below 1e150 in size, as all lengths in metres are; what is shorter than 1e-150 may
/// come out as 0.
#[inline]
pub fn hypot(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers from tiny to large, of both signs.
    fn numbers() -> impl Iterator<Item = f64> {
        let size = |i: i32| libm::pow(1.173, f64::from(i - 200));
        (0..270).flat_map(move |i| [size(i), -size(i)]).chain([0.0, -0.0])
    }

    #[test]
    fn sine_and_cosine_are_those_of_libm_within_two_units_of_the_last_place_of_one() {
        let steps = (-400_000..400_000).map(|i| f64::from(i) * 0.000_123);
        for angle in numbers().chain(steps).chain((0..1000).map(|i| f64::from(i) * 99.9)) {
            let ((sine, cosine), (s, c)) = (sin_cos(angle), libm::sincos(angle));
            assert!(
                (sine - s).abs() <= 2.0 * f64::EPSILON && (cosine - c).abs() <= 2.0 * f64::EPSILON,
                "{angle}"
            );
            assert_eq!((sine, cosine), (sin(angle), cos(angle)));
        }
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
        assert!(sin_cos(f64::NAN).0.is_nan() && sin_cos(f64::INFINITY).1.is_nan());
    }

    #[test]
    fn the_direction_is_that_of_libm_within_one_unit_of_the_last_place_of_pi() {
        for y in numbers() {
            for x in numbers() {
                let (own, other) = (atan2(y, x), libm::atan2(y, x));
                assert!((own - other).abs() <= 4.5e-16, "atan2({y}, {x}) = {own}, {other}");
                assert_eq!(own.is_sign_negative(), other.is_sign_negative(), "{y} {x}");
            }
        }
        assert!(atan2(f64::NAN, 1.0).is_nan() && atan2(1.0, f64::NAN).is_nan());
    }

    #[test]
    fn the_bits_are_those_that_were_committed() {
        let mut sum = 0_u64;
        let mut take =
            |value: f64| sum = (sum.rotate_left(5) ^ value.to_bits()).wrapping_mul(0x517c_c1b7_2722_0a95);
        for value in numbers() {
            let small = value.clamp(-30.0, 30.0);
            let (sine, cosine) = sin_cos(value);
            let results = [sine, cosine, tan(value), atan(value), exp(small), exp_m1(small)];
            results.into_iter().for_each(&mut take);
            [acos(small / 31.0), ln(value.abs() + 1e-300), hypot(value, small), atan2(value, small)]
                .into_iter()
                .for_each(&mut take);
        }
        assert_eq!(format!("{sum:016x}"), "5384eb408b674f0b");
    }
}
