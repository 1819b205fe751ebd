//! Sparse Cholesky factorisation for matrices of 3 × 3 blocks, with the same result to the bit on every machine.

use crate::ordering::minimum_degree;

/// A 3 × 3 block, row by row.
pub type Block = [f64; 9];

/// Sparse Cholesky factorisation of a symmetric positive definite matrix of 3 × 3 blocks.
///
/// The pattern is analysed once and used for many matrices. Plain scalar arithmetic in a fixed order: the
/// result is the same to the bit on every machine, which a library that picks fused or wide instructions at
/// run time does not promise.
pub struct BlockCholesky {
    /// Position of each node in the order of elimination.
    position: Vec<usize>,
    /// Start of each column's blocks below the diagonal, by position.
    starts: Vec<usize>,
    /// Row (position) of each block below the diagonal, ascending within a column.
    rows: Vec<usize>,
    diagonal: Vec<Block>,
    below: Vec<Block>,
}

impl BlockCholesky {
    /// Prepares for matrices over `nodes` nodes with blocks at `links`.
    pub fn new(nodes: usize, links: &[(usize, usize)]) -> Self {
        let steps = minimum_degree(nodes, links);
        let mut position = vec![0; nodes];
        for (place, (node, _)) in steps.iter().enumerate() {
            position[*node] = place;
        }
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for (_, around) in &steps {
            let first = rows.len();
            rows.extend(around.iter().map(|&node| position[node]));
            rows[first..].sort_unstable();
            starts.push(rows.len());
        }
        let below = vec![[0.0; 9]; rows.len()];
        Self { position, starts, rows, diagonal: vec![[0.0; 9]; nodes], below }
    }

    /// Work of a solution, products of blocks.
    pub fn work(&self) -> u64 {
        let column = |pair: &[usize]| ((pair[1] - pair[0] + 1) * (pair[1] - pair[0] + 2) / 2) as u64;
        self.starts.windows(2).map(column).sum()
    }

    /// Sets the matrix to zero.
    pub fn clear(&mut self) {
        self.diagonal.fill([0.0; 9]);
        self.below.fill([0.0; 9]);
    }

    /// Adds to the diagonal block of `node`.
    pub fn add_diagonal(&mut self, node: usize, block: &Block) {
        add(&mut self.diagonal[self.position[node]], block);
    }

    /// Adds to the block in the row of `a` and the column of `b` (and, transposed, to its mirror image). The
    /// two must be linked.
    pub fn add_link(&mut self, a: usize, b: usize, block: &Block) {
        let (row, column) = (self.position[a], self.position[b]);
        if row > column {
            let slot = self.slot(row, column);
            add(&mut self.below[slot], block);
        } else {
            let slot = self.slot(column, row);
            add(&mut self.below[slot], &transposed(block));
        }
    }

    fn slot(&self, row: usize, column: usize) -> usize {
        let (start, end) = (self.starts[column], self.starts[column + 1]);
        start + self.rows[start..end].binary_search(&row).expect("only linked nodes have a block")
    }

    /// Solves the system in place: right-hand side (by node) in, solution out. The matrix is consumed. False
    /// when it is not positive definite.
    pub fn solve(&mut self, vector: &mut [[f64; 3]]) -> bool {
        let is_definite = self.factor();
        if is_definite {
            self.substituted(vector);
        }
        is_definite
    }

    /// Solves the system of a matrix that is factorised, in place: right-hand side (by node) in, solution out.
    pub fn substituted(&self, vector: &mut [[f64; 3]]) {
        let mut x = vec![[0.0; 3]; vector.len()];
        for (node, value) in vector.iter().enumerate() {
            x[self.position[node]] = *value;
        }
        self.substitute(&mut x);
        for (node, value) in vector.iter_mut().enumerate() {
            *value = x[self.position[node]];
        }
    }

    /// Factorises the matrix in place. False when it is not positive definite.
    pub fn factor(&mut self) -> bool {
        for column in 0..self.diagonal.len() {
            let Some(factor) = cholesky(&self.diagonal[column]) else { return false };
            self.diagonal[column] = factor;
            let (start, end) = (self.starts[column], self.starts[column + 1]);
            for slot in start..end {
                self.below[slot] = right_solved(&self.below[slot], &factor);
            }
            for second in start..end {
                self.update_column(second, end);
            }
        }
        true
    }

    /// Takes the outer product of a finished column's blocks from the column that its block `second` stands
    /// for.
    fn update_column(&mut self, second: usize, end: usize) {
        let target = self.rows[second];
        let right = self.below[second];
        subtract_product(&mut self.diagonal[target], &right, &right);
        let mut slot = self.starts[target];
        for first in second + 1..end {
            let row = self.rows[first];
            while self.rows[slot] != row {
                slot += 1;
            }
            let left = self.below[first];
            subtract_product(&mut self.below[slot], &left, &right);
        }
    }

