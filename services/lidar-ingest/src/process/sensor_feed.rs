//! Scans of sensors that speak by themselves – on the socket, through a pipe – with what else they say brought to them, in order of time.

use super::feed::Fed;
use super::lidar_names::LidarNames;
use super::sensor_inlet::{SensorEvent, SensorInlet};
use crate::carmen::{Rejection, Tally};
use crate::continuity::{Continuity, follows};
use crate::scan_locator::{ScanLocator, Sighting};
use crate::settings::Settings;
use flockslam_geometry::Pose;
use flockslam_messages::{STARTS_DETACHED, ScanBuffer};
use flockslam_sensor_stream::{LidarScan, SensorFrame, TransformsReading};
use flockslam_stage::{Mode, StageContext, StageError};
use flockslam_telemetry::monotonic_ns;
use flockslam_transforms::Mounting;
use std::collections::BTreeMap;
use std::time::Duration;

/// While a scan waits for what belongs to it, this is looked at so often.
const LOOK: Duration = Duration::from_millis(5);

/// Scans of sensors, placed on the robot.
pub struct SensorFeed {
    inlet: SensorInlet,
    locator: ScanLocator,
    names: LidarNames,
    mode: Mode,
    /// Names the source in errors.
    name: String,
    /// Nobody listens any more.
    at_end: bool,
    /// The newest stamp so far: the time of a stream that is replayed.
    newest_stamp_ns: i64,
    by_lidar: BTreeMap<u32, LidarState>,
    /// Stamp of the last scan of any lidar.
    last_stamp_ns: Option<i64>,
    /// How often the time of the scans has gone back.
    times_back: u64,
    tally: Tally,
    producers: Producers,
    /// The last scans had no transform, which was logged.
    unplaced_reported: bool,
}

/// What is known of one lidar.
#[derive(Default)]
struct LidarState {
    continuity: Continuity,
    last_stamp_ns: Option<i64>,
}

/// Counts by sender.
#[derive(Clone, Copy, Debug, Default)]
struct Producers {
    came: u64,
    went: u64,
    broken_off: u64,
    /// One of the present producers has sent an invalid frame, which was logged.
    problem_reported: bool,
}

impl SensorFeed {
    /// Reads what comes through `inlet`; `name` stands for the source in errors.
    pub fn new(
        context: &StageContext,
        inlet: SensorInlet,
        name: String,
        settings: &Settings,
    ) -> Result<Self, StageError> {
        let gyro_leads = settings.imu_topic.is_some();
        let locator = match context.mode {
            Mode::Live => ScanLocator::live(settings, gyro_leads),
            Mode::Exact => ScanLocator::new(settings, settings.scan_topics.len(), gyro_leads),
        };
        Ok(Self {
            inlet,
            locator,
            names: LidarNames::open(&context.status_dir, &settings.scan_topics)?,
            mode: context.mode,
            name,
            at_end: false,
            newest_stamp_ns: i64::MIN,
            by_lidar: BTreeMap::new(),
            last_stamp_ns: None,
            times_back: 0,
            tally: Tally::default(),
            producers: Producers::default(),
            unplaced_reported: false,
        })
    }

    /// Gives lidars their numbers before their scans come: in this order.
    pub fn number(&mut self, lidars: impl IntoIterator<Item = String>) -> Result<(), StageError> {
        for lidar in lidars {
            self.names.number(&lidar).map_err(|error| StageError::Source(error.to_string()))?;
        }
        self.locator.set_lidars(self.names.count());
        Ok(())
    }

    /// Counts so far; a frame is a line.
    pub fn tally(&self) -> Tally {
        let of_lines = self.inlet.tally();
        if of_lines.lines > 0 { of_lines } else { self.tally.clone() }
    }

