//! Tracks of moving bodies: clusters of points in known-free space, followed from scan to scan.

mod cluster;
mod track_filter;

use cluster::find_centers;
use flockslam_geometry::Point;
use flockslam_messages::Track;
use track_filter::Motion;

/// A sighting farther from a track than this, squared Mahalanobis distance, is another object (χ², two degrees of freedom,
/// 99 %) …
const GATE: f64 = 9.2;
/// … as is one farther than this, metres.
const GATE_M: f64 = 1.0;
/// A track is confirmed after so many sightings.
const SIGHTINGS_MIN: u32 = 3;
/// A confirmed track, and one not yet confirmed, end after so many seconds out of sight.
const DROPPED_AFTER_S: (f64, f64) = (1.5, 0.35);
/// After a pause of this many seconds all tracks end.
const PAUSE_MAX_S: f64 = 3.0;
/// A hidden person who turns or stops reappears elsewhere than expected: within this distance of the last sighting,
/// metres, and so much farther for each second …
const REACH: (f64, f64) = (0.4, 1.8);
/// Greatest number of tracks.
const TRACKS_MAX: usize = 256;

/// Follows clusters of points by constant velocity, each to the nearest sighting within a gate.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tracker {
    followed: Vec<Followed>,
    next_id: u64,
    last_ns: Option<i64>,
    centers: Vec<Point>,
    /// Tracks and sightings within the gate with their surprise, the least first.
    pairs: Vec<(f64, usize, usize)>,
    taken: Vec<bool>,
    tracks: Vec<Track>,
}

#[derive(Clone, Copy, Debug)]
struct Followed {
    id: u64,
    motion: Motion,
    /// Where the last sighting was.
    seen: Point,
    sightings: u32,
    age_s: f64,
    unseen_s: f64,
}

impl Tracker {
    /// Takes the points of a scan on moving bodies, in the order of its beams, and gives the confirmed tracks.
    /// Points and lidar are in odom, metres.
    pub fn follow(&mut self, stamp_ns: i64, points: &[Point], laser: Point) -> &[Track] {
        self.predict(stamp_ns);
        find_centers(points, laser, &mut self.centers);
        self.associate();
        self.welcome();
        self.recognise();
        self.followed.retain(|followed| !followed.is_stale());
        self.tracks.clear();
        let confirmed = self.followed.iter().filter(|followed| followed.sightings >= SIGHTINGS_MIN);
        self.tracks.extend(confirmed.map(Followed::track));
        &self.tracks
    }

    /// Time goes on. Stamps of logs may run backwards: then it stands still.
    fn predict(&mut self, stamp_ns: i64) {
        let since_s = self.last_ns.map_or(0.0, |last_ns| (stamp_ns - last_ns) as f64 * 1e-9);
        self.last_ns = Some(stamp_ns);
        if since_s.abs() > PAUSE_MAX_S {
            self.followed.clear();
        }
        for followed in self.followed.iter_mut().filter(|_| since_s > 0.0) {
            followed.motion.predict(since_s);
            followed.age_s += since_s;
            followed.unseen_s += since_s;
        }
    }

    /// Gives each track its sighting: the likeliest pair first, each track and each sighting once.
    fn associate(&mut self) {
        self.pairs.clear();
        for (track, followed) in self.followed.iter().enumerate() {
            for (sighting, center) in self.centers.iter().enumerate() {
                let distance = followed.motion.squared_distance(*center);
                if distance < GATE && followed.motion.position.distance_m(*center) < GATE_M {
                    self.pairs.push((followed.motion.surprise(*center), track, sighting));
                }
            }
        }
        self.pairs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        self.taken.clear();
        self.taken.resize(self.centers.len(), false);
        for (_, track, sighting) in &self.pairs {
            let followed = &mut self.followed[*track];
            if !self.taken[*sighting] && (followed.unseen_s > 0.0 || followed.sightings == 0) {
                self.taken[*sighting] = true;
                followed.motion.correct(self.centers[*sighting]);
                followed.seen = self.centers[*sighting];
                followed.sightings += 1;
                followed.unseen_s = 0.0;
            }
        }
    }

    /// Begins a track for each cluster that no track explains.
    fn welcome(&mut self) {
        for (center, taken) in self.centers.iter().zip(&self.taken) {
            if !taken && self.followed.len() < TRACKS_MAX {
                let motion = Motion::at(*center);
                let id = self.next_id;
                self.followed.push(Followed {
                    id,
                    motion,
                    seen: *center,
                    sightings: 1,
                    age_s: 0.0,
                    unseen_s: 0.0,
                });
                self.next_id += 1;
            }
        }
    }
}

impl Tracker {
    /// A track that is newly confirmed may be a person who was hidden, and has turned or stopped meanwhile: then it keeps
    /// the number of the hidden track. Of several the nearest one is chosen.
    fn recognise(&mut self) {
        for new in 0..self.followed.len() {
            let found = self.followed[new];
            if found.sightings != SIGHTINGS_MIN || found.unseen_s > 0.0 {
                continue;
            }
            let expected_m = |other: &usize| self.followed[*other].motion.position.distance_m(found.seen);
            let hidden = (0..self.followed.len()).filter(|other| self.followed[*other].could_be(&found));
            let Some(nearest) = hidden.min_by(|a, b| expected_m(a).total_cmp(&expected_m(b))) else {
                continue;
            };
            let known = &mut self.followed[nearest];
            let age_s = known.age_s;
            *known = Followed { id: known.id, sightings: known.sightings + found.sightings, age_s, ..found };
            // Out of sight for ever: it is dropped at once.
            self.followed[new].unseen_s = f64::INFINITY;
        }
    }
}

impl Followed {
    /// Whether a hidden confirmed track may be the person that was found.
    fn could_be(&self, found: &Followed) -> bool {
        self.sightings >= SIGHTINGS_MIN
            && self.id != found.id
            && self.unseen_s > found.age_s
            && self.unseen_s.is_finite()
            && self.seen.distance_m(found.seen) < REACH.0 + REACH.1 * self.unseen_s
    }

    fn is_stale(&self) -> bool {
        let confirmed = self.sightings >= SIGHTINGS_MIN;
        self.unseen_s > if confirmed { DROPPED_AFTER_S.0 } else { DROPPED_AFTER_S.1 }
    }

    fn track(&self) -> Track {
        Track {
            id: self.id,
            position: self.motion.position,
            velocity_m_s: self.motion.velocity,
            position_variance: self.motion.pp,
            position_velocity_covariance: self.motion.pv,
            velocity_variance: self.motion.vv,
            age_s: self.age_s,
            unseen_s: self.unseen_s,
            predicted: [1.0, 2.0, 3.0].map(|seconds| self.motion.position_after(seconds)),
        }
    }
}

#[cfg(test)]
mod tests;
