//! Whether this process keeps something in memory because a file system refuses it.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Writers of this process that are refused.
static REFUSED: AtomicUsize = AtomicUsize::new(0);

/// Whether all that this process has written so far is in its files.
pub fn is_durable() -> bool {
    REFUSED.load(Ordering::Relaxed) == 0
}

/// One writer's part in [`is_durable`].
#[derive(Debug, Default)]
pub struct Refusal {
    is_refused: bool,
}

impl Refusal {
    /// Takes note of whether the writer has something that is not in its file.
    pub fn set(&mut self, is_refused: bool) {
        match (self.is_refused, is_refused) {
            (false, true) => REFUSED.fetch_add(1, Ordering::Relaxed),
            (true, false) => REFUSED.fetch_sub(1, Ordering::Relaxed),
            _ => 0,
        };
        self.is_refused = is_refused;
    }

    /// As it was set last.
    pub fn is_set(&self) -> bool {
        self.is_refused
    }
}

impl Drop for Refusal {
    fn drop(&mut self) {
        self.set(false);
    }
}
