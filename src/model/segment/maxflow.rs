//! Minimum cut between two terminals by the two search trees of Boykov & Kolmogorov (2004), "An
//! experimental comparison of min-cut/max-flow algorithms for energy minimization in vision", with
//! the timestamps and distances of the authors' own program.
//!
//! Capacities are integers, so that saturation is exact and every machine finds the same cut. Nodes
//! and arcs lie in two flat arrays; the arcs of a node are adjacent.

use crate::error::{Error, Result, cause};
use crate::geometry::NONE;

/// Value of `parent` for a node in no tree.
const FREE: u32 = u32::MAX;
/// Value of `parent` for a node that is joined to the terminal itself.
const TERMINAL: u32 = u32::MAX - 1;
/// Value of `parent` for a node that has lost its parent and has not yet been adopted.
const ORPHAN: u32 = u32::MAX - 2;

/// Maximum numbers of nodes and of links. A link has two arcs; the numbers of nodes and arcs must
/// be below the special values above.
const MAX_NODES: u64 = ORPHAN as u64 - 1;
const MAX_LINKS: u64 = ORPHAN as u64 / 2;

/// One direction of a link.
#[derive(Debug, Clone, Copy)]
struct Arc {
    /// Node at which the arc ends.
    head: u32,
    /// Arc of the opposite direction.
    sister: u32,
    /// Residual capacity.
    residual: i32,
}

/// A node, with its place in the search trees.
#[derive(Debug, Clone, Copy)]
struct FlowNode {
    /// First arc of the node. Its arcs end where those of the next node begin.
    first_arc: u32,
    /// Arc to the parent, or one of `FREE`, `TERMINAL` and `ORPHAN`.
    parent: u32,
    /// Time at which `distance` was last known to be right.
    timestamp: u32,
    /// Estimated number of arcs to the terminal.
    distance: u32,
    /// Residual capacity from the source (positive) or to the sink (negative).
    terminal_residual: i32,
    /// `true` if the node is in the sink's tree; undefined for nodes in no tree.
    is_in_sink: bool,
    /// `true` if the node is in a queue of active nodes.
    is_queued: bool,
}

/// A flow network: nodes joined by links, each node with capacities from the source and to the
/// sink.
#[derive(Debug, Clone)]
pub struct Network {
    /// One more entry than there are nodes, so that the arcs of the last node have an end.
    nodes: Vec<FlowNode>,
    arcs: Vec<Arc>,
    flow: i64,
    time: u32,
    /// Queue of active nodes, read from `queue_position` on; nodes activated meanwhile are in
    /// `next_queue`.
    queue: Vec<u32>,
    queue_position: usize,
    next_queue: Vec<u32>,
    orphans: std::collections::VecDeque<u32>,
}

impl Network {
    /// Creates a network whose links have equal capacity in both directions. `links` must call its
    /// argument with the two nodes and the capacity of each link. It runs twice: once to count the
    /// links and once to store them.
    ///
    /// The sum of the capacities at any node must be below 2^30.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if there are too many nodes or links: nearly 2^32 or 2^31.
    pub fn new(count: usize, links: impl Fn(&mut dyn FnMut(u32, u32, i32))) -> Result<Self> {
        check_size(count as u64, 0)?;
        let node = FlowNode {
            first_arc: 0,
            parent: FREE,
            timestamp: 0,
            distance: 0,
            terminal_residual: 0,
            is_in_sink: false,
            is_queued: false,
        };
        let mut nodes = vec![node; count + 1];
        let mut link_count = 0u64;
        links(&mut |a, b, _| {
            link_count += 1;
            for node in [a, b] {
                let arcs = &mut nodes[node as usize].first_arc;
                *arcs = arcs.wrapping_add(1);
            }
        });
        check_size(count as u64, link_count)?;
        // `first_arc` first holds the end of each node's arcs; filling them from the back turns it
        // into the beginning.
        let mut end = 0;
        for node in &mut nodes {
            end += node.first_arc;
            node.first_arc = end;
        }
        let unset = Arc {
            head: NONE,
            sister: NONE,
            residual: 0,
        };
        let mut arcs = vec![unset; end as usize];
        links(&mut |a, b, capacity| {
            let mut next_slot = |node: u32| {
                let first = &mut nodes[node as usize].first_arc;
                *first -= 1;
                *first
            };
            let (forward, backward) = (next_slot(a), next_slot(b));
            arcs[forward as usize] = Arc {
                head: b,
                sister: backward,
                residual: capacity,
            };
            arcs[backward as usize] = Arc {
                head: a,
                sister: forward,
                residual: capacity,
            };
        });
        Ok(Self {
            nodes,
            arcs,
            flow: 0,
            time: 0,
            queue: Vec::new(),
            queue_position: 0,
            next_queue: Vec::new(),
            orphans: std::collections::VecDeque::new(),
        })
    }

