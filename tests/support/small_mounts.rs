//! Small file systems that only one process set sees, by a mount namespace of its own.

use super::{flockslam, not_tested, wait_for};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The executable where `size` is all the room in `directory`; `None`, and noted, where nothing may be mounted.
pub fn flockslam_with(directory: &Path, size: &str) -> Option<Command> {
    let mut probe = namespace();
    let may_mount = probe.args(["mount", "-t", "tmpfs", "none", "/mnt"]).status();
    if !may_mount.is_ok_and(|status| status.success()) {
        not_tested(&format!("{size} in {}", directory.display()), "no filesystem may be mounted");
        return None;
    }
    let mut command = namespace();
    let script = "mount -t tmpfs -o size=\"$1\" none \"$0\" && shift && exec \"$@\"";
    command.args(["sh", "-c", script]).arg(directory).arg(size).arg(flockslam().get_program());
    Some(command)
}

fn namespace() -> Command {
    let mut command = Command::new("unshare");
    command.args(["--mount", "--map-root-user"]);
    command
}

/// A directory as a process in such a namespace sees it.
pub fn inside(pid: u32, directory: &Path) -> PathBuf {
    PathBuf::from(format!("/proc/{pid}/root{}", directory.display()))
}

/// Fills the file system of a directory; the file that does it.
pub fn fill(directory: &Path) -> PathBuf {
    let ballast = directory.join("ballast");
    // Written to the last byte, and again, since what others free meanwhile is room too.
    let bytes = vec![1; 4096];
    wait_for("a full file system", || {
        let mut file = fs::File::options().append(true).create(true).open(&ballast).unwrap();
        while std::io::Write::write_all(&mut file, &bytes).is_ok() {}
        let found = rustix::fs::statvfs(directory).unwrap();
        (found.f_bavail == 0).then_some(())
    });
    ballast
}
