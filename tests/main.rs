//! Whole-system tests: they start the real executable, each with a root and a name of its own, and test it from outside.
//!
//! All of them are one executable, since linking takes longer than most of the tests. `house.rs` keeps this list complete.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

mod apart;
mod arm64;
mod as_it_was_again;
mod bad_input;
mod bad_recordings;
mod benchmarks;
mod checkers;
mod dashboards;
mod deployment;
mod document_links;
mod documented_commands;
mod documented_runs;
mod examination;
mod faults;
mod filter_stage;
mod first_set;
mod flock;
mod fuzzing;
mod house;
mod idle;
mod imported_maps;
mod killed_stage;
mod lidar_lines;
mod limited_machines;
mod live_calibration;
mod live_set;
mod localisation;
mod log_readers;
mod logs;
mod metrics;
mod mode_change;
mod mountings;
mod moving_world;
mod ndt_experiments;
mod old_words;
mod one_thread;
mod online_poses;
mod overload;
mod package;
mod page;
mod panics;
mod published_covariance;
mod recorder;
mod recordings;
mod replay;
mod replicas;
mod ros2;
mod ros2_localisation;
mod ros2_time;
mod ros2_zenoh;
mod same_bytes;
mod saved_maps;
mod scans_source;
mod seeing;
mod shared_memory;
mod small_memory;
mod spill;
mod stopped_stage;
#[allow(dead_code, unused_imports, reason = "benchmarks use the rest of it")]
mod support;
mod torn_logs;
mod tracking;
mod turning;
mod worlds;

#[allow(dead_code, unused_imports, reason = "the test runs a part of the benchmark's sections")]
#[path = "benches/page/mod.rs"]
mod benchmark;
#[path = "fuzz/entries.rs"]
mod fuzz_entries;
