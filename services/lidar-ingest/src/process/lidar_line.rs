//! The line to a lidar: a serial port or a TCP connection.

use flockslam_lidars::{Act, Family};
use rustix::event::{PollFd, PollFlags};
use rustix::fd::BorrowedFd;
use serde::{Deserialize, Serialize};
use serialport::{SerialPort, TTYPort};
use std::fmt;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::fd::{AsFd, AsRawFd};
use std::path::PathBuf;
use std::time::Duration;

/// A TCP connection that is not made within this is not made.
const CONNECT_LIMIT: Duration = Duration::from_secs(2);
/// A request is written within this: more than any line needs for it.
const WRITE_LIMIT: Duration = Duration::from_millis(500);

/// A lidar of a robot, as a description names it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LidarSpec {
    /// Its name on the robot; may be empty where it is the only one.
    pub name: String,
    /// How it speaks.
    pub family: Family,
    /// Its model, where it is known.
    pub model: Option<String>,
    /// Where it is.
    pub place: LidarPlace,
    /// The rate of its line, bits a second; without one those of its models are tried.
    pub rate: Option<u32>,
}

/// Where a lidar is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LidarPlace {
    /// At a serial port.
    Port(PathBuf),
    /// At a host and TCP port.
    Address(String),
}

impl fmt::Display for LidarPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Port(path) => write!(f, "{}", path.display()),
            Self::Address(address) => write!(f, "{address}"),
        }
    }
}

impl fmt::Display for LidarSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = if self.name.is_empty() { String::new() } else { format!(" '{}'", self.name) };
        write!(f, "lidar{name} ({} at {})", self.family.name(), self.place)
    }
}

impl LidarSpec {
    /// The rates to try, the likeliest first; none where bytes come in packets.
    pub fn rates(&self) -> Vec<Option<u32>> {
        match (&self.place, self.rate) {
            (LidarPlace::Address(_), _) => vec![None],
            (_, Some(rate)) => vec![Some(rate)],
            _ => {
                let known = self.family.rates(self.model.as_deref());
                let rates = known.or_else(|_| self.family.rates(None)).unwrap_or_default();
                rates.into_iter().map(Some).collect()
            }
        }
    }
}

/// An open line.
pub enum Line {
    /// A serial port.
    Serial(TTYPort),
    /// A connection.
    Tcp(TcpStream),
}

impl Line {
    /// Opens the line, which may take some seconds.
    ///
    /// # Errors
    /// When it is not there, is in use, or may not be used; in words for the user.
    pub fn open(spec: &LidarSpec, rate: Option<u32>) -> Result<Self, String> {
        match &spec.place {
            LidarPlace::Port(path) => {
                let port = serialport::new(path.to_string_lossy(), rate.unwrap_or(115_200));
                let opened = TTYPort::open(&port.timeout(WRITE_LIMIT));
                Ok(Self::Serial(opened.map_err(|error| in_words(&error))?))
            }
            LidarPlace::Address(address) => {
                let connected = connect(address, spec.family).map_err(|error| error.to_string())?;
                Ok(Self::Tcp(connected))
            }
        }
    }

    /// Executes the requests of a driver.
    ///
    /// # Errors
    /// When the line is gone.
    pub fn carry_out(&mut self, act: &Act) -> io::Result<()> {
        match (self, act) {
            (Self::Serial(port), Act::Send(bytes)) => port.write_all(bytes),
            (Self::Tcp(stream), Act::Send(bytes)) => stream.write_all(bytes),
            (Self::Serial(port), Act::SetDtr(on)) => {
                // A pseudo terminal has no such line.
                let _ = port.write_data_terminal_ready(*on);
                Ok(())
            }
            (Self::Tcp(_), Act::SetDtr(_)) => Ok(()),
        }
    }

    /// Reads what has come, after the line was found ready.
    ///
    /// # Errors
    /// When the line is gone.
    pub fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = match self {
            Self::Serial(port) => port.read(bytes),
            Self::Tcp(stream) => stream.read(bytes),
        };
        match read {
            Ok(0) => Err(io::Error::new(ErrorKind::BrokenPipe, "it hung up")),
            Err(error) if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::TimedOut) => Ok(0),
            other => other,
        }
    }

    /// To wait for bytes.
    pub fn poll_fd(&self) -> PollFd<'_> {
        let descriptor = match self {
            // SAFETY: the port is open for as long as it is borrowed here, and the descriptor is its own.
            Self::Serial(port) => unsafe { BorrowedFd::borrow_raw(port.as_raw_fd()) },
            Self::Tcp(stream) => stream.as_fd(),
        };
        PollFd::from_borrowed_fd(descriptor, PollFlags::IN)
    }
}

fn in_words(error: &serialport::Error) -> String {
    match error.kind() {
        serialport::ErrorKind::Io(ErrorKind::PermissionDenied) => {
            "no permission; add the user to the group dialout, and log in anew".to_owned()
        }
        _ => error.to_string(),
    }
}

fn connect(address: &str, family: Family) -> io::Result<TcpStream> {
    let with_port = match (address.rsplit_once(':'), family.tcp_port()) {
        (None, Some(port)) => format!("{address}:{port}"),
        _ => address.to_owned(),
    };
    let mut last = io::Error::new(ErrorKind::NotFound, "the address has no host");
    for socket in with_port.to_socket_addrs()? {
        match TcpStream::connect_timeout(&socket, CONNECT_LIMIT) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                stream.set_write_timeout(Some(WRITE_LIMIT))?;
                return Ok(stream);
            }
            Err(error) => last = error,
        }
    }
    Err(last)
}
