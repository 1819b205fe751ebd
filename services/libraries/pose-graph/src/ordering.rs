//! The order in which the unknowns of a sparse system are eliminated: minimum degree (Tinney and Walker 1967).

use std::collections::BTreeSet;

/// An order in which to eliminate the nodes of a graph that keeps the factor sparse: always the node with the
/// fewest neighbours left, the lowest number among equals (minimum degree, Tinney and Walker 1967).
///
/// Returns, for each step, the node and its neighbours at that moment, both as node numbers.
pub fn minimum_degree(nodes: usize, links: &[(usize, usize)]) -> Vec<(usize, Vec<usize>)> {
    let mut neighbours = vec![Vec::new(); nodes];
    for &(a, b) in links {
        if a != b {
            neighbours[a].push(b);
            neighbours[b].push(a);
        }
    }
    for list in &mut neighbours {
        list.sort_unstable();
        list.dedup();
    }
    let mut queue: BTreeSet<(usize, usize)> =
        neighbours.iter().enumerate().map(|(i, l)| (l.len(), i)).collect();
    let mut steps = Vec::with_capacity(nodes);
    while let Some((_, node)) = queue.pop_first() {
        let around = std::mem::take(&mut neighbours[node]);
        for &neighbour in &around {
            queue.remove(&(neighbours[neighbour].len(), neighbour));
            neighbours[neighbour] = joined(&neighbours[neighbour], &around, node, neighbour);
            queue.insert((neighbours[neighbour].len(), neighbour));
        }
        steps.push((node, around));
    }
    steps
}

/// Union of two sorted lists without two of the nodes.
fn joined(a: &[usize], b: &[usize], without: usize, nor: usize) -> Vec<usize> {
    let mut union = Vec::with_capacity(a.len() + b.len());
    let (mut i, mut k) = (0, 0);
    while i < a.len() || k < b.len() {
        let next = match (a.get(i), b.get(k)) {
            (Some(&x), Some(&y)) => x.min(y),
            (Some(&x), None) => x,
            (None, Some(&y)) => y,
            (None, None) => break,
        };
        i += usize::from(a.get(i) == Some(&next));
        k += usize::from(b.get(k) == Some(&next));
        if next != without && next != nor {
            union.push(next);
        }
    }
    union
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chain_fills_nothing_in_and_a_ring_one_link_a_step() {
        let trajectory: Vec<_> = (1..50).map(|i| (i - 1, i)).collect();
        assert!(minimum_degree(50, &trajectory).iter().all(|(_, around)| around.len() <= 1));
        let ring: Vec<_> = (0..50).map(|i| (i, (i + 1) % 50)).collect();
        let steps = minimum_degree(50, &ring);
        assert!(steps.iter().all(|(_, around)| around.len() <= 2));
        let mut nodes: Vec<_> = steps.iter().map(|(node, _)| *node).collect();
        nodes.sort_unstable();
        assert_eq!(nodes, (0..50).collect::<Vec<_>>());
    }
}
