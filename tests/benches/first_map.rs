//! `cargo bench -p flockslam --bench first_map -- ROOT PACKAGE [robot|recording|lidar]`: from a bare Debian 12 and the file of the package
//! to the first map, as a user gets there: of the simulated robot, of a recording, of a lidar on a serial port; then how long an upgrade
//! takes a set away, and what `remove` and `purge` leave. ROOT is a folder with a Debian 12, made by debootstrap when it is not there.
//! Needs root, systemd-nspawn, debootstrap, a browser, and a recording and bytes of a lidar in `FLOCKSLAM_DATA`.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

mod bare_debian;

use bare_debian::{ANSWERS_AFTER, BareDebian};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};
use support::lidar_player::{LidarPlayer, Played};
use support::{Browser, data_dir, http_get, keep_picture, wait_for, wait_for_every};

/// Where the page is unless it is said otherwise.
const PAGE_PORT: u16 = 8470;
/// A drive of 88 s on one floor, with odometry and transforms.
const RECORDING: &str = "robot/carried/before.bag";
/// Bytes of a YDLIDAR T-mini Plus: three for each of 4000 points a second, and a tenth of a byte of head.
const LIDAR_BYTES: &str = "lidar-bytes/ydlidar-t-mini-plus.hex.txt";
const LIDAR_BYTES_PER_S: f64 = 13_000.0;
/// Places in the system.
const PACKAGE_PLACE: &str = "/srv/flockslam.deb";
const RECORDING_PLACE: &str = "/srv/drive.bag";
const PORT_PLACE: &str = "/dev/ttyUSB0";
const INSTALL: &str = "apt install ./flockslam.deb";
/// So much of the page is drawn once there are tiles: a robot that stands, and whose first turn was cut, has a small map.
const KNOWN_SHARE: f64 = 0.003;
/// Group `dialout` of Debian.
const DIALOUT: u32 = 20;

/// What there is to be tried.
struct Trial {
    root: PathBuf,
    package: PathBuf,
    data: PathBuf,
    browser: Browser,
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let [root, package, only @ ..] = arguments.as_slice() else {
        eprintln!("first_map: needs ROOT PACKAGE: a folder for a Debian 12, and the file of the package");
        return;
    };
    let [root, package] = [root, package].map(|path| support::repository().join(path));
    if !root.exists() {
        let status = Command::new("debootstrap").arg("bookworm").arg(&root).status().expect("debootstrap");
        assert!(status.success(), "debootstrap: {status}");
    }
    assert!(http_get(PAGE_PORT, "/").is_none(), "port {PAGE_PORT} is taken: the page needs it");
    let data = data_dir().expect("a recording, and bytes of a lidar");
    let trial = Trial { root, package, data, browser: Browser::start("the page").expect("a browser") };
    let is_wanted = |what: &str| only.is_empty() || only.iter().any(|named| named == what);
    for (what, run) in [
        ("robot", Trial::simulated_robot as fn(&Trial)),
        ("recording", Trial::recording),
        ("lidar", Trial::lidar),
    ] {
        if is_wanted(what) {
            run(&trial);
        }
    }
}

/// Seconds since then, with a word of what they lead to.
fn report(what: &str, since: Instant) {
    println!("{what}: {:.1} s", since.elapsed().as_secs_f64());
}

impl Trial {
    fn debian(&self, more: &[(PathBuf, &str)]) -> BareDebian {
        let package = [(self.package.clone(), PACKAGE_PLACE)];
        BareDebian::start(&self.root, &[package.as_slice(), more].concat())
    }

    /// Waits until the page shows a map, and keeps a picture of it.
    fn wait_for_map(&self, what: &str, since: Instant) {
        wait_for("the page", || http_get(PAGE_PORT, "/"));
        report(&format!("{what}: the page answers"), since);
        self.browser.resize(1280, 800, false);
        self.browser.open(&format!("http://localhost:{PAGE_PORT}/"));
        wait_for_every(Duration::from_millis(100), "a map on the page", || {
            let share = self.browser.script(KNOWN).as_f64()?;
            (share > KNOWN_SHARE).then_some(())
        });
        report(&format!("{what}: map on the page"), since);
        keep_picture(&format!("first-map-{}", what.replace(' ', "-")), &self.browser.screenshot());
        self.browser.open("about:blank");
    }

