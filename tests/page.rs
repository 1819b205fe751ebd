//! The live page, in a real Chromium where there is one: it shows what the set does, marks what happens to its stages, takes orders,
//! and comes back after everything behind it has died.

use crate::support;
use crate::support::flocks::FlockRobot;
use crate::support::lidar_player::{LidarPlayer, Played};
use crate::support::{
    Browser, Drive, LiveSet, RunningSet, free_port, http_get, keep_picture, machine_share, of, processes_of,
    send, wait_for,
};
use flockslam_bus::RuntimeDir;
use flockslam_messages::Stage;
use rustix::process::Signal;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::Instant;

/// Round the built-in office and back to where it began, with loops to close.
const DRIVE: Drive = Drive { scan_rate_hz: 10.0, duration_s: 3000.0, rate: 6.0 };

fn start(test: &str, directory: &Path, port: u16, more: &[&str]) -> LiveSet {
    let settings = ["page.enabled=true", &format!("page.listen=127.0.0.1:{port}"), "simulation.walkers=8"];
    let settings = settings.iter().copied().chain(more.iter().copied());
    let arguments: Vec<String> = settings.flat_map(|set| ["--set".to_owned(), set.to_owned()]).collect();
    LiveSet::start_with_failpoints(test, directory, DRIVE, "", &arguments, "")
}

/// The process that serves the page.
fn page_pid(robot: &str) -> u32 {
    let serves = |pid: &u32| {
        let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        line.split(|byte| *byte == 0).nth(1) == Some(b"page".as_slice())
    };
    let set_dir = RuntimeDir::path_of(robot).display().to_string();
    wait_for("a page", || processes_of(&set_dir).into_iter().find(serves))
}

/// Head of the answer to a request with these headers.
fn answer(port: u16, path: &str, headers: &str) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nConnection: close\r\n{headers}\r\n").unwrap();
    let mut answer = vec![0; 4096];
    let length = stream.read(&mut answer).unwrap();
    String::from_utf8_lossy(&answer[..length]).split("\r\n\r\n").next().unwrap().to_owned()
}

/// Pixels of the map of each kind: (all, those of the commonest colour, of the path, of the scan).
const PIXELS: &str = "
    const canvas = document.querySelector('#map');
    const data = new Uint32Array(canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.buffer);
    const counts = new Map();
    for (const pixel of data) counts.set(pixel, (counts.get(pixel) ?? 0) + 1);
    const of = (name) => {
        const hex = getComputedStyle(document.documentElement).getPropertyValue(name).trim().slice(1);
        const [r, g, b] = [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16));
        return counts.get(((255 << 24) | (b << 16) | (g << 8) | r) >>> 0) ?? 0;
    };
    return { all: data.length, unknown: of('--map-unknown'), free: of('--map-free'), path: of('--path'), scan: of('--scan'), flock: of('--flock') };";

fn show(browser: &Browser, name: &str, scheme: &str, (width, height, mobile): (u32, u32, bool)) {
    browser.colours(scheme);
    browser.resize(width, height, mobile);
    browser.script("await new Promise((r) => setTimeout(r, 700));");
    let png = browser.screenshot();
    keep_picture(&format!("page-{name}"), &png);
}

