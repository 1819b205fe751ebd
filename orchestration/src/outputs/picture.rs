//! The map and trajectories as a PNG for people. Takes an occupancy image and trajectories; gives the bytes of the picture.

use super::canvas::{Canvas, Colour, Pixel, mix, write_png};
use super::glyphs::text_width;
use super::{CellState, OccupancyImage, OutputError, TrajectoryPoint, put_by};
use flockslam_geometry::Point;
use flockslam_geometry::elementary::hypot;
use png::EncodingError;
use std::io::Write;
use std::path::Path;

const WALL: Colour = [28, 32, 40];
const FREE: Colour = [255, 255, 255];
const UNKNOWN: Colour = [218, 224, 232];
const INK: Colour = [52, 60, 74];
const OTHER_TRACK: Colour = [150, 158, 172];
const START: Colour = [24, 150, 84];
const END: Colour = [206, 40, 48];
/// Colours of the trajectory from its start to its end.
const TIME: [Colour; 4] = [[38, 84, 200], [120, 60, 190], [214, 62, 122], [246, 142, 38]];

/// Colours of the robots of a flock, distinguishable also for colour-blind people.
const ROBOTS: [Colour; 8] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [120, 60, 190],
    [90, 70, 50],
];

/// The longer side of the map in the picture has at most this many pixels, and more than half of it.
const SIDE_MAX: usize = 2000;
/// Pixels around the map, and of the strip below it for scale bar and time bar.
const MARGIN: usize = 36;
const STRIP: usize = 76;
/// Pixels of one dot of the text.
const DOT: i64 = 3;

/// The trajectories to draw.
#[derive(Clone, Copy, Debug, Default)]
pub struct PictureTracks<'a> {
    /// Drawn in colours that run with time, with marks at start and end.
    pub main: &'a [TrajectoryPoint],
    /// Drawn thin and grey below it, to compare; may be empty.
    pub other: &'a [TrajectoryPoint],
}

/// Writes [`render_picture`] to `path`.
///
/// # Errors
/// When the disk refuses or the picture is too large to encode.
pub fn write_picture(
    path: &Path,
    map: &OccupancyImage,
    tracks: PictureTracks<'_>,
) -> Result<(), OutputError> {
    put_by(path, |file| Ok(draw_picture(file, map, tracks)?))
}

/// The known part of the map as a PNG for people: walls, free space, trajectory, start (disc), end (diamond), a scale
/// bar, and the colours of time with the duration in seconds.
///
/// # Errors
/// When the picture is too large to encode.
pub fn render_picture(map: &OccupancyImage, tracks: PictureTracks<'_>) -> Result<Vec<u8>, OutputError> {
    let mut bytes = Vec::new();
    draw_picture(&mut bytes, map, tracks)?;
    Ok(bytes)
}

fn draw_picture(
    to: impl Write,
    map: &OccupancyImage,
    tracks: PictureTracks<'_>,
) -> Result<(), EncodingError> {
    let view = View::of(map, tracks);
    write_png(to, view.pixels(), UNKNOWN, |canvas| {
        draw_cells(canvas, map, &view);
        draw_track(canvas, &view, tracks.other, 0.55, |_| OTHER_TRACK);
        draw_track(canvas, &view, tracks.main, 1.0, time_colour);
        draw_marks(canvas, &view, tracks.main);
        draw_scale_bar(canvas, &view);
        draw_time_bar(canvas, &view, tracks.main);
    })
}

/// The known part of the map as a PNG with the trajectory of each robot in a colour of its own, with marks where it starts and ends.
///
/// # Errors
/// When the disk refuses or the picture is too large to encode.
pub fn write_flock_picture(
    path: &Path,
    map: &OccupancyImage,
    robots: &[Vec<TrajectoryPoint>],
) -> Result<(), OutputError> {
    let all: Vec<TrajectoryPoint> = robots.iter().flatten().copied().collect();
    let view = View::of(map, PictureTracks { main: &all, other: &[] });
    let draw = |canvas: &mut Canvas| {
        draw_cells(canvas, map, &view);
        for (track, colour) in robots.iter().zip(ROBOTS.iter().cycle()) {
            draw_track(canvas, &view, track, 1.0, |_| *colour);
        }
        robots.iter().for_each(|track| draw_marks(canvas, &view, track));
        draw_scale_bar(canvas, &view);
    };
    put_by(path, |file| Ok(write_png(file, view.pixels(), UNKNOWN, draw)?))
}

