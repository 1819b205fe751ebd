//! A thread that saves the map of a running set periodically and by order.

use super::{Mirror, StoreError};
use crate::supervisor::SaveStatus;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// Saves the map of a running set again and again. A thread of its own does it: a disk that is slow, full or gone delays nothing else.
pub struct MapSaver {
    orders: Sender<Sender<()>>,
    state: Arc<Mutex<State>>,
    directory: PathBuf,
}

/// How it went so far.
#[derive(Default)]
struct State {
    saved: Option<Instant>,
    problem: Option<String>,
}

impl MapSaver {
    /// Starts saving with this period; `directory` is where, for people.
    ///
    /// # Errors
    /// When the system has no thread left.
    pub fn start(mirror: Mirror, directory: PathBuf, period: Duration) -> std::io::Result<Self> {
        let (orders, received) = channel();
        let state = Arc::new(Mutex::new(State::default()));
        let shared = Arc::clone(&state);
        let save = move || keep(mirror, &shared, &received, period);
        thread::Builder::new().name("saver".to_owned()).spawn(save)?;
        Ok(Self { orders, state, directory })
    }

    /// Saves now; false when that takes longer than `limit` or fails.
    pub fn save_now(&self, limit: Duration) -> bool {
        let (done, waits) = channel();
        self.orders.send(done).is_ok() && waits.recv_timeout(limit).is_ok() && self.status().durable
    }

    /// Saves before its period has passed; the caller does not wait.
    pub fn save_soon(&self) {
        // Without the thread nothing is saved, and the status says so.
        let _ = self.orders.send(channel().0);
    }

    /// How it went so far.
    pub fn status(&self) -> SaveStatus {
        let state = self.state.lock().expect("the saver does not panic");
        SaveStatus {
            directory: self.directory.display().to_string(),
            durable: state.problem.is_none() && state.saved.is_some(),
            age_s: state.saved.map(|saved| saved.elapsed().as_secs_f64()),
            problem: state.problem.clone(),
        }
    }
}

/// Until the supervisor has gone.
fn keep(mut mirror: Mirror, state: &Mutex<State>, orders: &Receiver<Sender<()>>, period: Duration) {
    loop {
        let order = match orders.recv_timeout(period) {
            Ok(order) => Some(order),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        note(state, mirror.bring_up());
        // Whoever waited for it may have given up.
        if let Some(order) = order {
            let _ = order.send(());
        }
    }
}

fn note(state: &Mutex<State>, outcome: Result<(), StoreError>) {
    let mut state = state.lock().expect("the supervisor does not panic");
    match outcome {
        Ok(()) => {
            if state.problem.take().is_some() {
                tracing::info!("the map can be saved again");
            }
            state.saved = Some(Instant::now());
        }
        Err(error) => {
            let problem = error.to_string();
            if state.problem.as_ref() != Some(&problem) {
                tracing::error!(problem, "not durable: the map cannot be saved");
            }
            state.problem = Some(problem);
        }
    }
}
