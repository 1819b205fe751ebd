//! Rust files of the project as tokens, for the tests of the house's rules: comments and texts are no tokens, and what is compiled
//! for tests alone is left out.

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// All Rust files below a folder, in order.
pub fn rust_files(below: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(below).into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// The tokens of a file.
pub fn tokens(file: &Path) -> TokenStream {
    let text = fs::read_to_string(file).unwrap();
    text.parse().unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

/// Every identifier of a file that is compiled into the product, in order; what is called comes once more, as `name()`.
pub fn product_identifiers(file: &Path) -> Vec<String> {
    let mut found = Vec::new();
    if !is_test_module(file) {
        collect(tokens(file), &mut found);
    }
    found
}

fn collect(stream: TokenStream, found: &mut Vec<String>) {
    let mut tokens = stream.into_iter().peekable();
    while let Some(token) = tokens.next() {
        match token {
            TokenTree::Ident(name) => {
                found.push(name.to_string());
                if let Some(TokenTree::Group(group)) = tokens.peek()
                    && group.delimiter() == Delimiter::Parenthesis
                {
                    found.push(format!("{name}()"));
                }
            }
            TokenTree::Group(group)
                if is_cfg_test(&group.stream()) && group.delimiter() == Delimiter::Bracket =>
            {
                skip_item(&mut tokens);
            }
            TokenTree::Group(group) => collect(group.stream(), found),
            TokenTree::Punct(_) | TokenTree::Literal(_) => {}
        }
    }
}

/// Whether this is what stands in `#[cfg(test)]`, or in a condition that needs it.
fn is_cfg_test(attribute: &TokenStream) -> bool {
    let text = attribute.to_string().replace(' ', "");
    text == "cfg(test)" || text.starts_with("cfg(all(test,")
}

/// Skips an item: up to its body or its semicolon.
fn skip_item(tokens: &mut impl Iterator<Item = TokenTree>) {
    for token in tokens {
        match token {
            TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => return,
            TokenTree::Punct(punct) if punct.as_char() == ';' => return,
            _ => {}
        }
    }
}

/// Whether the file is a module that its parent declares for tests alone.
fn is_test_module(file: &Path) -> bool {
    let name = file.file_stem().unwrap().to_str().unwrap();
    let folder = file.parent().unwrap();
    let beside = folder.with_extension("rs");
    let parents = [folder.join("lib.rs"), folder.join("mod.rs"), beside];
    parents.iter().filter(|parent| parent.is_file() && *parent != file).any(|parent| {
        let text = fs::read_to_string(parent).unwrap();
        text.contains(&format!("#[cfg(test)]\nmod {name};"))
    })
}

/// The files that are compiled into a target: its root, and what `mod` leads to from there.
pub fn files_of_target(root: &Path) -> BTreeSet<PathBuf> {
    let mut files = BTreeSet::new();
    // Modules of a root lie beside it, those of another file in the folder of its name.
    follow(&root.canonicalize().unwrap(), true, &mut files);
    files
}

fn follow(file: &Path, is_root: bool, files: &mut BTreeSet<PathBuf>) {
    if !files.insert(file.to_owned()) {
        return;
    }
    let beside = file.parent().unwrap();
    let owns_folder = is_root || file.ends_with("mod.rs");
    let folder = if owns_folder { beside.to_owned() } else { file.with_extension("") };
    let text = fs::read_to_string(file).unwrap();
    let mut path = None;
    for line in text.lines().map(str::trim) {
        if let Some(named) = line.strip_prefix("#[path = \"").and_then(|rest| rest.strip_suffix("\"]")) {
            path = Some(beside.join(named));
        } else if let Some(name) = module_of(line) {
            let places = [folder.join(format!("{name}.rs")), folder.join(name).join("mod.rs")];
            let place = path.take().or_else(|| places.into_iter().find(|place| place.is_file()));
            let place = place.unwrap_or_else(|| panic!("{}: no file for mod {name}", file.display()));
            follow(&place.canonicalize().unwrap(), false, files);
        }
    }
}

/// The name in a line that says `mod NAME;`.
fn module_of(line: &str) -> Option<&str> {
    let line = line.strip_prefix("pub(crate) ").or_else(|| line.strip_prefix("pub ")).unwrap_or(line);
    line.strip_prefix("mod ")?.strip_suffix(';')
}
