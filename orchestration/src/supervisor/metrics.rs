//! Serves one metrics page for the whole set. It reads the page of each process and merges them with the supervisor's own.

use super::ProcessSet;
use flockslam_bus::RuntimeDir;
use flockslam_messages::Stage;
use flockslam_stage::{heartbeat_file, metrics_socket};
use flockslam_telemetry::{
    CounterMemory, EndpointError, MetricsEndpoint, SupervisorMetrics, merge_expositions, monotonic_ns,
    read_heartbeat, scrape,
};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// A stage that does not answer within this is left out of the page.
const ANSWER_LIMIT: Duration = Duration::from_millis(100);
/// While metrics may be scraped, stages are read at this period: the counters of a process are kept when it ends.
const LOOK: Duration = Duration::from_secs(1);
/// What the sockets of metrics end in, and whose is not a stage's.
const ENDING: &str = ".metrics";
const SUPERVISOR: &str = "supervisor";

/// Serves the metrics of a set as one page: those of its supervisor and of all its processes, whose counters go on when they are
/// replaced. Ends when dropped.
pub struct MetricsService {
    _socket: MetricsEndpoint,
    _port: Option<MetricsEndpoint>,
    _watch: Option<Watch>,
}

impl MetricsService {
    /// Serves on the set's own socket, and on 127.0.0.1 at `port`.
    ///
    /// # Errors
    /// When one of them cannot be opened.
    pub fn start(set: &ProcessSet, port: Option<u16>) -> Result<Self, EndpointError> {
        let gatherer = Arc::new(Gatherer {
            runtime: set.runtime().path().to_owned(),
            metrics: set.metrics().clone(),
            memory: Mutex::default(),
        });
        let page = |gatherer: &Arc<Gatherer>| {
            let gatherer = Arc::clone(gatherer);
            move || gatherer.page()
        };
        let socket = set_metrics_socket(set.runtime().path());
        Ok(Self {
            _socket: MetricsEndpoint::on_unix_socket(&socket, page(&gatherer))?,
            _port: port.map(|port| MetricsEndpoint::on_loopback(port, page(&gatherer))).transpose()?,
            _watch: port.and_then(|_| Watch::start(gatherer)),
        })
    }
}

/// Where a set whose directory is `runtime` serves the metrics of all its processes.
pub fn set_metrics_socket(runtime: &Path) -> PathBuf {
    metrics_socket(&runtime.join("status"), SUPERVISOR)
}

/// Puts the page together.
struct Gatherer {
    runtime: PathBuf,
    metrics: SupervisorMetrics,
    memory: Mutex<CounterMemory>,
}

impl Gatherer {
    fn page(&self) -> String {
        let (mut pages, status_dir) = (self.look(), self.runtime.join("status"));
        self.note_heartbeats(&status_dir);
        if let Ok(runtime) = RuntimeDir::open(&self.runtime) {
            self.metrics.set_shared_memory(runtime.occupied_bytes());
        }
        pages.push(self.metrics.render());
        merge_expositions(pages.iter().map(String::as_str))
    }

    /// The pages of all processes; of one that does not answer, what is known of it.
    fn look(&self) -> Vec<String> {
        let status_dir = self.runtime.join("status");
        let mut memory = self.memory.lock().unwrap_or_else(PoisonError::into_inner);
        let mut pages = Vec::new();
        for stage in Stage::ALL {
            let mut up = false;
            for name in processes_of(&status_dir, stage) {
                match scrape(&metrics_socket(&status_dir, &name), ANSWER_LIMIT) {
                    Ok(page) => {
                        up = true;
                        pages.push(memory.accumulate(&name, &page));
                    }
                    Err(_) => pages.extend(memory.recall(&name)),
                }
            }
            self.metrics.set_up(stage.name(), up);
        }
        pages
    }

    fn note_heartbeats(&self, status_dir: &Path) {
        for stage in Stage::ALL {
            for name in processes_of(status_dir, stage) {
                let beat = read_heartbeat(&heartbeat_file(status_dir, &name)).ok().flatten();
                if let (Some(beat), Some(replica)) = (beat, replica_of(&name)) {
                    let age_ns = monotonic_ns().saturating_sub(beat.monotonic_ns);
                    self.metrics.set_heartbeat_age(stage.name(), replica, age_ns as f64 * 1e-9);
                }
            }
        }
    }
}

/// Names of the processes of a stage that have a socket, in order.
fn processes_of(status_dir: &Path, stage: Stage) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(status_dir) else { return Vec::new() };
    let name = |file: String| file.strip_suffix(ENDING).map(str::to_owned);
    let is_of_stage = |name: &String| {
        name.rsplit_once('-')
            .is_some_and(|(of, replica)| of == stage.name() && replica.parse::<u32>().is_ok())
    };
    let files = entries.filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned()));
    let mut names: Vec<String> = files.filter_map(name).filter(is_of_stage).collect();
    names.sort();
    names
}

fn replica_of(name: &str) -> Option<u32> {
    name.rsplit_once('-')?.1.parse().ok()
}

/// Reads the stages' metrics now and then, so that the counters of a process are known when it ends.
struct Watch {
    // Its end is the thread's end.
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Watch {
    fn start(gatherer: Arc<Gatherer>) -> Option<Self> {
        let (stop, stopped) = channel();
        let looks = move || {
            while stopped.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
                gatherer.look();
            }
        };
        match thread::Builder::new().name("counters".to_owned()).spawn(looks) {
            Ok(thread) => Some(Self { stop: Some(stop), thread: Some(thread) }),
            Err(error) => {
                tracing::warn!(%error, "counters may go back when a stage is restarted between two scrapes");
                None
            }
        }
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.stop.take();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processes_are_found_by_their_sockets() {
        let directory = tempfile::tempdir().unwrap();
        let files = [
            "mapper-0.metrics",
            "mapper-1.metrics",
            "mapper-x.metrics",
            "mapper-0.heartbeat",
            "supervisor.metrics",
            "scan-matcher-0.metrics",
        ];
        files.iter().for_each(|file| std::fs::write(directory.path().join(file), "").unwrap());
        assert_eq!(processes_of(directory.path(), Stage::Mapper), ["mapper-0", "mapper-1"]);
        assert_eq!(processes_of(directory.path(), Stage::ScanMatcher), ["scan-matcher-0"]);
        assert_eq!(replica_of("scan-matcher-12"), Some(12));
    }
}
