//! The metrics endpoint: one thread that serves a page on a unix socket or on the loopback address.

use crate::http::{Bounded, TimedStream, read_request, write_answer};
use rustix::net::{Shutdown, shutdown};
use std::fs;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// A client that has not sent its request and taken its answer within this is dropped.
const WRITE_TIMEOUT: Duration = Duration::from_millis(500);
/// After a failed accept (no descriptors left) the thread waits so long before it tries again.
const PAUSE_AFTER_ERROR: Duration = Duration::from_millis(200);

/// Why a metrics endpoint could not be opened.
#[derive(Debug, thiserror::Error)]
#[error("cannot serve metrics at {at}: {source}")]
pub struct EndpointError {
    at: String,
    source: io::Error,
}

/// Answers `GET /metrics` from one background thread that sleeps in `accept` between requests. Dropping it ends the
/// thread and removes its socket file.
pub struct MetricsEndpoint {
    listener: OwnedFd,
    stopping: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    socket: Option<PathBuf>,
    port: Option<u16>,
}

impl MetricsEndpoint {
    /// Serves what `render` gives on a unix socket at `path`; a socket that a dead predecessor left there is replaced.
    ///
    /// # Errors
    /// When the socket cannot be made: no such directory, a path over about 100 bytes, another file in its place.
    pub fn on_unix_socket(
        path: &Path,
        render: impl Fn() -> String + Send + 'static,
    ) -> Result<Self, EndpointError> {
        let failed = |source| EndpointError { at: path.display().to_string(), source };
        remove_old_socket(path).map_err(failed)?;
        let listener = UnixListener::bind(path).map_err(failed)?;
        let handle = listener.as_fd().try_clone_to_owned().map_err(failed)?;
        let accept = move || listener.accept().map(|(stream, _)| stream);
        let mut endpoint = Self::start(handle, accept, render).map_err(failed)?;
        endpoint.socket = Some(path.to_owned());
        Ok(endpoint)
    }

    /// Serves what `render` gives on 127.0.0.1 at `port`; port 0 takes a free one, see [`Self::port`].
    ///
    /// # Errors
    /// When the port cannot be opened.
    pub fn on_loopback(
        port: u16,
        render: impl Fn() -> String + Send + 'static,
    ) -> Result<Self, EndpointError> {
        let failed = |source| EndpointError { at: format!("127.0.0.1:{port}"), source };
        let listener = TcpListener::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, port))).map_err(failed)?;
        let port = listener.local_addr().map_err(failed)?.port();
        let handle = listener.as_fd().try_clone_to_owned().map_err(failed)?;
        let accept = move || listener.accept().map(|(stream, _)| stream);
        let mut endpoint = Self::start(handle, accept, render).map_err(failed)?;
        endpoint.port = Some(port);
        Ok(endpoint)
    }

    /// The TCP port, when it has one.
    pub fn port(&self) -> Option<u16> {
        self.port
    }

    fn start<S: TimedStream>(
        listener: OwnedFd,
        accept: impl Fn() -> io::Result<S> + Send + 'static,
        render: impl Fn() -> String + Send + 'static,
    ) -> io::Result<Self> {
        let stopping = Arc::new(AtomicBool::new(false));
        let stop = Arc::clone(&stopping);
        let thread = thread::Builder::new()
            .name("metrics".to_owned())
            .stack_size(256 * 1024)
            .spawn(move || serve(&accept, &render, &stop))?;
        Ok(Self { listener, stopping, thread: Some(thread), socket: None, port: None })
    }
}

impl Drop for MetricsEndpoint {
    fn drop(&mut self) {
        self.stopping.store(true, Ordering::SeqCst);
        // Wakes the thread: on Linux `accept` fails once its socket is shut down.
        let woken = shutdown(&self.listener, Shutdown::Both).is_ok();
        if let (true, Some(thread)) = (woken, self.thread.take()) {
            let _ = thread.join();
        }
        if let Some(path) = &self.socket {
            let _ = fs::remove_file(path);
        }
    }
}

