//! One interface to all sources of scans – log, recording, pipe, socket, simulation – with the experiment's changes applied.

use super::live_lidars::listen_to;
use super::pipe::read_pipe;
use super::recording_reader::RecordingReader;
use super::scan_socket::{SCAN_SOCKET, listen_at};
use super::sensor_feed::SensorFeed;
use super::topic_choice::ReadRecordingError;
use super::truth_file::TruthWriter;
use super::{Source, Task, first_stages, world_file};
use crate::carmen::{CarmenReader, ShiftedOdometry, Tally};
use crate::experiment::Experiment;
use crate::self_mask::mask;
use crate::{LidarCalibration, Settings};
use flockslam_messages::ScanBuffer;
use flockslam_recordings::is_recording;
use flockslam_simulation::{Simulation, World};
use flockslam_stage::{StageContext, StageError};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::time::Duration;

/// Scans one after another, from whatever source, with the experiment's changes applied.
pub struct Feed {
    kind: Kind,
    calibration: Vec<LidarCalibration>,
    self_mask: Vec<[f64; 4]>,
    experiment: Experiment,
}

enum Kind {
    Log(Box<CarmenReader<BufReader<File>>>, ShiftedOdometry),
    Recording(Box<RecordingReader>),
    Sensors(Box<SensorFeed>),
    Simulation { simulation: Box<Simulation>, truth: TruthWriter },
    Nothing,
}

/// The result of a feed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fed {
    /// The next scan.
    Scan,
    /// Nothing for now.
    NotYet,
    /// Nothing any more.
    End,
}

const BUFFER_BYTES: usize = 1 << 20;

impl Feed {
    /// Opens the source.
    pub fn open(context: &StageContext, task: &Task) -> Result<Self, StageError> {
        let (kind, expected) = match &task.source {
            Source::Log(path) if is_recording(path) => {
                let reader = RecordingReader::open(path, &task.settings).map_err(of_recording)?;
                let expected = reader.expected_scans();
                (Kind::Recording(Box::new(reader)), expected)
            }
            Source::Log(path) => {
                let expected = count_scans(path, &task.settings)?;
                let reader = BufReader::with_capacity(BUFFER_BYTES, open(path)?);
                let name = path.display().to_string();
                let reader = Box::new(CarmenReader::new(reader, name, task.settings.clone()));
                (Kind::Log(reader, ShiftedOdometry::new(task.settings.offset_ns(0))), expected)
            }
            Source::Pipe => {
                let inlet = read_pipe(context, task.settings.clone(), first_stages(context.mode))?;
                let feed = SensorFeed::new(context, inlet, "standard input".to_owned(), &task.settings)?;
                (Kind::Sensors(Box::new(feed)), 0)
            }
            Source::Scans(path) => {
                let path = path.clone().unwrap_or_else(|| context.set_dir().join(SCAN_SOCKET));
                let inlet = listen_at(context, &path)?;
                let feed = SensorFeed::new(context, inlet, path.display().to_string(), &task.settings)?;
                (Kind::Sensors(Box::new(feed)), 0)
            }
            Source::Lidars(lidars) => {
                let mut feed = SensorFeed::new(
                    context,
                    listen_to(context, lidars)?,
                    "lidars".to_owned(),
                    &task.settings,
                )?;
                feed.number(lidars.iter().map(|lidar| lidar.name.clone()))?;
                (Kind::Sensors(Box::new(feed)), 0)
            }
            Source::Simulation => {
                let built_in = || Ok(World::built_in(&task.simulation));
                let world = task.world.as_deref().map_or_else(built_in, world_file::read)?;
                let simulation = Simulation::new(&task.simulation, world);
                let simulation = Box::new(simulation.map_err(|e| StageError::Source(e.to_string()))?);
                let total = simulation.scans() as u64;
                (Kind::Simulation { simulation, truth: TruthWriter::create(&context.result_dir)? }, total)
            }
            Source::Nothing => (Kind::Nothing, 0),
        };
        let (calibration, self_mask) = (task.settings.calibration.clone(), task.settings.self_mask.clone());
        Ok(Self { kind, calibration, self_mask, experiment: Experiment::new(&task.settings, expected) })
    }

    /// Goes past the scans that a predecessor has sent. Simulating hours of driving again takes longer than a stage may be silent.
    pub fn skip(&mut self, context: &mut StageContext, scans: u64) -> Result<(), StageError> {
        // What sensors have sent is gone with the process that received it.
        if self.is_sensor() {
            return Ok(());
        }
        let mut scan = ScanBuffer::default();
        for _ in 0..scans {
            if context.stop.is_set() || self.next(&mut scan)? != Fed::Scan {
                break;
            }
            context.alive();
        }
        Ok(())
    }

