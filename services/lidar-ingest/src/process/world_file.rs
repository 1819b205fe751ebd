//! Reads a nav2 map (YAML and picture) as a world to simulate in.

use flockslam_simulation::{ImageWorld, World};
use flockslam_stage::StageError;
use std::path::Path;

/// Reads a map in nav2's form (YAML beside a picture) as a world to simulate in.
///
/// # Errors
/// When the YAML lacks a key, or the picture cannot be read.
pub fn read(yaml: &Path) -> Result<World, StageError> {
    let wrong = |reason: String| StageError::Source(format!("{}: {reason}", yaml.display()));
    let text = std::fs::read_to_string(yaml).map_err(|e| wrong(e.to_string()))?;
    let value = |key: &str| {
        let found =
            text.lines().find_map(|line| line.trim().strip_prefix(key)?.strip_prefix(':').map(str::trim));
        found.map(|value| value.trim_matches(['"', '\''])).ok_or_else(|| wrong(format!("no '{key}:' line")))
    };
    let resolution_m = value("resolution")?.parse::<f64>().map_err(|e| wrong(format!("resolution: {e}")))?;
    let negate = matches!(value("negate"), Ok("1" | "true"));
    let path = yaml.parent().unwrap_or(Path::new(".")).join(value("image")?);
    let picture = image::open(&path).map_err(|e| wrong(format!("{}: {e}", path.display())))?.into_luma8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let mut pixels = picture.into_raw();
    if negate {
        pixels.iter_mut().for_each(|grey| *grey = 255 - *grey);
    }
    let world =
        ImageWorld::from_grey(width, height, resolution_m, &pixels).map_err(|e| wrong(e.to_string()))?;
    Ok(World::Image(world))
}
