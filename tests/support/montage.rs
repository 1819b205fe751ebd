//! Small pictures of several maps beside each other.

use super::Outputs;
use flockslam_geometry::Point;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, GrayImage, ImageEncoder, Luma, Rgb, RgbImage};
use std::path::Path;

/// What is around the panels, and how far they are apart, pixels.
const BACKGROUND: u8 = 235;
const GAP: u32 = 6;
/// Side of a pixel of the picture of tracks, metres.
const PIXEL_M: f64 = 0.015;
/// Colours that tracks take in turn.
const COLOURS: [[u8; 3]; 6] =
    [[208, 58, 46], [36, 107, 206], [34, 139, 84], [158, 72, 190], [214, 132, 14], [14, 148, 160]];

/// The map of a run in a box of so many pixels: what stands is seen however small it gets.
pub fn panel(outputs: &Outputs, width: u32, height: u32) -> GrayImage {
    let map = image::load_from_memory(&outputs.bytes("map.pgm")).unwrap().into_luma8();
    let per_pixel = (map.width().div_ceil(width)).max(map.height().div_ceil(height)).max(1);
    let mut panel = GrayImage::from_pixel(width, height, Luma([BACKGROUND]));
    let (columns, rows) = (map.width().div_ceil(per_pixel), map.height().div_ceil(per_pixel));
    let (left, top) = ((width - columns) / 2, (height - rows) / 2);
    for (x, y) in (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))) {
        let block = (y * per_pixel..((y + 1) * per_pixel).min(map.height()))
            .flat_map(|y| (x * per_pixel..((x + 1) * per_pixel).min(map.width())).map(move |x| (x, y)));
        let shades: Vec<u8> = block.map(|(x, y)| map.get_pixel(x, y).0[0]).collect();
        let stands = shades.contains(&0);
        let shade = if stands { 0 } else { shades.iter().copied().max().unwrap_or(BACKGROUND) };
        panel.put_pixel(left + x, top + y, Luma([shade]));
    }
    panel
}

/// Panels of one size in rows.
pub fn montage(rows: &[Vec<GrayImage>]) -> GrayImage {
    let (width, height) = rows[0][0].dimensions();
    let columns = rows.iter().map(Vec::len).max().unwrap_or(1) as u32;
    let side = |panels: u32, size: u32| panels * (size + GAP) + GAP;
    let mut picture =
        GrayImage::from_pixel(side(columns, width), side(rows.len() as u32, height), Luma([255]));
    for (row, panels) in (0..).zip(rows) {
        for (column, panel) in (0..).zip(panels) {
            let (x, y) = (side(column, width), side(row, height));
            image::imageops::replace(&mut picture, panel, i64::from(x), i64::from(y));
        }
    }
    picture
}

/// What stands, and the ways of who moved, each in a colour.
pub fn picture_of_ways<'a>(standing: &[Point], ways: impl Iterator<Item = &'a [Point]>) -> RgbImage {
    let bound = |pick: fn(&Point) -> f64| {
        let values = || standing.iter().map(pick);
        (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
    };
    let ((left, right), (bottom, top)) = (bound(|point| point.x_m), bound(|point| point.y_m));
    let pixels = |metres: f64| (metres / PIXEL_M) as i64 + 8;
    let mut picture = RgbImage::from_pixel(
        (pixels(right - left) + 8) as u32,
        (pixels(top - bottom) + 8) as u32,
        Rgb([255; 3]),
    );
    let mut dot = |point: Point, size: i64, colour: [u8; 3]| {
        for (dx, dy) in (0..size).flat_map(|dy| (0..size).map(move |dx| (dx, dy))) {
            let (x, y) = (pixels(point.x_m - left) + dx, pixels(top - point.y_m) + dy);
            if let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y))
                && x < picture.width()
                && y < picture.height()
            {
                picture.put_pixel(x, y, Rgb(colour));
            }
        }
    };
    standing.iter().for_each(|point| dot(*point, 3, [40; 3]));
    for (way, colour) in ways.zip(COLOURS.iter().cycle()) {
        for pair in way.windows(2) {
            let steps = (pair[0].distance_m(pair[1]) / PIXEL_M).ceil().max(1.0);
            for step in 0..steps as u32 {
                let share = f64::from(step) / steps;
                let between = |from: f64, to: f64| from + share * (to - from);
                let at = Point::new(between(pair[0].x_m, pair[1].x_m), between(pair[0].y_m, pair[1].y_m));
                dot(at, 2, *colour);
            }
        }
    }
    picture
}

/// Stores a picture as small as it gets.
pub fn store_picture(picture: impl Into<DynamicImage>, to: &Path) {
    let (picture, mut png) = (picture.into(), Vec::new());
    let encoder = PngEncoder::new_with_quality(&mut png, CompressionType::Best, FilterType::NoFilter);
    let (width, height, colours) = (picture.width(), picture.height(), picture.color().into());
    encoder.write_image(picture.as_bytes(), width, height, colours).unwrap();
    std::fs::write(to, &png).unwrap();
    println!("{}: {} kB", to.display(), png.len() / 1000);
}
