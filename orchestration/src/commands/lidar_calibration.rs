//! Estimates where the lidars of a run sit, from the poses in its journal.

use crate::configuration::Configuration;
use crate::outputs::CalibrationRow;
use flockslam_calibration::{DriveSample, DriveSamples, estimate};
use flockslam_geometry::Pose;
use flockslam_lidar_ingest::LidarCalibration;
use flockslam_messages::{PoseEstimate, PoseFlags, Quality};
use flockslam_stage::{JournalReader, StageError};
use std::collections::BTreeMap;
use std::path::Path;

/// What the journal has of one lidar.
#[derive(Default)]
struct Driven {
    samples: DriveSamples,
    /// Where it was taken to sit: accepted scans say so.
    assumed: Option<Pose>,
}

/// Of each lidar with odometry, what the journal in a directory tells of it from a sequence on. A lidar of which it says nothing has no
/// row.
///
/// # Errors
/// When the journal cannot be read.
pub fn of_journal(
    journal_dir: &Path,
    first_sequence: u64,
    configuration: &Configuration,
) -> Result<Vec<CalibrationRow>, StageError> {
    let mut lidars: BTreeMap<u32, Driven> = BTreeMap::new();
    let mut journal = JournalReader::open(journal_dir)?;
    while let Some(record) = journal.read_next()? {
        let pose = &record.pose;
        if pose.id.sequence < first_sequence || !pose.has(PoseFlags::HAS_ODOMETRY) {
            continue;
        }
        let driven = lidars.entry(pose.id.lidar).or_default();
        driven.assumed = driven.assumed.or(record.scan.map(|scan| scan.header.base_from_laser));
        driven.samples.push(sample(pose));
    }
    let row = |(lidar, driven): (u32, Driven)| {
        let assumed = driven.assumed?;
        let found = estimate(&driven.samples, assumed).ok()?;
        Some(CalibrationRow::new(lidar, assumed, configured(configuration, lidar).offset_s, &found))
    };
    Ok(lidars.into_iter().filter_map(row).collect())
}

/// What the configuration says of a lidar already.
pub fn configured(configuration: &Configuration, lidar: u32) -> LidarCalibration {
    configuration.lidar_ingest.calibration.get(lidar as usize).cloned().unwrap_or_default()
}

/// The value of `lidar_ingest.calibration` that uses what these rows know, over what is configured.
pub fn setting(rows: &[CalibrationRow], configuration: &Configuration) -> String {
    let mut lidars = configuration.lidar_ingest.calibration.clone();
    for row in rows {
        let at = row.lidar as usize;
        lidars.resize(lidars.len().max(at + 1), LidarCalibration::default());
        lidars[at] = row.setting(&configured(configuration, row.lidar));
    }
    let table = |lidar: &LidarCalibration| {
        let places = [("x_m", lidar.x_m), ("y_m", lidar.y_m), ("heading_deg", lidar.heading_deg)];
        let places = places.into_iter().filter_map(|(key, value)| Some(format!("{key}={:?}", value?)));
        let all: Vec<String> = places.chain([format!("offset_s={:?}", lidar.offset_s)]).collect();
        format!("{{{}}}", all.join(", "))
    };
    format!("[{}]", lidars.iter().map(table).collect::<Vec<_>>().join(", "))
}

fn sample(pose: &PoseEstimate) -> DriveSample {
    // Where odometry helped out, the pose says nothing beside it.
    let is_fit = pose.has(PoseFlags::MATCHED)
        && !pose.has(PoseFlags::OPEN)
        && pose.quality == Quality::Tracking as u32;
    DriveSample {
        stamp_ns: pose.times.sensor_ns,
        world_from_base: is_fit.then_some(pose.odom_from_base),
        odometry: pose.odometry,
        trajectory: pose.trajectory,
    }
}
