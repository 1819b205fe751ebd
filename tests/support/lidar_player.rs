//! Plays a lidar at a pseudo terminal or a TCP port: sends packets at their pace, answers requests, can be unplugged.

use flockslam_lidars::encoders::ld06_encoder::Ld06Encoder;
use flockslam_lidars::encoders::rplidar_encoder::RplidarEncoder;
use flockslam_lidars::encoders::sick_tim_encoder::SickTimEncoder;
use flockslam_lidars::encoders::urg_encoder::UrgEncoder;
use flockslam_lidars::encoders::ydlidar_encoder::YdlidarEncoder;
use flockslam_lidars::{Driver, Family};
use flockslam_telemetry::monotonic_ns;
use serialport::{SerialPort, TTYPort};
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::{Duration, Instant};

/// The room around the lidar: 8 by 5 m, not in its middle.
pub fn room(angle_rad: f64) -> f64 {
    let (sin, cos) = angle_rad.sin_cos();
    let along = |direction: f64, ahead_m: f64, behind_m: f64| {
        let wall_m = if direction > 0.0 { ahead_m } else { behind_m };
        if direction.abs() < 1e-9 { f64::INFINITY } else { wall_m / direction.abs() }
    };
    along(cos, 4.6, 3.4).min(along(sin, 2.8, 2.2))
}

/// A lidar that can be played.
pub enum Played {
    Ld06(Ld06Encoder),
    Rplidar(RplidarEncoder),
    Ydlidar(YdlidarEncoder),
    Urg(UrgEncoder),
    SickTim(SickTimEncoder),
    /// Bytes as they were recorded, and how many of them come in a second.
    Bytes(Vec<u8>, f64),
    /// Sends bytes that are no packets.
    Garbage,
    /// Sends nothing.
    Nothing,
}

impl Played {
    pub fn ld06() -> Self {
        Self::Ld06(Ld06Encoder::new(10.0))
    }

    /// What the lidar answers to a request, and whether it measures from then on.
    fn receive(&self, request: &[u8]) -> (Vec<u8>, Option<bool>) {
        match self {
            Self::Rplidar(encoder) => {
                let measures = match request.get(1) {
                    Some(0x20 | 0x82) => Some(true),
                    Some(0x25) => Some(false),
                    _ => None,
                };
                (encoder.answer(request), measures)
            }
            Self::Ydlidar(_) => {
                let measures = [(0x60, true), (0x65, false)];
                let measures = measures.into_iter().find(|(command, _)| request.get(1) == Some(command));
                (Vec::new(), measures.map(|(_, measures)| measures))
            }
            Self::Urg(encoder) => {
                let measures = request.starts_with(b"MD").then_some(true);
                (encoder.answer(request), measures.or(request.starts_with(b"QT").then_some(false)))
            }
            Self::SickTim(encoder) => {
                (encoder.answer(request), request.starts_with(b"\x02sEN LMDscandata 1").then_some(true))
            }
            _ => (Vec::new(), None),
        }
    }

    fn family(&self) -> Option<Family> {
        match self {
            Self::Ld06(_) => Some(Family::Ld06),
            Self::Rplidar(_) => Some(Family::Rplidar),
            Self::Ydlidar(_) => Some(Family::Ydlidar),
            Self::Urg(_) => Some(Family::Urg),
            Self::SickTim(_) => Some(Family::SickTim),
            Self::Bytes(..) | Self::Garbage | Self::Nothing => None,
        }
    }

    fn streams_unrequested(&self) -> bool {
        matches!(self, Self::Ld06(_) | Self::Bytes(..) | Self::Garbage)
    }

    /// Packets of about one turn, and how long they take.
    fn turn(&mut self) -> (Vec<Vec<u8>>, Duration) {
        let tenth = Duration::from_millis(100);
        match self {
            Self::Ld06(encoder) => (encoder.turn(&room), tenth),
            Self::Rplidar(encoder) => (encoder.turn(&room), tenth),
            Self::Ydlidar(encoder) => (encoder.turn(&room), Duration::from_millis(125)),
            Self::Urg(encoder) => (encoder.turn(&room), Duration::from_millis(25)),
            Self::SickTim(encoder) => (encoder.turn(&room), Duration::from_millis(67)),
            Self::Bytes(bytes, per_s) => {
                let packets: Vec<_> = bytes.chunks(64).map(<[u8]>::to_vec).collect();
                (packets, Duration::from_secs_f64(bytes.len() as f64 / *per_s))
            }
            Self::Garbage => ((0..50u8).map(|k| vec![k.wrapping_mul(37) | 1; 40]).collect(), tenth),
            Self::Nothing => (Vec::new(), tenth),
        }
    }
}

/// One end of a line.
enum End {
    Pty(TTYPort),
    Tcp(TcpListener, Option<TcpStream>),
}

impl End {
    /// What was asked so far, without waiting.
    fn receive(&mut self, bytes: &mut [u8]) -> usize {
        let read = match self {
            Self::Pty(master) => match master.bytes_to_read() {
                Ok(1..) => master.read(bytes),
                _ => return 0,
            },
            Self::Tcp(listener, stream) => {
                if let Ok((accepted, _)) = listener.accept() {
                    accepted.set_nonblocking(true).unwrap();
                    accepted.set_nodelay(true).unwrap();
                    *stream = Some(accepted);
                }
                match stream {
                    Some(stream) => stream.read(bytes),
                    None => return 0,
                }
            }
        };
        read.unwrap_or(0)
    }

