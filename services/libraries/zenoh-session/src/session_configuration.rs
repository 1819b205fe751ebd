//! The configuration of a session: what zenoh has by default or a file says, and single keys over it.

use crate::SessionError;
use std::path::Path;

/// The configuration of a session.
#[derive(Clone, Debug, Default)]
pub struct SessionConfiguration(zenoh::Config);

impl SessionConfiguration {
    /// From a file in JSON5, as zenoh documents it.
    ///
    /// # Errors
    /// When it cannot be read, or has keys that zenoh does not know.
    pub fn from_file(path: &Path) -> Result<Self, SessionError> {
        zenoh::Config::from_file(path)
            .map(Self)
            .map_err(|error| SessionError(format!("{}: {error}", path.display())))
    }

    /// Sets a key, such as `listen/endpoints`, to a value in JSON5.
    ///
    /// # Errors
    /// When zenoh does not know the key, or the value is none for it.
    pub fn set(&mut self, key: &str, value: &str) -> Result<(), SessionError> {
        self.0.insert_json5(key, value).map_err(|error| SessionError(format!("{key}: {error}")))
    }

    pub(crate) fn into_inner(self) -> zenoh::Config {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_zenoh_does_not_know_is_refused_with_its_place() {
        let mut configuration = SessionConfiguration::default();
        configuration.set("scouting/multicast/enabled", "false").unwrap();
        let error = configuration.set("listen/endpoint", "[]").unwrap_err();
        assert!(error.to_string().starts_with("listen/endpoint: "), "{error}");
        let error = SessionConfiguration::from_file(Path::new("nowhere.json5")).unwrap_err();
        assert!(error.to_string().starts_with("nowhere.json5: "), "{error}");
    }
}
