//! Minimum cut between two terminals by the two search trees of Boykov & Kolmogorov (2004), "An
//! experimental comparison of min-cut/max-flow algorithms for energy minimization in vision", with
//! the time stamps and distances that the authors' own programme keeps.
//!
//! Capacities are whole numbers, so that saturated is saturated and the same cut comes out on every
//! machine. Nodes and arcs lie in two flat arrays; the arcs of a node are next to each other.

use crate::error::{Error, Result, cause};

/// No node.
const NO_NODE: u32 = u32::MAX;
/// As a node's parent: it is in no tree.
const FREE: u32 = u32::MAX;
/// As a node's parent: the terminal itself.
const TERMINAL: u32 = u32::MAX - 1;
/// As a node's parent: cut off, and still to be adopted.
const ORPHAN: u32 = u32::MAX - 2;

/// Most nodes, and most links, which are two arcs each: their numbers are below the words above.
const MAX_NODES: u64 = ORPHAN as u64 - 1;
const MAX_LINKS: u64 = ORPHAN as u64 / 2;

/// One direction of a link.
#[derive(Debug, Clone, Copy)]
struct Arc {
    /// Where it leads.
    head: u32,
    /// The other direction.
    sister: u32,
    /// What can still flow.
    residual: i32,
}

/// A node's place in the search trees.
#[derive(Debug, Clone, Copy)]
struct FlowNode {
    /// Its first arc; the next node's first arc ends its own.
    first_arc: u32,
    /// The arc to its parent, or one of the four words above.
    parent: u32,
    /// When its distance to the terminal was known to be right.
    stamp: u32,
    /// An estimate of that distance.
    distance: u32,
    /// What can flow from the source (positive) or to the sink (negative).
    terminal_residual: i32,
    /// Whether it is in the sink's tree, if it is in any.
    is_in_sink: bool,
    /// Whether it waits among the active nodes.
    is_queued: bool,
}

/// Nodes joined by links, each with capacities from the source and to the sink.
#[derive(Debug, Clone)]
pub struct Network {
    /// One more than there are nodes, so that every node's arcs have an end.
    nodes: Vec<FlowNode>,
    arcs: Vec<Arc>,
    flow: i64,
    time: u32,
    /// Active nodes: those being looked at, in order, and those that come after them.
    queue: Vec<u32>,
    queue_position: usize,
    next_queue: Vec<u32>,
    orphans: std::collections::VecDeque<u32>,
}

