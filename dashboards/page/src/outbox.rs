//! Decides what one browser is sent next. Takes the view and what the browser has answered; gives a frame of bounded size.

use crate::frame::Frame;
use crate::guard::Controls;
use crate::view::View;
use serde::Serialize;
use serde_json::{Value, json};

/// Frames that a browser may have been sent without having said that it has drawn them.
const UNANSWERED_MAX: u64 = 2;

/// What one browser has received, and the next frame for it.
///
/// It holds no frames: each is made of what is newest when the browser can take it. So its size is bounded whatever the browser does.
#[derive(Debug, Default)]
pub struct Outbox {
    /// Frames sent, and the last one that the browser has answered.
    sent: u64,
    answered: u64,
    greeted: bool,
    restarts: u64,
    seen: Seen,
    replies: Vec<Value>,
}

/// Versions and counts up to which a browser knows everything.
#[derive(Debug, Default)]
struct Seen {
    map: u64,
    live: u64,
    path: usize,
    robot: u64,
    scan: u64,
    graph: u64,
    tracks: u64,
    other_robots: u64,
    catching_up: u64,
    health: Option<u64>,
    latencies: u64,
    events: u64,
}

/// What was answered to an order.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OrderReply {
    /// The order's number.
    pub id: u64,
    /// Whether it is done.
    pub ok: bool,
    /// For people.
    pub text: String,
}

impl Outbox {
    /// The browser has drawn this frame.
    pub fn answered(&mut self, frame: u64) {
        self.answered = self.answered.max(frame.min(self.sent));
    }

    /// Frames that the browser has not answered.
    pub fn unanswered(&self) -> u64 {
        self.sent - self.answered
    }

    /// Puts an answer to an order of the browser's into its next frame.
    pub fn reply(&mut self, reply: &OrderReply) {
        self.replies.push(json!(reply));
    }

    /// The next frame: all that is new to the browser, the newest of each. Nothing when nothing is, or while the browser has not drawn
    /// what it was sent. `now_ms` is the page's time.
    pub fn next_frame(&mut self, view: &View, controls: Controls, now_ms: u64) -> Option<Vec<u8>> {
        if self.unanswered() >= UNANSWERED_MAX {
            return None;
        }
        let mut frame = Frame::default();
        if !self.greeted || self.restarts != view.restarts {
            (self.greeted, self.restarts, self.seen) = (true, view.restarts, Seen::default());
            frame.json.insert("hello".to_owned(), json!({ "head": view.head, "controls": controls }));
        }
        self.fill(&mut frame, view);
        if frame.is_empty() {
            return None;
        }
        self.sent += 1;
        frame.json.insert("frame".to_owned(), json!(self.sent));
        frame.json.insert("now_ms".to_owned(), json!(now_ms));
        Some(frame.finish())
    }

