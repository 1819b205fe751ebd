//! A scan and a grid become a pose.
//!
//! The first scan of a run begins the map; each later one is matched to the grid that the mapper makes of those before:
//!
//! ```
//! # use flockslam_evidence::{Tile, TileGrid};
//! # use flockslam_geometry::Pose;
//! # use flockslam_mapper::Mapper;
//! # use flockslam_messages::{PoseFlags, ScanBuffer, Verdict};
//! use flockslam_scan_matcher::{ScanMatcher, Settings};
//! # use std::f64::consts::{PI, TAU};
//!
//! // `look` gives a scan of a square room of 4 × 4 m, taken in its middle at a heading.
//! # let look = |heading_rad: f64| {
//! #     let directions = (0..360).map(|i| heading_rad - 0.3 - PI + TAU * f64::from(i) / 360.0);
//! #     let ranges = directions.map(|a| (2.0 / a.cos().abs().max(a.sin().abs())) as f32);
//! #     ScanBuffer::from_ranges(&ranges.collect::<Vec<_>>(), -PI, TAU / 360.0)
//! # };
//! let mapping = flockslam_mapper::Settings::default();
//! let mut grid = TileGrid::<Box<Tile>>::new(mapping.cell_size_m);
//! let (mut matcher, mut mapper) = (ScanMatcher::new(Settings::default()), Mapper::new(mapping));
//! let verdict = Verdict { keep: 1, ..Verdict::default() };
//!
//! let first = look(0.0);
//! let begun = matcher.handle(first.view()?, &verdict, &grid);
//! assert!(begun.has(PoseFlags::INSERT) && !begun.has(PoseFlags::MATCHED));
//! let changed = mapper.insert(first.view()?, &begun, &[]).changed.to_vec();
//! for key in changed {
//!     let mut tile = Tile::unknown(0);
//!     mapper.write_tile(key, &mut tile);
//!     grid.set(key, tile).unwrap();
//! }
//!
//! let turned = matcher.handle(look(0.05).view()?, &verdict, &grid);
//! assert!(turned.has(PoseFlags::MATCHED));
//! assert!(turned.odom_from_base.turn_rad(Pose::new(0.0, 0.0, 0.05)) < 0.01);
//! assert!(turned.odom_from_base.distance_m(Pose::IDENTITY) < 0.02);
//! # Ok::<(), flockslam_messages::ScanProblem>(())
//! ```

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod contradiction;
mod matcher;
mod motion;
mod prediction;
pub mod process;
mod scan_steps;
mod settings;
mod turn_scale;
mod twist_weights;
mod velocity_noise;
mod wheel_scale;

pub use matcher::ScanMatcher;
pub use settings::{Gate, Rescue, Settings, Strategy};