/// Which part of the plane is shown, and how large. One cell is `zoom` pixels, or `shrink` cells are one pixel.
struct View {
    /// First column and row shown.
    first: (i64, i64),
    zoom: usize,
    shrink: usize,
    /// Pixels of the map.
    width: usize,
    height: usize,
    pixel_m: f64,
    /// Lower left corner of what is shown.
    corner: Point,
}

impl View {
    fn of(map: &OccupancyImage, tracks: PictureTracks<'_>) -> Self {
        let (min_x, max_x, min_y, max_y) = shown_box(map, tracks);
        let (columns, rows) = ((max_x - min_x + 1) as usize, (max_y - min_y + 1) as usize);
        let longer = columns.max(rows);
        let (zoom, shrink) = ((SIDE_MAX / longer).max(1), longer.div_ceil(SIDE_MAX));
        let size = map.cell_size_m();
        Self {
            first: (min_x, min_y),
            zoom,
            shrink,
            width: columns.div_ceil(shrink) * zoom,
            height: rows.div_ceil(shrink) * zoom,
            pixel_m: size * shrink as f64 / zoom as f64,
            corner: Point::new(
                map.origin().x_m + min_x as f64 * size,
                map.origin().y_m + min_y as f64 * size,
            ),
        }
    }

    /// Width and height of the whole picture.
    fn pixels(&self) -> (u32, u32) {
        ((self.width + 2 * MARGIN) as u32, (self.height + MARGIN + STRIP) as u32)
    }

    /// Where a point of the map frame is on the canvas.
    fn pixel(&self, point: Point) -> Pixel {
        Pixel {
            x: MARGIN as f64 + (point.x_m - self.corner.x_m) / self.pixel_m,
            y: (MARGIN + self.height) as f64 - (point.y_m - self.corner.y_m) / self.pixel_m,
        }
    }

    /// Line widths and marks grow with the picture.
    fn stroke(&self) -> f64 {
        (self.width.max(self.height) as f64 / 620.0).max(1.6)
    }
}

/// The cells to show: all that are known and those under the trajectories (as far as these stay near the map).
fn shown_box(map: &OccupancyImage, tracks: PictureTracks<'_>) -> (i64, i64, i64, i64) {
    let (a, b, c, d) = map.known_box().unwrap_or((0, map.width() - 1, 0, map.height() - 1));
    let (mut min_x, mut max_x, mut min_y, mut max_y) = (a as i64, b as i64, c as i64, d as i64);
    let (width, height) = (map.width() as i64, map.height() as i64);
    for point in tracks.main.iter().chain(tracks.other).filter(|p| p.map_from_base.is_finite()) {
        let x = ((point.map_from_base.x_m - map.origin().x_m) / map.cell_size_m()).floor() as i64;
        let y = ((point.map_from_base.y_m - map.origin().y_m) / map.cell_size_m()).floor() as i64;
        let (x, y) = (x.clamp(-width, 2 * width), y.clamp(-height, 2 * height));
        (min_x, max_x, min_y, max_y) = (min_x.min(x), max_x.max(x), min_y.min(y), max_y.max(y));
    }
    (min_x, max_x, min_y, max_y)
}

fn draw_cells(canvas: &mut Canvas, map: &OccupancyImage, view: &View) {
    let (zoom, shrink) = (view.zoom, view.shrink);
    for row in 0..view.height / zoom {
        let top = (MARGIN + view.height - (row + 1) * zoom) as i64;
        if !canvas.shows(top..top + zoom as i64) {
            continue;
        }
        for column in 0..view.width / zoom {
            let x = view.first.0 + (column * shrink) as i64;
            let y = view.first.1 + (row * shrink) as i64;
            let state = block_state(map, x, y, shrink as i64);
            if state != CellState::Unknown {
                let colour = if state == CellState::Occupied { WALL } else { FREE };
                let left = (MARGIN + column * zoom) as i64;
                canvas.rectangle(left, top, zoom as i64, zoom as i64, colour);
            }
        }
    }
}

