//! The same bytes on every machine: on processors with fewer instructions, and as they were committed.

use crate::support::public_logs::{ACES, FILTER_OFF, FR079, INTEL, Log};
use crate::support::{self, Outputs, assert_nothing_left, building, flockslam, run_well, stderr};
use std::path::Path;

/// The system's library then takes its functions for processors without these instructions.
const FEWER_INSTRUCTIONS: (&str, &str) =
    ("GLIBC_TUNABLES", "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable");
const COMPARED: [&str; 4] = ["trajectory.tum", "trajectory_online.tum", "map.pgm", "map.yaml"];
const DURATION_S: u32 = 40;

/// First digits of the hash of the map of the simulated building …
const BUILDING_HASH: &str = "614d61abf500";
/// … and of each log's, without the filter and with it.
const LOG_HASHES: [(Log, &str, &str); 3] = [
    (INTEL, "b7b33444c8cb", "ad8df12ddad1"),
    (FR079, "cb237a5ae5c6", "933b808a4a51"),
    (ACES, "761bc8307989", "d12080d1ddc0"),
];

/// Functions of the system's library whose last bits differ between processors.
const BY_PROCESSOR: [&str; 18] = [
    "sin", "cos", "tan", "sincos", "asin", "acos", "atan", "atan2", "exp", "exp2", "expm1", "log1p", "sinf",
    "cosf", "sincosf", "atan2f", "expf", "powf",
];

fn with_fewer_instructions(out: &Path, args: &[String]) -> Outputs {
    let robot = support::robot("instructions");
    let mut command = flockslam();
    command.args(args).args(["--robot", &robot, "--out"]).arg(out);
    let (variable, value) = FEWER_INSTRUCTIONS;
    let output = command.env(variable, value).output().unwrap();
    assert_nothing_left(&robot);
    assert!(output.status.success(), "{}", stderr(&output));
    Outputs::read(out)
}

fn assert_same(one: &Outputs, other: &Outputs, more: &[&str]) {
    for name in COMPARED.iter().chain(more) {
        assert!(one.bytes(name) == other.bytes(name), "{name} differs");
    }
    assert_eq!(one.report.map_hash, other.report.map_hash);
}

#[test]
fn a_simulated_drive_gives_the_same_bytes_with_fewer_instructions_and_the_committed_hash() {
    let directories = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let args = building(DURATION_S);
    let all = run_well("bytes", directories[0].path(), &args);
    assert_same(&all, &with_fewer_instructions(directories[1].path(), &args), &["truth.tum"]);
    assert!(all.report.map_hash.starts_with(BUILDING_HASH), "{}", all.report.map_hash);
}

#[test]
fn a_log_gives_the_same_bytes_with_fewer_instructions() {
    let Some(all) = ACES.shared_run(&[]) else { return };
    let (all, directory) = (all.wait(), tempfile::tempdir().unwrap());
    let args = ["map".to_owned(), ACES.file("clf").unwrap().display().to_string()];
    assert_same(all, &with_fewer_instructions(directory.path(), &args), &[]);
}

#[test]
fn maps_of_the_logs_have_the_committed_hashes() {
    for (log, unfiltered, filtered) in LOG_HASHES {
        for (more, hash) in [(&["--set", FILTER_OFF][..], unfiltered), (&[], filtered)] {
            let Some(run) = log.shared_run(more) else { return };
            let found = &run.wait().report.map_hash;
            assert!(found.starts_with(hash), "{} {more:?}: {found}, not {hash}", log.name);
        }
    }
}

#[test]
fn the_executable_takes_no_function_of_angles_from_the_system() {
    let executable = std::fs::read(flockslam().get_program()).unwrap();
    let names = names_linked_at_the_start(&executable);
    let has = |name: &str| names.split(|byte| *byte == 0).any(|bytes| bytes == name.as_bytes());
    assert!(has("malloc"), "names of functions are found");
    let taken: Vec<_> = BY_PROCESSOR.into_iter().filter(|name| has(name)).collect();
    assert!(taken.is_empty(), "{taken:?}");
}

/// The table of names of what is linked when a program starts, each with a zero byte behind it: of an ELF file of 64 bits, little endian.
/// Names elsewhere in the file, as in what debuggers read, are of its own functions.
fn names_linked_at_the_start(elf: &[u8]) -> &[u8] {
    const DYNAMIC_SYMBOLS: u64 = 11;
    let number = |at: usize, bytes: usize| {
        elf[at..at + bytes].iter().rev().fold(0, |sum, byte| sum << 8 | u64::from(*byte))
    };
    let (first, size, count) = (number(0x28, 8), number(0x3a, 2), number(0x3c, 2));
    let section = |index: u64| (first + index * size) as usize;
    let symbols = (0..count).map(section).find(|at| number(at + 4, 4) == DYNAMIC_SYMBOLS).unwrap();
    let names = section(number(symbols + 0x28, 4));
    let (begin, length) = (number(names + 0x18, 8) as usize, number(names + 0x20, 8) as usize);
    &elf[begin..begin + length]
}