fn remove_old_socket(path: &Path) -> io::Result<()> {
    match fs::symlink_metadata(path) {
        Ok(found) if found.file_type().is_socket() => fs::remove_file(path),
        Ok(_) => Err(io::Error::new(io::ErrorKind::AlreadyExists, "a file that is not a socket is there")),
        Err(missing) if missing.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(other) => Err(other),
    }
}

fn serve<S: TimedStream>(accept: impl Fn() -> io::Result<S>, render: impl Fn() -> String, stop: &AtomicBool) {
    while !stop.load(Ordering::SeqCst) {
        match accept() {
            Ok(stream) => {
                if let Err(problem) = answer(&mut Bounded::new(stream, WRITE_TIMEOUT), &render) {
                    tracing::debug!("a client of the metrics was dropped: {problem}");
                }
            }
            Err(_) if stop.load(Ordering::SeqCst) => break,
            Err(problem) => {
                tracing::debug!("metrics: {problem}");
                thread::sleep(PAUSE_AFTER_ERROR);
            }
        }
    }
}

fn answer<S: TimedStream>(stream: &mut Bounded<S>, render: impl Fn() -> String) -> io::Result<()> {
    match read_request(stream)?.as_deref() {
        Some("/metrics" | "/") => write_answer(stream, "200 OK", &render()),
        Some(_) => write_answer(stream, "404 Not Found", "only /metrics is here\n"),
        None => write_answer(stream, "400 Bad Request", "GET /metrics is expected\n"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{StageMetrics, scrape};
    use std::io::{Read, Write};
    use std::net::TcpStream;
    use std::os::unix::net::UnixStream;

    const TIMEOUT: Duration = Duration::from_secs(5);

    #[test]
    fn a_stage_is_scraped_over_its_socket_and_the_socket_of_a_dead_one_is_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mapper.sock");
        let left_behind = UnixListener::bind(&path).unwrap();
        drop(left_behind);
        let metrics = StageMetrics::new("mapper", 0, &[]);
        let shared = metrics.clone();
        let endpoint = MetricsEndpoint::on_unix_socket(&path, move || shared.render()).unwrap();
        metrics.handled(7, 1000, 2000);
        let text = scrape(&path, TIMEOUT).unwrap();
        assert!(text.contains(r#"flockslam_last_scan_sequence{replica="0",stage="mapper"} 7"#), "{text}");
        drop(endpoint);
        assert!(!path.exists());
    }

    #[test]
    fn a_file_that_is_not_a_socket_is_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map.pgm");
        fs::write(&path, b"precious").unwrap();
        assert!(MetricsEndpoint::on_unix_socket(&path, String::new).is_err());
        assert_eq!(fs::read(&path).unwrap(), b"precious");
    }

    #[test]
    fn silent_invalid_and_stalled_clients_do_not_block_others() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.sock");
        let _endpoint = MetricsEndpoint::on_unix_socket(&path, || "a 1\n".repeat(100_000)).unwrap();
        let _silent = UnixStream::connect(&path).unwrap();
        let mut unread = UnixStream::connect(&path).unwrap();
        unread.write_all(b"GET /metrics HTTP/1.0\r\n\r\n").unwrap();
        let mut rude = UnixStream::connect(&path).unwrap();
        rude.write_all(&[0xff; 4096]).unwrap();
        assert_eq!(scrape(&path, TIMEOUT).unwrap().len(), 400_000);
    }

    #[test]
    fn the_loopback_variant_serves_any_http_client() {
        let endpoint = MetricsEndpoint::on_loopback(0, || "a 1\n".to_owned()).unwrap();
        let ask = |path: &str| {
            let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, endpoint.port().unwrap())).unwrap();
            write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
            let mut answer = String::new();
            stream.read_to_string(&mut answer).unwrap();
            answer
        };
        assert!(
            ask("/metrics").starts_with("HTTP/1.0 200 OK\r\n") && ask("/metrics").ends_with("\r\n\r\na 1\n")
        );
        assert!(ask("/other").starts_with("HTTP/1.0 404 "));
    }
}
