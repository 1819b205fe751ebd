//! The field's words: names that were replaced stand nowhere but in docs/upgrading.md and among the old keys that are refused.

use crate::support::repository;
use std::fs;
use std::path::{Path, PathBuf};

/// Private words of earlier versions; a word that ends with `*` stands for all that begin so.
const OLD_WORDS: [&str; 70] = [
    "strand*",
    "hindsight*",
    "look_back*",
    "bell",
    "bells",
    "bellringer",
    "ringer*",
    "teller*",
    "sabotag*",
    "roughened",
    "loosened",
    "widened",
    "least_held",
    "doubt_m",
    "layoutheader",
    "layout_revision",
    "livelayout",
    "live_layout*",
    "flocklayout",
    "layouts_are_ready",
    "apply_layouts",
    "waiting_layouts",
    "start_from_chain",
    "chain_began",
    "enter_chain",
    "chains",
    "in_force",
    "whose_turn",
    "who_acts",
    "stands_by",
    "follow_wheels",
    "by_wheels",
    "takenews",
    "say_news",
    "tell_the_flock",
    "told",
    "ear",
    "ears",
    "graph_ear",
    "quest",
    "sieve",
    "unrung",
    "rung",
    "attendants",
    "last_word",
    "lastword",
    "stand_in",
    "standin",
    "mapkeeper",
    "resemblance*",
    "rival*",
    "rehears*",
    "witness*",
    "toll",
    "reborn",
    "hardship*",
    "nuisance",
    "liar",
    "astray",
    "farewell*",
    "whereabouts",
    "remembered",
    "believed",
    "forgotten",
    "doubted",
    "hears",
    "hear_foreign",
    "strangers",
    "newcomer*",
    "atlas",
];
const FOLDERS: [&str; 6] = ["interfaces", "services", "orchestration", "dashboards", "tests", "docs"];
const KINDS: [&str; 7] = ["rs", "md", "toml", "json", "yml", "js", "html"];

#[test]
fn old_words_stand_only_in_upgrading_md() {
    let root = repository();
    let mut files = vec![root.join("README.md"), root.join("ARCHITECTURE.md"), root.join("CONTRIBUTING.md")];
    FOLDERS.iter().for_each(|folder| collect(&root.join(folder), &mut files));
    let lists = ["docs/upgrading.md", "tests/old_words.rs", "configuration/old_keys.rs"];
    files.retain(|file| !lists.iter().any(|list| file.ends_with(list)));
    assert!(files.len() > 300, "{} files were read", files.len());
    let found: Vec<String> = files.iter().flat_map(|file| old_words(root, file)).collect();
    assert!(found.is_empty(), "{} old words:\n{}", found.len(), found.join("\n"));
}

#[test]
fn an_old_word_is_found_in_names_and_sentences() {
    for text in
        ["the strands of a map", "fn whose_turn()", "two_strands_meet", "`LayoutHeader`", "a sabotaged stage"]
    {
        assert!(words(text).any(|word| is_old(&word)), "{text}");
    }
    for text in ["a trajectory", "iter.chain(other)", "foxglove-layout.json", "ringing"] {
        assert!(!words(text).any(|word| is_old(&word)), "{text}");
    }
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() {
            collect(&entry, files);
        } else if entry.extension().is_some_and(|kind| KINDS.iter().any(|known| kind == *known)) {
            files.push(entry);
        }
    }
}

fn old_words(root: &Path, file: &Path) -> Vec<String> {
    let text = fs::read_to_string(file).unwrap();
    let name = file.strip_prefix(root).unwrap().display().to_string();
    let of_line = |(number, line): (usize, &str)| -> Vec<String> {
        words(line).filter(|word| is_old(word)).map(|word| format!("{name}:{}: {word}", number + 1)).collect()
    };
    text.lines().enumerate().flat_map(of_line).collect()
}

fn words(text: &str) -> impl Iterator<Item = String> + '_ {
    let is_part = |letter: char| letter.is_alphanumeric() || letter == '_';
    text.split(move |letter| !is_part(letter)).map(str::to_lowercase)
}

/// Whether a word, or a part of it between underscores, is an old one.
fn is_old(word: &str) -> bool {
    let is_listed = |word: &str| {
        OLD_WORDS.iter().any(|old| match old.strip_suffix('*') {
            Some(beginning) => word.starts_with(beginning),
            None => word == *old,
        })
    };
    is_listed(word) || word.split('_').any(is_listed)
}