    /// Adds capacities from the source to a node and from the node to the sink. The smaller of the
    /// two flows at once.
    pub fn add_terminal(&mut self, node: u32, from_source: i32, to_sink: i32) {
        self.flow += i64::from(from_source.min(to_sink));
        self.nodes[node as usize].terminal_residual += from_source - to_sink;
    }

    /// Binds a node to the source or to the sink, with more capacity than its links can carry. Call
    /// it at most once for a node, before [`Network::solve`].
    pub fn bind_to_terminal(&mut self, node: u32, to_source: bool) {
        let arcs = self.arcs_of(node).map(|a| self.arcs[a as usize].residual);
        let excess = 1 + arcs.sum::<i32>();
        self.nodes[node as usize].terminal_residual = if to_source { excess } else { -excess };
    }

    /// Computes the maximum flow, and with it the minimum cut; returns the flow.
    pub fn solve(&mut self) -> i64 {
        for i in 0..self.nodes.len() as u32 - 1 {
            let node = &mut self.nodes[i as usize];
            if node.terminal_residual != 0 {
                node.is_in_sink = node.terminal_residual < 0;
                node.parent = TERMINAL;
                node.distance = 1;
                self.activate(i);
            }
        }
        let mut current = NONE;
        loop {
            let previous = std::mem::replace(&mut current, NONE);
            let i = match previous {
                NONE => match self.next_active() {
                    Some(i) => i,
                    None => return self.flow,
                },
                // An augmentation may have freed the node.
                i if self.nodes[i as usize].parent == FREE => continue,
                i => i,
            };
            let meeting_arc = self.grow(i);
            self.time += 1;
            if let Some(arc) = meeting_arc {
                current = i;
                self.augment(arc);
                while let Some(orphan) = self.orphans.pop_front() {
                    self.adopt(orphan);
                }
            }
        }
    }

    /// Returns `true` if a node is on the source's side of the cut. A node that could be on either
    /// side is on the sink's.
    pub fn is_on_source_side(&self, node: u32) -> bool {
        let node = &self.nodes[node as usize];
        node.parent != FREE && !node.is_in_sink
    }

    fn arcs_of(&self, node: u32) -> std::ops::Range<u32> {
        self.nodes[node as usize].first_arc..self.nodes[node as usize + 1].first_arc
    }

    fn activate(&mut self, node: u32) {
        let is_queued = &mut self.nodes[node as usize].is_queued;
        if !*is_queued {
            *is_queued = true;
            self.next_queue.push(node);
        }
    }

    /// Returns the active node that has waited longest and is still in a tree.
    fn next_active(&mut self) -> Option<u32> {
        loop {
            if self.queue_position == self.queue.len() {
                self.queue.clear();
                self.queue_position = 0;
                std::mem::swap(&mut self.queue, &mut self.next_queue);
            }
            let &i = self.queue.get(self.queue_position)?;
            self.queue_position += 1;
            let node = &mut self.nodes[i as usize];
            node.is_queued = false;
            if node.parent != FREE {
                return Some(i);
            }
        }
    }

    /// Grows the tree of an active node by its free neighbours until it meets the other tree.
    /// Returns the arc between the trees, directed from the source's side to the sink's.
    fn grow(&mut self, i: u32) -> Option<u32> {
        let FlowNode {
            is_in_sink: in_sink,
            timestamp,
            distance,
            ..
        } = self.nodes[i as usize];
        for a in self.arcs_of(i) {
            let Arc {
                head,
                sister,
                residual,
            } = self.arcs[a as usize];
            let available = if in_sink {
                self.arcs[sister as usize].residual
            } else {
                residual
            };
            if available == 0 {
                continue;
            }
            let node = &mut self.nodes[head as usize];
            if node.parent == FREE {
                node.is_in_sink = in_sink;
                node.parent = sister;
                node.timestamp = timestamp;
                node.distance = distance + 1;
                self.activate(head);
            } else if node.is_in_sink != in_sink {
                return Some(if in_sink { sister } else { a });
            } else if node.timestamp <= timestamp && node.distance > distance {
                // This path to the terminal is shorter.
                node.parent = sister;
                node.timestamp = timestamp;
                node.distance = distance + 1;
            }
        }
        None
    }

