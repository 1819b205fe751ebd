//! The fused map as it is stored: a rectangle of cells, row by row, in which stretches without evidence take no room.

use crate::ResultsError;
use flockslam_evidence::Cell;
use flockslam_geometry::Point;
use flockslam_journal::{Durability, replace_file_by, replace_file_by_parts};
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The fused map.
pub const FUSED_MAP: &str = "fused.map";
/// The map that a set localizes in, in the same form.
pub const KNOWN_MAP: &str = "known.map";
/// Cells of a row, and rows, at most: a torn file must not make a reader ask for more memory.
const SIDE_MAX: usize = 1 << 26;
/// Bits of a number in one byte; the highest bit says that another byte follows.
const BITS: u32 = 7;

/// A fused map: evidence on a rectangle of cells.
///
/// The corridors of a building fill a small part of the rectangle around them. So the rows are kept as they are stored: stretches of
/// unknown cells as their length, and the weights of the others as numbers of one to five bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredMap {
    /// Cells in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Side of a cell, metres.
    pub cell_size_m: f64,
    /// Lower left corner in the map frame.
    pub origin: Point,
    /// All rows, the lowest y first. Each is a sequence of: number of unknown cells, number of known cells, these cells.
    rows: Vec<u8>,
}

/// Size and place of a fused map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapShape {
    /// Cells in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Side of a cell, metres.
    pub cell_size_m: f64,
    /// Lower left corner in the map frame.
    pub origin: Point,
}

impl MapShape {
    /// That of a map without cells.
    pub fn empty() -> Self {
        Self { width: 0, height: 0, cell_size_m: 1.0, origin: Point::default() }
    }

    fn head(&self) -> MapHead {
        let Self { width, height, cell_size_m, origin } = *self;
        MapHead { width: width as u64, height: height as u64, cell_size_m, origin }
    }
}

#[repr(C)]
#[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
struct MapHead {
    width: u64,
    height: u64,
    cell_size_m: f64,
    origin: Point,
}

impl StoredMap {
    /// A map without cells.
    pub fn empty() -> Self {
        Self { width: 0, height: 0, cell_size_m: 1.0, origin: Point::default(), rows: Vec::new() }
    }

    /// An empty map of so many cells in a row, to which rows are added.
    pub fn of_width(width: usize, cell_size_m: f64, origin: Point) -> Self {
        Self { width, height: 0, cell_size_m, origin, rows: Vec::new() }
    }

    /// Adds the next row above the others.
    ///
    /// # Panics
    /// When the row is not as wide as the map.
    pub fn push_row(&mut self, row: &[Cell]) {
        assert_eq!(row.len(), self.width, "a row of the map");
        encode(row, &mut self.rows);
        self.height += 1;
    }

    /// Size and place.
    pub fn shape(&self) -> MapShape {
        let Self { width, height, cell_size_m, origin, .. } = *self;
        MapShape { width, height, cell_size_m, origin }
    }

    /// Calls `visit` with each row, the lowest y first.
    pub fn for_each_row(&self, visit: impl FnMut(&[Cell])) {
        decode(self.rows.as_slice(), &self.shape(), visit).expect("rows are as they were pushed");
    }

    /// Bytes of memory that the rows take.
    pub fn bytes(&self) -> usize {
        self.rows.len()
    }
}

/// A stored map that is read row by row: it need not fit into memory.
#[derive(Debug)]
pub struct MapReader {
    shape: MapShape,
    rows: BufReader<File>,
    path: PathBuf,
}

impl MapReader {
    /// Opens the fused map of a set's results.
    ///
    /// # Errors
    /// When there is none.
    pub fn open(directory: &Path) -> Result<Self, ResultsError> {
        Self::open_file(directory.join(FUSED_MAP))
    }

