//! Lets through what the bridge needs of the transforms in the graph: arms and wheels say much more than that. Pure.

use flockslam_ros::messages::TFMessage;
use std::collections::HashMap;

/// Of one frame a transform is enough for so long, nanoseconds: no odometry comes more often.
const SPACING_NS: u64 = 1_000_000;
/// Frames that are followed; those beyond are left out.
const FRAMES_MAX: usize = 1024;

/// Knows of each frame when it was let through last.
#[derive(Debug)]
pub struct TransformFilter {
    spacing_ns: u64,
    passed_ns: HashMap<String, i64>,
}

impl TransformFilter {
    /// Of transforms that hold at a time.
    pub fn of_moving() -> Self {
        Self { spacing_ns: SPACING_NS, passed_ns: HashMap::new() }
    }

    /// Of those that hold at all times: what is said anew counts, whatever its stamp.
    pub fn of_static() -> Self {
        Self { spacing_ns: 0, passed_ns: HashMap::new() }
    }

    /// The part of a message that is needed; `None` for none of it.
    pub fn filter(&mut self, mut message: TFMessage) -> Option<TFMessage> {
        message.transforms.retain(|transform| {
            let stamp_ns = transform.header.stamp.ns();
            match self.passed_ns.get_mut(&transform.child_frame_id) {
                Some(passed_ns) if passed_ns.abs_diff(stamp_ns) < self.spacing_ns => false,
                Some(passed_ns) => {
                    *passed_ns = stamp_ns;
                    true
                }
                None => {
                    let is_room = self.passed_ns.len() < FRAMES_MAX;
                    if is_room {
                        self.passed_ns.insert(transform.child_frame_id.clone(), stamp_ns);
                    }
                    is_room
                }
            }
        });
        (!message.transforms.is_empty()).then_some(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_ros::messages::{Header, TransformStamped};

    fn message(stamp_us: i64, frames: &[&str]) -> TFMessage {
        let transform = |frame: &&str| TransformStamped {
            header: Header::new(stamp_us * 1000, "odom"),
            child_frame_id: (*frame).to_owned(),
            ..TransformStamped::default()
        };
        TFMessage { transforms: frames.iter().map(transform).collect() }
    }

    #[test]
    fn transforms_of_a_frame_with_a_high_rate_are_thinned_out() {
        let mut filter = TransformFilter::of_moving();
        let mut passed = |stamp_us: i64, frames: &[&str]| {
            let found =
                filter.filter(message(stamp_us, frames)).map_or_else(Vec::new, |found| found.transforms);
            found.into_iter().map(|transform| transform.child_frame_id).collect::<Vec<_>>()
        };
        assert_eq!(passed(0, &["base", "wheel"]), ["base", "wheel"]);
        assert!((1..10).all(|step| passed(100 * step, &["wheel"]).is_empty()));
        assert_eq!(passed(900, &["wheel", "laser"]), ["laser"]);
        assert_eq!(passed(1000, &["wheel", "base"]), ["wheel", "base"]);
        // What comes late, out of order, or after time has gone back, counts as well.
        assert_eq!(passed(-5000, &["base"]), ["base"]);
    }

    #[test]
    fn frames_without_end_take_no_memory_without_end() {
        let mut filter = TransformFilter::of_static();
        for number in 0..2 * FRAMES_MAX {
            let name = format!("frame{number}");
            assert_eq!(filter.filter(message(0, &[name.as_str()])).is_some(), number < FRAMES_MAX);
        }
        assert!(filter.filter(message(0, &["frame0"])).is_some());
    }
}
