//! Upper bounds on the scores of all translations of a window at one heading: the first level of both searches by branch
//! and bound.

use crate::field::ScoreRead;
use flockslam_evidence::CellIndex;

/// Nodes whose sums grow at once.
const LANES: usize = 8;

/// Upper bounds of the scores of all nodes of a window that have the same heading.
///
/// A node moves points by up to a cell of a wide level, so each point ends within a block of 2 × 2 of its cells, and
/// neighbouring nodes read neighbouring blocks. With the greatest score of each block laid out row by row, a point adds
/// to a whole row of nodes at once.
#[derive(Clone, Debug, Default)]
pub(crate) struct NodeBounds {
    /// First cell that is laid out.
    first: CellIndex,
    width: usize,
    height: usize,
    /// Greatest score of the block that begins at each cell.
    blocks: Vec<u16>,
    /// Nodes to either side of the middle.
    reach: i32,
    sums: Vec<u32>,
    points: usize,
}

impl NodeBounds {
    /// Lays out the scores of a level for points that end within `radius` cells of `middle`, and for nodes from `-reach` up
    /// to below `reach` cells away.
    pub(crate) fn lay_out(&mut self, read: &mut impl ScoreRead, middle: CellIndex, radius: i32, reach: i32) {
        self.reach = reach;
        let low = radius + reach + 1;
        self.first = CellIndex::new(middle.x.wrapping_sub(low), middle.y.wrapping_sub(low));
        self.height = (2 * low + 2) as usize;
        self.width = self.height + LANES;
        self.blocks.resize(self.width * self.height, 0);
        for (y, row) in (0..).zip(self.blocks.chunks_exact_mut(self.width)) {
            read.row(CellIndex::new(self.first.x, self.first.y.wrapping_add(y)), row);
        }
        self.pool();
    }

    /// Makes of each score the greatest of its block.
    fn pool(&mut self) {
        for row in self.blocks.chunks_exact_mut(self.width) {
            for x in 1..row.len() {
                row[x - 1] = row[x - 1].max(row[x]);
            }
        }
        let mut rows = self.blocks.chunks_exact_mut(self.width);
        let mut below = rows.next();
        for row in rows {
            for (score, above) in below.into_iter().flatten().zip(&*row) {
                *score = (*score).max(*above);
            }
            below = Some(row);
        }
    }

    /// Adds up the bounds of all nodes for points that end in these cells, of which 2^halvings go into a wide one.
    pub(crate) fn sum(&mut self, ends: &[CellIndex], halvings: u32) {
        let side = 2 * self.reach as usize;
        let lanes = side.next_multiple_of(LANES);
        self.points = ends.len();
        self.sums.clear();
        self.sums.resize(lanes * side, 0);
        for end in ends {
            let x = (end.x >> halvings).wrapping_sub(self.reach).wrapping_sub(self.first.x) as u32 as usize;
            let y = (end.y >> halvings).wrapping_sub(self.reach).wrapping_sub(self.first.y) as u32 as usize;
            // Only at the edge of the range of numbers can a point end outside.
            if x + lanes > self.width || y + side > self.height {
                continue;
            }
            let rows = self.blocks[y * self.width + x..].chunks(self.width);
            for (sums, row) in self.sums.chunks_exact_mut(lanes).zip(rows) {
                for (sums, blocks) in sums.chunks_exact_mut(LANES).zip(row.chunks_exact(LANES)) {
                    for (sum, block) in sums.iter_mut().zip(blocks) {
                        *sum = sum.wrapping_add(u32::from(*block));
                    }
                }
            }
        }
    }

    /// The nodes (x, y) whose bound, 0 … 1, is above a score.
    pub(crate) fn above(&self, score: f64) -> impl Iterator<Item = (f64, i32, i32)> {
        let side = 2 * self.reach as usize;
        let lanes = side.next_multiple_of(LANES);
        let full = f64::from(u16::MAX) * self.points as f64;
        let nodes = self.sums.chunks_exact(lanes).zip(-self.reach..).flat_map(move |(sums, y)| {
            (-self.reach..self.reach).zip(sums).map(move |(x, sum)| (f64::from(*sum) / full, x, y))
        });
        nodes.filter(move |node| node.0 > score)
    }
}
