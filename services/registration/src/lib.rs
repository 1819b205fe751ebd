//! Strategies that fit a scan to a map, shared by scan-matcher (grids) and sync-manager (clouds of points).

pub mod cloud;
