//! The file with a robot's secret key and the number of its last epoch.

use crate::settings::FlockSettings;
use flockslam_records::{RecordError, RobotKey};
use flockslam_stage::StageError;
use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// Bytes of the secret.
const SECRET_BYTES: usize = 32;
/// Bytes of the secret and the last epoch behind it.
const FILE_BYTES: usize = SECRET_BYTES + 8;
/// Name of the file of a robot that is given none.
const OWN_FILE: &str = "flock.key";

/// Who a robot is, as a file keeps it: 32 secret bytes (RFC 8032), then the number of its last epoch, little-endian. One file, so that
/// neither is lost without the other: an epoch that is used twice would invalidate all records in it.
pub struct Identity {
    path: PathBuf,
    secret: [u8; SECRET_BYTES],
    epoch: u64,
}

impl Identity {
    /// Reads the file that settings name – or one in the set's own `directory`, which goes with the set – or makes it, for this user's
    /// eyes alone. A file of the secret alone is valid too: no record was signed with it.
    ///
    /// # Errors
    /// When the file is something else, others may read it, or the disk refuses.
    pub fn open(settings: &FlockSettings, directory: &Path) -> Result<Self, StageError> {
        let path = match settings.key_file.as_os_str().is_empty() {
            true => directory.join(OWN_FILE),
            false => settings.key_file.clone(),
        };
        let wrong = |error: std::io::Error| StageError::file(&path, error);
        let file = match File::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == ErrorKind::NotFound => {
                let identity = Self { secret: random().map_err(wrong)?, epoch: 0, path };
                identity.write()?;
                return Ok(identity);
            }
            Err(error) => return Err(wrong(error)),
        };
        if file.metadata().map_err(wrong)?.permissions().mode() & 0o077 != 0 {
            return Err(StageError::file(&path, "a secret that others may read: chmod 600"));
        }
        let mut bytes = Vec::new();
        (&file).take(FILE_BYTES as u64 + 1).read_to_end(&mut bytes).map_err(wrong)?;
        let (secret, epoch) = bytes.split_at(bytes.len().min(SECRET_BYTES));
        match (secret.try_into(), epoch.len()) {
            (Ok(secret), 0) => Ok(Self { path, secret, epoch: 0 }),
            (Ok(secret), 8) => {
                let epoch = u64::from_le_bytes(epoch.try_into().expect("eight bytes"));
                Ok(Self { path, secret, epoch })
            }
            _ => Err(StageError::file(&path, "is not a robot's key: 32 secret bytes, then its epoch")),
        }
    }

    /// The key of the robot of this name.
    ///
    /// # Errors
    /// When the name is not one of a robot.
    pub fn key(&self, name: &str) -> Result<RobotKey, RecordError> {
        RobotKey::new(name, &self.secret)
    }

    /// The last epoch; 0 = no record was published yet.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Begins an epoch that was never used: it is on the disk before any record is published in it.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn begin_epoch(&mut self) -> Result<u64, StageError> {
        self.epoch += 1;
        self.write()?;
        Ok(self.epoch)
    }

    fn write(&self) -> Result<(), StageError> {
        let wrong = |error: std::io::Error| StageError::file(&self.path, error);
        let directory = self.path.parent().filter(|parent| !parent.as_os_str().is_empty());
        let directory = directory.unwrap_or(Path::new("."));
        let beside = self.path.with_extension(format!("new-{}", std::process::id()));
        let write = || {
            std::fs::create_dir_all(directory)?;
            // What a killed process of the same number left.
            let _ = std::fs::remove_file(&beside);
            let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&beside)?;
            file.write_all(&[&self.secret[..], &self.epoch.to_le_bytes()].concat())?;
            file.sync_all()?;
            std::fs::rename(&beside, &self.path)?;
            File::open(directory)?.sync_all()
        };
        write().map_err(wrong)
    }
}

fn random() -> std::io::Result<[u8; SECRET_BYTES]> {
    let mut secret = [0; SECRET_BYTES];
    File::open("/dev/urandom")?.read_exact(&mut secret)?;
    Ok(secret)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_stays_itself_and_never_begins_an_epoch_twice() {
        let directory = tempfile::tempdir().unwrap();
        let open = || Identity::open(&FlockSettings::default(), directory.path()).unwrap();
        let mut first = open();
        assert_eq!(first.begin_epoch().unwrap(), 1);
        let mut second = open();
        assert_eq!(second.epoch(), 1);
        assert_eq!(second.begin_epoch().unwrap(), 2);
        assert_eq!(first.key("a").unwrap().id(), open().key("a").unwrap().id());
        let other = tempfile::tempdir().unwrap();
        let other_identity = Identity::open(&FlockSettings::default(), other.path()).unwrap();
        assert_ne!(first.key("a").unwrap().id(), other_identity.key("a").unwrap().id());
    }

    #[test]
    fn only_a_file_of_the_right_form_and_for_one_user_is_a_key() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("key");
        let settings = FlockSettings { key_file: path.clone(), ..FlockSettings::default() };
        let write = |bytes: &[u8], mode: u32| {
            std::fs::write(&path, bytes).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            Identity::open(&settings, directory.path())
        };
        assert_eq!(write(&[7; 32], 0o600).unwrap().epoch(), 0);
        assert!(write(&[7; 40], 0o600).is_ok());
        assert!(write(&[7; 33], 0o600).is_err() && write(&[7; 41], 0o600).is_err());
        assert!(write(&[7; 32], 0o644).is_err());
        std::fs::remove_file(&path).unwrap();
        Identity::open(&settings, directory.path()).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    }
}
