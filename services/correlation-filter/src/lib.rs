//! Scans become verdicts: keep or drop.
