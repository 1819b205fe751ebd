//! Prints the poses of a running process set as they are published: a start for a controller, a recorder or a display.
//!
//! ```text
//! flockslam demo --rate 1 --robot r1 &
//! cargo run -p flockslam-bus --example read_poses -- r1
//! ```
//!
//! The argument is the name given to `--robot`, or the directory of the set (`/dev/shm/flockslam-r1`). One line a scan:
//! stamp (s), x and y (m) and heading (rad) in the `map` frame, quality. Two things to know for a program of your own:
//!
//! - A controller should use `odom_from_base`, which is continuous, and look at `map_from_odom` when it plans:
//!   `map_from_base`, as printed here, moves when a loop is closed.
//! - A reader never slows the set down. When it does not keep up, the oldest of its waiting poses are replaced; the gap
//!   shows in `id.sequence`.
//!
//! A process can join one set only, once in its life. All programs of a set must be built from the same version of
//! `flockslam-messages`; otherwise the topic refuses to open and says so.

use flockslam_bus::{Bus, Capacity, RuntimeDir, Subscriber};
use flockslam_messages::{PoseEstimate, Quality};
use std::error::Error;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// How long to sleep when no pose waits: little beside the time between two scans, and next to no load.
const PAUSE: Duration = Duration::from_millis(2);
/// How often to look whether the set still runs.
const LOOK_AROUND: Duration = Duration::from_secs(1);

fn main() -> ExitCode {
    let Some(set) = std::env::args().nth(1) else {
        eprintln!("usage: read_poses NAME (as in --robot NAME) or the directory of a running set");
        return ExitCode::from(2);
    };
    match read_poses(&set_directory(&set)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("read_poses: {error}");
            ExitCode::FAILURE
        }
    }
}

fn set_directory(set: &str) -> PathBuf {
    if set.contains('/') { PathBuf::from(set) } else { PathBuf::from(format!("/dev/shm/flockslam-{set}")) }
}

fn read_poses(directory: &Path) -> Result<(), Box<dyn Error>> {
    if !is_running(directory) {
        return Err(format!("no set runs in {}: start one with --robot NAME", directory.display()).into());
    }
    let runtime = RuntimeDir::open(directory)?;
    // Sizes matter to publishers only: a reader takes those that the set was started with.
    let bus = Bus::join(&runtime, "read-poses", Capacity::default())?;
    let poses: Subscriber<PoseEstimate> = bus.subscriber()?;
    let mut looked = Instant::now();
    loop {
        while let Some(pose) = poses.receive()? {
            // The reader of the output may go away.
            if print(&pose).is_err() {
                return Ok(());
            }
        }
        if looked.elapsed() > LOOK_AROUND {
            looked = Instant::now();
            if !is_running(directory) {
                return Ok(());
            }
        }
        std::thread::sleep(PAUSE);
    }
}

/// The supervisor of a set holds this lock for as long as it lives, whatever ends it.
fn is_running(directory: &Path) -> bool {
    File::open(directory.join("lock")).is_ok_and(|lock| lock.try_lock_shared().is_err())
}

fn print(pose: &PoseEstimate) -> io::Result<()> {
    let map_from_base = pose.map_from_base();
    let microseconds = pose.times.sensor_ns.div_euclid(1000);
    writeln!(
        io::stdout(),
        "{}.{:06} {:.3} {:.3} {:.4} {}",
        microseconds.div_euclid(1_000_000),
        microseconds.rem_euclid(1_000_000),
        map_from_base.x_m,
        map_from_base.y_m,
        map_from_base.heading_rad,
        quality(pose.quality)
    )
}

fn quality(number: u32) -> &'static str {
    match number {
        n if n == Quality::Tracking as u32 => "tracking",
        n if n == Quality::Degraded as u32 => "degraded",
        n if n == Quality::Lost as u32 => "lost",
        _ => "unknown",
    }
}