    fn simulated_robot(&self) {
        let debian = self.debian(&[]);
        let since = Instant::now();
        let _typed = debian.types(&format!("{INSTALL} && flockslam demo --live"));
        self.wait_for_map("simulated robot", since);
    }

    fn recording(&self) {
        let recording = [(self.data.join(RECORDING), RECORDING_PLACE)];
        let debian = self.debian(&recording);
        let since = Instant::now();
        let said = debian.types(&format!("{INSTALL} && flockslam map drive.bag --out map")).ends_well();
        report("recording: map, picture and trajectory as files", since);
        debian.says("test -s map/map.png && test -s map/trajectory.tum");
        println!("{}", said.lines().last().unwrap_or_default());
        drop(debian);

        let debian = self.debian(&recording);
        let since = Instant::now();
        let _typed = debian.types(&format!("{INSTALL} && flockslam map drive.bag --live"));
        self.wait_for_map("recording", since);
    }

    /// A lidar through `setup`, which makes a service of it; then the set of that service through what packages do.
    fn lidar(&self) {
        let directory = tempfile::tempdir().expect("a directory");
        let link = directory.path().join("lidar");
        let hex = std::fs::read_to_string(self.data.join(LIDAR_BYTES)).expect("bytes of a lidar");
        let bytes = hex.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).expect("hex")).collect();
        let _player = LidarPlayer::plug(&link, Played::Bytes(bytes, LIDAR_BYTES_PER_S));
        let terminal = std::fs::canonicalize(&link).expect("the player's terminal");
        as_a_serial_port(&terminal);
        let debian = self.debian(&[(terminal, PORT_PLACE)]);
        let since = Instant::now();
        let typed = debian.types(&format!("{INSTALL} && flockslam setup --port {PORT_PLACE}"));
        wait_for("the end of setup", || typed.seen().contains("runs: ").then_some(()));
        let questions = typed.seen().matches("? [").count();
        let answer_timeout_s = ANSWERS_AFTER.as_secs();
        report(&format!("lidar: {questions} questions are answered, each after {answer_timeout_s} s"), since);
        self.wait_for_map("lidar", since);
        typed.ends_well();

        let unit = "flockslam@r1";
        debian.says(&format!("systemctl is-active {unit}"));
        debian.says("apt install --reinstall ./flockslam.deb");
        wait_for("the set again", || http_get(PAGE_PORT, "/"));
        let stamp = |name: &str| -> f64 {
            let said = debian.says(&format!("systemctl show --value -p {name}TimestampMonotonic {unit}"));
            said.trim().parse().expect("microseconds")
        };
        println!("upgrade: the set is away for {:.2} s", (stamp("ActiveEnter") - stamp("ActiveExit")) * 1e-6);

        debian.says("apt remove -y flockslam");
        debian.says("test -e /etc/flockslam/r1.toml && ls /var/lib/flockslam-r1/*");
        assert!(http_get(PAGE_PORT, "/").is_none() && !debian.says("ls /dev/shm").contains("flockslam"));
        println!("remove: the set is stopped, its description and its map stay");
        debian.says("apt purge -y flockslam");
        debian.says("test ! -e /etc/flockslam && test -z \"$(ls -d /var/lib/flockslam-* 2>/dev/null)\"");
        println!("purge: description and map are gone");
    }
}

/// Serial ports belong to a group, and so do services that read them.
fn as_a_serial_port(terminal: &Path) {
    use std::os::unix::fs::PermissionsExt;
    std::os::unix::fs::chown(terminal, None, Some(DIALOUT)).expect("only root may do that");
    std::fs::set_permissions(terminal, std::fs::Permissions::from_mode(0o660))
        .expect("only root may do that");
}

/// Share of the page's map that has another colour than the unknown, once the robot is shown.
const KNOWN: &str = "
    const { view } = await import('/main.js');
    if (!view.robot || view.map.tiles.size + view.live.tiles.size === 0) return 0;
    const canvas = document.querySelector('#map');
    const data = new Uint32Array(canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.buffer);
    const hex = getComputedStyle(document.documentElement).getPropertyValue('--map-unknown').trim().slice(1);
    const [r, g, b] = [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16));
    const unknown = ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0;
    return data.filter((pixel) => pixel !== unknown).length / data.length;";
