//! The published filter of the source work, defects included, for comparison: mode `seed-exact`.

use flockslam_messages::{KeepReason, ScanView};
use std::f64::consts::FRAC_PI_2;

/// Columns that are meant; one more is always made and stays empty.
const COLUMNS: usize = 30;
/// The buffer is shortened only once it holds more than this, so up to one more is compared with.
const WINDOW: usize = 4;
const THRESHOLD: f64 = 0.9;
const DROPS_MAX: u32 = 10;
const CORRIDOR_MAX: f64 = 0.4;

type Histogram = [f64; COLUMNS + 1];

/// The published filter of the source work, step by step in its own arithmetic, with what is wrong in it: coefficients are
/// multiplied, the first two scans are dropped, dropped scans are kept as well, columns follow from the index among
/// the valid points, an empty column is compared too, and the last beam is not looked at.
#[derive(Clone, Debug, Default)]
pub struct PublishedFilter {
    last: Vec<Histogram>,
    drops_in_a_row: u32,
}

impl PublishedFilter {
    /// Judges a scan: the product of the coefficients, 0 where it is not a number, and why the scan is kept, if it is.
    /// `None` when no valid point is among those that are looked at: there the program divides by nothing.
    pub fn classify(&mut self, scan: ScanView<'_>) -> Option<(f64, Option<KeepReason>)> {
        let count = points(scan).count();
        if count == 0 {
            return None;
        }
        let histogram = mean_range_histogram(scan, count);
        let correlation = self.correlation(&histogram);
        self.push(histogram);
        let required = corridor(scan, count) > CORRIDOR_MAX;
        let keep = self.decide(correlation, required);
        self.drops_in_a_row = if keep.is_some() { 0 } else { self.drops_in_a_row };
        Some((if correlation.is_finite() { correlation.clamp(-1.0, 1.0) } else { 0.0 }, keep))
    }

    /// The counter goes up only for scans that correlate, whatever is decided then.
    fn decide(&mut self, correlation: f64, required: bool) -> Option<KeepReason> {
        if correlation <= THRESHOLD || correlation.is_nan() {
            return Some(KeepReason::Novel);
        }
        let before = self.drops_in_a_row;
        self.drops_in_a_row += 1;
        if before >= DROPS_MAX {
            return Some(KeepReason::InARow);
        }
        required.then_some(KeepReason::Corridor)
    }

    fn correlation(&self, histogram: &Histogram) -> f64 {
        if self.last.len() <= 1 {
            return 1.0;
        }
        self.last.iter().fold(1.0, |product, old| product * pearson(old, histogram))
    }

    fn push(&mut self, histogram: Histogram) {
        if self.last.len() > WINDOW {
            self.last.remove(0);
        }
        self.last.push(histogram);
    }
}

