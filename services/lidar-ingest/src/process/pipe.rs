//! Reads the standard input in a thread of its own: lines of CARMEN, or frames, whichever it begins with.

use super::sensor_inlet::{SensorEvent, SensorInlet, SensorOutlet, event_of, listen};
use crate::Settings;
use crate::carmen::CarmenReader;
use flockslam_bus::Notifier;
use flockslam_messages::{ScanBuffer, Stage};
use flockslam_sensor_stream::FrameReader;
use flockslam_stage::{StageContext, StageError};
use std::io::{self, BufRead, BufReader, Read, stdin};

/// Room for several scans: a smaller one would be announced several times.
const BUFFER_BYTES: usize = 1 << 16;

/// Starts reading. The first bytes of a line of CARMEN announce its scan to the stage and to `first`. A thread of its own waits for the
/// bytes, since that wait cannot be cut short.
pub fn read_pipe(
    context: &StageContext,
    settings: Settings,
    first: &'static [Stage],
) -> Result<SensorInlet, StageError> {
    let inlet = listen(context, "pipe", move |maker, bus| {
        // The bus must outlive its events: it holds the thread's place in the set.
        let notifier = |stage: &Stage| bus.as_ref().and_then(|bus| bus.notifier(stage.name()).ok());
        let announced = [Stage::LidarIngest].iter().chain(first).filter_map(notifier).collect();
        let input = Announced { input: stdin().lock(), notifiers: announced, is_announced: true };
        let outlet = maker.outlet(event_of(bus.as_ref()));
        read(BufReader::with_capacity(BUFFER_BYTES, input), settings, &outlet);
        drop(outlet);
    });
    inlet.map_err(|e| StageError::Source(format!("standard input: {e}")))
}

/// An input of which arriving bytes are announced: a scan will soon be read from them.
struct Announced<R> {
    input: R,
    notifiers: Vec<Notifier>,
    is_announced: bool,
}

impl<R: Read> Read for Announced<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.input.read(buffer)?;
        if self.is_announced {
            self.notifiers.iter().for_each(Notifier::announce);
        }
        Ok(count)
    }
}

fn read<R: Read>(mut input: BufReader<Announced<R>>, settings: Settings, outlet: &SensorOutlet) {
    match input.fill_buf() {
        // Of frames most are no scans: those are not announced.
        Ok([0xfa | b'{', ..]) => {
            input.get_mut().is_announced = false;
            read_frames(input, outlet);
        }
        _ => read_carmen(input, settings, outlet),
    }
}

fn read_frames(mut input: impl BufRead, outlet: &SensorOutlet) {
    let mut reader = FrameReader::default();
    outlet.send(SensorEvent::Came);
    loop {
        let length = match input.fill_buf() {
            Ok([]) => break,
            Ok(bytes) => {
                reader.push(bytes);
                bytes.len()
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => {
                outlet.send(SensorEvent::Failed(format!("standard input: {error}")));
                return;
            }
        };
        input.consume(length);
        while let Some(frame) = reader.next_frame() {
            if !outlet.send_frame(frame) {
                return;
            }
        }
    }
    outlet.send(SensorEvent::Went { within_frame: reader.ends_within() });
}

fn read_carmen(input: impl BufRead, settings: Settings, outlet: &SensorOutlet) {
    let mut reader = CarmenReader::new(input, "standard input", settings);
    loop {
        let mut scan = ScanBuffer::default();
        let read = reader.next_scan(&mut scan);
        outlet.store_tally(reader.tally());
        let goes_on = match read {
            Ok(true) => outlet.send(SensorEvent::Scan(scan)),
            Ok(false) => false,
            Err(error) => {
                outlet.send(SensorEvent::Failed(error.to_string()));
                false
            }
        };
        if !goes_on {
            return;
        }
    }
}
