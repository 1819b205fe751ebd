//! Reads CARMEN lines from the standard input in a thread of its own.

use crate::Settings;
use crate::carmen::{CarmenReader, Tally};
use crossbeam::channel::{Receiver, Sender, TryRecvError, bounded};
use flockslam_bus::Notifier;
use flockslam_messages::{ScanBuffer, Stage};
use flockslam_stage::{StageContext, StageError};
use std::io::{self, BufReader, Read, stdin};
use std::sync::{Arc, Mutex};
use std::thread;

/// Scans from the standard input. A thread of its own waits for the lines, since that wait cannot be cut short.
pub struct Pipe {
    scans: Receiver<Result<ScanBuffer, String>>,
    tally: Arc<Mutex<Tally>>,
}

/// The result of a pipe.
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
    /// Starts reading. The stage's event rings with every scan, and the first bytes of a line announce one to the stage
    /// itself and to `first`.
    pub fn start(
        context: &StageContext,
        settings: Settings,
        first: &'static [Stage],
    ) -> Result<Self, StageError> {
        let (sender, scans) = bounded(AHEAD);
        let tally = Arc::new(Mutex::new(Tally::default()));
        let shared = Arc::clone(&tally);
        let join = context.joiner();
        let reader = thread::Builder::new().name("pipe".to_owned()).spawn(move || {
            // The bus must outlive the event: it holds the thread's place in the set.
            let bus = join();
            let notifier = |stage: &Stage| bus.as_ref().and_then(|bus| bus.notifier(stage.name()).ok());
            let event = notifier(&Stage::LidarIngest);
            let announced = [Stage::LidarIngest].iter().chain(first).filter_map(notifier).collect();
            let input = Announced { input: stdin().lock(), notifiers: announced };
            read(input, settings, &sender, &shared, event.as_ref());
            drop(sender);
            if let Some(event) = event {
                event.ring();
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

    /// Counts so far.
    pub fn tally(&self) -> Tally {
        self.tally.lock().expect("the reading thread does not panic").clone()
    }
}

/// An input of which arriving bytes are announced: a scan will soon be read from them.
struct Announced<R> {
    input: R,
    notifiers: Vec<Notifier>,
}

impl<R: Read> Read for Announced<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.input.read(buffer)?;
        self.notifiers.iter().for_each(Notifier::announce);
        Ok(count)
    }
}

/// Room for several scans: a smaller one would be announced several times.
const BUFFER_BYTES: usize = 1 << 16;

fn read(
    input: impl Read,
    settings: Settings,
    scans: &Sender<Result<ScanBuffer, String>>,
    tally: &Mutex<Tally>,
    event: Option<&Notifier>,
) {
    let mut reader =
        CarmenReader::new(BufReader::with_capacity(BUFFER_BYTES, input), "standard input", settings);
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
        if let Some(event) = event {
            event.ring();
        }
    }
}