    /// Counts of its own, for the report.
    pub fn counts(&self) -> [(&'static str, u64); 6] {
        let (producers, guesses) = (&self.producers, self.locator.guesses());
        [
            ("producers_came", producers.came),
            ("producers_went", producers.went),
            ("frames_broken_off", producers.broken_off),
            ("odometry_extrapolated", guesses.extrapolated),
            ("odometry_missing", guesses.without),
            ("times_gone_back", self.times_back),
        ]
    }

    /// The name of a lidar; empty where it has none.
    pub fn lidar_name(&self, number: u32) -> String {
        self.names.name(number)
    }

    /// How long nothing can be missed; `None`: until something is received.
    pub fn wait_max(&self) -> Option<Duration> {
        (self.mode == Mode::Live && self.locator.is_waiting()).then_some(LOOK)
    }

    /// The next scan.
    pub fn next(&mut self, scan: &mut ScanBuffer) -> Result<Fed, StageError> {
        loop {
            if let Some(located) = self.locate()? {
                *scan = located;
                if self.is_sound(scan) {
                    return Ok(Fed::Scan);
                }
                continue;
            }
            if self.at_end {
                return self.end();
            }
            match self.inlet.take() {
                Ok(Some(SensorEvent::Scan(received))) => {
                    *scan = received;
                    return Ok(Fed::Scan);
                }
                Ok(Some(event)) => self.handle(event)?,
                Ok(None) => {
                    self.inlet.await_anything(self.locator.is_waiting());
                    return Ok(Fed::NotYet);
                }
                Err(()) => self.at_end = true,
            }
        }
    }

    fn end(&self) -> Result<Fed, StageError> {
        let is_empty = self.tally.scans == 0 && self.tally.lines + self.tally.rejected_lines() > 0;
        if is_empty && self.mode == Mode::Exact {
            let reason = format!("{}: no scan in {} frames", self.name, self.tally.lines);
            return Err(StageError::Source(reason));
        }
        Ok(Fed::End)
    }

    fn handle(&mut self, event: SensorEvent) -> Result<(), StageError> {
        match event {
            SensorEvent::Frame(frame, received_ns) => self.take_frame(frame, received_ns),
            SensorEvent::Scan(_) => {}
            SensorEvent::Came => self.producers.came += 1,
            SensorEvent::Went { within_frame } => {
                self.producers.went += 1;
                self.producers.broken_off += u64::from(within_frame);
                self.producers.problem_reported = false;
                tracing::info!(source = self.name, within_frame, "a producer has gone");
            }
            SensorEvent::Problem(problem) => {
                self.tally.lines += 1;
                self.tally.reject(Rejection::BadFrame);
                if !std::mem::replace(&mut self.producers.problem_reported, true) {
                    tracing::warn!("{}: {problem}: passed over, counted", self.name);
                }
            }
            SensorEvent::Failed(reason) => return Err(StageError::Source(reason)),
        }
        Ok(())
    }

    /// The time at which something is taken as recorded: live that of the clock, else by the stamps.
    fn time_ns(&mut self, stamp_ns: i64, received_ns: u64) -> i64 {
        self.newest_stamp_ns = self.newest_stamp_ns.max(stamp_ns);
        match self.mode {
            Mode::Live => received_ns as i64,
            Mode::Exact => self.newest_stamp_ns,
        }
    }

    fn take_frame(&mut self, frame: SensorFrame, received_ns: u64) {
        self.tally.lines += 1;
        match frame {
            SensorFrame::Scan(scan) => {
                let at_ns = self.time_ns(scan.scan.scan.header.times.sensor_ns, received_ns);
                self.take_scan(scan, at_ns);
            }
            SensorFrame::Odometry(reading) => {
                let at_ns = self.time_ns(reading.transform.stamp_ns, received_ns);
                self.locator.push_odometry(at_ns, &reading);
            }
            SensorFrame::Transforms(TransformsReading { is_static, transforms }) => {
                let stamps = transforms.iter().map(|transform| transform.stamp_ns);
                // Static transforms give no time.
                let newest_ns = stamps.max().filter(|_| !is_static).unwrap_or(i64::MIN);
                let at_ns = self.time_ns(newest_ns, received_ns);
                self.locator.push_transforms(at_ns, &transforms, is_static);
            }
            SensorFrame::Imu(reading) => {
                let at_ns = self.time_ns(reading.stamp_ns, received_ns);
                self.locator.push_imu(at_ns, reading);
            }
        }
    }

    fn take_scan(&mut self, LidarScan { lidar, mut scan }: LidarScan, at_ns: i64) {
        let number = match self.names.number(&lidar) {
            Ok(number) => number,
            Err(problem) => {
                if !self.tally.rejected.contains_key(&Rejection::UnknownLidar) {
                    tracing::warn!("{}: {problem}", self.name);
                }
                self.tally.reject(Rejection::UnknownLidar);
                return;
            }
        };
        if scan.frame.is_empty() {
            // No mounting is given: the lidar's frame is the base frame.
            let middle = Mounting { base_from_laser: Pose::IDENTITY, upside_down: false };
            scan.mounting.get_or_insert(middle);
        }
        self.locator.set_lidars(self.names.count());
        self.locator.push_sighting(at_ns, number, Sighting::Scan(scan));
    }

    /// The next scan that has all that belongs to it. Live, one that cannot be placed is left out.
    fn locate(&mut self) -> Result<Option<ScanBuffer>, StageError> {
        if self.mode == Mode::Live {
            self.locator.note_time(monotonic_ns() as i64);
        }
        loop {
            match self.locator.take(self.at_end) {
                Ok(located) => {
                    self.unplaced_reported &= located.is_none();
                    return Ok(located);
                }
                Err(problem) if self.mode == Mode::Exact => {
                    return Err(StageError::Source(format!("{}: {problem}", self.name)));
                }
                Err(problem) => {
                    let lidar = self.locator.give_up();
                    self.tally.reject(Rejection::Unplaced);
                    if !std::mem::replace(&mut self.unplaced_reported, true) {
                        let lidar = lidar.map(|number| self.names.name(number)).unwrap_or_default();
                        tracing::warn!("{}: scans of lidar '{lidar}' are left out: {problem}", self.name);
                    }
                }
            }
        }
    }

    /// Counts a scan; whether it follows the one before it.
    fn is_sound(&mut self, scan: &mut ScanBuffer) -> bool {
        let state = self.by_lidar.entry(scan.header.id.lidar).or_default();
        if let Some(rejection) = state.continuity.refuses(scan) {
            self.tally.reject(rejection);
            return false;
        }
        let stamp_ns = scan.header.times.sensor_ns;
        let back_ns = state.continuity.back_ns();
        let before_ns = state.last_stamp_ns.replace(stamp_ns);
        let of_all_ns = self.last_stamp_ns.replace(stamp_ns);
        // Scans of other lidars follow the first one that went back.
        let is_first = back_ns.zip(of_all_ns).is_some_and(|(_, of_all_ns)| !follows(stamp_ns, of_all_ns));
        if is_first && self.mode == Mode::Live {
            self.times_back += 1;
            scan.header.starts_at_odometry = STARTS_DETACHED;
            let back_s = back_ns.unwrap_or_default() as f64 * 1e-9;
            tracing::warn!(
                "{}: the time of its scans has gone back by {back_s:.1} s: a new trajectory begins",
                self.name
            );
        }
        self.tally.steps_backward += u64::from(before_ns.is_some_and(|before_ns| stamp_ns <= before_ns));
        scan.header.id.sequence = self.tally.scans;
        self.tally.scans += 1;
        let limits = scan.header.range_min_m..=scan.header.range_max_m;
        let ranges = &scan.numbers[..scan.header.beam_count as usize];
        self.tally.invalid_beams += ranges.iter().filter(|range| !limits.contains(*range)).count() as u64;
        true
    }
}
