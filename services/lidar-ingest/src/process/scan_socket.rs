//! The local socket that producers of frames connect to: one thread waits for all of them.

use super::sensor_inlet::{OutletMaker, SensorEvent, SensorInlet, SensorOutlet, event_of, inlet, listen_too};
use flockslam_sensor_stream::FrameReader;
use flockslam_stage::{Mode, StageContext, StageError};
use rustix::event::{PollFd, PollFlags, poll};
use std::fs;
use std::io::{self, Read};
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

/// The socket's name in the directory of its set.
pub const SCAN_SOCKET: &str = "scans";
/// Producers at once; more wait until one goes.
const PRODUCERS_MAX: usize = 32;
/// Read at once from one producer.
const BUFFER_BYTES: usize = 1 << 16;

/// Listens at `path`, in place of a predecessor that has ended. Live, it goes on for ever; else the stream ends when the last producer has
/// gone.
pub fn listen_at(context: &StageContext, path: &Path) -> Result<SensorInlet, StageError> {
    let (maker, inlet) = inlet();
    listen_beside(context, path, maker)?;
    Ok(inlet)
}

/// As [`listen_at`], beside other threads that listen.
pub fn listen_beside(context: &StageContext, path: &Path, maker: OutletMaker) -> Result<(), StageError> {
    let wrong = |reason: String| StageError::Source(format!("{}: {reason}", path.display()));
    make_room(path).map_err(wrong)?;
    let listener = UnixListener::bind(path).map_err(|e| wrong(e.to_string()))?;
    listener.set_nonblocking(true).map_err(|e| wrong(e.to_string()))?;
    let ends = context.mode == Mode::Exact;
    let socket = ScanSocket { listener, path: path.to_owned(), producers: Vec::new(), ends };
    let started = listen_too(context, "scans", maker, move |maker, bus| {
        // The bus must outlive its events: it holds the thread's place in the set.
        socket.serve(&maker.outlet(event_of(bus.as_ref())));
    });
    started.map_err(|e| wrong(e.to_string()))
}

/// Removes what a predecessor left; nothing else.
fn make_room(path: &Path) -> Result<(), String> {
    let Ok(found) = fs::symlink_metadata(path) else { return Ok(()) };
    if !found.file_type().is_socket() {
        return Err("there is a file that is no socket; name another path".to_owned());
    }
    if UnixStream::connect(path).is_ok() {
        return Err("another program listens there; name another path".to_owned());
    }
    fs::remove_file(path).map_err(|error| error.to_string())
}

struct ScanSocket {
    listener: UnixListener,
    path: PathBuf,
    producers: Vec<Connection>,
    /// The stream ends with the last producer.
    ends: bool,
}

struct Connection {
    stream: UnixStream,
    reader: FrameReader,
}

/// Result of polling a connection.
enum Look {
    Open,
    Closed,
    /// The stage has ended.
    Over,
}

impl ScanSocket {
    fn serve(mut self, outlet: &SensorOutlet) {
        let mut bytes = vec![0; BUFFER_BYTES];
        loop {
            let Ok(ready) = self.wait() else { continue };
            // From the last to the first, so that places stay while connections go.
            for at in (0..self.producers.len()).rev().filter(|at| ready[1 + at]) {
                match self.producers[at].look(&mut bytes, outlet) {
                    Look::Open => {}
                    Look::Closed => {
                        let gone = self.producers.swap_remove(at);
                        outlet.send(SensorEvent::Went { within_frame: gone.reader.ends_within() });
                        if self.ends && self.producers.is_empty() {
                            return;
                        }
                    }
                    Look::Over => return,
                }
            }
            if ready[0]
                && let Ok((stream, _)) = self.listener.accept()
                && stream.set_nonblocking(true).is_ok()
            {
                self.producers.push(Connection { stream, reader: FrameReader::default() });
                outlet.send(SensorEvent::Came);
            }
        }
    }

    /// Waits until something is to be done; by place: the listener, then the connections.
    fn wait(&self) -> io::Result<Vec<bool>> {
        let accepts = if self.producers.len() < PRODUCERS_MAX { PollFlags::IN } else { PollFlags::empty() };
        let mut waits = vec![PollFd::new(&self.listener, accepts)];
        waits.extend(self.producers.iter().map(|producer| PollFd::new(&producer.stream, PollFlags::IN)));
        poll(&mut waits, None)?;
        Ok(waits.iter().map(|wait| !wait.revents().is_empty()).collect())
    }
}

impl Drop for ScanSocket {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path);
    }
}

impl Connection {
    fn look(&mut self, bytes: &mut [u8], outlet: &SensorOutlet) -> Look {
        match self.stream.read(bytes) {
            Ok(0) => return Look::Closed,
            Ok(length) => self.reader.push(&bytes[..length]),
            Err(error) => {
                let later = [io::ErrorKind::WouldBlock, io::ErrorKind::Interrupted].contains(&error.kind());
                return if later { Look::Open } else { Look::Closed };
            }
        }
        while let Some(frame) = self.reader.next_frame() {
            if !outlet.send_frame(frame) {
                return Look::Over;
            }
        }
        Look::Open
    }
}
