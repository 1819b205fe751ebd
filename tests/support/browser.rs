//! Chromium, driven over the WebDriver protocol.

use super::{free_port, not_tested, wait_for};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const DRIVER: &str = "chromedriver";
const CHROMIUM: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];

/// A Chromium of a test's own.
pub struct Browser {
    driver: Child,
    port: u16,
    session: String,
    _profile: tempfile::TempDir,
}

/// Where a program is to be found.
fn path_of(program: &str) -> Option<PathBuf> {
    let directories = std::env::var_os("PATH")?;
    std::env::split_paths(&directories).map(|directory| directory.join(program)).find(|path| path.is_file())
}

impl Browser {
    /// Starts one; `None`, with a word about what is `left_out`, where there is no Chromium.
    pub fn start(left_out: &str) -> Option<Self> {
        let chromium = CHROMIUM.into_iter().find_map(path_of);
        let (Some(chromium), Some(driver)) = (chromium, path_of(DRIVER)) else {
            not_tested(left_out, &format!("there is no Chromium with {DRIVER}"));
            return None;
        };
        let (port, profile) = (free_port(), tempfile::tempdir().unwrap());
        let mut command = Command::new(driver);
        command.arg(format!("--port={port}")).stdout(Stdio::null()).stderr(Stdio::null());
        let driver = command.spawn().unwrap();
        let mut browser = Self { driver, port, session: String::new(), _profile: profile };
        wait_for("chromedriver", || browser.try_command("GET", "/status", &Value::Null));
        let data_dir = format!("--user-data-dir={}", browser._profile.path().display());
        let capabilities = json!({ "capabilities": { "alwaysMatch": {
            "goog:chromeOptions": { "binary": chromium, "args": [
                "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars",
                "--disable-extensions", "--no-first-run", "--disable-background-networking", data_dir,
            ] },
            "goog:loggingPrefs": { "browser": "ALL" },
        } } });
        let made = browser.command("POST", "/session", &capabilities);
        browser.session = format!("/session/{}", made["sessionId"].as_str().unwrap());
        Some(browser)
    }

    /// Opens a page.
    pub fn open(&self, url: &str) {
        self.in_session("POST", "/url", &json!({ "url": url }));
    }

    /// What the body of a function in the page returns; a promise is waited for.
    pub fn script(&self, body: &str) -> Value {
        let body = format!(
            "const done = arguments[0]; (async () => {{ {body} }})().then(done, (e) => done(String(e)));"
        );
        self.in_session("POST", "/execute/async", &json!({ "script": body, "args": [] }))
    }

    /// Waits until an expression in the page is true.
    pub fn wait_until(&self, what: &str, expression: &str) {
        wait_for(what, || {
            (self.script(&format!("return Boolean({expression});")) == Value::Bool(true)).then_some(())
        });
    }

    /// A window of this size, in points; `mobile`: a phone's, with two pixels for each point.
    pub fn resize(&self, width: u32, height: u32, mobile: bool) {
        let ratio = if mobile { 2 } else { 1 };
        let metrics =
            json!({ "width": width, "height": height, "deviceScaleFactor": ratio, "mobile": mobile });
        self.developer("Emulation.setDeviceMetricsOverride", &metrics);
    }

    /// `dark` or `light`.
    pub fn colours(&self, scheme: &str) {
        let features = json!([{ "name": "prefers-color-scheme", "value": scheme }]);
        self.developer("Emulation.setEmulatedMedia", &json!({ "features": features }));
    }

    /// A picture of the window, PNG.
    pub fn screenshot(&self) -> Vec<u8> {
        let picture = self.in_session("GET", "/screenshot", &Value::Null);
        from_base64(picture.as_str().unwrap())
    }

    /// Presses a key where the focus is, for example `Tab`.
    pub fn press(&self, key: &str) {
        let code = match key {
            "Tab" => "\u{e004}",
            "Enter" => "\u{e007}",
            other => other,
        };
        let actions = ["keyDown", "keyUp"].map(|kind| json!({ "type": kind, "value": code }));
        let keyboard = json!({ "type": "key", "id": "keyboard", "actions": actions });
        self.in_session("POST", "/actions", &json!({ "actions": [keyboard] }));
    }

    /// Errors on the page's console since the last call, but for connections that failed.
    pub fn errors(&self) -> Vec<String> {
        let entries = self.in_session("POST", "/se/log", &json!({ "type": "browser" }));
        let entries = entries.as_array().unwrap().iter().filter(|entry| entry["level"] == "SEVERE");
        let messages = entries.map(|entry| entry["message"].as_str().unwrap().to_owned());
        messages.filter(|message| !message.contains("WebSocket connection to")).collect()
    }

    fn developer(&self, command: &str, parameters: &Value) {
        self.in_session("POST", "/goog/cdp/execute", &json!({ "cmd": command, "params": parameters }));
    }

    fn in_session(&self, method: &str, path: &str, body: &Value) -> Value {
        self.command(method, &format!("{}{path}", self.session), body)
    }

    fn command(&self, method: &str, path: &str, body: &Value) -> Value {
        let answer = self.try_command(method, path, body).expect("chromedriver answers");
        assert!(answer.get("error").is_none(), "{method} {path}: {answer}");
        answer
    }

    fn try_command(&self, method: &str, path: &str, body: &Value) -> Option<Value> {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).ok()?;
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let body = if body.is_null() { String::new() } else { body.to_string() };
        let head = format!(
            "{method} {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Type: application/json\r\n\
             Content-Length: {}\r\n\r\n",
            body.len()
        );
        stream.write_all(format!("{head}{body}").as_bytes()).ok()?;
        let mut answer = Vec::new();
        let mut part = [0; 65536];
        // The driver may keep the connection open: the length says when the answer is whole.
        loop {
            let text = String::from_utf8_lossy(&answer).into_owned();
            if let Some((head, rest)) = text.split_once("\r\n\r\n") {
                let length = head.lines().find_map(|line| {
                    line.to_ascii_lowercase().strip_prefix("content-length:")?.trim().parse().ok()
                });
                if length.is_some_and(|length: usize| rest.len() >= length) {
                    return Some(serde_json::from_str::<Value>(rest).ok()?["value"].clone());
                }
            }
            match stream.read(&mut part).ok()? {
                0 => return None,
                read => answer.extend_from_slice(&part[..read]),
            }
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        self.try_command("DELETE", &self.session, &Value::Null);
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}

fn from_base64(text: &str) -> Vec<u8> {
    let value = |byte: u8| match byte {
        b'A'..=b'Z' => Some(byte - b'A'),
        b'a'..=b'z' => Some(byte - b'a' + 26),
        b'0'..=b'9' => Some(byte - b'0' + 52),
        b'+' => Some(62),
        b'/' => Some(63),
        _ => None,
    };
    let (mut bytes, mut bits, mut count) = (Vec::new(), 0u32, 0);
    for six in text.bytes().filter_map(value) {
        (bits, count) = (bits << 6 | u32::from(six), count + 6);
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
        }
    }
    bytes
}
