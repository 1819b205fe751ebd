//! Draws lines, discs, rectangles and text with smooth edges on an RGB picture.

use super::glyphs::{HEIGHT, glyph, text_width};
use flockslam_geometry::elementary::hypot;
use image::{Rgb, RgbImage};
use png::{ColorType, Compression, Encoder, EncodingError};
use std::io::Write;
use std::ops::Range;

/// A colour, red, green and blue.
pub(super) type Colour = [u8; 3];

/// Rows of a picture that are drawn at a time: a whole one takes more memory than the map that it shows.
const BAND: u32 = 128;

/// A band of rows of a picture, with smooth lines and shapes; coordinates in pixels of the whole picture, y down, pixel (0, 0) covers
/// 0 … 1. What is outside of the band is left out.
pub(super) struct Canvas {
    image: RgbImage,
    /// Its first row.
    top: u32,
}

/// A position on the canvas.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pixel {
    pub x: f64,
    pub y: f64,
}

/// Writes a picture as a PNG, band by band; `draw` draws the whole of it on each.
///
/// # Errors
/// When `to` refuses, or the picture is too large for a PNG.
pub(super) fn write_png(
    to: impl Write,
    (width, height): (u32, u32),
    background: Colour,
    draw: impl Fn(&mut Canvas),
) -> Result<(), EncodingError> {
    let mut encoder = Encoder::new(to, width, height);
    encoder.set_color(ColorType::Rgb);
    encoder.set_compression(Compression::Fast);
    let mut png = encoder.write_header()?;
    let mut rows = png.stream_writer()?;
    for top in (0..height).step_by(BAND as usize) {
        let mut canvas = Canvas::new(width, top..height.min(top + BAND), background);
        draw(&mut canvas);
        rows.write_all(canvas.image.as_raw())?;
    }
    rows.finish()?;
    png.finish()
}

impl Canvas {
    fn new(width: u32, rows: Range<u32>, background: Colour) -> Self {
        Self { image: RgbImage::from_pixel(width, rows.end - rows.start, Rgb(background)), top: rows.start }
    }

    fn rows(&self) -> Range<u32> {
        self.top..self.top + self.image.height()
    }

    /// Whether one of these rows of the picture is in the band.
    pub fn shows(&self, rows: Range<i64>) -> bool {
        rows.start < self.rows().end.into() && rows.end > self.rows().start.into()
    }

    /// A line with round ends, `width` pixels wide, smoothed at its edge.
    pub fn line(&mut self, from: Pixel, to: Pixel, width: f64, colour: Colour) {
        let half = 0.5 * width;
        self.shape(from, to, half, colour, |at| distance_to_segment(at, from, to) - half);
    }

    /// A filled circle.
    pub fn disc(&mut self, centre: Pixel, radius: f64, colour: Colour) {
        self.shape(centre, centre, radius, colour, |at| hypot(at.x - centre.x, at.y - centre.y) - radius);
    }

    /// A filled square that stands on its corner; `radius` from its centre to a corner.
    pub fn diamond(&mut self, centre: Pixel, radius: f64, colour: Colour) {
        self.shape(centre, centre, radius, colour, |at| {
            ((at.x - centre.x).abs() + (at.y - centre.y).abs() - radius) * std::f64::consts::FRAC_1_SQRT_2
        });
    }

    /// A filled rectangle with sharp edges on whole pixels.
    pub fn rectangle(&mut self, x: i64, y: i64, width: i64, height: i64, colour: Colour) {
        let within = |from: i64, length: i64, shown: Range<u32>| {
            let limit = |place: i64| {
                (place.clamp(shown.start.into(), shown.end.into()) as u32 - shown.start) as usize
            };
            limit(from)..limit(from + length.max(0))
        };
        let (rows, columns) = (within(y, height, self.rows()), within(x, width, 0..self.image.width()));
        let pixels_in_row = self.image.width() as usize;
        let (pixels, _) = self.image.as_chunks_mut();
        for row in rows {
            pixels[row * pixels_in_row..][columns.clone()].fill(colour);
        }
    }

    /// Text of digits and units with its upper left corner at (x, y); a dot is `size` pixels. Gives its width.
    pub fn text(&mut self, x: i64, y: i64, size: i64, text: &str, colour: Colour) -> i64 {
        let mut left = x;
        for rows in text.chars().map(glyph) {
            for (row, dots) in (0..).zip(rows) {
                for (column, _) in (0..).zip(dots.bytes()).filter(|(_, dot)| *dot == b'#') {
                    self.rectangle(left + column * size, y + row * size, size, size, colour);
                }
            }
            left += (rows[0].len() as i64 + 1) * size;
        }
        text_width(text) as i64 * size
    }

