//! The binary format of what a browser is sent: JSON, then sections of numbers.

use crate::layer::Layer;
use crate::path::{POINT_BYTES, PathPoint};
use crate::view::ScanNow;
use serde_json::{Map, Value};

/// Most bytes of a frame's tiles and path; what does not fit comes with the next frame.
const BYTES_MAX: usize = 192 * 1024;

/// Sections of a frame behind its JSON.
#[derive(Clone, Copy)]
#[repr(u8)]
enum Section {
    /// Tiles of closed submaps: x and y (i32), length of the code (u16, 0: gone), code.
    Map = 1,
    /// Tiles of the grid that is being built, alike.
    Live = 2,
    /// The path: number of the first point (u32), then points (submap u32, x f32, y f32, quality u32).
    Path = 3,
    /// The current scan: `map_from_base` (3 f64), then points (2 i16).
    Scan = 4,
}

/// A frame in the making: JSON, and sections of numbers behind it. All numbers have the low byte first.
///
/// On the wire: length of the JSON (u32), the JSON, then for each section its kind (u8), its length (u32) and its bytes.
#[derive(Default)]
pub struct Frame {
    /// Messages as text.
    pub json: Map<String, Value>,
    sections: Vec<u8>,
}

impl Frame {
    /// Whether there is nothing in it.
    pub fn is_empty(&self) -> bool {
        self.json.is_empty() && self.sections.is_empty()
    }

    /// Appends tiles of the map that are new since `seen`, as many as fit; the version up to which all are in.
    pub fn map_tiles(&mut self, layer: &Layer, seen: u64) -> u64 {
        self.tiles(Section::Map, layer, seen)
    }

    /// The same of the live grid.
    pub fn live_tiles(&mut self, layer: &Layer, seen: u64) -> u64 {
        self.tiles(Section::Live, layer, seen)
    }

    fn tiles(&mut self, kind: Section, layer: &Layer, mut seen: u64) -> u64 {
        let mut bytes = Vec::new();
        for (version, key, code) in layer.since(seen) {
            if self.sections.len() + bytes.len() > BYTES_MAX {
                break;
            }
            bytes.extend_from_slice(&key.x.to_le_bytes());
            bytes.extend_from_slice(&key.y.to_le_bytes());
            bytes.extend_from_slice(&(code.len() as u16).to_le_bytes());
            bytes.extend_from_slice(code);
            seen = version;
        }
        self.section(kind, &bytes);
        seen
    }

    /// Appends points of the path behind the first `seen`, as many as fit; how many the browser has then.
    pub fn path(&mut self, points: &[PathPoint], seen: usize) -> usize {
        let room = BYTES_MAX.saturating_sub(self.sections.len()) / POINT_BYTES;
        let new = &points[seen.min(points.len())..];
        let new = &new[..new.len().min(room)];
        if !new.is_empty() {
            let mut bytes = (seen as u32).to_le_bytes().to_vec();
            new.iter().for_each(|point| point.write(&mut bytes));
            self.section(Section::Path, &bytes);
        }
        seen + new.len()
    }

    /// Appends the current scan.
    pub fn scan(&mut self, scan: &ScanNow) {
        let mut bytes: Vec<u8> = scan.map_from_base.iter().flat_map(|number| number.to_le_bytes()).collect();
        bytes.extend(scan.points.iter().flatten().flat_map(|number| number.to_le_bytes()));
        self.section(Section::Scan, &bytes);
    }

    fn section(&mut self, kind: Section, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.sections.push(kind as u8);
            self.sections.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
            self.sections.extend_from_slice(bytes);
        }
    }

    /// The frame as it is sent.
    pub fn finish(self) -> Vec<u8> {
        let json = Value::Object(self.json).to_string();
        let mut bytes = (json.len() as u32).to_le_bytes().to_vec();
        bytes.extend_from_slice(json.as_bytes());
        bytes.extend_from_slice(&self.sections);
        bytes
    }
}