    /// Opens a map by its file.
    ///
    /// # Errors
    /// When there is none.
    pub fn open_file(path: PathBuf) -> Result<Self, ResultsError> {
        let mut rows = BufReader::new(File::open(&path).map_err(|e| ResultsError::file(&path, e))?);
        let mut head = [0; size_of::<MapHead>()];
        rows.read_exact(&mut head).map_err(|_| broken(&path))?;
        let head = MapHead::read_from_bytes(&head).map_err(|_| broken(&path))?;
        let side = |cells: u64| {
            usize::try_from(cells).ok().filter(|cells| *cells <= SIDE_MAX).ok_or_else(|| broken(&path))
        };
        let (width, height) = (side(head.width)?, side(head.height)?);
        let shape = MapShape { width, height, cell_size_m: head.cell_size_m, origin: head.origin };
        Ok(Self { shape, rows, path })
    }

    /// Size and place.
    pub fn shape(&self) -> MapShape {
        self.shape
    }

    /// Calls `visit` with each row, the lowest y first.
    ///
    /// # Errors
    /// When the map is not whole: rows before its damage have been visited.
    pub fn for_each_row(self, visit: impl FnMut(&[Cell])) -> Result<(), ResultsError> {
        decode(self.rows, &self.shape, visit).ok_or_else(|| broken(&self.path))
    }
}

fn broken(path: &Path) -> ResultsError {
    ResultsError::file(path, "is not a whole map")
}

/// Appends a row.
fn encode(row: &[Cell], to: &mut Vec<u8>) {
    let mut rest = row;
    while !rest.is_empty() {
        let unknown = rest.iter().take_while(|cell| cell.is_unknown()).count();
        let known = rest[unknown..].iter().take_while(|cell| !cell.is_unknown()).count();
        push(to, unknown as u64);
        push(to, known as u64);
        for cell in &rest[unknown..unknown + known] {
            push(to, cell.occupied.into());
            push(to, cell.free.into());
        }
        rest = &rest[unknown + known..];
    }
}

/// `None` when these are not the rows of such a map and nothing more.
fn decode(mut rows: impl Read, shape: &MapShape, mut visit: impl FnMut(&[Cell])) -> Option<()> {
    let mut row = Vec::new();
    for _ in 0..shape.height {
        row.clear();
        while row.len() < shape.width {
            let (unknown, known) = (take(&mut rows)? as usize, take(&mut rows)? as usize);
            let left = shape.width - row.len();
            if unknown > left || known > left - unknown || unknown + known == 0 {
                return None;
            }
            row.resize(row.len() + unknown, Cell::UNKNOWN);
            for _ in 0..known {
                let occupied = u32::try_from(take(&mut rows)?).ok()?;
                let free = u32::try_from(take(&mut rows)?).ok()?;
                row.push(Cell { occupied, free });
            }
        }
        visit(&row);
    }
    matches!(rows.read(&mut [0]), Ok(0)).then_some(())
}

/// Appends a number, its lowest bits first.
fn push(bytes: &mut Vec<u8>, mut number: u64) {
    while number >= 1 << BITS {
        bytes.push(number as u8 | 1 << BITS);
        number >>= BITS;
    }
    bytes.push(number as u8);
}

/// Takes a number from the front.
fn take(bytes: &mut impl Read) -> Option<u64> {
    let (mut number, mut byte) = (0, [0]);
    for shift in (0..u64::BITS - BITS).step_by(BITS as usize) {
        bytes.read_exact(&mut byte).ok()?;
        number |= u64::from(byte[0] & !(1 << BITS)) << shift;
        if byte[0] >> BITS == 0 {
            return Some(number);
        }
    }
    None
}

/// Writes the fused map into a set's results.
///
/// # Errors
/// When the disk refuses.
pub fn write_map(directory: &Path, map: &StoredMap) -> Result<(), ResultsError> {
    let head = map.shape().head();
    let parts = [head.as_bytes(), &map.rows];
    Ok(replace_file_by_parts(&directory.join(FUSED_MAP), &parts, Durability::Process)?)
}

/// Writes a map into a file.
///
/// # Errors
/// When the disk refuses.
pub fn write_map_file(file: &mut File, map: &StoredMap) -> io::Result<()> {
    file.write_all(map.shape().head().as_bytes())?;
    file.write_all(&map.rows)
}

