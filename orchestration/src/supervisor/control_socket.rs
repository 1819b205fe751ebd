//! The control socket of a set: a Unix socket that takes one request and gives one reply, each a line of JSON. Holds both ends.

use super::status::SetStatus;
use flockslam_messages::Stage;
use serde::{Deserialize, Serialize};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::Duration;

/// Longest request or reply, bytes.
const LINE_MAX: u64 = 1 << 20;
/// Whoever does not finish its request within this is not served.
const REQUEST_LIMIT: Duration = Duration::from_secs(1);
/// What takes longer than this has failed.
const REPLY_LIMIT: Duration = Duration::from_secs(30);

/// A request to a running set: one line of JSON on its control socket.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Request {
    /// How it is.
    Status,
    /// Save and stop.
    Down,
    /// Replace the processes of a stage.
    Restart(String),
    /// Run so many processes of a stage.
    Scale(String, usize),
    /// Log what this filter lets through, from now on: the processes of a stage, `supervisor`, or `all`.
    Log(String, String),
    /// Rest (`true`) or go on: no scan is handled meanwhile.
    Pause(bool),
    /// Save the map into a directory now.
    Save(PathBuf),
    /// Go on with the map in a directory instead of the present one.
    Load(PathBuf),
    /// Drop the map and begin a new one.
    Reset,
    /// Look for the robot in the known map anew: everywhere, or near x, y, heading with two standard deviations, in metres and radians.
    Relocalize(Option<[f64; 5]>),
    /// Localize in the map as it is (`true`), or make a map again.
    Localize(bool),
}

/// What a set answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reply {
    /// It is done, or on its way.
    Done,
    /// How the set is.
    Status(Box<SetStatus>),
    /// It cannot be done, and why.
    Refused(String),
}

/// Why a request to a set failed.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// No supervisor listens.
    #[error("no set answers at {path}: {source}")]
    Unreachable {
        /// The socket.
        path: PathBuf,
        /// Message of the system.
        source: io::Error,
    },
    /// What it said makes no sense.
    #[error("the set did not answer in time, or another version of flockslam runs it")]
    Garbled,
}

/// The control socket of a supervisor. A thread of its own reads requests, so that no client can delay the supervisor.
pub struct ControlSocket {
    orders: Receiver<Order>,
}

/// A request and the channel to its client.
pub struct Order {
    /// What is wanted.
    pub request: Request,
    reply: Sender<Reply>,
}

impl Order {
    /// Answers. The client may have disconnected.
    pub fn answer(self, reply: Reply) {
        let _ = self.reply.send(reply);
    }
}

impl ControlSocket {
    /// Listens at `path`, in place of a predecessor that has ended.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn open(path: &Path) -> io::Result<Self> {
        match std::fs::remove_file(path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let listener = UnixListener::bind(path)?;
        let (sender, orders) = channel();
        thread::Builder::new().name("control".to_owned()).spawn(move || {
            for stream in listener.incoming().flatten() {
                if serve(&stream, &sender).is_none() {
                    tracing::debug!("a request was not understood");
                }
            }
        })?;
        Ok(Self { orders })
    }

    /// The next order, if one waits.
    pub fn next(&self) -> Option<Order> {
        self.orders.try_recv().ok()
    }
}

/// Hands on one request and gives back the reply.
fn serve(stream: &UnixStream, orders: &Sender<Order>) -> Option<()> {
    stream.set_read_timeout(Some(REQUEST_LIMIT)).ok()?;
    stream.set_write_timeout(Some(REQUEST_LIMIT)).ok()?;
    let reply = match read_line(stream).and_then(|line| serde_json::from_str(&line).ok()) {
        Some(request) => {
            let (reply, answers) = channel();
            orders.send(Order { request, reply }).ok()?;
            answers.recv_timeout(REPLY_LIMIT).ok()?
        }
        None => Reply::Refused("the request is not one that this version knows".to_owned()),
    };
    write_line(stream, &reply)
}

/// Asks the set whose control socket is at `path`.
///
/// # Errors
/// When no set listens there, or it gives no sensible answer.
pub fn ask(path: &Path, request: &Request) -> Result<Reply, ControlError> {
    let unreachable = |source| ControlError::Unreachable { path: path.to_owned(), source };
    let stream = UnixStream::connect(path).map_err(unreachable)?;
    stream.set_read_timeout(Some(REPLY_LIMIT)).map_err(unreachable)?;
    write_line(&stream, request).ok_or(ControlError::Garbled)?;
    let line = read_line(&stream).ok_or(ControlError::Garbled)?;
    serde_json::from_str(&line).map_err(|_| ControlError::Garbled)
}

/// The stage of this name.
///
/// # Errors
/// When there is none: names those that there are.
pub fn known_stage(name: &str) -> Result<Stage, String> {
    let names = || Stage::ALL.map(Stage::name).join(", ");
    Stage::from_name(name).ok_or_else(|| format!("'{name}' is not a stage; there are {}", names()))
}

fn read_line(stream: &UnixStream) -> Option<String> {
    let mut line = String::new();
    BufReader::new(stream.take(LINE_MAX)).read_line(&mut line).ok()?;
    line.ends_with('\n').then_some(line)
}

fn write_line(mut stream: &UnixStream, message: &impl Serialize) -> Option<()> {
    let mut line = serde_json::to_vec(message).ok()?;
    line.push(b'\n');
    stream.write_all(&line).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_answered_and_garbage_is_refused() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("control");
        std::fs::write(&path, b"left by a dead supervisor").unwrap();
        let socket = ControlSocket::open(&path).unwrap();
        let asked = {
            let path = path.clone();
            thread::spawn(move || ask(&path, &Request::Restart("mapper".to_owned())).unwrap())
        };
        let order = socket.orders.recv().unwrap();
        assert_eq!(order.request, Request::Restart("mapper".to_owned()));
        order.answer(Reply::Done);
        assert_eq!(asked.join().unwrap(), Reply::Done);
        let say = |bytes: &[u8]| {
            let stream = UnixStream::connect(&path).unwrap();
            (&stream).write_all(bytes).unwrap();
            stream
        };
        // A client that disconnects without its answer delays nothing else.
        drop(say(b"nonsense\n"));
        for garbage in [b"\xff\x00 nonsense\n".as_slice(), b"\n", b"{\"fly\":1}\n"] {
            assert!(read_line(&say(garbage)).unwrap().contains("refused"), "{garbage:?}");
        }
        assert!(socket.next().is_none(), "garbage is no order");
    }

    #[test]
    fn a_missing_set_is_reported() {
        let directory = tempfile::tempdir().unwrap();
        let error = ask(&directory.path().join("control"), &Request::Status).unwrap_err();
        assert!(error.to_string().contains("no set answers"), "{error}");
    }
}
