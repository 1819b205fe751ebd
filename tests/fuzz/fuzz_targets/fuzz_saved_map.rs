//! Fuzz target: the reader of the head of a saved map and its journal.

#![no_main]

#[path = "../entries.rs"]
#[allow(dead_code)]
mod entries;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| entries::saved_map(bytes));
