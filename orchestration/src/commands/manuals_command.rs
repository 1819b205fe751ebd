//! `flockslam manuals`: man pages and completions of shells, as packages have them. They are made of the command line's own description.

use super::CommandError;
use crate::arguments::Cli;
use crate::manuals_arguments::ManualsArgs;
use clap::{Command, CommandFactory};
use clap_complete::{Shell, generate_to};
use std::path::Path;

/// Shells that completions are made for.
const SHELLS: [Shell; 3] = [Shell::Bash, Shell::Zsh, Shell::Fish];

/// Runs the command: `man1/` and `completions/` in the directory.
///
/// # Errors
/// When the disk refuses.
pub fn run(args: &ManualsArgs) -> Result<(), CommandError> {
    let (pages, completions) = (args.out.join("man1"), args.out.join("completions"));
    for directory in [&pages, &completions] {
        std::fs::create_dir_all(directory)
            .map_err(|error| CommandError::user(format!("{}: {error}", directory.display())))?;
    }
    let mut command = Cli::command();
    command.build();
    write_pages(&command, "", &pages).map_err(CommandError::failed)?;
    for shell in SHELLS {
        generate_to(shell, &mut Cli::command(), "flockslam", &completions).map_err(CommandError::failed)?;
    }
    Ok(())
}

/// A page for a command and for each below it; hidden ones have none.
fn write_pages(command: &Command, above: &str, directory: &Path) -> std::io::Result<()> {
    let name = format!("{above}{}", command.get_name());
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone().display_name(name.clone()))
        .title(name.to_uppercase())
        .render(&mut page)?;
    std::fs::write(directory.join(format!("{name}.1")), page)?;
    let below = command.get_subcommands().filter(|below| !below.is_hide_set() && below.get_name() != "help");
    below.into_iter().try_for_each(|below| write_pages(below, &format!("{name}-"), directory))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_public_command_has_a_page_and_every_shell_its_completions() {
        let directory = tempfile::tempdir().unwrap();
        run(&ManualsArgs { out: directory.path().to_owned() }).unwrap();
        let page = |name: &str| std::fs::read_to_string(directory.path().join("man1").join(name));
        for command in Cli::command().get_subcommands().filter(|command| !command.is_hide_set()) {
            let text = page(&format!("flockslam-{}.1", command.get_name())).unwrap();
            assert!(text.contains("SYNOPSIS"), "{text}");
        }
        assert!(page("flockslam.1").is_ok() && page("flockslam-store-check.1").is_ok());
        assert!(page("flockslam-stage.1").is_err() && page("flockslam-manuals.1").is_err());
        for file in ["flockslam.bash", "_flockslam", "flockslam.fish"] {
            let text = std::fs::read_to_string(directory.path().join("completions").join(file)).unwrap();
            assert!(text.contains("doctor"), "{file}");
        }
    }
}