    fn send(&mut self, bytes: &[u8]) {
        let sent = match self {
            Self::Pty(master) => master.write_all(bytes),
            Self::Tcp(_, Some(stream)) => {
                stream.set_nonblocking(false).unwrap();
                let sent = stream.write_all(bytes);
                stream.set_nonblocking(true).unwrap();
                sent
            }
            Self::Tcp(_, None) => Ok(()),
        };
        if sent.is_err_and(|error| error.kind() != ErrorKind::TimedOut)
            && let Self::Tcp(_, stream) = self
        {
            *stream = None;
        }
    }
}

/// A lidar that is plugged in; dropped, it is unplugged.
pub struct LidarPlayer {
    stop: Arc<AtomicBool>,
    turns_ns: Arc<Mutex<Vec<u64>>>,
    thread: Option<JoinHandle<()>>,
    place: PathBuf,
}

impl LidarPlayer {
    /// Plugs a lidar in at a path, which is a link to its terminal.
    pub fn plug(path: &Path, lidar: Played) -> Self {
        let (mut master, slave) = TTYPort::pair().unwrap();
        let terminal = slave.name().unwrap();
        // Whoever opens it has it alone.
        drop(slave);
        master.set_timeout(Duration::from_millis(20)).unwrap();
        let _ = std::fs::remove_file(path);
        std::os::unix::fs::symlink(terminal, path).unwrap();
        Self::play(End::Pty(master), lidar, path.to_owned())
    }

    /// A lidar on the network; its address.
    pub fn listen(lidar: Played) -> (Self, String) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        let address = listener.local_addr().unwrap().to_string();
        (Self::play(End::Tcp(listener, None), lidar, PathBuf::new()), address)
    }

    fn play(mut end: End, mut lidar: Played, place: PathBuf) -> Self {
        let (stop, turns_ns) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new(Vec::new())));
        let (stopped, turned) = (Arc::clone(&stop), Arc::clone(&turns_ns));
        let thread = spawn(move || {
            let mut measures = lidar.streams_unrequested();
            let (mut bytes, mut received) = ([0; 256], Vec::new());
            let mut decoder = lidar.family().map(|family| family.driver(None, None));
            let mut due = Instant::now();
            while !stopped.load(Ordering::Relaxed) {
                let mut listen =
                    |end: &mut End, lidar: &Played, measures: &mut bool, decoder: &mut Decoder| {
                        let length = end.receive(&mut bytes);
                        received.extend_from_slice(&bytes[..length]);
                        while let Some(request) = first_request(&mut received) {
                            let (answer, changes) = lidar.receive(&request);
                            end.send(&answer);
                            decoder.iter_mut().for_each(|decoder| _ = gives_turn(&mut **decoder, &answer));
                            *measures = changes.unwrap_or(*measures);
                        }
                    };
                listen(&mut end, &lidar, &mut measures, &mut decoder);
                if !measures {
                    sleep(Duration::from_millis(2));
                    due = Instant::now();
                    continue;
                }
                let (packets, took) = lidar.turn();
                let bytes_of_turn = packets.iter().map(Vec::len).sum::<usize>().max(1) as f64;
                for packet in packets {
                    // A packet is sent when its last beam is measured.
                    due += took.mul_f64(packet.len() as f64 / bytes_of_turn);
                    sleep(due.saturating_duration_since(Instant::now()));
                    let sent_ns = monotonic_ns();
                    end.send(&packet);
                    if let Some(decoder) = &mut decoder
                        && gives_turn(&mut **decoder, &packet)
                    {
                        turned.lock().unwrap().push(sent_ns);
                    }
                    listen(&mut end, &lidar, &mut measures, &mut decoder);
                    if stopped.load(Ordering::Relaxed) || !measures {
                        break;
                    }
                }
            }
        });
        Self { stop, turns_ns, thread: Some(thread), place }
    }

    /// When the packet was sent with which each turn was whole, on the monotonic clock, nanoseconds.
    pub fn turns_ns(&self) -> Vec<u64> {
        self.turns_ns.lock().unwrap().clone()
    }
}

impl Drop for LidarPlayer {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
        let _ = std::fs::remove_file(&self.place);
    }
}

/// Receives what the lidar sends, to know when a turn is whole.
type Decoder = Option<Box<dyn Driver>>;

/// Whether a turn is whole with these bytes.
fn gives_turn(decoder: &mut dyn Driver, bytes: &[u8]) -> bool {
    let now_ns = monotonic_ns() as i64;
    // Its requests are those of the set, and have been sent.
    while decoder.act(now_ns).is_some() {}
    let mut any = false;
    decoder.take(bytes, now_ns, &mut |_| any = true);
    any
}

/// Cuts the first whole request off; requests of a lidar come one after the other.
fn first_request(received: &mut Vec<u8>) -> Option<Vec<u8>> {
    let length = match received.as_slice() {
        [] | [0xA5] => return None,
        [0xA5, command, ..] if command & 0x80 == 0 || [0x90, 0x92].contains(command) => 2,
        [0xA5, _] => return None,
        [0xA5, _, content, ..] => 4 + usize::from(*content),
        [2, ..] => 1 + received.iter().position(|byte| *byte == 3)?,
        _ => 1 + received.iter().position(|byte| *byte == b'\n')?,
    };
    (received.len() >= length).then(|| received.drain(..length).collect())
}