    /// Pushes the maximum flow through the path that contains the arc `meeting_arc`.
    fn augment(&mut self, meeting_arc: u32) {
        let Arc {
            head,
            sister,
            residual,
        } = self.arcs[meeting_arc as usize];
        let tail = self.arcs[sister as usize].head;
        let mut bottleneck = residual;
        for (start, in_sink) in [(tail, false), (head, true)] {
            let mut i = start;
            loop {
                let node = &self.nodes[i as usize];
                if node.parent == TERMINAL {
                    bottleneck = bottleneck.min(node.terminal_residual.abs());
                    break;
                }
                let arc = self.arcs[node.parent as usize];
                bottleneck = bottleneck.min(if in_sink {
                    arc.residual
                } else {
                    self.arcs[arc.sister as usize].residual
                });
                i = arc.head;
            }
        }
        self.arcs[meeting_arc as usize].residual -= bottleneck;
        self.arcs[sister as usize].residual += bottleneck;
        for (start, in_sink) in [(tail, false), (head, true)] {
            let mut i = start;
            loop {
                let node = &mut self.nodes[i as usize];
                let parent = node.parent;
                if parent == TERMINAL {
                    node.terminal_residual -= if in_sink { -bottleneck } else { bottleneck };
                    if node.terminal_residual == 0 {
                        node.parent = ORPHAN;
                        self.orphans.push_front(i);
                    }
                    break;
                }
                let Arc { head, sister, .. } = self.arcs[parent as usize];
                // In the source's tree the flow runs from the parent to the node, in the sink's
                // tree from the node to the parent.
                let (forward, backward) = if in_sink {
                    (parent, sister)
                } else {
                    (sister, parent)
                };
                self.arcs[backward as usize].residual += bottleneck;
                let remaining = &mut self.arcs[forward as usize].residual;
                *remaining -= bottleneck;
                if *remaining == 0 {
                    self.nodes[i as usize].parent = ORPHAN;
                    self.orphans.push_front(i);
                }
                i = head;
            }
        }
        self.flow += i64::from(bottleneck);
    }

    /// Finds a new parent for an orphan, as near to the terminal as possible, or else makes it
    /// free.
    fn adopt(&mut self, i: u32) {
        let in_sink = self.nodes[i as usize].is_in_sink;
        let (mut best_arc, mut min_distance) = (FREE, u32::MAX);
        for a in self.arcs_of(i) {
            let head = self.arcs[a as usize].head;
            if self.can_be_parent(a, in_sink)
                && let Some(distance) = self.distance_to_terminal(head, in_sink)
                && distance < min_distance
            {
                (best_arc, min_distance) = (a, distance);
            }
        }
        let time = self.time;
        let node = &mut self.nodes[i as usize];
        node.parent = best_arc;
        if best_arc != FREE {
            node.timestamp = time;
            node.distance = min_distance + 1;
            return;
        }
        for a in self.arcs_of(i) {
            let head = self.arcs[a as usize].head;
            let FlowNode {
                parent,
                is_in_sink: other_in_sink,
                ..
            } = self.nodes[head as usize];
            if parent == FREE || other_in_sink != in_sink {
                continue;
            }
            if self.can_be_parent(a, in_sink) {
                self.activate(head);
            }
            if parent < ORPHAN && self.arcs[parent as usize].head == i {
                self.nodes[head as usize].parent = ORPHAN;
                self.orphans.push_back(head);
            }
        }
    }

    /// Returns `true` if the node at the arc's head can be the parent of the node at its tail.
    fn can_be_parent(&self, arc: u32, in_sink: bool) -> bool {
        let Arc {
            residual, sister, ..
        } = self.arcs[arc as usize];
        if in_sink {
            residual > 0
        } else {
            self.arcs[sister as usize].residual > 0
        }
    }

    /// Returns the number of arcs from a node to its tree's terminal, or `None` if the path ends in
    /// an orphan. Stores the distances of all nodes on the path.
    fn distance_to_terminal(&mut self, start: u32, in_sink: bool) -> Option<u32> {
        let node = &self.nodes[start as usize];
        if node.parent == FREE || node.is_in_sink != in_sink {
            return None;
        }
        let (mut j, mut steps) = (start, 0);
        let total = loop {
            let node = &mut self.nodes[j as usize];
            if node.timestamp == self.time {
                break steps + node.distance;
            }
            steps += 1;
            match node.parent {
                TERMINAL => {
                    node.timestamp = self.time;
                    node.distance = 1;
                    break steps;
                }
                ORPHAN | FREE => return None,
                parent => j = self.arcs[parent as usize].head,
            }
        };
        let (mut j, mut remaining) = (start, total);
        loop {
            let node = &mut self.nodes[j as usize];
            if node.timestamp == self.time {
                return Some(total);
            }
            node.timestamp = self.time;
            node.distance = remaining;
            remaining -= 1;
            j = self.arcs[node.parent as usize].head;
        }
    }
}