    /// Whether it goes on by itself, also without a receiver.
    pub fn is_sensor(&self) -> bool {
        matches!(self.kind, Kind::Sensors(_))
    }

    /// The next scan.
    pub fn next(&mut self, scan: &mut ScanBuffer) -> Result<Fed, StageError> {
        let source = |error: crate::carmen::ReadError| StageError::Source(error.to_string());
        let fed = match &mut self.kind {
            Kind::Log(reader, odometry) => match odometry.next_scan(reader, scan).map_err(source)? {
                true => Fed::Scan,
                false => Fed::End,
            },
            Kind::Recording(reader) => match reader.next_scan(scan).map_err(of_recording)? {
                true => Fed::Scan,
                false => Fed::End,
            },
            Kind::Sensors(sensors) => sensors.next(scan)?,
            Kind::Simulation { simulation, truth } => match simulation.next_scan(scan) {
                Some(pose) => {
                    truth.push(scan.header.times.sensor_ns, pose);
                    Fed::Scan
                }
                None => Fed::End,
            },
            Kind::Nothing => Fed::End,
        };
        if fed == Fed::Scan {
            let header = &mut scan.header;
            if let Some(known) = self.calibration.get(header.id.lidar as usize) {
                header.base_from_laser = known.corrected(header.base_from_laser);
            }
            mask(scan, &self.self_mask);
            self.experiment.apply(scan);
        }
        Ok(fed)
    }

    /// Counts for the report.
    pub fn tally(&self) -> Option<Tally> {
        match &self.kind {
            Kind::Log(reader, _) => Some(reader.tally().clone()),
            Kind::Recording(reader) => Some(reader.tally().clone()),
            Kind::Sensors(sensors) => Some(sensors.tally()),
            Kind::Simulation { .. } | Kind::Nothing => None,
        }
    }

    /// The name of a lidar; its number where it has none.
    pub fn lidar_name(&self, number: u32) -> String {
        let name = match &self.kind {
            Kind::Sensors(sensors) => sensors.lidar_name(number),
            Kind::Recording(reader) => {
                reader.scan_topics().nth(number as usize).unwrap_or_default().to_owned()
            }
            _ => String::new(),
        };
        if name.is_empty() { number.to_string() } else { name }
    }

    /// Counts of its own, by name.
    pub fn counts(&self) -> Vec<(&'static str, u64)> {
        match &self.kind {
            Kind::Sensors(sensors) => sensors.counts().to_vec(),
            _ => Vec::new(),
        }
    }

    /// How long nothing can be missed; `None`: until the stage is woken.
    pub fn wait_max(&self) -> Option<Duration> {
        match &self.kind {
            Kind::Sensors(sensors) => sensors.wait_max(),
            _ => None,
        }
    }

    /// Why the source ended before its end.
    pub fn cut_short(&self) -> Option<&str> {
        match &self.kind {
            Kind::Recording(reader) => reader.cut_short(),
            _ => None,
        }
    }

    /// What ended before the source did, a line each.
    pub fn ended_early(&self) -> Vec<String> {
        match &self.kind {
            Kind::Recording(reader) => reader.ended_early(),
            _ => Vec::new(),
        }
    }

    /// Stores the simulation's exact trajectory beside the results.
    pub fn store_truth(&mut self) -> Result<(), StageError> {
        match &mut self.kind {
            Kind::Simulation { truth, .. } => truth.finish(),
            _ => Ok(()),
        }
    }
}

fn open(path: &Path) -> Result<File, StageError> {
    File::open(path).map_err(|error| StageError::Source(format!("{}: {error}", path.display())))
}

fn of_recording(error: ReadRecordingError) -> StageError {
    StageError::Source(error.to_string())
}

/// Scans of a log or a recording: what experiments spread their events over, and what progress is measured against.
///
/// # Errors
/// When the file cannot be read.
pub fn count_scans(path: &Path, settings: &Settings) -> Result<u64, StageError> {
    if is_recording(path) {
        return Ok(RecordingReader::open(path, settings).map_err(of_recording)?.expected_scans());
    }
    let mut reader = BufReader::with_capacity(BUFFER_BYTES, open(path)?);
    let unreadable = |error| StageError::Source(format!("{}: {error}", path.display()));
    let (mut scans, mut line_begins) = (0, true);
    loop {
        let bytes = reader.fill_buf().map_err(unreadable)?;
        if bytes.is_empty() {
            return Ok(scans);
        }
        // A line that straddles two fills may be missed: this is an estimate.
        for line in bytes.split_inclusive(|byte| *byte == b'\n') {
            scans +=
                u64::from(line_begins && (line.starts_with(b"FLASER") || line.starts_with(b"ROBOTLASER1")));
            line_begins = line.ends_with(b"\n");
        }
        let length = bytes.len();
        reader.consume(length);
    }
}
