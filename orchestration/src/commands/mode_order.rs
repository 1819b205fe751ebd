//! The change of a running set from making a map to localizing in it and back, as its supervisor does it. The map as it is then is worked out by a
//! process of its own, from a copy of what the set knows, while the set goes on.

use super::localisation_map;
use crate::store::{MapSaver, Mirror, SavedMap};
use crate::supervisor::{ModeStatus, ProcessSet};
use flockslam_bus::RuntimeDir;
use flockslam_results::{LocalisationStatus, SetMode, StoredMap};
use flockslam_sync_manager::Settings;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::thread;

/// What is wanted of the mode of a set, and how far it has come.
#[derive(Default)]
pub(super) struct ModeChange {
    /// The map that is worked out.
    freezing: Option<Receiver<Result<StoredMap, String>>>,
    /// The stages have the order to localize, and have said nothing of it yet: no scan has come since.
    begins: bool,
    problem: Option<String>,
}

impl ModeChange {
    /// Begins to work out the map as it is now; `mirror` copies what the set knows into a saved map.
    ///
    /// # Errors
    /// When a copy cannot be made here.
    pub fn localize(
        &mut self,
        set: &ProcessSet,
        mirror: impl FnOnce(SavedMap) -> Mirror,
    ) -> Result<(), String> {
        self.problem = None;
        if set.localizes() || self.freezing.is_some() {
            return Ok(());
        }
        let copy = std::env::temp_dir().join(format!("flockslam-frozen-{}", std::process::id()));
        let settings = copy.join("settings.toml");
        let mut configuration = set.configuration().clone();
        // Nobody but the set speaks for the robot.
        configuration.sync_manager.flock = Settings::default().flock;
        let text = toml::to_string(&configuration).map_err(|error| error.to_string())?;
        let refused = |error: std::io::Error| format!("{}: {error}", copy.display());
        // A killed predecessor may have left one.
        let _ = fs::remove_dir_all(&copy);
        fs::create_dir_all(&copy).and_then(|()| fs::write(&settings, text)).map_err(refused)?;
        let saved = copy.join("map");
        let mut mirror = mirror(SavedMap::at(&saved));
        let (sender, frozen) = channel();
        let work = move || {
            let exported = mirror.bring_up().map_err(|error| error.to_string()).and_then(|()| {
                localisation_map::exported(&saved, &copy.join("out"), Some(&settings))
                    .map_err(|error| error.to_string())
            });
            let _ = fs::remove_dir_all(&copy);
            // The set may have ended meanwhile.
            let _ = sender.send(exported);
        };
        thread::Builder::new().name("freezes".to_owned()).spawn(work).map_err(|error| error.to_string())?;
        self.freezing = Some(frozen);
        Ok(())
    }

    /// Lets a set that localizes make its map further.
    ///
    /// # Errors
    /// When its robot is not localized, or the known map has no submaps.
    pub fn map(&mut self, set: &mut ProcessSet) -> Result<(), String> {
        self.problem = None;
        // What is not done yet is not done any more.
        self.freezing = None;
        if !set.localizes() {
            return Ok(());
        }
        let status_dir = set.runtime().status();
        let mode = SetMode::read(&set.runtime().results()).unwrap_or_default();
        if let Some(fixed) = &mode.fixed {
            return Err(format!(
                "{fixed}, which has no submaps that could be added to: `flockslam store import` makes a saved map of it, and --localize takes that"
            ));
        }
        let belief = LocalisationStatus::read(&status_dir).filter(|_| !self.begins).unwrap_or_default();
        if belief.knowledge != "localized" {
            return Err(
                "the robot is not localized in the known map: drive on, or say where it is by relocalize --near, and order it again"
                    .to_owned(),
            );
        }
        set.change_mode(&SetMode { localizes: false, changed: true, ..mode })
            .map_err(|error| error.to_string())
    }

    /// Lets the stages localize once the map is worked out, and the saver save what belongs to it.
    pub fn advance(&mut self, set: &mut ProcessSet, saver: Option<&MapSaver>) {
        let frozen = self.freezing.as_ref().map(Receiver::try_recv);
        if let Some(Ok(_) | Err(TryRecvError::Disconnected)) = &frozen {
            self.freezing = None;
            let map = match frozen {
                Some(Ok(map)) => map,
                _ => Err("the map as it is now could not be worked out".to_owned()),
            };
            match map.and_then(|map| begin(set, &map)) {
                Ok(()) => self.begins = true,
                Err(problem) => {
                    tracing::error!(problem, "the set does not localize");
                    self.problem = Some(problem);
                }
            }
        }
        if self.begins && LocalisationStatus::file(&set.runtime().status()).exists() {
            self.begins = false;
            saver.iter().for_each(|saver| saver.save_soon());
        }
    }

    /// Adds what it knows to the status of the set.
    pub fn report(&self, status: &mut ModeStatus) {
        status.changing = self.freezing.is_some();
        status.problem.clone_from(&self.problem);
    }
}

/// Lets the stages of a set localize in this map.
fn begin(set: &mut ProcessSet, map: &StoredMap) -> Result<(), String> {
    let runtime: &RuntimeDir = set.runtime();
    let status_dir = runtime.status();
    localisation_map::put(map, runtime).map_err(|error| error.to_string())?;
    remove_file(&LocalisationStatus::file(&status_dir))?;
    let before = SetMode::read(&runtime.results()).unwrap_or_default();
    set.change_mode(&SetMode { localizes: true, fixed: None, changed: true, ..before })
        .map_err(|error| error.to_string())
}

fn remove_file(file: &Path) -> Result<(), String> {
    match fs::remove_file(file) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(format!("{}: {error}", file.display())),
        _ => Ok(()),
    }
}
