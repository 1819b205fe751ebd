//! The client of a metrics endpoint: reads the page of a stage within a time limit.

use crate::http::{Bounded, split_answer};
use rustix::net::sockopt::{Timeout, set_socket_timeout};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with};
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

/// An answer over this is refused: a stage's page has some ten thousand bytes.
const ANSWER_BYTES_MAX: u64 = 8 * 1024 * 1024;

/// Why a stage's metrics could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ScrapeError {
    /// Nobody answered in time, or the connection broke.
    #[error("cannot read metrics: {0}")]
    Io(#[from] io::Error),
    /// The answer was not a whole HTTP answer in UTF-8.
    #[error("the answer was cut off or is not a metrics page")]
    NotMetrics,
    /// The other side refused.
    #[error("the endpoint answered with status {0}")]
    Status(u16),
}

/// Reads the metrics that a stage serves on its unix socket, within `timeout` all in all.
///
/// # Errors
/// When the stage does not answer (stopped, dead, hanging) or answers with something else than metrics.
pub fn scrape(socket: &Path, timeout: Duration) -> Result<String, ScrapeError> {
    let mut stream = Bounded::new(connect_within(socket, timeout)?, timeout);
    stream.write_all(b"GET /metrics HTTP/1.0\r\n\r\n")?;
    let mut bytes = Vec::new();
    Read::take(&mut stream, ANSWER_BYTES_MAX).read_to_end(&mut bytes)?;
    let answer = String::from_utf8(bytes).map_err(|_| ScrapeError::NotMetrics)?;
    match split_answer(&answer).ok_or(ScrapeError::NotMetrics)? {
        (200, Some(length), body) if length == body.len() => Ok(body.to_owned()),
        (200, _, _) => Err(ScrapeError::NotMetrics),
        (status, _, _) => Err(ScrapeError::Status(status)),
    }
}

/// Connecting blocks while the queue of a stopped stage is full, unless the socket has a send timeout beforehand;
/// std cannot set that.
fn connect_within(path: &Path, timeout: Duration) -> io::Result<UnixStream> {
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, SocketFlags::CLOEXEC, None)?;
    set_socket_timeout(&socket, Timeout::Send, Some(timeout.max(Duration::from_millis(1))))?;
    connect(&socket, &SocketAddrUnix::new(path)?)?;
    Ok(UnixStream::from(socket))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::write_answer;
    use std::os::unix::net::UnixListener;

    const SHORT: Duration = Duration::from_millis(50);

    #[test]
    fn a_stage_that_hangs_is_given_up_even_when_its_queue_is_full() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("hangs.sock");
        assert!(matches!(scrape(&path, SHORT), Err(ScrapeError::Io(_))));
        let hanging =
            socket_with(AddressFamily::UNIX, SocketType::STREAM, SocketFlags::CLOEXEC, None).unwrap();
        rustix::net::bind(&hanging, &SocketAddrUnix::new(path.as_path()).unwrap()).unwrap();
        rustix::net::listen(&hanging, 1).unwrap();
        for _ in 0..5 {
            assert!(matches!(scrape(&path, SHORT), Err(ScrapeError::Io(_))));
        }
    }

    #[test]
    fn answers_that_are_not_metrics_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("odd.sock");
        let listener = UnixListener::bind(&path).unwrap();
        let answers: [fn(&mut UnixStream); 4] = [
            |stream| write_answer(stream, "503 Busy", "").unwrap(),
            |stream| stream.write_all(b"HTTP/1.0 200 OK\r\nContent-Length: 50\r\n\r\ncut off").unwrap(),
            |stream| stream.write_all(&[0xfe, 0xff]).unwrap(),
            |_| (),
        ];
        let server = std::thread::spawn(move || {
            for answer in answers {
                let mut stream = listener.accept().unwrap().0;
                crate::http::read_request(&mut stream).unwrap();
                answer(&mut stream);
            }
        });
        let timeout = Duration::from_secs(5);
        assert!(matches!(scrape(&path, timeout), Err(ScrapeError::Status(503))));
        for _ in 0..3 {
            assert!(matches!(scrape(&path, timeout), Err(ScrapeError::NotMetrics)));
        }
        server.join().unwrap();
    }
}
