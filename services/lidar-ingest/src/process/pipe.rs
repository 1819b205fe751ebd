use crate::Settings;
use crate::carmen::{CarmenReader, Tally};
use crossbeam::channel::{Receiver, Sender, TryRecvError, bounded};
use flockslam_bus::BellRinger;
use flockslam_messages::{ScanBuffer, Stage};
use flockslam_stage::{StageContext, StageError};
use std::io::stdin;
use std::sync::{Arc, Mutex};
use std::thread;

/// Scans from the standard input. A thread of its own waits for the lines, since that wait cannot be cut short.
pub struct Pipe {
    scans: Receiver<Result<ScanBuffer, String>>,
    tally: Arc<Mutex<Tally>>,
}

/// What a pipe gave.
pub enum Piped {
    /// The next scan.
    Scan(ScanBuffer),
    /// Nothing for now.
    NotYet,
    /// Nothing any more.
    End,
}

/// Scans read ahead: a full channel makes the writer of the pipe wait.
const AHEAD: usize = 16;

impl Pipe {
    /// Starts reading; the stage's bell rings with every scan.
    pub fn start(context: &StageContext, settings: Settings) -> Result<Self, StageError> {
        let (sender, scans) = bounded(AHEAD);
        let tally = Arc::new(Mutex::new(Tally::default()));
        let shared = Arc::clone(&tally);
        let join = context.joiner();
        let reader = thread::Builder::new().name("pipe".to_owned()).spawn(move || {
            // The bus must outlive the bell: it holds the thread's place in the set.
            let bus = join();
            let bell = bus.as_ref().and_then(|bus| bus.ringer(Stage::LidarIngest.name()).ok());
            read(settings, &sender, &shared, bell.as_ref());
            drop(sender);
            if let Some(bell) = bell {
                bell.ring();
            }
        });
        reader.map_err(|e| StageError::Source(format!("standard input: {e}")))?;
        Ok(Self { scans, tally })
    }

    /// The next scan, if one has arrived.
    pub fn take(&self) -> Result<Piped, StageError> {
        match self.scans.try_recv() {
            Ok(Ok(scan)) => Ok(Piped::Scan(scan)),
            Ok(Err(reason)) => Err(StageError::Source(reason)),
            Err(TryRecvError::Empty) => Ok(Piped::NotYet),
            Err(TryRecvError::Disconnected) => Ok(Piped::End),
        }
    }

    /// What was met so far.
    pub fn tally(&self) -> Tally {
        self.tally.lock().expect("the reading thread does not panic").clone()
    }
}

fn read(
    settings: Settings,
    scans: &Sender<Result<ScanBuffer, String>>,
    tally: &Mutex<Tally>,
    bell: Option<&BellRinger>,
) {
    let mut reader = CarmenReader::new(stdin().lock(), "standard input", settings);
    loop {
        let mut scan = ScanBuffer::default();
        let read = reader.next_scan(&mut scan);
        *tally.lock().expect("the stage does not panic") = reader.tally().clone();
        let sent = match read {
            Ok(true) => scans.send(Ok(scan)),
            Ok(false) => return,
            Err(error) => {
                let _ = scans.send(Err(error.to_string()));
                return;
            }
        };
        if sent.is_err() {
            return;
        }
        if let Some(bell) = bell {
            bell.ring();
        }
    }
}