#[test]
fn a_browser_shows_the_run_and_what_happens_to_it() {
    let Some(browser) = Browser::start("what the live page shows") else { return };
    let (directory, port) = (tempfile::tempdir().unwrap(), free_port());
    let mut set = start("page", directory.path(), port, &[]);
    wait_for("the page", || http_get(port, "/"));
    browser.resize(1280, 800, false);
    browser.colours("dark");
    browser.open(&format!("http://localhost:{port}/"));
    browser.wait_until("a connection", "document.body.dataset.link === 'open'");

    // The map is drawn, with all that belongs to it.
    browser.wait_until("tiles", "Number(document.body.dataset.tiles) > 20");
    let before = browser.script(PIXELS);
    let view = "(await import('/main.js')).view";
    browser.wait_until(
        "submaps at their places",
        &format!("{view}.map.tiles.size > 20 && {view}.origins.length > 3"),
    );
    browser.wait_until("a closed loop", &format!("{view}.closures.length > 0"));
    browser.wait_until("a scan", &format!("{view}.scan?.points.length > 100"));
    let after = browser.script(PIXELS);
    for kind in ["free", "path", "scan"] {
        assert!(after[kind].as_u64() > Some(50), "{kind}: {after}");
    }
    let known =
        |pixels: &serde_json::Value| pixels["all"].as_f64().unwrap() - pixels["unknown"].as_f64().unwrap();
    println!("pixels early {before}, later {after}");
    assert!(known(&after) > 0.05 * after["all"].as_f64().unwrap());
    browser.wait_until("somebody who walks", &format!("{view}.tracks.length > 0"));
    browser.wait_until(
        "latencies",
        "document.querySelector('[data-stage=mapper] .detail').textContent.includes('Hz')",
    );

    // It can be moved with the keyboard alone.
    browser.script("document.querySelector('#map').focus();");
    browser.press("+");
    browser.wait_until("a closer look", &format!("!{view}.camera.fits"));
    browser.press("f");
    browser.wait_until("the whole map", &format!("{view}.camera.fits"));

    // A stage dies: there is a mark, and its counter has grown.
    let restarts = |set: &LiveSet, stage| {
        wait_for("a status", || set.status().map(|status| of(&status, stage).restarts))
    };
    // On a busy machine one may have been replaced before.
    let before = restarts(&set, Stage::Mapper);
    let killed = Instant::now();
    send(set.pid(Stage::Mapper), Signal::KILL);
    let marked = "parseInt(document.querySelector('[data-stage=mapper].struck .restarts')?.textContent)";
    browser.wait_until("a mark", &format!("{marked} > {before}"));
    println!("from kill -9 to the mark: {:.2} s", killed.elapsed().as_secs_f64());
    browser
        .wait_until("an event", "document.querySelector('#events .restart')?.textContent.includes('mapper')");

    // A button replaces a stage, on the second press.
    let before = restarts(&set, Stage::DynamicCleaner);
    let press = "document.querySelector('[data-stage=dynamic-cleaner] .again').focus();";
    browser.script(press);
    browser.press("Enter");
    browser.press("Enter");
    browser.wait_until("the answer", "document.querySelector('#toast').textContent.includes('restarted')");
    set.wait_until("a restart", |status| of(status, Stage::DynamicCleaner).restarts > before);

    // It rests and goes on.
    browser.script("document.querySelector('#pause').click();");
    browser.wait_until("a pause", "document.querySelector('#link').textContent.includes('paused')");
    let resting = wait_for("rest", || {
        let at = |set: &LiveSet| set.status().map(|status| of(&status, Stage::ScanMatcher).handled);
        let before = at(&set)?;
        browser.script("await new Promise((r) => setTimeout(r, 300));");
        (at(&set)? == before).then_some(before)
    });
    browser.script("document.querySelector('#pause').click();");
    set.wait_until("more scans", |status| of(status, Stage::ScanMatcher).handled > resting + 5);

    show(&browser, "dark", "dark", (1280, 800, false));
    show(&browser, "light", "light", (1280, 800, false));
    show(&browser, "phone", "light", (390, 780, true));
    browser.resize(1280, 800, false);

    // The page's own process dies, then the supervisor with everything.
    send(page_pid(set.robot()), Signal::KILL);
    browser.wait_until("a lost connection", "document.body.dataset.link === 'closed'");
    browser.wait_until("the page again", "document.body.dataset.link === 'open'");
    let mut set = set.kill_and_start_again();
    browser.wait_until("a lost connection", "document.body.dataset.link === 'closed'");
    browser.wait_until("the set again", "document.body.dataset.link === 'open'");
    set.wait_until_handled(Stage::ScanMatcher, 20);
    browser.wait_until("the map again", &format!("{view}.map.tiles.size > 20 && {view}.robot"));
    assert_eq!(browser.errors(), [""; 0]);
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}

/// A robot that stands gives its mapper one scan: the page has to ask for the tiles that came before it.
#[test]
fn the_map_of_a_standing_robot_reaches_late_subscribers() {
    machine_share::mostly_waits();
    let Some(browser) = Browser::start("the map of a robot that stands") else { return };
    let directory = tempfile::tempdir().unwrap();
    let (robot, lidar, port) = (support::robot("stands"), directory.path().join("lidar"), free_port());
    let _player = LidarPlayer::plug(&lidar, Played::ld06());
    let description = format!(
        "robot = \"{robot}\"\nset = [\"page.listen=127.0.0.1:{port}\"]\n[source]\nkind = \"ld06\"\nport = {lidar:?}\n"
    );
    std::fs::write(directory.path().join("set.toml"), description).unwrap();
    let mut set = LiveSet::start_again(robot, directory.path(), &[]);
    set.wait_until_handled(Stage::ScanMatcher, 10);
    browser.open(&format!("http://localhost:{port}/"));
    browser.wait_until("tiles", "Number(document.body.dataset.tiles) > 0");
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}

