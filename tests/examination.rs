//! `flockslam doctor` on the real machine: exit codes, JSON, a set that runs, and a bundle without secrets.

use crate::support::{Drive, LiveSet, flockslam, machine_share, robot, stderr, stdout};
use flate2::read::GzDecoder;
use flockslam_messages::Stage;
use flockslam_stage::JournalReader;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Output};

const TOKEN: &str = "sesame-open-now-please";

fn doctor(arguments: &[&str]) -> Output {
    flockslam().arg("doctor").args(arguments).output().unwrap()
}

fn set_file(directory: &Path, text: &str) -> String {
    let path = directory.join("set.toml");
    std::fs::write(&path, text).unwrap();
    path.display().to_string()
}

/// All files of an archive, without the name of its folder.
fn unpacked(path: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut archive = tar::Archive::new(GzDecoder::new(std::fs::File::open(path).unwrap()));
    let entries = archive.entries().unwrap();
    let file = |entry: std::io::Result<tar::Entry<'_, _>>| {
        let mut entry = entry.unwrap();
        let name = entry.path().unwrap().display().to_string();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        (name.split_once('/').unwrap().1.to_owned(), bytes)
    };
    entries.map(file).collect()
}

#[test]
fn a_set_that_cannot_work_ends_with_code_4_and_a_line_for_each_cause() {
    let directory = tempfile::tempdir().unwrap();
    let set = set_file(
        directory.path(),
        &format!(
            "robot = \"{}\"\nset = [\"page.enabled=false\"]\nlocalize = \"no-map\"\n\
             source = {{ kind = \"ld06\", port = \"/dev/no-lidar-here\" }}\n",
            robot("cannotwork")
        ),
    );
    let output = doctor(&[&set]);
    let text = stdout(&output);
    assert_eq!(output.status.code(), Some(4), "{text}{}", stderr(&output));
    for wanted in ["error lidar: /dev/no-lidar-here is not there; cure: ", "error map: ", "does not run"] {
        assert!(text.contains(wanted), "{wanted}: {text}");
    }
    let json: serde_json::Value = serde_json::from_str(&stdout(&doctor(&[&set, "--json"]))).unwrap();
    let findings = json["findings"].as_array().unwrap();
    assert!(findings.iter().any(|finding| finding["subject"] == "map" && finding["severity"] == "error"));
    assert!(json["machine"]["processors"].as_u64().unwrap() > 0);
}

#[test]
fn what_is_no_description_is_a_finding_and_what_is_not_there_a_mistake() {
    let directory = tempfile::tempdir().unwrap();
    let set = set_file(directory.path(), "robot = \"r1\"\nretri_s = 5.0\n");
    let output = doctor(&[&set]);
    assert_eq!(output.status.code(), Some(4));
    assert!(stdout(&output).contains("did you mean `retry_s`?"), "{}", stdout(&output));
    assert_eq!(doctor(&["no-such-set.toml"]).status.code(), Some(2));
    assert_eq!(doctor(&["--robot", "nobody-here"]).status.code(), Some(2));
}

#[test]
fn the_bundle_of_a_running_set_has_all_its_parts_and_no_secret() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let (token, bundle) = (directory.path().join("token"), directory.path().join("report.tar.gz"));
    std::fs::write(&token, TOKEN).unwrap();
    let map = directory.path().join("map");
    let drive = Drive { scan_rate_hz: 10.0, duration_s: 600.0, rate: 4.0 };
    let name = robot("bundled");
    // The description repeats the token in a comment, as people do.
    let description = drive.description(&name, &format!("map = {map:?}\nsave_every_s = 1.0")).replace(
        "\"page.enabled=false\"",
        &format!("\"page.enabled=false\", 'page.token_file={}'", token.display()),
    );
    let set = set_file(directory.path(), &format!("# {TOKEN}\n{description}"));
    let mut running = LiveSet::start_again(name.clone(), directory.path(), &[]);
    running.wait_until_handled(Stage::Mapper, 60);
    let output = doctor(&[&set, "--bundle", &bundle.display().to_string()]);
    assert!([0, 3, 4].contains(&output.status.code().unwrap()), "{}", stderr(&output));
    assert!(!stdout(&output).contains("does not run"), "{}", stdout(&output));
    let files = unpacked(&bundle);
    let of_set = |file: &str| {
        files.get(&format!("{name}/{file}")).unwrap_or_else(|| panic!("{file}: {:?}", missing(&files)))
    };
    assert!(of_set("map.png").starts_with(b"\x89PNG"));
    let metrics = String::from_utf8_lossy(of_set("metrics.txt"));
    assert!(metrics.contains("flockslam_scans_handled_total"), "{metrics}");
    assert!(String::from_utf8_lossy(of_set("set.toml")).contains("[removed]"));
    let readings: serde_json::Value = serde_json::from_slice(of_set("readings.json")).unwrap();
    assert!(readings["running"]["handled_hz"].as_f64().unwrap() > 1.0, "{readings}");
    for file in ["findings.txt", "machine.json", "missing.txt"] {
        assert!(files.contains_key(file), "{file}");
    }
    let journal = directory.path().join("journal");
    std::fs::create_dir(&journal).unwrap();
    std::fs::write(journal.join("scans.journal"), of_set("journal/scans.journal")).unwrap();
    let mut reader = JournalReader::open(&journal).unwrap();
    let (mut poses, mut scans) = (0, 0);
    while let Some(record) = reader.read_next().unwrap() {
        (poses, scans) = (poses + 1, scans + usize::from(record.scan.is_some()));
    }
    assert!(poses >= 60 && (1..poses).contains(&scans), "{poses} poses, {scans} scans");
    for (file, bytes) in &files {
        assert!(!bytes.windows(TOKEN.len()).any(|window| window == TOKEN.as_bytes()), "{file}");
        assert!(!file.ends_with(".key") && !file.ends_with("token"), "{file}");
    }
    assert!(listed(&bundle), "tar reads it");
    running.command_well(&["down"]);
    assert_eq!(running.wait(), Some(0));
}

fn missing(files: &BTreeMap<String, Vec<u8>>) -> String {
    String::from_utf8_lossy(files.get("missing.txt").map_or(&[], Vec::as_slice)).into_owned()
}

fn listed(bundle: &Path) -> bool {
    Command::new("tar").arg("-tzf").arg(bundle).output().is_ok_and(|output| output.status.success())
}

#[test]
fn a_running_set_is_examined_by_its_name() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let drive = Drive { scan_rate_hz: 10.0, duration_s: 600.0, rate: 1.0 };
    let mut set = LiveSet::start("examined", directory.path(), drive, "");
    set.wait_until_handled(Stage::ScanMatcher, 5);
    let killed = set.pid(Stage::DynamicCleaner);
    crate::support::send(killed, rustix::process::Signal::KILL);
    set.wait_until("the restart", |status| crate::support::of(status, Stage::DynamicCleaner).restarts == 1);
    let output = doctor(&["--robot", set.robot()]);
    let text = stdout(&output);
    assert!(text.contains("warning stages: dynamic-cleaner was replaced 1 times"), "{text}");
    assert!(text.contains("warning map: the map is kept nowhere"), "{text}");
    assert!([3, 4].contains(&output.status.code().unwrap()), "{text}");
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}
