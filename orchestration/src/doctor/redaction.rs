//! Takes secrets out of texts that leave the machine.

use std::path::Path;

/// What stands where a secret was.
const REMOVED: &str = "[removed]";
/// Lines with such a word are taken for the head of a key in a PEM file.
const PEM_KEY: &str = "PRIVATE KEY";
/// Shorter words of a file of secrets are no secrets, and would be found by accident.
const WORD_MIN: usize = 8;
/// Secret bytes of a robot's key.
const KEY_BYTES: usize = 32;

/// The secrets of a set: contents of its key and token files.
#[derive(Default)]
pub struct Redaction {
    secrets: Vec<String>,
}

impl Redaction {
    /// Takes note of all words of a file with a secret. A file that is not there, or that this user may not read, has none here.
    pub fn add_file(&mut self, path: &Path) {
        let Ok(bytes) = std::fs::read(path) else { return };
        match std::str::from_utf8(&bytes) {
            Ok(text) => {
                let words = text.split(|c: char| c.is_whitespace() || "\"',;:={}[]".contains(c));
                self.secrets.extend(words.filter(|word| word.len() >= WORD_MIN).map(str::to_owned));
            }
            // A robot's key begins with its secret.
            Err(_) => {
                let secret = &bytes[..bytes.len().min(KEY_BYTES)];
                self.secrets.push(data_encoding::HEXLOWER.encode(secret));
                self.secrets.push(data_encoding::BASE64.encode(secret));
            }
        }
        // Of two of which one contains the other the longer goes first.
        self.secrets.sort_by_key(|secret| std::cmp::Reverse(secret.len()));
    }

    /// The text without secrets.
    pub fn clean(&self, text: &str) -> String {
        let mut clean = text.to_owned();
        for secret in &self.secrets {
            clean = clean.replace(secret, REMOVED);
        }
        let lines = clean.lines().map(|line| if line.contains(PEM_KEY) { REMOVED } else { line });
        let mut clean = lines.collect::<Vec<_>>().join("\n");
        if text.ends_with('\n') {
            clean.push('\n');
        }
        clean
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_word_of_a_secret_stays_in_a_text() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("token");
        std::fs::write(&path, "correct-horse-battery\n").unwrap();
        let mut redaction = Redaction::default();
        redaction.add_file(&path);
        redaction.add_file(Path::new("/nowhere/at/all"));
        let text = "a\nGET /?token=correct-horse-battery HTTP\n-----BEGIN PRIVATE KEY-----\nb\n";
        assert_eq!(redaction.clean(text), "a\nGET /?token=[removed] HTTP\n[removed]\nb\n");
        assert_eq!(Redaction::default().clean("plain"), "plain");
    }

    #[test]
    fn the_key_of_a_robot_stays_out_in_each_spelling() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("flock.key");
        std::fs::write(&path, [[0xab; 32].as_slice(), &7_u64.to_le_bytes()].concat()).unwrap();
        let mut redaction = Redaction::default();
        redaction.add_file(&path);
        let spelled = format!("x {} y {} z", "ab".repeat(32), data_encoding::BASE64.encode(&[0xab; 32]));
        assert_eq!(redaction.clean(&spelled), "x [removed] y [removed] z");
    }
}
