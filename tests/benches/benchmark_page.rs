//! Writes `docs/benchmarks.md`: `cargo bench -p flockslam --bench page`. What it measures is in the sections' own words.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

mod page;
#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use page::{Page, Plan, SECTIONS, echo, generate};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const USAGE: &str = "options: --only SECTION,SECTION… (the others stay as they are), --quick, --output FILE";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [option, directory] = arguments.as_slice()
        && option == "--echo"
    {
        echo(Path::new(directory));
        return ExitCode::SUCCESS;
    }
    match write_page(&arguments) {
        Ok(path) => {
            eprintln!("wrote {}", path.display());
            ExitCode::SUCCESS
        }
        Err(reason) => {
            eprintln!("{reason}");
            ExitCode::from(2)
        }
    }
}

fn write_page(arguments: &[String]) -> Result<PathBuf, String> {
    let (mut only, mut quick, mut path) = (Vec::new(), false, default_path());
    let mut arguments = arguments.iter();
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or_else(|| format!("{argument} needs a value; {USAGE}"));
        match argument.as_str() {
            "--only" => only = sections(value()?)?,
            "--quick" => quick = true,
            "--output" => path = value()?.into(),
            // What cargo adds by itself.
            "--bench" => {}
            _ => return Err(format!("unknown option {argument}; {USAGE}")),
        }
    }
    let mut page = Page::parse(&std::fs::read_to_string(&path).unwrap_or_default());
    // Kept after every section: minutes have gone into the others when one fails.
    let keep = |page: &Page| std::fs::write(&path, page.render());
    generate(&Plan { only, ..Plan::full(quick) }, &mut page, keep)
        .map_err(|error| format!("{}: {error}", path.display()))?;
    Ok(path)
}

fn sections(list: &str) -> Result<Vec<String>, String> {
    let known = || SECTIONS.map(|(name, _)| name).join(", ");
    let check = |name: &str| match SECTIONS.iter().any(|(known, _)| *known == name) {
        true => Ok(name.to_owned()),
        false => Err(format!("'{name}' is not a section; there are {}", known())),
    };
    list.split(',').map(check).collect()
}

fn default_path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/benchmarks.md")
}
