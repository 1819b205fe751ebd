//! Fuzz target: the reader of configurations, descriptions of sets and orders.

#![no_main]

#[path = "../entries.rs"]
#[allow(dead_code)]
mod entries;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| entries::configuration(bytes));
