//! Links between the documents: each leads to what is there, and the table of contents leads to every page.

use crate::support::repository;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Documents beside those in `docs`.
const OTHERS: [&str; 5] =
    ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "dashboards/README.md"];
const TABLE: &str = "docs/README.md";

fn pages() -> Vec<PathBuf> {
    let entries = fs::read_dir(repository().join("docs")).unwrap().map(|entry| entry.unwrap().path());
    entries.filter(|path| path.extension().is_some_and(|kind| kind == "md")).collect()
}

/// Lines that are not within a block of code.
fn prose(path: &Path) -> Vec<String> {
    let mut is_fenced = false;
    let text = fs::read_to_string(path).unwrap();
    let is_prose = |line: &&str| {
        is_fenced ^= line.starts_with("```");
        !is_fenced && !line.starts_with("```") && !line.starts_with("    ")
    };
    text.lines().filter(is_prose).map(str::to_owned).collect()
}

/// Targets of the links of a document to others of this repository.
fn links(path: &Path) -> Vec<String> {
    let text = prose(path).join("\n");
    let targets = text.split("](").skip(1).filter_map(|behind| behind.split_once(')'));
    let targets = targets.map(|(target, _)| target.to_owned());
    targets.filter(|target| !target.contains("://")).collect()
}

/// The names by which the headings of a document are linked to.
fn anchors(path: &Path) -> BTreeSet<String> {
    let headings = prose(path).into_iter().filter(|line| line.starts_with('#'));
    let anchor = |heading: String| {
        let words = heading.trim_start_matches('#').trim().to_lowercase();
        let kept = words.chars().filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c));
        kept.map(|c| if c == ' ' { '-' } else { c }).collect()
    };
    headings.map(anchor).collect()
}

#[test]
fn every_link_leads_to_what_is_there() {
    let others = OTHERS.map(|file| repository().join(file));
    let (mut count, mut broken) = (0, Vec::new());
    for page in pages().into_iter().chain(others) {
        for link in links(&page) {
            count += 1;
            let (file, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let target = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
            let is_there = target.exists() && (anchor.is_empty() || anchors(&target).contains(anchor));
            if !is_there {
                broken.push(format!("{}: {link}", page.display()));
            }
        }
    }
    assert!(count > 100, "{count} links were found");
    assert!(broken.is_empty(), "{broken:#?}");
}

#[test]
fn the_table_of_contents_leads_to_every_page_once() {
    let mut listed = links(&repository().join(TABLE));
    listed.retain(|link| !link.starts_with("../"));
    listed.sort();
    let mut there: Vec<_> = pages()
        .iter()
        .map(|path| path.file_name().unwrap().to_string_lossy().into_owned())
        .filter(|name| name != "README.md")
        .collect();
    there.sort();
    assert_eq!(listed, there);
    assert!(links(&repository().join("README.md")).iter().any(|link| link == TABLE), "README.md names it");
}
