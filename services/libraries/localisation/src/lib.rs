//! Where a robot is in a map that is known and never edited.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod alignment;
mod belief;
mod front_end_slip;
mod information;
mod known_map;
mod leading_place;
mod localizer;
mod lost_place;
mod outdoor_state;
mod place_acceptance;
mod place_field;
mod place_search;
mod pose_hint;
mod recent_views;
mod scattered_returns;
mod search_schedule;
mod surface_lines;

pub use alignment::{Agreement, Fit, SeenPoint, Surroundings};
pub use belief::{Belief, Hypothesis, Knowledge};
pub use known_map::{KnownMap, Place};
pub use localizer::{Localizer, Measurement};
pub use place_field::{MUCH_UNKNOWN, PlaceField, UNKNOWN};
pub use place_search::{Candidate, Near, PlaceSearch, Places, SearchRequest};
pub use pose_hint::Hint;
pub use recent_views::RecentViews;