    fn fill(&mut self, frame: &mut Frame, view: &View) {
        let Self { seen, replies, .. } = self;
        let mut put = |key: &str, seen: &mut u64, version: u64, value: &dyn Fn(u64) -> Value| {
            if *seen != version {
                frame.json.insert(key.to_owned(), value(*seen));
                *seen = version;
            }
        };
        put("robot", &mut seen.robot, view.robot.version(), &|_| json!(view.robot.get()));
        put("graph", &mut seen.graph, view.graph.version(), &|_| json!(view.graph.get()));
        put("tracks", &mut seen.tracks, view.tracks.version(), &|_| json!(view.tracks.get()));
        put("other_robots", &mut seen.other_robots, view.other_robots.version(), &|_| {
            json!(view.other_robots.get())
        });
        put("catching_up", &mut seen.catching_up, view.is_catching_up.version(), &|_| {
            json!(view.is_catching_up.get())
        });
        put("latencies", &mut seen.latencies, view.latencies.count(), &|known| {
            json!(view.latencies.since(known).collect::<Vec<_>>())
        });
        put("events", &mut seen.events, view.events.count(), &|known| {
            json!(view.events.since(known).collect::<Vec<_>>())
        });
        if seen.health != Some(view.health.version()) {
            seen.health = Some(view.health.version());
            frame.json.insert("health".to_owned(), json!(view.health.get()));
        }
        if !replies.is_empty() {
            frame.json.insert("replies".to_owned(), Value::Array(std::mem::take(replies)));
        }
        if seen.scan != view.scan.version() {
            seen.scan = view.scan.version();
            frame.scan(view.scan.get());
        }
        seen.live = frame.live_tiles(&view.live, seen.live);
        seen.map = frame.map_tiles(&view.map, seen.map);
        seen.path = frame.path(view.path.points(), seen.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::POINT_BYTES;
    use crate::tile_code::encode_tile;
    use crate::view::{Head, RobotNow};
    use flockslam_evidence::{TILE_CELLS, TileKey};
    use flockslam_messages::PoseEstimate;

    fn view() -> View {
        View::new(Head {
            robot: "r1".to_owned(),
            version: "0".to_owned(),
            cell_size_m: 0.05,
            can_save: false,
        })
    }

    fn json_of(frame: &[u8]) -> Value {
        let length = u32::from_le_bytes(frame[..4].try_into().unwrap()) as usize;
        serde_json::from_slice(&frame[4..4 + length]).unwrap()
    }

    /// A frame's sections: kind and bytes of each.
    fn sections(frame: &[u8]) -> Vec<(u8, &[u8])> {
        let mut rest = &frame[4 + u32::from_le_bytes(frame[..4].try_into().unwrap()) as usize..];
        let mut found = Vec::new();
        while let [kind, a, b, c, d, tail @ ..] = rest {
            let length = u32::from_le_bytes([*a, *b, *c, *d]) as usize;
            found.push((*kind, &tail[..length]));
            rest = &tail[length..];
        }
        assert!(rest.is_empty());
        found
    }

    fn robot(sequence: u64) -> Option<RobotNow> {
        Some(RobotNow { sequence, ..RobotNow::default() })
    }

    #[test]
    fn a_browser_that_does_not_answer_gets_no_more_frames_and_then_the_newest() {
        let (mut view, mut outbox) = (view(), Outbox::default());
        let mut frames = Vec::new();
        for sequence in 1..100 {
            view.robot.set(robot(sequence));
            (0..50).for_each(|x| view.live.set(TileKey { x, y: 0 }, &[(sequence % 15) as u8; TILE_CELLS]));
            frames.extend(outbox.next_frame(&view, Controls::Open, 0));
        }
        assert_eq!(frames.len() as u64, UNANSWERED_MAX);
        assert!(json_of(&frames[0])["hello"]["head"]["robot"] == "r1");
        outbox.answered(2);
        let frame = outbox.next_frame(&view, Controls::Open, 0).unwrap();
        assert_eq!(
            (&json_of(&frame)["robot"]["sequence"], &json_of(&frame)["frame"]),
            (&json!(99), &json!(3))
        );
        let newest = encode_tile(&[99 % 15; TILE_CELLS]);
        let sent = sections(&frame);
        assert_eq!((sent.len(), sent[0].0, sent[0].1.len()), (1, 2, 50 * 13), "each tile once");
        assert!(sent[0].1.chunks_exact(13).all(|tile| tile.ends_with(&newest)));
        outbox.answered(3);
        assert!(outbox.next_frame(&view, Controls::Open, 0).is_none(), "nothing is new");
        outbox.answered(900);
        assert_eq!(outbox.unanswered(), 0, "what was not sent cannot be answered");
    }

    #[test]
    fn a_large_map_comes_in_pieces_and_whole() {
        let (mut view, mut outbox) = (view(), Outbox::default());
        let checkered = std::array::from_fn(|place| (place % 2) as u8);
        (0..300).for_each(|x| view.map.set(TileKey { x, y: 0 }, &checkered));
        for step in 0..50_000 {
            let odom_from_base = flockslam_geometry::Pose::new(f64::from(step), 0.0, 0.0);
            view.path.push(&PoseEstimate { odom_from_base, ..PoseEstimate::default() });
        }
        let number = |bytes: &[u8]| u32::from_le_bytes(bytes[..4].try_into().unwrap());
        let (mut tiles, mut points, mut frames) = (Vec::new(), 0, 0);
        while let Some(frame) = outbox.next_frame(&view, Controls::Open, 0) {
            // 192 KiB, one tile more, and the JSON.
            assert!(frame.len() < 202_000, "{}", frame.len());
            for (kind, bytes) in sections(&frame) {
                match kind {
                    1 => tiles.extend(bytes.chunks_exact(10 + TILE_CELLS).map(number)),
                    3 => {
                        assert_eq!(number(bytes) as usize, points);
                        points += (bytes.len() - 4) / POINT_BYTES;
                    }
                    _ => {}
                }
            }
            frames += 1;
            outbox.answered(frames);
        }
        assert_eq!(tiles, (0..300).collect::<Vec<u32>>(), "each tile once");
        // 2 031 800 bytes of tiles and points need 11 frames of 192 KiB.
        assert_eq!((points, frames), (50_000, 11));
    }

    #[test]
    fn a_restarted_view_is_sent_from_its_start() {
        let (mut view, mut outbox) = (view(), Outbox::default());
        view.robot.set(robot(1));
        outbox.next_frame(&view, Controls::Off, 0).unwrap();
        view.begin_anew();
        view.robot.set(robot(1));
        outbox.reply(&OrderReply { id: 4, ok: true, text: "done".to_owned() });
        let frame = json_of(&outbox.next_frame(&view, Controls::Off, 7).unwrap());
        assert!(frame["hello"].is_object() && frame["robot"]["sequence"] == 1 && frame["now_ms"] == 7);
        assert_eq!(frame["replies"][0]["id"], 4);
    }
}
