//! Plans as pictures, and what becomes of a building: parts that are not drawn, furniture, walls that stand elsewhere, doors that are closed.

#![allow(dead_code, reason = "each user needs a part of it")]

use flockslam::store::read_nav2_map;
use flockslam_evidence::CellState;
use flockslam_geometry::Point;
use flockslam_random::Random;
use flockslam_results::StoredMap;
use std::fs;
use std::path::{Path, PathBuf};

/// What stands in free space keeps so far from walls, metres, as where robots drive.
const GAP_M: f64 = 0.3;
/// Sides of a piece of furniture, metres.
const SIDES_M: (f64, f64) = (0.3, 0.8);
/// A passage of at most this width between walls may be a door, metres; a narrower one is a gap.
const DOOR_M: (f64, f64) = (0.6, 1.3);

/// A rectangle of cells, the lowest row first.
#[derive(Clone, Debug)]
pub struct PlanPicture {
    pub width: usize,
    pub height: usize,
    pub cell_size_m: f64,
    pub origin: Point,
    pub cells: Vec<CellState>,
}

/// A piece of furniture: the column and row of its corner, and its size in cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Furniture {
    pub corner: (usize, usize),
    pub size: (usize, usize),
}

impl PlanPicture {
    /// What a map says.
    pub fn of_map(map: &StoredMap) -> Self {
        let mut cells = Vec::new();
        map.for_each_row(|row| cells.extend(row.iter().map(CellState::of)));
        let StoredMap { width, height, cell_size_m, origin, .. } = *map;
        Self { width, height, cell_size_m, origin, cells }
    }

    /// A map of nav2's kind.
    pub fn read(yaml: &Path) -> Self {
        Self::of_map(&read_nav2_map(yaml).unwrap())
    }

    fn at(&self, x: usize, y: usize) -> CellState {
        self.cells[y * self.width + x]
    }

    /// Area of its free space, m².
    pub fn free_m2(&self) -> f64 {
        let free = self.cells.iter().filter(|cell| **cell == CellState::Free);
        free.count() as f64 * self.cell_size_m * self.cell_size_m
    }

    /// What it says of a place.
    pub fn state_at(&self, at: Point) -> CellState {
        let cell = |metres: f64| (metres / self.cell_size_m).floor();
        let (x, y) = (cell(at.x_m - self.origin.x_m), cell(at.y_m - self.origin.y_m));
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        if inside { self.at(x as usize, y as usize) } else { CellState::Unknown }
    }

    /// The middle of the cell with this number.
    pub fn middle(&self, place: usize) -> Point {
        let along = |from: f64, cell: usize| from + (cell as f64 + 0.5) * self.cell_size_m;
        Point::new(along(self.origin.x_m, place % self.width), along(self.origin.y_m, place / self.width))
    }

    fn cells_of(&self, metres: f64) -> usize {
        (metres / self.cell_size_m).round() as usize
    }

    /// Nothing is drawn left of this share of the width.
    #[must_use]
    pub fn without_left(mut self, share: f64) -> Self {
        let end = (share * self.width as f64) as usize;
        for y in 0..self.height {
            let row = y * self.width;
            self.cells[row..row + end].fill(CellState::Unknown);
        }
        self
    }

    /// Puts so many pieces of furniture where there is room.
    #[must_use]
    pub fn furnished(mut self, pieces: usize, random: &mut Random) -> (Self, Vec<Furniture>) {
        let empty = self.clone();
        let mut put = Vec::new();
        for _ in 0..400 * pieces {
            if put.len() == pieces {
                break;
            }
            if let Some(piece) = empty.room_for_a_piece(random) {
                let overlaps = self.rectangle(&piece).any(|place| self.cells[place] == CellState::Occupied);
                if !overlaps {
                    self.put(&piece);
                    put.push(piece);
                }
            }
        }
        (self, put)
    }

    /// Puts a piece of furniture where it says.
    pub fn put(&mut self, piece: &Furniture) {
        self.rectangle(piece)
            .collect::<Vec<_>>()
            .into_iter()
            .for_each(|place| self.cells[place] = CellState::Occupied);
    }

    /// Whether a piece of furniture stands there.
    pub fn has(&self, piece: &Furniture) -> bool {
        self.rectangle(piece).all(|place| self.cells[place] == CellState::Occupied)
    }

    fn rectangle(&self, piece: &Furniture) -> impl Iterator<Item = usize> + use<> {
        let (Furniture { corner, size }, width) = (*piece, self.width);
        (corner.1..corner.1 + size.1)
            .flat_map(move |y| (corner.0..corner.0 + size.0).map(move |x| y * width + x))
    }

