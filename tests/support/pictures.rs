//! Pictures that tests make for the documentation.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use std::path::Path;

/// The same picture, as small as it gets.
fn squeezed(png: &[u8]) -> Vec<u8> {
    let picture = image::load_from_memory(png).unwrap().to_rgb8();
    let mut small = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut small, CompressionType::Best, FilterType::Adaptive);
    picture.write_with_encoder(encoder).unwrap();
    small
}

/// Stores a picture beside the tests' outputs, and, when `FLOCKSLAM_PICTURES` asks for it, among those of the documentation.
pub fn keep_picture(name: &str, png: &[u8]) {
    assert!(png.starts_with(b"\x89PNG") && png.len() > 10_000);
    let small = squeezed(png);
    let places = [Some(env!("CARGO_TARGET_TMPDIR").into()), std::env::var_os("FLOCKSLAM_PICTURES")];
    for directory in places.into_iter().flatten() {
        std::fs::write(Path::new(&directory).join(format!("{name}.png")), &small).unwrap();
    }
    println!("{name}.png: {} kB", small.len() / 1000);
}
