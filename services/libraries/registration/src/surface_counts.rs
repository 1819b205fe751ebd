//! How many points are in the cells of a map of surfaces, for searches that ask for millions of them.

use crate::surface_map::{SIDE, SurfaceMap, cell};

/// Numbers of points in the cells of a [`SurfaceMap`], up to a greatest one: a byte for each, so that all stay in the processor's cache.
#[derive(Debug, Default)]
pub struct SurfaceCounts {
    /// Row by row of the torus.
    counts: Vec<u8>,
}

impl SurfaceCounts {
    /// Takes over the numbers of a map; greater ones than `most` become that.
    pub fn take(&mut self, map: &SurfaceMap, most: u8) {
        self.counts.clear();
        self.counts.resize((SIDE * SIDE) as usize, 0);
        map.for_each_count(|column, row, count| {
            self.counts[(row * SIDE + column) as usize] = count.clamp(0, most.into()) as u8;
        });
    }

    /// The column of an x coordinate in metres, for [`Self::at`].
    pub fn column(x_m: f64) -> u32 {
        (cell(x_m) & (SIDE - 1)) as u32
    }

    /// The row of a y coordinate in metres.
    pub fn row(y_m: f64) -> u32 {
        ((cell(y_m) & (SIDE - 1)) * SIDE) as u32
    }

    /// The number in the cell of a column and a row.
    #[inline]
    pub fn at(&self, column: u32, row: u32) -> u8 {
        self.counts[(row + column) as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::{Point, Pose};

    #[test]
    fn each_cell_has_the_number_of_its_points_up_to_the_greatest() {
        let mut map = SurfaceMap::default();
        let points: Vec<Point> = (0..9)
            .flat_map(|k| vec![Point::new(3.1 * f64::from(k) - 12.2, 7.3 - f64::from(k)); k as usize])
            .collect();
        map.add(Pose::IDENTITY, &points);
        let mut counts = SurfaceCounts::default();
        counts.take(&map, 6);
        for k in 0..9 {
            let (x_m, y_m) = (3.1 * f64::from(k) - 12.2, 7.3 - f64::from(k));
            assert_eq!(counts.at(SurfaceCounts::column(x_m), SurfaceCounts::row(y_m)), k.min(6) as u8);
        }
        assert_eq!(counts.counts.iter().filter(|count| **count > 0).count(), 8);
    }
}