    fn substitute(&self, x: &mut [[f64; 3]]) {
        for column in 0..x.len() {
            let solved = forward(&self.diagonal[column], &x[column]);
            x[column] = solved;
            for slot in self.starts[column]..self.starts[column + 1] {
                let product = times(&self.below[slot], &solved);
                let target = &mut x[self.rows[slot]];
                (0..3).for_each(|i| target[i] -= product[i]);
            }
        }
        for column in (0..x.len()).rev() {
            let mut rest = x[column];
            for slot in self.starts[column]..self.starts[column + 1] {
                let product = times(&transposed(&self.below[slot]), &x[self.rows[slot]]);
                (0..3).for_each(|i| rest[i] -= product[i]);
            }
            x[column] = backward(&self.diagonal[column], &rest);
        }
    }
}

fn add(to: &mut Block, block: &Block) {
    (0..9).for_each(|i| to[i] += block[i]);
}

fn transposed(m: &Block) -> Block {
    [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]]
}

fn times(m: &Block, v: &[f64; 3]) -> [f64; 3] {
    [0, 3, 6].map(|r| m[r] * v[0] + m[r + 1] * v[1] + m[r + 2] * v[2])
}

/// `to -= a·bᵀ`.
#[inline]
fn subtract_product(to: &mut Block, a: &Block, b: &Block) {
    for r in 0..3 {
        for c in 0..3 {
            to[3 * r + c] -= a[3 * r] * b[3 * c] + a[3 * r + 1] * b[3 * c + 1] + a[3 * r + 2] * b[3 * c + 2];
        }
    }
}

/// Lower triangular L with L·Lᵀ = m, from the lower triangle of m.
fn cholesky(m: &Block) -> Option<Block> {
    let l00 = m[0].sqrt();
    let (l10, l20) = (m[3] / l00, m[6] / l00);
    let l11 = (m[4] - l10 * l10).sqrt();
    let l21 = (m[7] - l20 * l10) / l11;
    let l22 = (m[8] - l20 * l20 - l21 * l21).sqrt();
    let positive = l00 > 0.0 && l11 > 0.0 && l22 > 0.0 && (l00 + l11 + l22).is_finite();
    positive.then_some([l00, 0.0, 0.0, l10, l11, 0.0, l20, l21, l22])
}

/// `b·L⁻ᵀ`.
fn right_solved(b: &Block, l: &Block) -> Block {
    let mut out = *b;
    for r in [0, 3, 6] {
        let row = forward(l, &[b[r], b[r + 1], b[r + 2]]);
        out[r..r + 3].copy_from_slice(&row);
    }
    out
}

/// `L⁻¹·v`.
fn forward(l: &Block, v: &[f64; 3]) -> [f64; 3] {
    let x = v[0] / l[0];
    let y = (v[1] - l[3] * x) / l[4];
    [x, y, (v[2] - l[6] * x - l[7] * y) / l[8]]
}

/// `L⁻ᵀ·v`.
fn backward(l: &Block, v: &[f64; 3]) -> [f64; 3] {
    let z = v[2] / l[8];
    let y = (v[1] - l[7] * z) / l[4];
    [(v[0] - l[3] * y - l[6] * z) / l[0], y, z]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn solves_what_it_is_given(
            links in prop::collection::vec((0usize..12, 0usize..12), 0..30),
            values in prop::collection::vec(-1.0..1.0f64, 9 * 30),
            wanted in prop::collection::vec(-1.0..1.0f64, 36),
        ) {
            let links: Vec<_> = links.into_iter().filter(|(a, b)| a != b).collect();
            let mut matrix = BlockCholesky::new(12, &links);
            // Multiply while building: off-diagonal blocks are small against a dominant diagonal.
            let x: Vec<[f64; 3]> = wanted.chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
            let mut product: Vec<[f64; 3]> = x.iter().map(|v| v.map(|c| 100.0 * c)).collect();
            for node in 0..12 {
                matrix.add_diagonal(node, &[100.0, 0.0, 0.0, 0.0, 100.0, 0.0, 0.0, 0.0, 100.0]);
            }
            for (k, &(a, b)) in links.iter().enumerate() {
                let block: Block = values[9 * k..9 * k + 9].try_into().unwrap();
                matrix.add_link(a, b, &block);
                let (pa, pb) = (times(&block, &x[b]), times(&transposed(&block), &x[a]));
                (0..3).for_each(|i| { product[a][i] += pa[i]; product[b][i] += pb[i]; });
            }
            prop_assert!(matrix.solve(&mut product));
            for (found, wanted) in product.iter().zip(&x) {
                prop_assert!((0..3).all(|i| (found[i] - wanted[i]).abs() < 1e-9));
            }
        }
    }

    #[test]
    fn refuses_an_indefinite_matrix() {
        let mut matrix = BlockCholesky::new(1, &[]);
        matrix.add_diagonal(0, &[1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        assert!(!matrix.solve(&mut [[1.0; 3]]));
    }
}
