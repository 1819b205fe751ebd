//! Commands in the documents: each `flockslam …` is understood by the command line and its settings exist, each `cargo …` names what is
//! there, each command has a place in the documents and in a test.

use crate::support::repository;
use crate::support::source::rust_files;
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser};
use flockslam::arguments::Cli;
use flockslam::configuration::{Configuration, Profile};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// What stands for a word in capitals where not any word would do.
const PLACEHOLDERS: [(&str, &str); 6] = [
    ("STAGE", "mapper"),
    ("STAGE=N", "mapper=2"),
    ("STAGE=FILTER", "mapper=debug"),
    ("PORT", "9464"),
    ("RATE", "1"),
    ("N", "3"),
];
/// Complaints about a command in a sentence, which names the command and not all that it needs.
const UNFINISHED: [ErrorKind; 3] = [
    ErrorKind::MissingRequiredArgument,
    ErrorKind::MissingSubcommand,
    ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand,
];
/// What may stand before a command, and ends one.
const BETWEEN: [&str; 7] = ["|", "&", "&&", ";", ">", "#", "2>"];

/// A command as a document has it.
pub(crate) struct Documented {
    file: String,
    pub(crate) words: Vec<String>,
    /// In a block of its own: all is there that it needs.
    pub(crate) whole: bool,
    /// The line behind it.
    pub(crate) answer: String,
}

impl Documented {
    fn text(&self) -> String {
        format!("{}: {}", self.file, self.words.join(" "))
    }
}

fn documents() -> Vec<PathBuf> {
    let root = repository();
    let docs = fs::read_dir(root.join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = docs.filter(|path| path.extension().is_some_and(|kind| kind == "md")).collect();
    // It names what is gone.
    files.retain(|path| !path.ends_with("upgrading.md"));
    files.extend(["README.md", "CONTRIBUTING.md", "dashboards/README.md"].map(|file| root.join(file)));
    files.sort();
    files
}

/// The words of a line as a shell takes them apart.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for letter in line.chars() {
        match (letter, quote) {
            (_, Some(open)) if letter == open => quote = None,
            ('\'' | '"', None) => {
                quote = Some(letter);
                word.get_or_insert_default();
            }
            (' ' | '\n', None) => words.extend(word.take()),
            // Around what may be left out.
            ('[' | ']', None) => {}
            _ => word.get_or_insert_default().push(letter),
        }
    }
    words.extend(word);
    words
}

/// All commands of this program in a document, whatever stands before them.
fn commands_of(path: &PathBuf, program: &str) -> Vec<Documented> {
    let text = fs::read_to_string(path).unwrap();
    let file = path.strip_prefix(repository()).unwrap().display().to_string();
    let mut found = Vec::new();
    let mut add = |line: &str, whole: bool, answer: &str| {
        for command in words(line).split(|word| BETWEEN.contains(&word.as_str())) {
            let is_before = |word: &&String| {
                ["$", "sudo"].contains(&word.as_str()) || word.contains('=') && !word.starts_with('-')
            };
            let mut command: Vec<_> = command.iter().skip_while(is_before).cloned().collect();
            if command.first().is_some_and(|word| word == "-u") {
                command.drain(..2);
            }
            // What a container runs stands behind the image's name.
            if command.len() > 2 && command[0] == "podman" && ["run", "exec"].contains(&command[1].as_str()) {
                let at = command.iter().position(|word| word == program).unwrap_or(0);
                command.drain(..at);
            }
            if command.first().is_some_and(|word| word == program) && command.len() > 1 {
                let words = command.into_iter().filter(|word| word != "…").collect();
                found.push(Documented { file: file.clone(), words, whole, answer: answer.to_owned() });
            }
        }
    };
    let mut is_fenced = false;
    let (blocks, sentences): (Vec<_>, Vec<_>) = text.lines().partition(|line| {
        is_fenced ^= line.starts_with("```");
        is_fenced || line.starts_with("    ") || line.starts_with("```")
    });
    for (at, line) in blocks.iter().enumerate() {
        add(line, true, blocks.get(at + 1).map_or("", |line| line.trim()));
    }
    sentences.join("\n").split('`').skip(1).step_by(2).for_each(|span| add(span, false, ""));
    found
}

pub(crate) fn all_commands(program: &str) -> Vec<Documented> {
    documents().iter().flat_map(|path| commands_of(path, program)).collect()
}

