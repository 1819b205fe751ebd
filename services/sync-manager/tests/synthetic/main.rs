//! The back end in synthetic buildings, in one executable: one robot whose front end drifts, jumps or is lost (`loops`), the poses that it drives by (`driving_poses`), robots
//! that meet (`flock`), and meetings beside robots that share no place, with false constraints among them (`false_merges`).
//!
//! `support` has the buildings and front ends, `flocks` the robots that tell each other, `trials` the trials of `false_merges`. The
//! examples `false_merges` and `scaling` use these three as well.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

mod driving_poses;
mod loops;
mod meeting_trials;
mod meetings_of_robots;
mod merge_trials;
mod support;
mod synthetic_flock;
