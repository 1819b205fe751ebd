//! Removal of what killed processes left of their iceoryx2 nodes.

use crate::RuntimeDir;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// What is left of a dead process's node is cleaned by iceoryx2 before it has been seen so often, or never.
const SEEN_MAX: u32 = 3;

/// Removes the remains of nodes whose processes were killed while they made or removed them.
///
/// iceoryx2 0.10 neither lists nor cleans these, and many of them make starts slow.
#[derive(Debug, Default)]
pub struct OrphanedNodes {
    /// How often each was met.
    seen: BTreeMap<u128, u32>,
}

impl OrphanedNodes {
    /// To be called now and then, after the cleaning of dead nodes, which takes what is whole. Gives how many nodes were removed.
    pub fn remove(&mut self, runtime: &RuntimeDir) -> usize {
        let orphans = orphans(&runtime.nodes(), &runtime.object_prefix());
        self.seen.retain(|id, _| orphans.contains_key(id));
        let mut removed = 0;
        for (id, paths) in orphans {
            let seen = self.seen.entry(id).or_default();
            *seen += 1;
            if *seen >= SEEN_MAX {
                // An entry that is no directory is a file. An entry that cannot be removed now is tried again.
                let gone =
                    |path: &PathBuf| fs::remove_dir_all(path).or_else(|_| fs::remove_file(path)).is_ok();
                removed += usize::from(paths.iter().filter(|path| gone(path)).count() == paths.len());
            }
        }
        removed
    }
}

/// Nodes of dead processes, and what there is of each: a directory with its number, and files whose names begin with it.
fn orphans(nodes: &Path, prefix: &str) -> BTreeMap<u128, Vec<PathBuf>> {
    let mut orphans: BTreeMap<u128, Vec<PathBuf>> = BTreeMap::new();
    for entry in fs::read_dir(nodes).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let number = name.strip_prefix(prefix).unwrap_or(&name).split('.').next();
        let id = number.and_then(|number| number.parse().ok());
        if let Some(id) = id.filter(|id| has_exited(process_of_node(*id))) {
            orphans.entry(id).or_default().push(entry.path());
        }
    }
    orphans
}

/// The process that made a node: iceoryx2 0.10 names nodes by seconds, nanoseconds, process and a counter, 32 bits each.
fn process_of_node(id: u128) -> u32 {
    (id >> 64) as u32
}

fn has_exited(pid: u32) -> bool {
    !Path::new("/proc").join(pid.to_string()).exists()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(pid: u32) -> u128 {
        (u128::from(pid) << 64) | (7 << 96) | 12_345
    }

    #[test]
    fn leftovers_of_dead_processes_are_removed_and_files_of_running_ones_stay() {
        let runtime = RuntimeDir::create(&format!("orphans-{}", std::process::id())).unwrap();
        let nodes = runtime.nodes();
        // No process has the greatest number.
        for pid in [std::process::id(), u32::MAX] {
            fs::create_dir_all(nodes.join(id(pid).to_string())).unwrap();
            let monitor = format!("{}{}.node_monitor", runtime.object_prefix(), id(pid));
            fs::write(nodes.join(monitor), b"").unwrap();
        }
        fs::write(nodes.join("something else"), b"").unwrap();
        let mut orphans = OrphanedNodes::default();
        let removed: Vec<usize> = (0..4).map(|_| orphans.remove(&runtime)).collect();
        assert_eq!(removed, [0, 0, 1, 0]);
        assert_eq!(fs::read_dir(&nodes).unwrap().count(), 3);
        assert!(nodes.join(id(std::process::id()).to_string()).exists());
    }

    #[test]
    fn a_node_is_named_by_its_process() {
        // Read off a running set.
        assert_eq!(process_of_node(343_978_708_962_865_206_850_334), 18_647);
    }
}
