//! Chains wedges into acute lines.

use super::line::{AcuteLine, AcutePair};
use super::wedges::Wedge;

/// Maximum mean angle of an acute line, in degrees.
const MAX_MEAN_ANGLE: f64 = 30.0;
/// Minimum length of a line in 3-D, in units of d. One or two edges at which rough faces are folded
/// by chance are not a line.
const MIN_LENGTH: f64 = 2.0;

/// Acute lines of a mesh, and for their nodes the global numbers, the positions, and d. The nodes
/// of lines are indices into these lists.
pub struct AcuteLines<const D: usize> {
    pub lines: Vec<AcuteLine>,
    pub global_nodes: Vec<u32>,
    pub nodes: Vec<[f64; D]>,
    pub distance: Vec<f64>,
}

/// Chains wedges, which are ordered by ridge, into lines.
pub fn chain_lines<const D: usize>(mut wedges: Vec<Wedge<D>>) -> AcuteLines<D> {
    let ends = |wedge: &Wedge<D>| {
        let end = |k: usize| (wedge.ridge[k], (wedge.ends[k], wedge.distance[k]));
        [end(0), end(1)]
    };
    let mut ends: Vec<(u32, ([f64; D], f64))> = wedges.iter().flat_map(ends).collect();
    ends.sort_by_key(|(number, _)| *number);
    ends.dedup_by_key(|(number, _)| *number);
    let (global_nodes, node_values): (Vec<u32>, Vec<_>) = ends.into_iter().unzip();
    let (nodes, distance): (Vec<[f64; D]>, Vec<f64>) = node_values.into_iter().unzip();
    let node_index = |n: u32| global_nodes.partition_point(|&number| number < n) as u32;
    wedges
        .iter_mut()
        .for_each(|wedge| wedge.ridge = wedge.ridge.map(node_index));
    let mut lines = chain_wedges(&wedges, &nodes);
    lines.retain(|line| {
        let d = line
            .nodes
            .iter()
            .map(|&n| distance[n as usize])
            .sum::<f64>();
        let d = d / line.nodes.len() as f64;
        line.mean_angle < MAX_MEAN_ANGLE && (D == 2 || line.length >= MIN_LENGTH * d)
    });
    AcuteLines {
        lines,
        global_nodes,
        nodes,
        distance,
    }
}

/// Chains wedges, which are ordered by ridge, into lines. A line continues at a node where exactly
/// one other ridge of the same pair begins.
fn chain_wedges<const D: usize>(wedges: &[Wedge<D>], positions: &[[f64; D]]) -> Vec<AcuteLine> {
    let line = |nodes, angles, pair| AcuteLine::new(nodes, angles, pair, positions);
    if D == 2 {
        let single = |w: &Wedge<D>| line(vec![w.ridge[0]], vec![w.angle], w.pair);
        return wedges.iter().map(single).collect();
    }
    let mut ends: Vec<(u32, AcutePair, usize)> = (wedges.iter().enumerate())
        .flat_map(|(i, w)| w.ridge.map(|node| (node, w.pair, i)))
        .collect();
    ends.sort_unstable();
    let ends_at = |node: u32, pair: AcutePair| {
        let begin = ends.partition_point(|end| (end.0, end.1) < (node, pair));
        let end = ends.partition_point(|end| (end.0, end.1) <= (node, pair));
        &ends[begin..end]
    };
    let mut used = vec![false; wedges.len()];
    let mut walk = |first: usize, start_node: u32| {
        let pair = wedges[first].pair;
        let (mut nodes, mut angles) = (vec![start_node], Vec::new());
        let mut next = Some(first);
        let mut node = start_node;
        while let Some(i) = next.filter(|&i| !used[i]) {
            used[i] = true;
            let [a, b] = wedges[i].ridge;
            node = if a == node { b } else { a };
            nodes.push(node);
            angles.push(wedges[i].angle);
            next = match ends_at(node, pair) {
                [end_a, end_b] => Some(if end_a.2 == i { end_b.2 } else { end_a.2 }),
                _ => None,
            };
        }
        (!angles.is_empty()).then(|| line(nodes, angles, pair))
    };
    // Open lines are followed from their ends, then closed lines from any of their edges.
    let open_ends = ends.iter().filter(|end| ends_at(end.0, end.1).len() != 2);
    let mut lines: Vec<AcuteLine> = open_ends.filter_map(|end| walk(end.2, end.0)).collect();
    lines.extend((0..wedges.len()).filter_map(|i| walk(i, wedges[i].ridge[0])));
    lines
}
