//! Quantiles of a histogram that is given by its cumulative buckets, as a metrics page has them.

/// The value that a share `share` (0 … 1) of all values does not exceed, interpolated linearly within its bucket; the last finite
/// bound when it is beyond that. `buckets` are upper bounds, rising, with cumulative counts. `None` without values.
pub fn bucket_quantile(buckets: &[(f64, f64)], share: f64) -> Option<f64> {
    let total = buckets.last()?.1;
    if total <= 0.0 {
        return None;
    }
    let (mut lower, mut below) = (0.0, 0.0);
    for (bound, count) in buckets {
        if *count >= share * total {
            let part = (share * total - below) / (count - below).max(f64::MIN_POSITIVE);
            return Some(if bound.is_finite() { lower + part * (bound - lower) } else { lower });
        }
        (lower, below) = (*bound, *count);
    }
    Some(lower)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantile_is_interpolated_within_its_bucket_and_ends_at_the_last_finite_bound() {
        let buckets = [(1.0, 1.0), (2.0, 3.0), (f64::INFINITY, 4.0)];
        assert_eq!(bucket_quantile(&buckets, 0.5), Some(1.5));
        assert_eq!(bucket_quantile(&buckets, 0.99), Some(2.0));
        assert_eq!(bucket_quantile(&[(1.0, 0.0)], 0.5), None);
        assert_eq!(bucket_quantile(&[], 0.5), None);
    }
}