/// The command with values in place of words in capitals.
fn with_values(command: &Documented) -> Vec<String> {
    let value = |word: &String| {
        let (before, name) = match word.split_once('=') {
            Some((key, name)) if key.contains('.') => (format!("{key}="), name),
            _ => (String::new(), word.as_str()),
        };
        let known = PLACEHOLDERS.iter().find(|(placeholder, _)| *placeholder == name);
        format!("{before}{}", known.map_or(name, |(_, value)| value))
    };
    command.words.iter().map(value).collect()
}

#[test]
fn every_command_in_the_documents_is_understood() {
    let commands = all_commands("flockslam");
    assert!(commands.len() > 80, "{} commands were found", commands.len());
    let complaint = |command: &Documented| {
        let error = Cli::try_parse_from(with_values(command)).err()?;
        let is_unfinished = !command.whole && UNFINISHED.contains(&error.kind());
        (!is_unfinished).then(|| format!("{}\n{error}", command.text()))
    };
    let complaints: Vec<_> = commands.iter().filter_map(complaint).collect();
    assert!(complaints.is_empty(), "{}", complaints.join("\n"));
}

#[test]
fn every_setting_of_a_command_in_the_documents_is_known_unless_its_refusal_is_shown() {
    let mut count = 0;
    for command in all_commands("flockslam") {
        for setting in with_values(&command).windows(2).filter(|pair| pair[0] == "--set") {
            count += 1;
            let outcome = Configuration::load(Profile::Default, None, &setting[1..]);
            let refusal_is_shown = command.answer.starts_with("flockslam: ");
            assert_eq!(outcome.is_err(), refusal_is_shown, "{}: {outcome:?}", command.text());
        }
    }
    assert!(count >= 5, "{count} settings were found");
}

#[test]
fn every_cargo_command_in_the_documents_names_what_is_there() {
    let read = |path: &PathBuf| fs::read_to_string(path).unwrap();
    let manifests: Vec<_> = ["interfaces", "services", "orchestration", "dashboards"]
        .iter()
        .flat_map(|folder| files_named("Cargo.toml", &repository().join(folder)))
        .map(|path| read(&path))
        .collect();
    let tests = read(&repository().join("tests/main.rs"));
    let is_there = |text: &str| manifests.iter().any(|manifest| manifest.contains(text));
    let commands = all_commands("cargo");
    assert!(commands.len() > 10, "{} commands were found", commands.len());
    for command in &commands {
        let place = command.text();
        for pair in command.words.windows(2) {
            let name = &pair[1];
            match pair[0].as_str() {
                "--bench" => assert!(is_there(&format!("[[bench]]\nname = {name:?}")), "{place}"),
                "-p" => assert!(is_there(&format!("[package]\nname = {name:?}")), "{place}"),
                _ => {}
            }
        }
        let modules = command.words.iter().filter_map(|word| word.strip_suffix("::"));
        modules.for_each(|name| assert!(tests.contains(&format!("\nmod {name};")), "{place}"));
    }
}

fn files_named(name: &str, below: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(below).unwrap().map(|entry| entry.unwrap().path());
    let found = entries.flat_map(|path| if path.is_dir() { files_named(name, &path) } else { vec![path] });
    found.filter(|path| path.ends_with(name)).collect()
}

/// All commands that help shows, each with those above it.
fn public_commands(command: &clap::Command, above: &[String]) -> Vec<Vec<String>> {
    let mut all = Vec::new();
    for below in command.get_subcommands().filter(|below| !below.is_hide_set()) {
        let path: Vec<_> = above.iter().cloned().chain([below.get_name().to_owned()]).collect();
        if below.has_subcommands() {
            all.extend(public_commands(below, &path));
        } else {
            all.push(path);
        }
    }
    all
}

#[test]
fn every_command_is_in_the_documents_and_in_a_test() {
    let text: String = documents().iter().map(|path| fs::read_to_string(path).unwrap()).collect();
    let spans: BTreeSet<_> =
        text.split(|letter: char| !(letter.is_alphanumeric() || letter == '-')).collect();
    let tests: String = rust_files(&repository().join("tests"))
        .into_iter()
        .filter(|path| !path.ends_with("documented_commands.rs"))
        .map(|path| fs::read_to_string(path).unwrap())
        .collect();
    let commands = public_commands(&Cli::command(), &[]);
    assert!(commands.len() > 30, "{commands:?}");
    for path in commands {
        for word in &path {
            assert!(spans.contains(word.as_str()), "{path:?} is in no document");
            assert!(tests.contains(&format!("\"{word}\"")), "{path:?} is in no test");
        }
    }
}
