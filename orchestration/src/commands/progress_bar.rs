//! The progress bar of a run on the terminal.

use indicatif::{ProgressBar, ProgressStyle};

/// Progress on the terminal; silent when there is none.
pub struct RunProgress(ProgressBar);

impl RunProgress {
    /// A bar over this many scans, or a counter when their number is unknown.
    pub fn new(scans: Option<u64>) -> Self {
        let bar = match scans {
            Some(scans) => ProgressBar::new(scans).with_style(
                ProgressStyle::with_template("{bar:40} {pos}/{len} scans  {per_sec}  {eta} left")
                    .expect("the template is a constant"),
            ),
            None => ProgressBar::no_length().with_style(
                ProgressStyle::with_template("{spinner} {pos} scans  {per_sec}")
                    .expect("the template is a constant"),
            ),
        };
        Self(bar)
    }

    /// So many scans are done.
    pub fn at(&self, scans: u64) {
        self.0.set_position(scans);
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.0.finish_and_clear();
    }
}
