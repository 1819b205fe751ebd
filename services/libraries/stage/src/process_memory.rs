//! How much memory this process uses, read from `/proc`.

use std::fs;

/// Memory of a process, each page in exactly one place of a set's account.
///
/// Private is what the kernel calls anonymous: heap, stacks, and pages of files that were written to. Pages of shared memory are never
/// private here, however few processes have them mapped: they are counted once, by their size in `/dev/shm`. Pages of the executable and
/// its libraries as they are on disk are the same memory in every process of a set, so that the largest of them stands for all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MemoryUse {
    /// Greatest resident memory so far, of all kinds, bytes.
    pub peak_rss_bytes: u64,
    /// Greatest private memory, bytes.
    pub private_bytes: u64,
    /// Unchanged pages of files that are mapped, bytes.
    pub file_bytes: u64,
}

impl MemoryUse {
    /// What this process has now. The peak of private memory between two looks is not lost: the kernel keeps the peak of all resident
    /// memory, and the other kinds hardly ever shrink, so what remains after taking their present size from it was private then.
    pub fn of_this_process() -> Self {
        let text = |path| fs::read_to_string(path).unwrap_or_default();
        Self::parse(&text("/proc/self/smaps_rollup"), &text("/proc/self/status"))
    }

    /// The same by the kernel's counters alone, which lag behind by some pages. Reading all pages takes as long as matching a scan.
    pub fn roughly_of_this_process() -> Self {
        Self::parse("", &fs::read_to_string("/proc/self/status").unwrap_or_default())
    }

    /// `rollup` has the exact sum over all pages, `status` counters that lag behind by some pages but know the peak.
    fn parse(rollup: &str, status: &str) -> Self {
        let of_status = |name| bytes(status, name).unwrap_or(0);
        let (peak_rss_bytes, file_bytes) = (of_status("VmHWM:"), of_status("RssFile:"));
        let private_now = bytes(rollup, "Anonymous:").unwrap_or_else(|| of_status("RssAnon:"));
        let at_the_peak = peak_rss_bytes.saturating_sub(file_bytes + of_status("RssShmem:"));
        Self { peak_rss_bytes, private_bytes: private_now.max(at_the_peak), file_bytes }
    }

    /// The greater of each figure.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self {
            peak_rss_bytes: self.peak_rss_bytes.max(other.peak_rss_bytes),
            private_bytes: self.private_bytes.max(other.private_bytes),
            file_bytes: self.file_bytes.max(other.file_bytes),
        }
    }
}

/// The figure of a line `NAME   1234 kB`.
fn bytes(text: &str, name: &str) -> Option<u64> {
    let figure = text.lines().find_map(|line| line.strip_prefix(name))?;
    let kilobytes: u64 = figure.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peak_between_two_looks_is_found() {
        let status = "VmHWM:\t   900 kB\nRssAnon:\t 98 kB\nRssFile:\t 200 kB\nRssShmem:\t 300 kB\n";
        let found = MemoryUse::parse("Rss: 600 kB\nAnonymous:   100 kB\n", status);
        assert_eq!((found.private_bytes, found.file_bytes), (400 << 10, 200 << 10));
        let flat = MemoryUse::parse("Anonymous: 450 kB\n", status);
        assert_eq!((flat.private_bytes, flat.peak_rss_bytes), (450 << 10, 900 << 10));
        assert_eq!(MemoryUse::parse("", "VmHWM: 1 kB\nRssAnon: 98 kB\n").private_bytes, 98 << 10);
    }

    #[test]
    fn memory_that_was_given_back_stays_in_the_peak() {
        let before = MemoryUse::of_this_process();
        assert!(before.private_bytes > 0 && before.file_bytes > 0, "{before:?}");
        let block = vec![1u8; 64 << 20];
        assert_eq!(block.iter().step_by(4096).map(|byte| u64::from(*byte)).sum::<u64>(), 16 << 10);
        drop(block);
        let after = before.max(MemoryUse::of_this_process());
        assert!(after.private_bytes >= 60 << 20, "{after:?}");
    }
}
