//! A Debian 12 without anything of ours, started with its own systemd on a copy that is discarded, and a person who types into it.

use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::Duration;

use crate::support::{stderr, stdout, wait_for, wait_for_every};

/// A person looks at a question for so long, and presses Enter.
pub const ANSWERS_AFTER: Duration = Duration::from_secs(5);
/// What a line of the shell finds.
const ENVIRONMENT: [(&str, &str); 4] = [
    ("HOME", "/srv"),
    ("PATH", "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"),
    ("TERM", "xterm"),
    ("LANG", "C.UTF-8"),
];
/// What systemd says when all has been started.
const STARTED: [&str; 2] = ["running", "degraded"];

/// A system that runs; dropped, it is shut down and what was written to it is gone.
pub struct BareDebian {
    machine: Child,
    init: u32,
}

impl BareDebian {
    /// Starts the system in `root`, which itself is only read, with files of this machine at places in it.
    pub fn start(root: &Path, files: &[(PathBuf, &str)]) -> Self {
        let mut command = Command::new("systemd-nspawn");
        command.arg("--directory").arg(root);
        // An overlay of memory takes what is written. The network is that of this machine: a browser here reaches the page.
        command.args(["--boot", "--volatile=overlay", "--register=no", "--keep-unit", "--console=pipe"]);
        for (file, place) in files {
            command.arg(format!("--bind={}:{place}", file.display()));
        }
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let machine = command.spawn().expect("systemd-nspawn (Debian's package systemd-container)");
        let children = format!("/proc/{0}/task/{0}/children", machine.id());
        // Before it there is one that prepares the system and ends.
        let is_init = |pid: &u32| {
            std::fs::read_to_string(format!("/proc/{pid}/comm")).is_ok_and(|name| name.trim() == "systemd")
        };
        let init = wait_for("the first process", || {
            let children = std::fs::read_to_string(&children).ok()?;
            children.split_whitespace().filter_map(|pid| pid.parse().ok()).find(is_init)
        });
        let debian = Self { machine, init };
        wait_for_every(Duration::from_millis(200), "systemd", || {
            let said = stdout(&debian.shell("systemctl is-system-running").output().ok()?);
            STARTED.contains(&said.trim()).then_some(())
        });
        debian
    }

    /// A line for its shell, in its home folder.
    pub fn shell(&self, line: &str) -> Command {
        let mut command = Command::new("nsenter");
        command.args(["--target", &self.init.to_string(), "--all", "sh", "-c"]);
        command.arg(format!("cd && {line}")).env_clear().envs(ENVIRONMENT);
        command
    }

    /// What a line prints, which must succeed.
    pub fn says(&self, line: &str) -> String {
        let output = self.shell(line).output().expect("nsenter");
        assert!(output.status.success(), "{line}: {}{}", stdout(&output), stderr(&output));
        stdout(&output)
    }

    /// Types a line in a terminal.
    pub fn types(&self, line: &str) -> Typed {
        let mut command = self.shell(&format!("script --quiet --return --command '{line}' /dev/null"));
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut process = command.spawn().expect("nsenter");
        let mut keyboard = process.stdin.take().expect("it is piped");
        let mut screen = process.stdout.take().expect("it is piped");
        let seen = Arc::new(Mutex::new(String::new()));
        let shown = Arc::clone(&seen);
        let reader = spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(length @ 1..) = screen.read(&mut bytes) {
                let text = String::from_utf8_lossy(&bytes[..length]).into_owned();
                shown.lock().expect("nobody panics").push_str(&text);
                // A question of `setup`, with its usual answer.
                if text.trim_end_matches(' ').ends_with(']') && text.contains('?') {
                    sleep(ANSWERS_AFTER);
                    let _ = keyboard.write_all(b"\n");
                }
            }
        });
        Typed { process, seen, reader: Some(reader) }
    }
}

impl Drop for BareDebian {
    fn drop(&mut self) {
        let _ = self.shell("systemctl poweroff 2>/dev/null").status();
        let _ = self.machine.wait();
    }
}

/// A line that was typed; dropped, it is interrupted.
pub struct Typed {
    process: Child,
    seen: Arc<Mutex<String>>,
    reader: Option<JoinHandle<()>>,
}

impl Typed {
    /// What the terminal has shown so far.
    pub fn seen(&self) -> String {
        self.seen.lock().expect("nobody panics").clone()
    }

    /// Waits for the end of the line, which must be a good one.
    pub fn ends_well(mut self) -> String {
        let status = self.process.wait().expect("it can be waited for");
        if let Some(reader) = self.reader.take() {
            reader.join().expect("it reads to the end");
        }
        assert!(status.success(), "{status}: {}", self.seen());
        self.seen()
    }
}

impl Drop for Typed {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
