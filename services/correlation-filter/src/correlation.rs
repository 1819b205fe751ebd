//! Pearson's coefficient of two rows of numbers, defined for every input.

/// With fewer common places than this two scans are not compared.
const COMMON_MIN: usize = 4;

/// Pearson's coefficient `cov(X,Y) / (σ_X σ_Y)` (An. Filatov 2021, chapter 4) over the places where both are numbers;
/// always within −1 … 1. Where it is not defined: 1 when both are the same constant, 0 otherwise; 0 as well when less than half of the
/// numbers have a partner.
pub(crate) fn correlation(x: &[f32], y: &[f32]) -> f64 {
    let common = || {
        let pairs = x.iter().zip(y).map(|(x, y)| (f64::from(*x), f64::from(*y)));
        pairs.filter(|(x, y)| x.is_finite() && y.is_finite())
    };
    let numbers = |v: &[f32]| v.iter().filter(|v| v.is_finite()).count();
    let (count, sum_x, sum_y) = common().fold((0, 0.0, 0.0), |(n, sx, sy), (x, y)| (n + 1, sx + x, sy + y));
    if count < COMMON_MIN.min(x.len()) || 2 * count < numbers(x).max(numbers(y)) {
        return 0.0;
    }
    let (mean_x, mean_y) = (sum_x / count as f64, sum_y / count as f64);
    let (xx, xy, yy) = common().fold((0.0, 0.0, 0.0), |(xx, xy, yy), (x, y)| {
        let (dx, dy) = (x - mean_x, y - mean_y);
        (xx + dx * dx, xy + dx * dy, yy + dy * dy)
    });
    // Rounding leaves a trace of variance in a constant.
    let constant = |variance: f64, mean: f64| variance <= 1e-12 * count as f64 * (mean * mean).max(1e-12);
    match (constant(xx, mean_x), constant(yy, mean_y)) {
        (false, false) => (xy / (xx * yy).sqrt()).clamp(-1.0, 1.0),
        (true, true) if (mean_x - mean_y).abs() <= 1e-6 * mean_x.abs() => 1.0,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn is_symmetric_bounded_and_blind_to_scale_and_offset(
            x in prop::collection::vec(-50.0_f32..50.0, 30), y in prop::collection::vec(-50.0_f32..50.0, 30),
        ) {
            let r = correlation(&x, &y);
            prop_assert!((-1.0..=1.0).contains(&r));
            prop_assert_eq!(r, correlation(&y, &x));
            let moved: Vec<f32> = x.iter().map(|v| 3.0 * v + 7.0).collect();
            prop_assert!((correlation(&moved, &y) - r).abs() < 1e-4);
            prop_assert!((correlation(&x, &x) - 1.0).abs() < 1e-12);
        }

        #[test]
        fn is_a_number_for_any_input(x in prop::collection::vec(any::<f32>(), 0..40), y in prop::collection::vec(any::<f32>(), 0..40)) {
            let r = correlation(&x, &y);
            prop_assert!((-1.0..=1.0).contains(&r), "{}", r);
        }
    }

    #[test]
    fn constants_are_defined() {
        let (two, three) = ([2.0; 30], [3.0; 30]);
        let ramp: [f32; 30] = std::array::from_fn(|i| i as f32);
        assert_eq!(
            [correlation(&two, &two), correlation(&two, &three), correlation(&two, &ramp)],
            [1.0, 0.0, 0.0]
        );
        assert_eq!(correlation(&[0.1; 30], &[0.1; 30]), 1.0);
        assert_eq!(correlation(&[f32::NAN; 30], &[f32::NAN; 30]), 0.0);
    }
}