/// One state for a block of cells: a wall stays visible however much the picture shrinks.
fn block_state(map: &OccupancyImage, x: i64, y: i64, side: i64) -> CellState {
    let mut state = CellState::Unknown;
    for cell in (y..y + side).flat_map(|y| (x..x + side).map(move |x| map.at(x, y))) {
        match cell {
            CellState::Occupied => return CellState::Occupied,
            CellState::Free => state = CellState::Free,
            CellState::Unknown => (),
        }
    }
    state
}

fn draw_track(
    canvas: &mut Canvas,
    view: &View,
    track: &[TrajectoryPoint],
    weight: f64,
    colour_at: impl Fn(f64) -> Colour,
) {
    let mut last: Option<Pixel> = None;
    for (i, point) in track.iter().enumerate().filter(|(_, point)| point.map_from_base.is_finite()) {
        let here = view.pixel(point.map_from_base.position());
        let from = last.unwrap_or(here);
        // Steps far below a pixel are gathered, so the colour does not build up while the robot stands still.
        if last.is_none() || hypot(here.x - from.x, here.y - from.y) >= 1.0 || i + 1 == track.len() {
            let share = i as f64 / (track.len() - 1).max(1) as f64;
            canvas.line(from, here, weight * view.stroke(), colour_at(share));
            last = Some(here);
        }
    }
}

fn draw_marks(canvas: &mut Canvas, view: &View, track: &[TrajectoryPoint]) {
    if let (Some(first), Some(last)) = (track.first(), track.last()) {
        draw_start(canvas, view.pixel(first.map_from_base.position()), 3.2 * view.stroke());
        draw_end(canvas, view.pixel(last.map_from_base.position()), 3.2 * view.stroke());
    }
}

fn draw_start(canvas: &mut Canvas, at: Pixel, radius: f64) {
    canvas.disc(at, radius * 1.35, FREE);
    canvas.disc(at, radius, START);
    canvas.disc(at, radius * 0.35, FREE);
}

fn draw_end(canvas: &mut Canvas, at: Pixel, radius: f64) {
    canvas.diamond(at, radius * 1.7, FREE);
    canvas.diamond(at, radius * 1.25, END);
}

fn draw_scale_bar(canvas: &mut Canvas, view: &View) {
    let length_m = round_length_m(0.2 * view.width as f64 * view.pixel_m);
    let length = (length_m / view.pixel_m).round() as i64;
    let (left, middle) = (MARGIN as i64, strip_middle(view));
    canvas.rectangle(left, middle - 2, length, 4, INK);
    canvas.rectangle(left, middle - 10, 4, 20, INK);
    canvas.rectangle(left + length - 4, middle - 10, 4, 20, INK);
    let text = format!("{length_m} m");
    canvas.text(left + length + 16, middle - Canvas::text_height(DOT) / 2, DOT, &text, INK);
}

/// The bar of time at the right: start mark, colours, end mark, duration.
fn draw_time_bar(canvas: &mut Canvas, view: &View, track: &[TrajectoryPoint]) {
    let (Some(first), Some(last)) = (track.first(), track.last()) else { return };
    let seconds = last.stamp_ns.saturating_sub(first.stamp_ns) as f64 * 1e-9;
    let text = format!("{seconds:.0} s");
    let (middle, length) = (strip_middle(view), (view.width / 6) as i64);
    let text_left = (MARGIN + view.width) as i64 - text_width(&text) as i64 * DOT;
    let left = text_left - 36 - length;
    // A narrow map leaves no room beside the scale bar.
    if left < (MARGIN + view.width * 2 / 5) as i64 {
        return;
    }
    canvas.text(text_left, middle - Canvas::text_height(DOT) / 2, DOT, &text, INK);
    for x in 0..length {
        canvas.rectangle(left + x, middle - 3, 1, 6, time_colour(x as f64 / length as f64));
    }
    let pixel = |x: i64| Pixel { x: x as f64, y: middle as f64 };
    draw_start(canvas, pixel(left), 8.0);
    draw_end(canvas, pixel(left + length), 8.0);
}

