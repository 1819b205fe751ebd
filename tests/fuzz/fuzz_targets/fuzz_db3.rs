//! Fuzz target: the reader of a file of rosbag2's SQLite storage.

#![no_main]

#[path = "../entries.rs"]
#[allow(dead_code)]
mod entries;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| entries::db3(bytes));