/// As [`write_map`], for a map of which `rows` hands over one row after the other, the lowest y first: they need not lie in memory together.
///
/// # Errors
/// When the disk refuses.
///
/// # Panics
/// When the rows are not those of such a map.
pub fn write_map_rows(
    directory: &Path,
    shape: &MapShape,
    rows: impl FnOnce(&mut dyn FnMut(&[Cell]) -> io::Result<()>) -> io::Result<()>,
) -> Result<(), ResultsError> {
    let write = |file: &mut File| {
        let (mut file, mut bytes, mut height) = (BufWriter::new(file), Vec::new(), 0);
        file.write_all(shape.head().as_bytes())?;
        rows(&mut |row| {
            assert_eq!(row.len(), shape.width, "a row of the map");
            bytes.clear();
            encode(row, &mut bytes);
            height += 1;
            file.write_all(&bytes)
        })?;
        assert_eq!(height, shape.height, "rows of the map");
        file.flush()
    };
    Ok(replace_file_by(&directory.join(FUSED_MAP), write, Durability::Process)?)
}

/// Reads the fused map from a set's results.
///
/// # Errors
/// When there is none, or it is not whole.
pub fn read_map(directory: &Path) -> Result<StoredMap, ResultsError> {
    let reader = MapReader::open(directory)?;
    let MapShape { width, cell_size_m, origin, .. } = reader.shape();
    let mut map = StoredMap::of_width(width, cell_size_m, origin);
    reader.for_each_row(|row| map.push_row(row))?;
    Ok(map)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cells() -> impl Strategy<Value = Vec<Cell>> {
        let cell = (any::<u32>(), 0..3000u32, any::<bool>()).prop_map(|(occupied, free, is_known)| {
            if is_known { Cell { occupied, free } } else { Cell::UNKNOWN }
        });
        prop::collection::vec(cell, 0..120)
    }

    fn map(width: usize, cells: &[Cell]) -> StoredMap {
        let mut map = StoredMap::of_width(width, 0.05, Point::new(-1.0, 2.0));
        cells.chunks_exact(width).for_each(|row| map.push_row(row));
        map
    }

    proptest! {
        #[test]
        fn whole_rows_are_read_and_torn_ones_are_not(cells in cells(), width in 1usize..30) {
            let directory = tempfile::tempdir().unwrap();
            let map = map(width, &cells);
            write_map(directory.path(), &map).unwrap();
            prop_assert_eq!(&read_map(directory.path()).unwrap(), &map);
            write_map_rows(directory.path(), &map.shape(), |push| cells.chunks_exact(width).try_for_each(push))
                .unwrap();
            prop_assert_eq!(&read_map(directory.path()).unwrap(), &map);
            let mut rows = Vec::new();
            map.for_each_row(|row| rows.extend_from_slice(row));
            prop_assert_eq!(&rows[..], &cells[..map.width * map.height]);
            let path = directory.path().join(FUSED_MAP);
            let bytes = std::fs::read(&path).unwrap();
            for torn in [&bytes[..bytes.len() - 1], &[&bytes[..], &[0]].concat()] {
                std::fs::write(&path, torn).unwrap();
                prop_assert!(read_map(directory.path()).is_err());
            }
        }

        #[test]
        fn any_bytes_are_a_map_or_none(bytes in prop::collection::vec(any::<u8>(), 0..80), side in 0u64..6) {
            let head = MapHead { width: side, height: side, cell_size_m: 0.05, origin: Point::default() };
            let directory = tempfile::tempdir().unwrap();
            std::fs::write(directory.path().join(FUSED_MAP), [head.as_bytes(), &bytes].concat()).unwrap();
            if let Ok(map) = read_map(directory.path()) {
                map.for_each_row(|row| assert_eq!(row.len(), map.width));
            }
        }
    }

    #[test]
    fn unknown_cells_take_no_memory() {
        let (width, height) = (4000, 500);
        let mut row = vec![Cell::UNKNOWN; width];
        let wall = Cell { occupied: 9000, free: 90 };
        row[100..140].fill(wall);
        let map = map(width, &row.repeat(height));
        // Two bytes and one for the weights of a cell, two for the lengths up to its stretch, three for those behind it.
        assert_eq!(map.bytes(), height * (40 * 3 + 2 + 3));
    }
}
