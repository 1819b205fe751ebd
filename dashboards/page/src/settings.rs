//! Settings of the live page, the section `[page]` of the configuration.

use crate::Guard;
use serde::{Deserialize, Serialize};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

/// A token of fewer characters can be guessed.
const TOKEN_CHARACTERS_MIN: usize = 16;

/// The live page of `flockslam up` and of a run with `--live`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Whether the page is served.
    pub enabled: bool,
    /// Address and port at which it is served. Beyond this machine (any other address than 127.0.0.1 or `[::1]`) everybody who reaches
    /// the address sees the map.
    pub listen: SocketAddr,
    /// File with the token that the page's buttons ask for, at least 16 characters. Without it they work only for requests from this machine,
    /// while `listen` is an address of this machine.
    pub token_file: Option<PathBuf>,
    /// Directory in which the page's button saves the map, each time under a new name; without it there is no such button.
    pub save_dir: Option<PathBuf>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            enabled: true,
            listen: SocketAddr::from((Ipv4Addr::LOCALHOST, 8470)),
            token_file: None,
            save_dir: None,
        }
    }
}

/// Why a page cannot be served with these settings.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// The token cannot be read.
    #[error("page.token_file: {path}: {source}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Message of the system.
        source: std::io::Error,
    },
    /// The token is not a secret.
    #[error("page.token_file: {0}: a token needs at least {TOKEN_CHARACTERS_MIN} characters")]
    Short(PathBuf),
}

impl Settings {
    /// Who may see the page and use its buttons. `host_name` is the name of this machine.
    ///
    /// # Errors
    /// When the token cannot be read or is too short.
    pub fn guard(&self, host_name: &str) -> Result<Guard, SettingsError> {
        let token = self.token_file.as_ref().map(|path| {
            let text = std::fs::read_to_string(path);
            let text = text.map_err(|source| SettingsError::Unreadable { path: path.clone(), source })?;
            let token = text.trim().to_owned();
            let is_long = token.chars().count() >= TOKEN_CHARACTERS_MIN;
            is_long.then_some(token).ok_or_else(|| SettingsError::Short(path.clone()))
        });
        Ok(Guard::new(self.listen, host_name, token.transpose()?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_read_from_its_file_and_must_be_one() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("token");
        let settings = Settings { token_file: Some(path.clone()), ..Settings::default() };
        assert!(matches!(settings.guard("r1"), Err(SettingsError::Unreadable { .. })));
        std::fs::write(&path, "too short\n").unwrap();
        assert!(matches!(settings.guard("r1"), Err(SettingsError::Short(_))));
        std::fs::write(&path, "0123456789abcdef\n").unwrap();
        let guard = settings.guard("r1").unwrap();
        assert!(guard.may_order(Some("0123456789abcdef")) && !guard.may_order(None));
    }
}
