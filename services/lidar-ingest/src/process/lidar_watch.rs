//! Which lidar gave how many scans, and when its last: for status and metrics.

use flockslam_results::LidarStatus;
use flockslam_stage::StageContext;
use flockslam_telemetry::{Counter, CountersByLabels, Gauge, GaugesByLabels, names};

/// Period at which the status of lidars is written, nanoseconds.
const PERIOD_NS: u64 = 500_000_000;

/// What is known of each lidar, by number.
pub struct LidarWatch {
    counters: CountersByLabels,
    ages: GaugesByLabels,
    lidars: Vec<Watched>,
    written_ns: u64,
    /// Scans of all of them when it was written.
    written_scans: u64,
}

struct Watched {
    status: LidarStatus,
    scans: Counter,
    age: Gauge,
    /// The warning about its silence was logged.
    silence_reported: bool,
}

impl LidarWatch {
    /// Of a stage's process.
    pub fn new(context: &StageContext) -> Self {
        let labels = [names::LABEL_LIDAR];
        Self {
            counters: context.metrics.counters_by(names::LIDAR_SCANS, &labels),
            ages: context.metrics.gauges_by(names::LIDAR_AGE, &labels),
            lidars: Vec::new(),
            written_ns: 0,
            written_scans: 0,
        }
    }

    /// A scan of a lidar was given to the set; `name` gives the names of lidars by number.
    pub fn gave(&mut self, lidar: u32, now_ns: u64, name: impl Fn(u32) -> String) {
        while self.lidars.len() <= lidar as usize {
            let name = name(self.lidars.len() as u32);
            let (scans, age) = (self.counters.one(&[&name]), self.ages.one(&[&name]));
            let status = LidarStatus { lidar: name, ..LidarStatus::default() };
            self.lidars.push(Watched { status, scans, age, silence_reported: false });
        }
        let watched = &mut self.lidars[lidar as usize];
        watched.scans.inc();
        (watched.status.scans, watched.status.last_ns) = (watched.status.scans + 1, now_ns);
    }

    /// Writes the status, when that was not done for a while. A lidar that is silent while another goes on is logged.
    pub fn look(&mut self, context: &StageContext, now_ns: u64) {
        let others_active = self.lidars.iter().any(|lidar| !lidar.status.is_silent(now_ns));
        for Watched { status, age, silence_reported, .. } in &mut self.lidars {
            if status.scans == 0 {
                continue;
            }
            age.set(status.age_s(now_ns));
            let is_silent = status.is_silent(now_ns);
            if is_silent && others_active && !std::mem::replace(silence_reported, true) {
                tracing::warn!("lidar '{}' has fallen silent: the set goes on without it", status.lidar);
            } else if !is_silent && std::mem::take(silence_reported) {
                tracing::warn!("lidar '{}' is back", status.lidar);
            }
        }
        let scans = self.lidars.iter().map(|lidar| lidar.status.scans).sum();
        if scans == self.written_scans || now_ns.saturating_sub(self.written_ns) < PERIOD_NS {
            return;
        }
        (self.written_ns, self.written_scans) = (now_ns, scans);
        let statuses = self.lidars.iter().map(|watched| watched.status.clone());
        let measuring: Vec<LidarStatus> = statuses.filter(|status| status.scans > 0).collect();
        if let Err(error) = LidarStatus::write(&measuring, &context.status_dir) {
            tracing::warn!(%error, "it is not left how lidars are");
        }
    }
}
