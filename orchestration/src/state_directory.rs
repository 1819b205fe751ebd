//! Where on disk a set keeps what grows as it drives: journal, closed submaps, results.

use rustix::fs::statvfs;
use std::path::{Path, PathBuf};

/// A place with less room is passed over: about half an hour of driving, bytes.
const FREE_MIN_BYTES: u64 = 16 << 20;

/// The directory that was asked for; else the first usable one of those that are usual. `None` when there is none: everything stays in
/// memory then.
pub fn spill_directory(asked_for: Option<&Path>, map: Option<&Path>) -> Option<PathBuf> {
    if let Some(directory) = asked_for {
        return Some(directory.to_owned());
    }
    let found = usual_directories(map).into_iter().find(|d| is_usable(d));
    if found.is_none() {
        tracing::warn!("no directory on disk can be written: journal, submaps and results lie in /dev/shm");
    }
    found
}

/// Where such files go when nothing is asked for, the first choice first; not all can be written.
pub fn usual_directories(map: Option<&Path>) -> Vec<PathBuf> {
    usual(map, |name| std::env::var_os(name).map(PathBuf::from))
}

/// Beside the map, else where the system has state, else where it has temporary files.
fn usual(map: Option<&Path>, variable: impl Fn(&str) -> Option<PathBuf>) -> Vec<PathBuf> {
    let beside_map = map.and_then(|map| Some(std::path::absolute(map).ok()?.parent()?.to_owned()));
    // A service may have several.
    let of_service = variable("STATE_DIRECTORY").and_then(|all| {
        let all = all.to_str()?.to_owned();
        all.split(':').next().map(PathBuf::from)
    });
    let of_user = variable("XDG_STATE_HOME").or_else(|| Some(variable("HOME")?.join(".local/state")));
    let temporary = variable("TMPDIR").unwrap_or_else(|| "/tmp".into());
    let all = [
        beside_map,
        of_service,
        of_user.map(|state| state.join("flockslam")),
        Some(temporary.join(format!("flockslam-{}", rustix::process::getuid().as_raw()))),
    ];
    all.into_iter().flatten().filter(|directory| directory.is_absolute()).collect()
}

/// Whether a file can be made there, and more than a few.
fn is_usable(directory: &Path) -> bool {
    let probe = directory.join(format!(".flockslam-{}", std::process::id()));
    let made = std::fs::create_dir_all(directory).and_then(|()| std::fs::write(&probe, b"?"));
    let _ = std::fs::remove_file(&probe);
    let free_bytes = || statvfs(directory).map_or(0, |found| found.f_bavail.saturating_mul(found.f_frsize));
    made.is_ok() && free_bytes() >= FREE_MIN_BYTES
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_usual_places_are_in_this_order() {
        let paths = |map: Option<&str>, set: &[(&str, &str)]| {
            let of = |name: &str| set.iter().find(|(key, _)| *key == name).map(|(_, value)| value.into());
            let found = usual(map.map(Path::new), of);
            found.iter().map(|path| path.display().to_string()).collect::<Vec<_>>()
        };
        let last = format!("/tmp/flockslam-{}", rustix::process::getuid().as_raw());
        let home = ("HOME", "/home/r");
        assert_eq!(paths(None, &[]), std::slice::from_ref(&last));
        assert_eq!(paths(None, &[home]), ["/home/r/.local/state/flockslam", &last]);
        assert_eq!(
            paths(
                Some("/maps/r1"),
                &[home, ("XDG_STATE_HOME", "/state"), ("STATE_DIRECTORY", "/var/a:/var/b")]
            ),
            ["/maps", "/var/a", "/state/flockslam", &last]
        );
        assert_eq!(
            paths(None, &[home, ("XDG_STATE_HOME", "not/absolute"), ("TMPDIR", "/t")])[0],
            last.replace("/tmp", "/t")
        );
    }

    #[test]
    fn a_requested_directory_is_used_unless_it_is_not_writable() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("file");
        std::fs::write(&file, b"").unwrap();
        assert_eq!(spill_directory(Some(&file), None), Some(file.clone()));
        assert!(!is_usable(&file) && is_usable(&directory.path().join("new")));
        let map = directory.path().join("map");
        assert_eq!(spill_directory(None, Some(&map)), Some(directory.path().to_owned()));
    }
}