fn strip_middle(view: &View) -> i64 {
    (MARGIN + view.height + STRIP / 2) as i64 - 4
}

/// The largest of 1, 2, 5, 10, 20 … (and 0.1, 0.2, 0.5) that is not above `limit_m`.
fn round_length_m(limit_m: f64) -> f64 {
    const STEPS: [f64; 18] =
        [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1e3, 2e3, 5e3, 1e4, 2e4, 5e4];
    STEPS.into_iter().rev().find(|step| *step <= limit_m).unwrap_or(STEPS[0])
}

fn time_colour(share: f64) -> Colour {
    let place = share.clamp(0.0, 1.0) * (TIME.len() - 1) as f64;
    let below = (place as usize).min(TIME.len() - 2);
    mix(TIME[below], TIME[below + 1], place - below as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::Pose;

    fn room(width: usize, height: usize) -> OccupancyImage {
        let border = |x, y| x == 0 || y == 0 || x == width - 1 || y == height - 1;
        let cells = (0..width * height)
            .map(|i| if border(i % width, i / width) { CellState::Occupied } else { CellState::Free })
            .collect();
        OccupancyImage::new(width, height, 0.05, Point::new(-1.0, -2.0), cells)
    }

    fn decoded(map: &OccupancyImage, tracks: PictureTracks<'_>) -> image::RgbImage {
        image::load_from_memory(&render_picture(map, tracks).unwrap()).unwrap().into_rgb8()
    }

    #[test]
    fn the_longer_side_has_a_legible_number_of_pixels() {
        for (width, height) in [(1, 1), (40, 90), (700, 300), (1300, 200), (2001, 10), (30, 9000)] {
            let view = View::of(&room(width, height), PictureTracks::default());
            let longer = view.width.max(view.height);
            assert!(longer > SIDE_MAX / 2 && longer <= SIDE_MAX, "{width} x {height}: {longer}");
            let picture = decoded(&room(width, height), PictureTracks::default());
            let longer = picture.width().max(picture.height());
            assert!((1000..=2150).contains(&longer), "{width} x {height}: {longer}");
        }
    }

    #[test]
    fn points_appear_where_they_are() {
        let map = room(200, 100);
        let at = |x_m, y_m| TrajectoryPoint { stamp_ns: 0, map_from_base: Pose::new(x_m, y_m, 0.0) };
        let main = [at(1.0, 1.0), at(6.0, 1.0)];
        let picture = decoded(&map, PictureTracks { main: &main, other: &[] });
        let view = View::of(&map, PictureTracks { main: &main, other: &[] });
        let colour = |x_m, y_m| {
            let pixel = view.pixel(Point::new(x_m, y_m));
            picture.get_pixel(pixel.x as u32, pixel.y as u32).0
        };
        assert_eq!(colour(-0.975, -1.975), WALL);
        assert_eq!(colour(0.0, 2.0), FREE);
        assert_eq!(colour(6.0, 1.0), END);
        assert_eq!(colour(3.0, 1.0), TIME[3]);
    }

    #[test]
    fn tracks_outside_of_the_map_or_without_numbers_are_survived() {
        let at = |x_m: f64| TrajectoryPoint {
            stamp_ns: 0,
            map_from_base: Pose { x_m, y_m: 0.0, heading_rad: 0.0 },
        };
        let wild = [at(1e12), at(f64::NAN), at(-1e12), at(0.0)];
        decoded(&room(50, 50), PictureTracks { main: &wild, other: &wild });
    }

    #[test]
    fn scale_bars_have_round_lengths() {
        assert_eq!([0.05, 0.7, 19.9, 20.0, 1e9].map(round_length_m), [0.1, 0.5, 10.0, 20.0, 5e4]);
    }

    #[test]
    fn the_same_map_gives_the_same_bytes() {
        let map = room(120, 80);
        let render = || render_picture(&map, PictureTracks::default()).unwrap();
        assert_eq!(render(), render());
    }
}
