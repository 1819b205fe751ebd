//! A bounded, seeded run of all fuzz entries, for any toolchain: the seeds of `tests/fuzz/corpus`, changed at random. More with
//! `FLOCKSLAM_FUZZ_RUNS=10000000`, of one entry alone with `FLOCKSLAM_FUZZ_ENTRY=carmen`; a crash names the run that it came from.

use crate::fuzz_entries;
use crate::support::faults::Seeded;
use crate::support::repository;
use std::fs;
use std::time::Instant;

const RUNS: u64 = 20_000;
/// Numbers that lengths and counts are tried with.
const TELLING: [u32; 8] = [0, 1, 0x7f, 0xff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff];
const BYTES_MAX: usize = 1 << 16;

/// The seeds of an entry, in the order of their names.
fn corpus(name: &str) -> Vec<Vec<u8>> {
    let directory = repository().join("tests/fuzz/corpus").join(name);
    let mut paths: Vec<_> = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(!paths.is_empty(), "{name} has no seeds");
    paths.iter().map(|path| fs::read(path).unwrap()).collect()
}

/// Changes a few places, and sometimes the length.
fn mutate(bytes: &mut Vec<u8>, other: &[u8], random: &mut Seeded) {
    for _ in 0..1 + random.below(6) {
        let at = random.below(bytes.len() as u64 + 1) as usize;
        match random.below(7) {
            0 if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            1 if at < bytes.len() => bytes[at] = random.below(256) as u8,
            2 => bytes.truncate(at),
            3 => bytes.insert(at, random.below(256) as u8),
            4 if at + 4 <= bytes.len() => {
                let number = TELLING[random.below(TELLING.len() as u64) as usize];
                bytes[at..at + 4].copy_from_slice(&number.to_le_bytes());
            }
            5 if !other.is_empty() => {
                let from = random.below(other.len() as u64) as usize;
                let length = (random.below(64) as usize).min(other.len() - from);
                bytes.splice(at..at, other[from..from + length].iter().copied());
            }
            _ => {
                let end = (at + random.below(16) as usize).min(bytes.len());
                bytes.drain(at..end);
            }
        }
    }
    bytes.truncate(BYTES_MAX);
}

#[test]
fn no_reader_of_foreign_bytes_panics() {
    let runs = std::env::var("FLOCKSLAM_FUZZ_RUNS").ok().and_then(|runs| runs.parse().ok()).unwrap_or(RUNS);
    let only = std::env::var("FLOCKSLAM_FUZZ_ENTRY").ok();
    let mut entries = fuzz_entries::ENTRIES.to_vec();
    entries.retain(|(name, _)| only.as_deref().is_none_or(|only| only == *name));
    assert!(!entries.is_empty(), "there is no entry of the name {only:?}");
    for (name, entry) in entries {
        let (seeds, since) = (corpus(name), Instant::now());
        seeds.iter().for_each(|seed| entry(seed));
        for run in 0..runs {
            let mut random = Seeded::new(run);
            let mut pick = || &seeds[random.below(seeds.len() as u64) as usize];
            let (mut bytes, other) = (pick().clone(), pick());
            mutate(&mut bytes, other, &mut random);
            // The message then contains its origin.
            let text = std::panic::catch_unwind(|| entry(&bytes));
            assert!(text.is_ok(), "{name}: run {run} panicked with {bytes:?}");
        }
        println!("{name}: {runs} executions in {:.1} s", since.elapsed().as_secs_f64());
    }
    fuzz_entries::clean_up();
}