impl Network {
    /// Nodes with links of equal capacity in both directions. `links` calls its argument with the two
    /// nodes and the capacity of each link, and is run twice: once to count, once to fill.
    ///
    /// What leaves any node must be below 2^30.
    ///
    /// # Errors
    /// [`Error::Job`] if there are 2^32 nodes or 2^31 links, or nearly so.
    pub fn new(count: usize, links: impl Fn(&mut dyn FnMut(u32, u32, i32))) -> Result<Self> {
        check_size(count as u64, 0)?;
        let node = FlowNode {
            first_arc: 0,
            parent: FREE,
            stamp: 0,
            distance: 0,
            terminal_residual: 0,
            is_in_sink: false,
            is_queued: false,
        };
        let mut nodes = vec![node; count + 1];
        let mut sum = 0u64;
        links(&mut |a, b, _| {
            sum += 1;
            for node in [a, b] {
                let arcs = &mut nodes[node as usize].first_arc;
                *arcs = arcs.wrapping_add(1);
            }
        });
        check_size(count as u64, sum)?;
        // Ends first; filling from the back turns them into beginnings.
        let mut end = 0;
        for node in &mut nodes {
            end += node.first_arc;
            node.first_arc = end;
        }
        let unset = Arc {
            head: NO_NODE,
            sister: NO_NODE,
            residual: 0,
        };
        let mut arcs = vec![unset; end as usize];
        links(&mut |a, b, capacity| {
            let mut place = |node: u32| {
                let first = &mut nodes[node as usize].first_arc;
                *first -= 1;
                *first
            };
            let (there, back) = (place(a), place(b));
            arcs[there as usize] = Arc {
                head: b,
                sister: back,
                residual: capacity,
            };
            arcs[back as usize] = Arc {
                head: a,
                sister: there,
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

    /// Adds capacities from the source to a node and from it to the sink; what they have in common
    /// flows at once.
    pub fn add_terminal(&mut self, node: u32, from_source: i32, to_sink: i32) {
        self.flow += i64::from(from_source.min(to_sink));
        self.nodes[node as usize].terminal_residual += from_source - to_sink;
    }

    /// Binds a node to the source, or to the sink, with more than its links can carry. To be called
    /// once for a node, before [`Network::solve`].
    pub fn bind_to_terminal(&mut self, node: u32, to_source: bool) {
        let arcs = self.arcs_of(node).map(|a| self.arcs[a as usize].residual);
        let more = 1 + arcs.sum::<i32>();
        self.nodes[node as usize].terminal_residual = if to_source { more } else { -more };
    }

    /// Finds the maximum flow, and with it the minimum cut.
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
        let mut current = NO_NODE;
        loop {
            let kept = std::mem::replace(&mut current, NO_NODE);
            let i = match kept {
                NO_NODE => match self.next_active() {
                    Some(i) => i,
                    None => return self.flow,
                },
                // An augmentation may have set it free.
                i if self.nodes[i as usize].parent == FREE => continue,
                i => i,
            };
            let meeting = self.grow(i);
            self.time += 1;
            if let Some(arc) = meeting {
                current = i;
                self.augment(arc);
                while let Some(orphan) = self.orphans.pop_front() {
                    self.adopt(orphan);
                }
            }
        }
    }

    /// Whether a node is on the source's side of the cut. What both sides could have is the sink's.
    pub fn is_on_source_side(&self, node: u32) -> bool {
        let node = &self.nodes[node as usize];
        node.parent != FREE && !node.is_in_sink
    }

    fn arcs_of(&self, node: u32) -> std::ops::Range<u32> {
        self.nodes[node as usize].first_arc..self.nodes[node as usize + 1].first_arc
    }

    fn activate(&mut self, node: u32) {
        let waits = &mut self.nodes[node as usize].is_queued;
        if !*waits {
            *waits = true;
            self.next_queue.push(node);
        }
    }

    /// The active node that has waited longest and is still in a tree.
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

    /// Lets the tree of an active node take its free neighbours, until it meets the other tree: the
    /// arc there, from the source's side to the sink's.
    fn grow(&mut self, i: u32) -> Option<u32> {
        let FlowNode {
            is_in_sink: in_sink,
            stamp,
            distance,
            ..
        } = self.nodes[i as usize];
        for a in self.arcs_of(i) {
            let Arc {
                head,
                sister,
                residual,
            } = self.arcs[a as usize];
            let open = match in_sink {
                false => residual,
                true => self.arcs[sister as usize].residual,
            };
            if open == 0 {
                continue;
            }
            let node = &mut self.nodes[head as usize];
            if node.parent == FREE {
                node.is_in_sink = in_sink;
                node.parent = sister;
                node.stamp = stamp;
                node.distance = distance + 1;
                self.activate(head);
            } else if node.is_in_sink != in_sink {
                return Some(if in_sink { sister } else { a });
            } else if node.stamp <= stamp && node.distance > distance {
                // A shorter way to the terminal.
                node.parent = sister;
                node.stamp = stamp;
                node.distance = distance + 1;
            }
        }
        None
    }

    /// Lets as much flow as can through the path that runs over `middle`.
    fn augment(&mut self, middle: u32) {
        let Arc {
            head,
            sister,
            residual,
        } = self.arcs[middle as usize];
        let tail = self.arcs[sister as usize].head;
        let mut most = residual;
        for (start, in_sink) in [(tail, false), (head, true)] {
            let mut i = start;
            loop {
                let node = &self.nodes[i as usize];
                if node.parent == TERMINAL {
                    most = most.min(node.terminal_residual.abs());
                    break;
                }
                let arc = self.arcs[node.parent as usize];
                most = most.min(match in_sink {
                    false => self.arcs[arc.sister as usize].residual,
                    true => arc.residual,
                });
                i = arc.head;
            }
        }
        self.arcs[middle as usize].residual -= most;
        self.arcs[sister as usize].residual += most;
        for (start, in_sink) in [(tail, false), (head, true)] {
            let mut i = start;
            loop {
                let node = &mut self.nodes[i as usize];
                let parent = node.parent;
                if parent == TERMINAL {
                    node.terminal_residual -= if in_sink { -most } else { most };
                    if node.terminal_residual == 0 {
                        node.parent = ORPHAN;
                        self.orphans.push_front(i);
                    }
                    break;
                }
                let Arc { head, sister, .. } = self.arcs[parent as usize];
                // Down the source's tree the flow runs from the parent, down the sink's to it.
                let (with, against) = if in_sink {
                    (parent, sister)
                } else {
                    (sister, parent)
                };
                self.arcs[against as usize].residual += most;
                let left = &mut self.arcs[with as usize].residual;
                *left -= most;
                if *left == 0 {
                    self.nodes[i as usize].parent = ORPHAN;
                    self.orphans.push_front(i);
                }
                i = head;
            }
        }
        self.flow += i64::from(most);
    }

    /// Finds a new parent for an orphan, the one nearest to the terminal, or sets it free.
    fn adopt(&mut self, i: u32) {
        let in_sink = self.nodes[i as usize].is_in_sink;
        let (mut best, mut least) = (FREE, u32::MAX);
        for a in self.arcs_of(i) {
            let head = self.arcs[a as usize].head;
            if self.can_be_parent(a, in_sink)
                && let Some(distance) = self.distance_to_terminal(head, in_sink)
                && distance < least
            {
                (best, least) = (a, distance);
            }
        }
        let time = self.time;
        let node = &mut self.nodes[i as usize];
        node.parent = best;
        if best != FREE {
            node.stamp = time;
            node.distance = least + 1;
            return;
        }
        for a in self.arcs_of(i) {
            let head = self.arcs[a as usize].head;
            let FlowNode {
                parent,
                is_in_sink: other,
                ..
            } = self.nodes[head as usize];
            if parent == FREE || other != in_sink {
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

    /// Whether the node at the arc's head could be its tail's parent.
    fn can_be_parent(&self, arc: u32, in_sink: bool) -> bool {
        let Arc {
            residual, sister, ..
        } = self.arcs[arc as usize];
        match in_sink {
            false => self.arcs[sister as usize].residual > 0,
            true => residual > 0,
        }
    }

    /// How far a node is from its tree's terminal, if its way there is whole; known from then on for
    /// all nodes on the way.
    fn distance_to_terminal(&mut self, start: u32, in_sink: bool) -> Option<u32> {
        let node = &self.nodes[start as usize];
        if node.parent == FREE || node.is_in_sink != in_sink {
            return None;
        }
        let (mut j, mut steps) = (start, 0);
        let whole = loop {
            let node = &mut self.nodes[j as usize];
            if node.stamp == self.time {
                break steps + node.distance;
            }
            steps += 1;
            match node.parent {
                TERMINAL => {
                    node.stamp = self.time;
                    node.distance = 1;
                    break steps;
                }
                ORPHAN | FREE => return None,
                parent => j = self.arcs[parent as usize].head,
            }
        };
        let (mut j, mut left) = (start, whole);
        loop {
            let node = &mut self.nodes[j as usize];
            if node.stamp == self.time {
                return Some(whole);
            }
            node.stamp = self.time;
            node.distance = left;
            left -= 1;
            j = self.arcs[node.parent as usize].head;
        }
    }
}

/// Refuses a network whose nodes or arcs could not be numbered.
///
/// # Errors
/// [`Error::Job`] that says how many there are and may be.
pub(super) fn check_size(nodes: u64, links: u64) -> Result<()> {
    for (count, most, what) in [
        (nodes, MAX_NODES, "cells or samples"),
        (links, MAX_LINKS, "faces between them"),
    ] {
        if count > most {
            return Err(Error::Job(cause(
                "segmentation",
                format!("has {count} {what}, more than the {most} that a cut can have"),
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

    /// The value of the best of all cuts.
    fn brute_force(terminals: &[[i32; 2]], links: &[(u32, u32, i32)]) -> i64 {
        let cost = |cut: u32| {
            let in_source = |node: u32| cut >> node & 1 == 1;
            let own = terminals
                .iter()
                .zip(0..)
                .map(|(t, node)| i64::from(if in_source(node) { t[1] } else { t[0] }));
            let between = links
                .iter()
                .filter(|(a, b, _)| in_source(*a) != in_source(*b));
            own.sum::<i64>() + between.map(|link| i64::from(link.2)).sum::<i64>()
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
            let own = (0..).zip(&terminals).map(|(node, t)| if side(node) { t[1] } else { t[0] });
            let cut = links.iter().filter(|(a, b, _)| side(*a) != side(*b)).map(|link| link.2);
            prop_assert_eq!(flow, own.chain(cut).map(i64::from).sum::<i64>());
        }
    }

    #[test]
    fn more_nodes_or_links_than_can_be_numbered_are_refused() {
        assert!(check_size(MAX_NODES, MAX_LINKS).is_ok());
        // The last arc of the largest network has a number that is none of the words.
        assert!(2 * MAX_LINKS - 1 < u64::from(ORPHAN));
        for (nodes, links) in [(MAX_NODES + 1, 0), (1 << 32, 0), (7, MAX_LINKS + 1)] {
            let error = check_size(nodes, links).unwrap_err().to_string();
            let most = if links == 0 { MAX_NODES } else { MAX_LINKS };
            assert!(error.contains(&format!("more than the {most} ")), "{error}");
        }
        let error = Network::new(1 << 32, |_| panic!("links are asked for")).unwrap_err();
        assert!(error.to_string().contains("4294967296 cells"), "{error}");
    }

    #[test]
    fn a_large_grid_has_equal_flow_and_cut() {
        // 40 x 40 x 6 nodes with capacities that look random: many augmentations and adoptions.
        let [nx, ny, nz] = [40u32, 40, 6];
        let mut state = 7u32;
        let mut random = |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((state >> 8) % below) as i32
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
        let own = (0..)
            .zip(&terminals)
            .map(|(node, t)| if side(node) { t[1] } else { t[0] });
        let cut = links
            .iter()
            .filter(|(a, b, _)| side(*a) != side(*b))
            .map(|link| link.2);
        assert_eq!(flow, own.chain(cut).map(i64::from).sum::<i64>());
        let objects = (0..nx * ny * nz).filter(|&node| side(node)).count();
        assert!((1000..8600).contains(&objects), "{objects}");
    }
}
