//! Beams of a lidar that turns all the time become turns.

use crate::{Counts, Turn};

/// A turn with fewer degrees than this between its first and its last beam is partial: the first one, or a torn one.
const SPAN_MIN_DEG: f64 = 300.0;
/// A turn with more degrees has missed the mark of the next one.
const SPAN_MAX_DEG: f64 = 380.0;
/// After a silence of this long nothing is known of the rotation: the turn is given up.
const SILENCE_NS: i64 = 500_000_000;
/// A step back of up to this many degrees is an uneven rotation, not the way around.
const STEP_BACK_DEG: f64 = 30.0;
/// Default for a lidar that neither reports its speed nor shows it by its arrivals.
const SPEED_HZ: f64 = 10.0;
/// A change of speed is one of more than this share.
const SPEED_CHANGE: f64 = 0.1;
/// More beams in a turn than any lidar has: the rotation stands.
const BEAMS_MAX: usize = 20_000;

/// One beam of a lidar that counts degrees clockwise as seen from above.
#[derive(Clone, Copy)]
pub(crate) struct Beam {
    /// Where the head stood, degrees clockwise.
    pub head_deg: f64,
    /// Where the beam went, degrees clockwise: of lidars that triangulate not quite the same.
    pub direction_deg: f64,
    /// The range, metres; 0 for none.
    pub range_m: f32,
    /// Strength of the return.
    pub intensity: f32,
}

/// Collects beams until the head has gone around.
///
/// A beam's time follows from how far the head had turned and from its speed. A turn's stamp is the earliest that any of its
/// packets allows: packets come late by what the transport buffers, never early.
pub(crate) struct Assembly {
    turn: Turn,
    done: Turn,
    /// How far the head had turned at each beam, degrees from the first.
    progress_deg: Vec<f64>,
    /// Packets: how far the head had turned with its last beam, degrees, and when that beam was measured at the latest.
    arrivals: Vec<(f64, i64)>,
    head_deg: Option<f64>,
    last_arrival_ns: Option<i64>,
    last_speed_hz: Option<f64>,
    has_intensities: bool,
}

impl Assembly {
    /// For a lidar with or without strengths of returns. Ranges are limited to these, metres.
    pub fn new(range_min_m: f32, range_max_m: f32, has_intensities: bool) -> Self {
        let limits = || Turn { range_min_m, range_max_m, ..Turn::default() };
        Self {
            turn: limits(),
            done: limits(),
            progress_deg: Vec::new(),
            arrivals: Vec::new(),
            head_deg: None,
            last_arrival_ns: None,
            last_speed_hz: None,
            has_intensities,
        }
    }

    /// Sets the greatest range, metres.
    pub fn set_range_max(&mut self, range_max_m: f32) {
        (self.turn.range_max_m, self.done.range_max_m) = (range_max_m, range_max_m);
    }

    /// Sets whether returns have strengths.
    pub fn set_intensities(&mut self, has_intensities: bool) {
        if has_intensities != self.has_intensities {
            self.give_up();
            self.done.clear();
            self.has_intensities = has_intensities;
        }
    }

    /// A packet begins whose last byte came at `arrival_ns`.
    pub fn begin_packet(&mut self, arrival_ns: i64, counts: &mut Counts) {
        let silence =
            self.last_arrival_ns.replace(arrival_ns).is_some_and(|last| arrival_ns - last > SILENCE_NS);
        if (silence || self.turn.len() > BEAMS_MAX) && !self.turn.is_empty() {
            counts.partial_turns += 1;
            self.give_up();
        }
    }

    /// Whether a beam with the head here belongs to the next turn: zero has been passed. A turn that was cut ahead of zero may have
    /// its first beam just before it.
    pub fn is_around(&self, head_deg: f64) -> bool {
        self.turn.len() > 1 && self.head_deg.is_some_and(|last| last - head_deg > 180.0)
    }

    /// Whether the head has gone clearly further than around: the mark of a new turn was lost.
    pub fn is_over_full(&self) -> bool {
        self.progress_deg.last().is_some_and(|last| *last > SPAN_MAX_DEG)
    }

    /// How far the head turns from its last place to here, degrees.
    pub fn step_deg(&self, head_deg: f64) -> f64 {
        let Some(last) = self.head_deg else { return 0.0 };
        let step = (head_deg - last).rem_euclid(360.0);
        if step > 360.0 - STEP_BACK_DEG { step - 360.0 } else { step }
    }

    /// Takes a beam.
    pub fn push(&mut self, beam: Beam) {
        let last = self.progress_deg.last().copied();
        self.progress_deg.push(last.map_or(0.0, |last| last + self.step_deg(beam.head_deg)));
        self.head_deg = Some(beam.head_deg);
        self.turn.ranges_m.push(beam.range_m);
        self.turn.angles_rad.push(-beam.direction_deg.to_radians() as f32);
        if self.has_intensities {
            self.turn.intensities.push(beam.intensity);
        }
    }

    /// A packet has ended: its last beam was measured at `measured_ns` at the latest.
    pub fn end_packet(&mut self, measured_ns: i64) {
        if let Some(last) = self.progress_deg.last() {
            self.arrivals.push((*last, measured_ns));
        }
    }

    /// Ends the turn. `speed_hz` when the lidar reports it; else it follows from the arrivals.
    pub fn cut(&mut self, speed_hz: Option<f64>, counts: &mut Counts, give: &mut dyn FnMut(&Turn)) {
        let span_deg = self.progress_deg.last().copied().unwrap_or(0.0);
        if span_deg < SPAN_MIN_DEG {
            counts.partial_turns += u64::from(!self.turn.is_empty());
            self.give_up();
            return;
        }
        let plausible = |speed: &f64| (0.5..100.0).contains(speed);
        let speed_hz = speed_hz.filter(plausible).or_else(|| self.speed_by_arrivals_hz().filter(plausible));
        let speed_hz = speed_hz.or(self.last_speed_hz).unwrap_or(SPEED_HZ);
        let changes = |last: f64| (speed_hz - last).abs() > SPEED_CHANGE * last;
        counts.speed_changes += u64::from(self.last_speed_hz.replace(speed_hz).is_some_and(changes));
        let s_per_deg = 1.0 / (360.0 * speed_hz);
        self.turn.times_s.extend(self.progress_deg.iter().map(|deg| (deg * s_per_deg) as f32));
        let begun = |(deg, ns): &(f64, i64)| ns - (deg * s_per_deg * 1e9) as i64;
        self.turn.begun_ns = self.arrivals.iter().map(begun).min().unwrap_or(0);
        self.turn.speed_hz = speed_hz;
        std::mem::swap(&mut self.turn, &mut self.done);
        self.give_up();
        counts.turns += 1;
        give(&self.done);
    }

    /// The speed of this turn when each of its beams took this long, seconds.
    pub fn speed_by_samples_hz(&self, sample_s: f64) -> Option<f64> {
        let steps = self.progress_deg.len().checked_sub(1)? as f64;
        Some(self.progress_deg.last()? / 360.0 / (steps * sample_s)).filter(|speed| speed.is_finite())
    }

    fn speed_by_arrivals_hz(&self) -> Option<f64> {
        let ((from_deg, from_ns), (to_deg, to_ns)) = (self.arrivals.first()?, self.arrivals.last()?);
        Some((to_deg - from_deg) / 360.0 / ((to_ns - from_ns) as f64 * 1e-9))
            .filter(|speed| speed.is_finite())
    }

    /// Drops the turn so far.
    fn give_up(&mut self) {
        self.turn.clear();
        self.progress_deg.clear();
        self.arrivals.clear();
    }
}
