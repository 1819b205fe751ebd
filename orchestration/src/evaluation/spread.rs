//! Statistics of a set of errors: mean, standard deviation, RMSE, median, maximum. Also prints them as columns of a table.

use serde::{Deserialize, Serialize};
use std::fmt;

/// How a set of non-negative errors is spread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation (of the whole population).
    pub std: f64,
    /// Root of the mean square.
    pub rmse: f64,
    /// The middle one of the sorted errors, the upper one of the two when their number is even.
    pub median: f64,
    /// Largest.
    pub max: f64,
}

impl Spread {
    /// The spread of these errors, in any order; `None` when there are none.
    pub fn of(errors: &[f64]) -> Option<Self> {
        if errors.is_empty() {
            return None;
        }
        let mean_of =
            |value: &dyn Fn(f64) -> f64| errors.iter().map(|e| value(*e)).sum::<f64>() / errors.len() as f64;
        let mean = mean_of(&|error| error);
        let mut sorted = errors.to_vec();
        sorted.sort_by(f64::total_cmp);
        Some(Self {
            mean,
            std: mean_of(&|error| (error - mean) * (error - mean)).sqrt(),
            rmse: mean_of(&|error| error * error).sqrt(),
            median: sorted[sorted.len() / 2],
            max: sorted[sorted.len() - 1],
        })
    }
}

impl fmt::Display for Spread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = f.precision().unwrap_or(4);
        write!(
            f,
            "{:>9.digits$} ± {:<8.digits$} {:>9.digits$} {:>9.digits$} {:>9.digits$}",
            self.mean, self.std, self.rmse, self.median, self.max
        )
    }
}

/// Names of the columns that a [`Spread`] prints.
pub(super) const SPREAD_COLUMNS: &str = "     mean ± std           rmse    median       max";

/// A row of a table: the spread with so many digits, or that there is none.
pub(super) fn row(spread: Option<Spread>, digits: usize) -> String {
    spread.map_or_else(|| format!("{:>9}", "none"), |spread| format!("{spread:.digits$}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_those_worked_out_by_hand() {
        let spread = Spread::of(&[3.0, 1.0, 4.0, 0.0]).unwrap();
        assert_eq!((spread.mean, spread.median, spread.max), (2.0, 3.0, 4.0));
        assert!((spread.std - 2.5f64.sqrt()).abs() < 1e-12 && (spread.rmse - 6.5f64.sqrt()).abs() < 1e-12);
        assert_eq!(Spread::of(&[]), None);
    }

    #[test]
    fn columns_stand_below_their_names() {
        // The place behind each word.
        let ends = |text: &str| -> Vec<usize> {
            let text: Vec<char> = text.chars().chain([' ']).collect();
            let ends = (1..text.len()).filter(|place| text[place - 1] != ' ' && text[*place] == ' ');
            ends.collect()
        };
        let (names, figures) = (ends(SPREAD_COLUMNS), ends(&row(Spread::of(&[1.0]), 4)));
        assert_eq!((names.len(), figures.len()), (6, 6));
        // Mean, ±, rmse, median, max. The deviation is aligned to the left.
        for column in [0, 1, 3, 4, 5] {
            assert_eq!(names[column], figures[column], "column {column}");
        }
    }
}