/// Range and angle of the points that the program takes in: its number of beams is rounded from the angles between the first
/// and the last, which is one too few.
fn points(scan: ScanView<'_>) -> impl Iterator<Item = (f64, f64)> + '_ {
    let header = scan.header();
    let angle = move |beam: usize| match header.sections & flockslam_messages::ScanSections::ANGLES {
        0 => f64::from(header.angle_min_rad as f32 + beam as f32 * header.angle_increment_rad as f32),
        _ => scan.angle_rad(beam),
    };
    let ranges = &scan.ranges()[..scan.len().saturating_sub(1)];
    let valid = move |range: f32| range < header.range_max_m && range >= header.range_min_m;
    ranges.iter().enumerate().filter(move |(_, r)| valid(**r)).map(move |(i, r)| (f64::from(*r), angle(i)))
}

/// Sums of ranges by index among the points, each divided by the number of columns.
fn mean_range_histogram(scan: ScanView<'_>, count: usize) -> Histogram {
    let part = COLUMNS as f64 / count as f64;
    let mut sums = [0.0; COLUMNS + 1];
    for (i, (range_m, _)) in points(scan).enumerate() {
        let column = (i as f64 * part) as usize;
        if column <= COLUMNS {
            sums[column] += range_m;
        }
    }
    sums.map(|sum| sum / COLUMNS as f64)
}

/// Pearson's coefficient from five sums in one pass; NaN for a constant.
fn pearson(x: &Histogram, y: &Histogram) -> f64 {
    let n = x.len() as f64;
    let (mut sum_x, mut sum_y, mut sum_xy, mut squares_x, mut squares_y) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (x, y) in x.iter().zip(y) {
        sum_x += x;
        sum_y += y;
        sum_xy += x * y;
        squares_x += x * x;
        squares_y += y * y;
    }
    (n * sum_xy - sum_x * sum_y) / ((n * squares_x - sum_x * sum_x) * (n * squares_y - sum_y * sum_y)).sqrt()
}

/// The share of corridor pattern; angles are the lidar's.
fn corridor(scan: ScanView<'_>, count: usize) -> f64 {
    let mut score = 0_i64;
    for ((here_m, angle), (next_m, _)) in points(scan).zip(points(scan).skip(1)) {
        let falls = i64::from(here_m > next_m) - i64::from(here_m < next_m);
        let front = -FRAC_PI_2 < angle && angle < FRAC_PI_2;
        score += if front == (angle < 0.0) { falls } else { -falls };
    }
    score.unsigned_abs() as f64 / count as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanBuffer;

    fn scan(ranges: &[f32]) -> ScanBuffer {
        ScanBuffer::from_ranges(ranges, -1.5, 0.01)
    }

    fn classified(filter: &mut PublishedFilter, ranges: &[f32]) -> (f64, Option<KeepReason>) {
        filter.classify(scan(ranges).view().unwrap()).unwrap()
    }

    /// Walls of a room: nothing that looks like a corridor.
    fn room(shift: f32) -> Vec<f32> {
        (0..241_i16).map(|i| 3.0 + (f32::from(i) * 0.4 + shift).sin() + shift).collect()
    }

    #[test]
    fn the_first_two_scans_are_dropped_and_eleven_in_a_row_never() {
        let mut filter = PublishedFilter::default();
        let kept: Vec<usize> = (0..33).filter(|_| classified(&mut filter, &room(0.0)).1.is_some()).collect();
        assert_eq!(kept, [10, 21, 32]);
        let mut filter = PublishedFilter::default();
        assert_eq!(classified(&mut filter, &room(0.0)), (1.0, None));
        assert_eq!(classified(&mut filter, &room(3.0)), (1.0, None));
        assert!(classified(&mut filter, &room(1.5)).1.is_some());
    }

    #[test]
    fn up_to_five_scans_are_kept_and_dropped_ones_too() {
        let mut filter = PublishedFilter::default();
        for _ in 0..9 {
            classified(&mut filter, &room(0.0));
        }
        assert_eq!((filter.last.len(), filter.drops_in_a_row), (5, 9));
    }

    #[test]
    fn coefficients_are_multiplied() {
        let mut filter = PublishedFilter::default();
        for shift in [0.0, 0.05, 0.1] {
            classified(&mut filter, &room(shift));
        }
        let new = mean_range_histogram(scan(&room(0.2)).view().unwrap(), 240);
        let each: Vec<f64> = filter.last.iter().map(|old| pearson(old, &new)).collect();
        assert_eq!(filter.correlation(&new), 1.0 * each[0] * each[1] * each[2]);
        assert!(filter.correlation(&new) < each.iter().fold(1.0, |least, r| least.min(*r)));
    }

    #[test]
    fn columns_follow_from_the_index_among_the_valid_points() {
        let mut ranges = vec![1.0_f32; 61];
        ranges[0] = f32::NAN;
        let histogram = mean_range_histogram(scan(&ranges).view().unwrap(), 59);
        assert_eq!(histogram[COLUMNS], 0.0);
        assert_eq!(histogram.iter().sum::<f64>() * COLUMNS as f64, 59.0);
        // 59 points over 30 columns: two each, but for one of them.
        assert_eq!(histogram.iter().filter(|column| **column == 1.0 / 30.0).count(), 1);
    }

    #[test]
    fn what_is_no_number_keeps_the_scan() {
        let mut filter = PublishedFilter::default();
        let flat = vec![1e18_f32; 31];
        for _ in 0..2 {
            classified(&mut filter, &flat);
        }
        // Beside huge ranges one of usual size still gives a number.
        let one = [5.0_f32, 1.0];
        let (coefficient, _) = classified(&mut filter, &one);
        assert!(coefficient.is_finite());
        // Ranges that are all 0 have no variance: zero is divided by zero.
        assert_eq!(classified(&mut filter, &[0.0; 31]), (0.0, Some(KeepReason::Novel)));
        assert!(filter.classify(scan(&[1.0]).view().unwrap()).is_none());
        assert!(filter.classify(scan(&[]).view().unwrap()).is_none());
    }

    #[test]
    fn a_corridor_is_always_kept() {
        let mut filter = PublishedFilter::default();
        let walls: Vec<f32> =
            (0..301_i16).map(|i| 1.2 / (f32::from(i) * 0.01 - 1.5).sin().abs().max(0.02)).collect();
        let reasons: Vec<_> = (0..40).map(|_| classified(&mut filter, &walls).1).collect();
        assert_eq!(reasons, [Some(KeepReason::Corridor); 40]);
    }
}
