//! `flockslam doctor`: what is wrong with this machine and with a set, and the cure.

use super::control_command::choose;
use super::{CommandError, print};
use crate::doctor::{
    Bundle, Finding, Machine, SetReading, check_machine, check_set, exit_code, inspect_description,
    inspect_running, read_disk, read_machine,
};
use crate::doctor_arguments::DoctorArgs;
use crate::state_directory::usual_directories;
use flockslam_bus::RuntimeDir;
use serde::Serialize;
use std::path::PathBuf;

/// What was found, and what it was found in.
#[derive(Serialize)]
struct Examination<'a> {
    findings: &'a [Finding],
    machine: &'a Machine,
    sets: &'a [SetReading],
}

/// Runs the command; its exit code.
///
/// # Errors
/// When there is no such set, or the bundle cannot be written.
pub fn run(args: &DoctorArgs) -> Result<u8, CommandError> {
    let sets = match (&args.set, &args.robot.robot) {
        (Some(path), _) if !path.exists() => {
            return Err(CommandError::user(format!("{}: No such file or directory", path.display())));
        }
        (Some(path), _) => vec![inspect_description(path)],
        (None, Some(_)) => vec![inspect_running(&choose(&args.robot)?)],
        (None, None) => RuntimeDir::running().iter().map(|robot| inspect_running(robot)).collect(),
    };
    let maps: Vec<PathBuf> = sets.iter().filter_map(|set| set.map.clone()).collect();
    let mut places: Vec<_> = maps.iter().map(|map| ("the map".to_owned(), map.as_path())).collect();
    let mut states: Vec<PathBuf> = sets.iter().filter_map(|set| set.spill.clone()).collect();
    if states.is_empty() {
        // The one that a set would take; nothing is made here.
        let usual = usual_directories(maps.first().map(PathBuf::as_path)).into_iter();
        states.extend(usual.filter(|path| read_disk("", path).is_writable).take(1));
    }
    places.extend(states.iter().map(|state| ("journal and submaps".to_owned(), state.as_path())));
    let machine = read_machine(&places);
    let mut findings = check_machine(&machine);
    sets.iter().for_each(|set| findings.extend(check_set(set, &machine)));
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    if args.json {
        let examination = Examination { findings: &findings, machine: &machine, sets: &sets };
        let json = serde_json::to_string_pretty(&examination).map_err(CommandError::failed)?;
        print(&format!("{json}\n"));
    } else {
        findings.iter().for_each(|finding| print(&format!("{finding}\n")));
        print(&format!("{}\n", summary(&findings, &machine, &sets)));
    }
    if let Some(path) = &args.bundle {
        Bundle::of(&machine, &sets, &findings).write(path).map_err(CommandError::failed)?;
        eprintln!("packed in {}: look into it before you send it", path.display());
    }
    Ok(exit_code(&findings))
}

/// What was looked at, and what could not be read.
fn summary(findings: &[Finding], machine: &Machine, sets: &[SetReading]) -> String {
    let (kernel, system) = (machine.kernel.as_deref(), machine.system.as_deref());
    let names: Vec<&str> = sets.iter().map(|set| set.robot.as_str()).collect();
    let looked =
        if names.is_empty() { "no set runs".to_owned() } else { format!("sets: {}", names.join(", ")) };
    let unread = [
        ("shared memory", machine.shared_memory.is_none()),
        ("time service", machine.clock_is_synchronised.is_none()),
        ("governor", machine.governors.is_empty()),
    ];
    let unread: Vec<&str> = unread.into_iter().filter(|(_, is)| *is).map(|(name, _)| name).collect();
    let unread =
        if unread.is_empty() { String::new() } else { format!("; not known: {}", unread.join(", ")) };
    format!(
        "{} findings; flockslam {}, {}, Linux {}; {} serial ports; {looked}{unread}",
        findings.len(),
        machine.version,
        system.unwrap_or("unknown system"),
        kernel.unwrap_or("unknown"),
        machine.ports.len()
    )
}
