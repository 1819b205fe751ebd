//! A link between robots that carries so many bytes a second and no more.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// As much goes at once.
const CHUNK_BYTES: usize = 4096;

/// A way to a robot's endpoint.
pub struct SlowLink {
    /// Where it begins, as an endpoint of zenoh.
    pub endpoint: String,
    carried: Arc<AtomicU64>,
}

impl SlowLink {
    /// A link to an endpoint `tcp/ADDRESS:PORT`, as long as this process lives.
    pub fn to(endpoint: &str, bytes_per_s: f64) -> Self {
        let (listener, target) = (TcpListener::bind("127.0.0.1:0").unwrap(), endpoint.to_owned());
        let carried = Arc::new(AtomicU64::new(0));
        let link = Self {
            endpoint: format!("tcp/{}", listener.local_addr().unwrap()),
            carried: Arc::clone(&carried),
        };
        thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                let Ok(far) = TcpStream::connect(target.trim_start_matches("tcp/")) else { continue };
                for (from, to) in [(&near, &far), (&far, &near)] {
                    let (from, to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    let carried = Arc::clone(&carried);
                    thread::spawn(move || carry(from, to, bytes_per_s, &carried));
                }
            }
        });
        link
    }

    /// Bytes so far, both ways.
    pub fn carried(&self) -> u64 {
        self.carried.load(Ordering::Relaxed)
    }
}

/// One direction, until one of both ends is closed.
fn carry(mut from: TcpStream, mut to: TcpStream, bytes_per_s: f64, carried: &AtomicU64) {
    let mut bytes = [0; CHUNK_BYTES];
    let mut free = Instant::now();
    while let Ok(length @ 1..) = from.read(&mut bytes) {
        free = free.max(Instant::now()) + Duration::from_secs_f64(length as f64 / bytes_per_s);
        thread::sleep(free.saturating_duration_since(Instant::now()));
        carried.fetch_add(length as u64, Ordering::Relaxed);
        if to.write_all(&bytes[..length]).is_err() {
            return;
        }
    }
    let _ = to.shutdown(std::net::Shutdown::Write);
}