    /// A piece at a random place with free space around it; `None` when there is none at that place.
    fn room_for_a_piece(&self, random: &mut Random) -> Option<Furniture> {
        let gap = self.cells_of(GAP_M);
        let side = |random: &mut Random| self.cells_of(random.between(SIDES_M.0, SIDES_M.1)).max(1);
        let size = (side(random), side(random));
        let place = |random: &mut Random, cells: usize| random.between(0.0, cells as f64) as usize;
        let corner = (place(random, self.width), place(random, self.height));
        let fits = corner.0 >= gap
            && corner.1 >= gap
            && corner.0 + size.0 + gap <= self.width
            && corner.1 + size.1 + gap <= self.height;
        let is_free = |around: usize| {
            (corner.1 - around..corner.1 + size.1 + around).all(|y| {
                (corner.0 - around..corner.0 + size.0 + around).all(|x| self.at(x, y) == CellState::Free)
            })
        };
        (fits && is_free(gap)).then_some(Furniture { corner, size })
    }

    /// Walls stand a cell elsewhere: all that is occupied in each block of so many metres has moved to one of the nine places around.
    #[must_use]
    pub fn with_walls_off(mut self, block_m: f64, random: &mut Random) -> Self {
        let before = self.clone();
        let side = self.cells_of(block_m);
        let occupied = |x: usize, y: usize| before.at(x, y) == CellState::Occupied;
        for place in self.cells.iter_mut().filter(|cell| **cell == CellState::Occupied) {
            *place = CellState::Free;
        }
        for y in (0..self.height).step_by(side) {
            for x in (0..self.width).step_by(side) {
                let (dx, dy) = (random.below(3), random.below(3));
                for (y, x) in (y..(y + side).min(self.height))
                    .flat_map(|y| (x..(x + side).min(self.width)).map(move |x| (y, x)))
                {
                    let moved = ((x + dx).wrapping_sub(1), (y + dy).wrapping_sub(1));
                    if occupied(x, y) && moved.0 < self.width && moved.1 < self.height {
                        self.cells[moved.1 * self.width + moved.0] = CellState::Occupied;
                    }
                }
            }
        }
        // A gap of a cell between what moved apart and behind what moved is no way through.
        let after = self.clone();
        for y in 1..self.height - 1 {
            for x in 1..self.width - 1 {
                let was_wall = occupied(x, y) && after.at(x, y) == CellState::Free;
                let is = |x: usize, y: usize| after.at(x, y) == CellState::Occupied;
                let is_between = (is(x - 1, y) && is(x + 1, y)) || (is(x, y - 1) && is(x, y + 1));
                let outside = |x: usize, y: usize| before.at(x, y) == CellState::Unknown;
                let is_edge =
                    outside(x - 1, y) || outside(x + 1, y) || outside(x, y - 1) || outside(x, y + 1);
                if was_wall && (is_between || is_edge) {
                    self.cells[y * self.width + x] = CellState::Occupied;
                }
            }
        }
        self
    }

    /// Closes this share of the narrow passages between walls.
    #[must_use]
    pub fn with_doors_closed(mut self, share: f64, random: &mut Random) -> (Self, usize) {
        let before = self.clone();
        let (least, most) = (self.cells_of(DOOR_M.0), self.cells_of(DOOR_M.1));
        let mut closed: Vec<(usize, usize)> = Vec::new();
        for y in 1..self.height - 1 {
            for x in 1..self.width - 1 {
                // A door between a wall on the left or below and one on the other side, with room before and behind it.
                for across in [(1, 0), (0, 1)] {
                    let step = |n: usize| (x + across.0 * n, y + across.1 * n);
                    let inside = |(x, y): (usize, usize)| x < self.width && y < self.height;
                    let is =
                        |place: (usize, usize), state| inside(place) && before.at(place.0, place.1) == state;
                    let begins = is((x - across.0, y - across.1), CellState::Occupied);
                    let free = (0..=most).take_while(|n| is(step(*n), CellState::Free)).count();
                    let ends = is(step(free), CellState::Occupied);
                    let is_door = begins && ends && (least..=most).contains(&free);
                    let is_known = closed.iter().any(|at| at.0.abs_diff(x) + at.1.abs_diff(y) < 2 * most);
                    if is_door && !is_known {
                        closed.push((x, y));
                        if random.happens(share) {
                            (0..free)
                                .map(step)
                                .for_each(|(x, y)| self.cells[y * self.width + x] = CellState::Occupied);
                        }
                    }
                }
            }
        }
        let shut = before.cells.iter().zip(&self.cells).filter(|(a, b)| a != b).count();
        (self, shut)
    }

    /// Writes it as a map of nav2's kind.
    pub fn write(&self, directory: &Path, name: &str) -> PathBuf {
        let mut pgm = format!("P5\n{} {}\n255\n", self.width, self.height).into_bytes();
        for y in (0..self.height).rev() {
            pgm.extend((0..self.width).map(|x| match self.at(x, y) {
                CellState::Free => 254,
                CellState::Occupied => 0,
                CellState::Unknown => 205,
            }));
        }
        fs::write(directory.join(format!("{name}.pgm")), pgm).unwrap();
        let yaml = directory.join(format!("{name}.yaml"));
        let Point { x_m, y_m } = self.origin;
        let text = format!(
            "image: {name}.pgm\nresolution: {}\norigin: [{x_m}, {y_m}, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
            self.cell_size_m
        );
        fs::write(&yaml, text).unwrap();
        yaml
    }
}