/// Checks that nodes and arcs can be numbered.
///
/// # Errors
/// Returns [`Error::Job`] if they cannot, with their number and the maximum.
pub(super) fn check_size(nodes: u64, links: u64) -> Result<()> {
    for (count, max_count, noun) in [
        (nodes, MAX_NODES, "cells or samples"),
        (links, MAX_LINKS, "faces between them"),
    ] {
        if count > max_count {
            return Err(Error::Job(cause(
                "segmentation",
                format!("has {count} {noun}, more than the {max_count} that a cut can have"),
                "cut out a part of the image, or take every other sample",
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns the value of the best of all cuts.
    fn brute_force(terminals: &[[i32; 2]], links: &[(u32, u32, i32)]) -> i64 {
        let cost = |cut: u32| {
            let in_source = |node: u32| cut >> node & 1 == 1;
            let terminal_cost = terminals
                .iter()
                .zip(0..)
                .map(|(t, node)| i64::from(if in_source(node) { t[1] } else { t[0] }));
            let between = links
                .iter()
                .filter(|(a, b, _)| in_source(*a) != in_source(*b));
            terminal_cost.sum::<i64>() + between.map(|link| i64::from(link.2)).sum::<i64>()
        };
        (0..1 << terminals.len()).map(cost).min().unwrap_or(0)
    }

    fn network(terminals: &[[i32; 2]], links: &[(u32, u32, i32)]) -> Network {
        let mut network = Network::new(terminals.len(), |add| {
            links.iter().for_each(|&(a, b, c)| add(a, b, c));
        })
        .unwrap();
        for (node, t) in (0..).zip(terminals) {
            network.add_terminal(node, t[0], t[1]);
        }
        network
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]
        #[test]
        fn the_flow_and_the_cut_are_those_of_brute_force(
            terminals in proptest::collection::vec([0..20i32, 0..20i32], 1..11),
            links in proptest::collection::vec((0..11u32, 0..11u32, 0..12i32), 0..40),
        ) {
            let n = terminals.len() as u32;
            let links: Vec<_> = links
                .into_iter()
                .map(|(a, b, c)| (a % n, b % n, c))
                .filter(|(a, b, _)| a != b)
                .collect();
            let mut network = network(&terminals, &links);
            let flow = network.solve();
            prop_assert_eq!(flow, brute_force(&terminals, &links));
            let side = |node: u32| network.is_on_source_side(node);
            let terminal_part = (0..).zip(&terminals).map(|(node, t)| if side(node) { t[1] } else { t[0] });
            let cut = links.iter().filter(|(a, b, _)| side(*a) != side(*b)).map(|link| link.2);
            prop_assert_eq!(flow, terminal_part.chain(cut).map(i64::from).sum::<i64>());
        }
    }

    #[test]
    fn more_nodes_or_links_than_can_be_numbered_are_refused() {
        assert!(check_size(MAX_NODES, MAX_LINKS).is_ok());
        // The number of the last arc of the largest network is none of the special values.
        assert!(2 * MAX_LINKS - 1 < u64::from(ORPHAN));
        for (nodes, links) in [(MAX_NODES + 1, 0), (1 << 32, 0), (7, MAX_LINKS + 1)] {
            let error = check_size(nodes, links).unwrap_err().to_string();
            let max_count = if links == 0 { MAX_NODES } else { MAX_LINKS };
            assert!(
                error.contains(&format!("more than the {max_count} ")),
                "{error}"
            );
        }
        let error = Network::new(1 << 32, |_| panic!("links must not be called")).unwrap_err();
        assert!(error.to_string().contains("4294967296 cells"), "{error}");
    }

    #[test]
    fn a_large_grid_has_equal_flow_and_cut() {
        // 40 x 40 x 6 nodes with pseudo-random capacities need many augmentations and adoptions.
        let [nx, ny, nz] = [40u32, 40, 6];
        let mut state = 7u32;
        let mut random = |bound: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((state >> 8) % bound) as i32
        };
        let mut links = Vec::new();
        for i in 0..nx * ny * nz {
            let [x, y, z] = [i % nx, i / nx % ny, i / (nx * ny)];
            for (inside, step) in [(x + 1 < nx, 1), (y + 1 < ny, nx), (z + 1 < nz, nx * ny)] {
                if inside {
                    links.push((i, i + step, random(25)));
                }
            }
        }
        let terminals: Vec<[i32; 2]> = (0..nx * ny * nz)
            .map(|_| [random(90), random(90)])
            .collect();
        let mut network = network(&terminals, &links);
        let flow = network.solve();
        let side = |node: u32| network.is_on_source_side(node);
        let terminal_part = (0..)
            .zip(&terminals)
            .map(|(node, t)| if side(node) { t[1] } else { t[0] });
        let cut = links
            .iter()
            .filter(|(a, b, _)| side(*a) != side(*b))
            .map(|link| link.2);
        assert_eq!(flow, terminal_part.chain(cut).map(i64::from).sum::<i64>());
        let objects = (0..nx * ny * nz).filter(|&node| side(node)).count();
        assert!((1000..8600).contains(&objects), "{objects}");
    }
}
