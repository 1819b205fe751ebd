//! `flockslam record`: what a running set says, into a file and to Foxglove.

use super::control_command::choose;
use super::run::count_interrupts;
use super::{CommandError, print};
use crate::arguments::RecordArgs;
use crate::recording::{FoxgloveServer, McapFile, RecordError, RecordTopic, Recorded, SetReader};
use flockslam_bus::RuntimeDir;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// How long to sleep when nothing waits: little beside the time between two scans.
const PAUSE: Duration = Duration::from_millis(5);
/// How often to look whether the set still runs.
const LOOK_AROUND: Duration = Duration::from_millis(500);

/// Records until SIGINT, SIGTERM or the end of the set.
///
/// # Errors
/// When there is no such set, or the file or the port cannot be used.
pub fn run(args: &RecordArgs) -> Result<(), CommandError> {
    flockslam_telemetry::init_tracing("recorder");
    let robot = choose(&args.robot)?;
    let interrupts = count_interrupts()?;
    let runtime = RuntimeDir::open(&RuntimeDir::path_of(&robot)).map_err(CommandError::user)?;
    // First it subscribes to everything, then there is a file: who waits for the file misses nothing.
    let mut reader = SetReader::join(&runtime).map_err(CommandError::failed)?;
    let mut sinks = Sinks {
        file: args.out.as_deref().map(McapFile::create).transpose().map_err(CommandError::user)?,
        server: args
            .foxglove
            .map(|port| FoxgloveServer::start(port, &robot))
            .transpose()
            .map_err(CommandError::user)?,
    };
    if let Some(server) = &sinks.server {
        print(&format!("Foxglove: open ws://127.0.0.1:{}\n", server.port()));
    }
    let mut looked = Instant::now();
    while interrupts.load(Ordering::Relaxed) == 0 {
        match reader.read(&mut |message| sinks.put(message)) {
            // A publisher that was killed while it was made is cleaned up by the supervisor.
            Err(RecordError::Bus(error)) => tracing::debug!(%error, "nothing was received"),
            read => read.map_err(CommandError::failed)?,
        }
        sinks.flush().map_err(CommandError::failed)?;
        if looked.elapsed() > LOOK_AROUND {
            looked = Instant::now();
            if !RuntimeDir::running().contains(&robot) {
                break;
            }
        }
        std::thread::sleep(PAUSE);
    }
    sinks.finish(reader.missed()).map_err(CommandError::failed)
}

/// Where messages go.
struct Sinks {
    file: Option<McapFile>,
    server: Option<FoxgloveServer>,
}

impl Sinks {
    fn put(&mut self, message: Recorded) -> Result<(), RecordError> {
        if let Some(file) = &mut self.file {
            file.put(&message)?;
        }
        if let Some(server) = &self.server {
            server.put(message);
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), RecordError> {
        self.file.as_mut().map_or(Ok(()), McapFile::flush_sometimes)
    }

    fn finish(self, missed: u64) -> Result<(), RecordError> {
        if let Some(file) = self.file {
            let counts = RecordTopic::all().zip(file.counts());
            let counts: Vec<_> = counts.map(|(topic, count)| format!("{} {count}", topic.name())).collect();
            file.finish()?;
            print(&format!("recorded {}; missed {missed} scans and poses\n", counts.join(", ")));
        }
        if let Some(server) = self.server.filter(|server| server.missed() > 0) {
            print(&format!("clients were too slow for {} messages\n", server.missed()));
        }
        Ok(())
    }
}
