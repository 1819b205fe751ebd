//! State that the threads of the page share: the view, the viewers, and access to the supervisor.

use crate::guard::Guard;
use crate::health::{Event, EventKind, Health};
use crate::view::{Head, View};
use flockslam_bus::Capacity;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use tokio::sync::watch;

/// Where a set is to be found.
#[derive(Clone, Debug)]
pub struct Place {
    /// Its directory.
    pub set_dir: PathBuf,
    /// Its name.
    pub robot: String,
    /// Version of the program.
    pub version: String,
    /// Side of a cell, metres.
    pub cell_size_m: f64,
    /// Sizes of its bus.
    pub capacity: Capacity,
    /// Whether sync-manager places submaps; otherwise they stay where the front end had them.
    pub optimises: bool,
    /// Whether the page can save the map.
    pub can_save: bool,
}

/// A set's supervisor, as the page needs it. Calls may block for a while.
pub trait SetAccess: Send + Sync + 'static {
    /// How the set is.
    ///
    /// # Errors
    /// When its supervisor does not answer.
    fn health(&self) -> Result<Health, String>;

    /// Replaces the processes of a stage.
    ///
    /// # Errors
    /// What the set says to it.
    fn restart(&self, stage: &str) -> Result<(), String>;

    /// Lets the set rest (`true`), or go on.
    ///
    /// # Errors
    /// What the set says to it.
    fn pause(&self, rests: bool) -> Result<(), String>;

    /// Lets the set localize in its map as it is (`true`), or map again.
    ///
    /// # Errors
    /// Why it cannot.
    fn localize(&self, localizes: bool) -> Result<(), String>;

    /// Saves the map; where it was saved.
    ///
    /// # Errors
    /// What the set says to it.
    fn save(&self) -> Result<String, String>;

    /// Whether the set still runs.
    fn is_alive(&self) -> bool;
}

/// What the page's threads and browsers have in common.
pub struct Shared {
    view: Mutex<View>,
    /// Counts frames.
    ticks: watch::Sender<u64>,
    viewers: AtomicUsize,
    has_ended: AtomicBool,
    began: Instant,
    /// Who may do what.
    pub guard: Guard,
    /// The supervisor.
    pub access: Box<dyn SetAccess>,
}

impl Shared {
    /// For a set at this place.
    pub fn new(place: &Place, guard: Guard, access: Box<dyn SetAccess>) -> Self {
        let head = Head {
            robot: place.robot.clone(),
            version: place.version.clone(),
            cell_size_m: place.cell_size_m,
            can_save: place.can_save,
        };
        Self {
            view: Mutex::new(View::new(head)),
            ticks: watch::Sender::new(0),
            viewers: AtomicUsize::new(0),
            has_ended: AtomicBool::new(false),
            began: Instant::now(),
            guard,
            access,
        }
    }

    /// What there is to see. Held for moments only.
    pub fn view(&self) -> MutexGuard<'_, View> {
        self.view.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Milliseconds since the page began.
    pub fn now_ms(&self) -> u64 {
        self.began.elapsed().as_millis() as u64
    }

    /// It is time for a frame.
    pub fn tick(&self) {
        self.ticks.send_modify(|ticks| *ticks += 1);
    }

    /// Tells of frames that are due.
    pub fn ticks(&self) -> watch::Receiver<u64> {
        self.ticks.subscribe()
    }

    /// The set has ended.
    pub fn end(&self) {
        self.has_ended.store(true, Ordering::Relaxed);
        self.tick();
    }

    /// Whether the set has ended.
    pub fn has_ended(&self) -> bool {
        self.has_ended.load(Ordering::Relaxed)
    }

    /// Browsers that look.
    pub fn viewers(&self) -> usize {
        self.viewers.load(Ordering::Relaxed)
    }

    /// Tells of something that was ordered.
    pub fn note_order(&self, stage: Option<&str>, text: String) {
        let event =
            Event { at_ms: self.now_ms(), kind: EventKind::Order, stage: stage.map(str::to_owned), text };
        self.view().events.push(event);
    }
}

/// A browser that looks, as long as this lives.
pub struct Viewer(Arc<Shared>);

impl Viewer {
    /// One more, unless there are `most` already.
    pub fn enter(shared: &Arc<Shared>, most: usize) -> Option<Self> {
        let one_more = |viewers: usize| (viewers < most).then_some(viewers + 1);
        let entered = shared.viewers.fetch_update(Ordering::Relaxed, Ordering::Relaxed, one_more);
        entered.is_ok().then(|| Self(Arc::clone(shared)))
    }

    /// What it looks at.
    pub fn shared(&self) -> &Arc<Shared> {
        &self.0
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        self.0.viewers.fetch_sub(1, Ordering::Relaxed);
    }
}