#[test]
fn foreign_requests_are_refused_and_orders_need_the_token() {
    let (directory, port) = (tempfile::tempdir().unwrap(), free_port());
    let token = directory.path().join("token");
    std::fs::write(&token, "not for everybody\n").unwrap();
    let token_file = format!("page.token_file={}", token.display());
    let mut set = start("foreign", directory.path(), port, &[&token_file]);
    wait_for("the page", || http_get(port, "/"));
    let own = format!("Host: localhost:{port}\r\n");
    let page = answer(port, "/", &own);
    assert!(
        page.starts_with("HTTP/1.1 200") && page.contains("content-security-policy: default-src 'none'"),
        "{page}"
    );
    assert!(answer(port, "/etc/passwd", &own).starts_with("HTTP/1.1 404"));
    assert!(answer(port, "/", "Host: evil.example\r\n").starts_with("HTTP/1.1 403"));
    let socket =
        "Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let opens = |origin: &str| {
        let headers = format!("{own}Connection: Upgrade\r\n{socket}Origin: {origin}\r\n");
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        write!(stream, "GET /ws HTTP/1.1\r\n{headers}\r\n").unwrap();
        let mut answer = [0; 12];
        stream.read_exact(&mut answer).unwrap();
        String::from_utf8_lossy(&answer[9..]).into_owned()
    };
    assert_eq!(opens(&format!("http://localhost:{port}")), "101");
    assert_eq!(opens("http://evil.example"), "403");
    if let Some(browser) = Browser::start("that orders need the token") {
        browser.open(&format!("http://localhost:{port}/"));
        browser.wait_until("a connection", "document.body.dataset.link === 'open'");
        browser.wait_until("stages", "document.querySelectorAll('.stage').length === 6");
        let order = |token: &str| {
            let body = format!(
                "return (await (await import('/main.js')).link.order({{ restart: 'mapper' }}, {token})).ok;"
            );
            browser.script(&body)
        };
        assert_eq!((order("undefined"), order("'not for everybodY'")), (false.into(), false.into()));
        assert_eq!(of(&set.status().unwrap(), Stage::Mapper).restarts, 0);
        assert_eq!(order("'not for everybody'"), true);
        set.wait_until("a restart", |status| of(status, Stage::Mapper).restarts == 1);
        assert_eq!(browser.errors(), [""; 0]);
    }
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}

#[test]
fn a_live_demo_is_shown_as_well_and_its_page_is_replaced_when_it_is_killed() {
    let (directory, port) = (tempfile::tempdir().unwrap(), free_port());
    let args = ["demo", "--live", "--rate", "2", "--set", &format!("page.listen=127.0.0.1:{port}")];
    let set = RunningSet::start("livepage", directory.path(), &args.map(str::to_owned));
    let (_, page) = wait_for("the page", || http_get(port, "/"));
    assert!(page.contains("<canvas id=\"map\""));
    let page = page_pid(set.robot());
    send(page, Signal::KILL);
    wait_for("another page", || {
        (page_pid(set.robot()) != page && http_get(port, "/").is_some()).then_some(())
    });
    send(set.supervisor_pid(), Signal::TERM);
    send(set.supervisor_pid(), Signal::TERM);
}

#[test]
fn a_token_file_that_is_missing_is_refused_at_the_start() {
    let directory = tempfile::tempdir().unwrap();
    let missing = directory.path().join("missing");
    let output = support::flockslam()
        .args(["demo", "--live", "--set", &format!("page.token_file={}", missing.display()), "--out"])
        .arg(directory.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = support::stderr(&output);
    assert!(said.contains("page.token_file") && said.lines().count() == 1, "{said}");
}

/// Robots that have met see each other on their pages.
#[test]
fn a_browser_shows_the_other_robots_of_the_flock() {
    // Three robots look for each other with what is left of the processors.
    machine_share::alone();
    let Some(browser) = Browser::start("the flock on the live page") else { return };
    let (directory, port) = (tempfile::tempdir().unwrap(), free_port());
    let drive = Drive { scan_rate_hz: 5.0, duration_s: 2000.0, rate: 5.0 };
    let mut robots = FlockRobot::start_with_page("page-flock", directory.path(), drive, 3, port);
    wait_for("the page", || http_get(port, "/"));
    browser.resize(1280, 800, false);
    browser.colours("dark");
    browser.open(&format!("http://localhost:{port}/"));
    let rows = "document.querySelectorAll('#robots [data-reach=near]').length";
    browser.wait_until("two robots near", &format!("{rows} === 2"));
    for robot in &mut robots {
        robot.wait_for_flock("a map of three robots", |flock| flock.merged && flock.members.len() == 3);
    }
    let view = "(await import('/main.js')).view";
    browser.wait_until("two robots on the map", &format!("{view}.otherRobots.size === 2"));
    let has_moved = format!("[...{view}.otherRobots.values()].every(({{ trail }}) => trail.length > 4)");
    browser.wait_until("ways of both", &has_moved);
    let pixels = browser.script(PIXELS);
    assert!(pixels["flock"].as_u64() > Some(50), "{pixels}");
    show(&browser, "flock", "dark", (1280, 800, false));

    // One dies: it is no longer shown as near.
    let mut dead = robots.pop().unwrap();
    dead.kill();
    browser.wait_until("one less near", &format!("{rows} === 1"));
    assert_eq!(browser.errors(), [""; 0]);
    dead.leave_nothing();
}
