//! A scan, its pose and the grid become clearances of stale cells.
