//! The small part of HTTP/1.0 that a metrics page needs: one request, one answer, both bounded in size and time.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

/// A request line with its headers is at most this long.
const REQUEST_BYTES_MAX: usize = 8 * 1024;

/// A connection whose reads and writes can be limited in time.
pub(crate) trait TimedStream: Read + Write {
    /// Every read or write from now on fails after `remaining`.
    fn limit(&self, remaining: Duration) -> io::Result<()>;
}

impl TimedStream for UnixStream {
    fn limit(&self, remaining: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(remaining))?;
        self.set_write_timeout(Some(remaining))
    }
}

impl TimedStream for TcpStream {
    fn limit(&self, remaining: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(remaining))?;
        self.set_write_timeout(Some(remaining))
    }
}

/// A connection that fails once its deadline has passed, however the other side trickles its bytes.
pub(crate) struct Bounded<S> {
    stream: S,
    deadline: Instant,
}

impl<S: TimedStream> Bounded<S> {
    pub(crate) fn new(stream: S, timeout: Duration) -> Self {
        Self { stream, deadline: Instant::now() + timeout }
    }

    fn limit(&self) -> io::Result<()> {
        let remaining = self.deadline.saturating_duration_since(Instant::now());
        if remaining.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        self.stream.limit(remaining)
    }
}

impl<S: TimedStream> Read for Bounded<S> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        self.limit()?;
        self.stream.read(to)
    }
}

impl<S: TimedStream> Write for Bounded<S> {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        self.limit()?;
        self.stream.write(from)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}

/// Reads a request up to the empty line behind its headers and gives the path that it asks for; `None` when it is
/// not a GET request.
pub(crate) fn read_request(from: &mut impl Read) -> io::Result<Option<String>> {
    let mut request = Vec::with_capacity(512);
    let mut chunk = [0; 512];
    while !ends_headers(&request) {
        let count = from.read(&mut chunk)?;
        if count == 0 || request.len() + count > REQUEST_BYTES_MAX {
            return Ok(None);
        }
        request.extend_from_slice(&chunk[..count]);
    }
    let text = String::from_utf8_lossy(&request);
    let mut words = text.lines().next().unwrap_or_default().split(' ');
    Ok(match (words.next(), words.next()) {
        (Some("GET"), Some(path)) => Some(path.to_owned()),
        _ => None,
    })
}

fn ends_headers(request: &[u8]) -> bool {
    request.windows(4).any(|w| w == b"\r\n\r\n") || request.windows(2).any(|w| w == b"\n\n")
}

/// Writes a whole answer; `status` is like `200 OK`.
pub(crate) fn write_answer(to: &mut impl Write, status: &str, body: &str) -> io::Result<()> {
    let head = format!(
        "HTTP/1.0 {status}\r\nContent-Type: text/plain; version=0.0.4; charset=utf-8\r\nContent-Length: {}\r\n\
         Connection: close\r\n\r\n",
        body.len()
    );
    to.write_all(head.as_bytes())?;
    to.write_all(body.as_bytes())?;
    to.flush()
}

/// Splits an answer into status code, announced length (when given) and body; `None` when it is not HTTP.
pub(crate) fn split_answer(answer: &str) -> Option<(u16, Option<usize>, &str)> {
    let (head, body) = answer.split_once("\r\n\r\n")?;
    let mut lines = head.lines();
    let status = lines.next()?.strip_prefix("HTTP/1.")?.split(' ').nth(1)?.parse().ok()?;
    let length = lines
        .filter_map(|line| line.split_once(':'))
        .find(|(name, _)| name.eq_ignore_ascii_case("content-length"))
        .and_then(|(_, value)| value.trim().parse().ok());
    Some((status, length, body))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn requests_are_read_whole_and_bounded() {
        let path = |text: &str| read_request(&mut text.as_bytes()).unwrap();
        assert_eq!(path("GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n").as_deref(), Some("/metrics"));
        assert_eq!(path("GET / HTTP/1.0\n\n").as_deref(), Some("/"));
        assert_eq!(path("POST /metrics HTTP/1.1\r\n\r\n"), None);
        assert_eq!(path("GET /metrics HTTP/1.1\r\n"), None);
        assert_eq!(path(&format!("GET /{} HTTP/1.1\r\n\r\n", "x".repeat(9000))), None);
    }

    #[test]
    fn an_answer_is_split_as_it_was_written() {
        let mut answer = Vec::new();
        write_answer(&mut answer, "200 OK", "a 1\n").unwrap();
        let text = String::from_utf8(answer).unwrap();
        assert_eq!(split_answer(&text), Some((200, Some(4), "a 1\n")));
        assert_eq!(split_answer("no http"), None);
    }

    #[test]
    fn a_client_that_trickles_its_bytes_is_dropped_at_the_deadline() {
        let (server, mut client) = UnixStream::pair().unwrap();
        // It goes on until the client disconnects; the longest request would take it most of a minute.
        let trickling = std::thread::spawn(move || {
            while client.write_all(b"x").is_ok() {
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        let mut bounded = Bounded::new(server, Duration::from_millis(50));
        assert!(read_request(&mut bounded).is_err());
        drop(bounded);
        trickling.join().unwrap();
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
            let _ = read_request(&mut bytes.as_slice()).unwrap();
            let _ = split_answer(&String::from_utf8_lossy(&bytes));
        }
    }
}