    /// Height of a text, pixels.
    pub fn text_height(size: i64) -> i64 {
        HEIGHT as i64 * size
    }

    /// Blends every pixel by how far `outside` (signed distance to the shape's edge, pixels) leaves it inside, within
    /// the box around two spots inflated by `reach`.
    fn shape(&mut self, a: Pixel, b: Pixel, reach: f64, colour: Colour, outside: impl Fn(Pixel) -> f64) {
        let limits = |p: f64, q: f64, shown: Range<u32>| {
            let (least, most) = (f64::from(shown.start), f64::from(shown.end));
            let first = (p.min(q) - reach - 1.0).floor().clamp(least, most) as i64;
            let last = (p.max(q) + reach + 1.0).ceil().clamp(least, most) as i64;
            first..last
        };
        for y in limits(a.y, b.y, self.rows()) {
            for x in limits(a.x, b.x, 0..self.image.width()) {
                let centre = Pixel { x: x as f64 + 0.5, y: y as f64 + 0.5 };
                self.blend(x, y, colour, (0.5 - outside(centre)).clamp(0.0, 1.0));
            }
        }
    }

    fn blend(&mut self, x: i64, y: i64, colour: Colour, share: f64) {
        if share == 0.0 {
            return;
        }
        let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y - i64::from(self.top))) else { return };
        if let Some(Rgb(pixel)) = self.image.get_pixel_mut_checked(x, y) {
            *pixel = mix(*pixel, colour, share);
        }
    }
}

/// The colour a share `t` (0 … 1) of the way from `a` to `b`.
pub(super) fn mix(a: Colour, b: Colour, t: f64) -> Colour {
    let channel = |i: usize| (f64::from(a[i]) + t * (f64::from(b[i]) - f64::from(a[i]))).round() as u8;
    [channel(0), channel(1), channel(2)]
}

fn distance_to_segment(at: Pixel, from: Pixel, to: Pixel) -> f64 {
    let (dx, dy) = (to.x - from.x, to.y - from.y);
    let squared = dx * dx + dy * dy;
    let along = if squared > 0.0 { ((at.x - from.x) * dx + (at.y - from.y) * dy) / squared } else { 0.0 };
    let along = along.clamp(0.0, 1.0);
    hypot(at.x - from.x - along * dx, at.y - from.y - along * dy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_covers_its_middle_and_is_clipped_at_the_border() {
        let mut canvas = Canvas::new(20, 0..10, [255; 3]);
        canvas.line(Pixel { x: -50.0, y: 5.0 }, Pixel { x: 50.0, y: 5.0 }, 3.0, [0; 3]);
        for x in 0..20 {
            assert_eq!(canvas.image.get_pixel(x, 4).0, [0; 3]);
            assert_eq!(canvas.image.get_pixel(x, 0).0, [255; 3]);
        }
        let edge = canvas.image.get_pixel(10, 3).0[0];
        assert!((100..=155).contains(&edge), "{edge}");
    }

    #[test]
    fn a_picture_of_several_bands_is_the_one_drawn_at_once() {
        let draw = |canvas: &mut Canvas| {
            canvas.line(Pixel { x: 3.0, y: 2.0 }, Pixel { x: 60.0, y: 295.0 }, 5.0, [0, 90, 0]);
            canvas.disc(Pixel { x: 30.0, y: f64::from(BAND) }, 20.0, [200, 0, 0]);
            canvas.rectangle(-5, 2 * i64::from(BAND) - 3, 40, 8, [0, 0, 200]);
            canvas.text(8, i64::from(BAND) - 9, 3, "12.5 m", [0; 3]);
        };
        let mut bytes = Vec::new();
        write_png(&mut bytes, (70, 300), [255; 3], draw).unwrap();
        let mut whole = Canvas::new(70, 0..300, [255; 3]);
        draw(&mut whole);
        assert!(image::load_from_memory(&bytes).unwrap().into_rgb8() == whole.image);
    }

    #[test]
    fn shapes_far_outside_are_harmless() {
        let mut canvas = Canvas::new(4, 0..4, [9; 3]);
        canvas.disc(Pixel { x: 1e9, y: -1e9 }, 5.0, [0; 3]);
        canvas.diamond(Pixel { x: f64::NAN, y: 0.0 }, 5.0, [0; 3]);
        canvas.text(-30, 2, 2, "12.5 m", [0; 3]);
        // The text begins in row 2.
        for (x, y) in (0..4).flat_map(|x| [(x, 0), (x, 1)]) {
            assert_eq!(canvas.image.get_pixel(x, y).0, [9; 3], "{x} {y}");
        }
    }
}
