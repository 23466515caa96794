//! What was tried in vain: as long as nothing around it has changed, it need not be tried again.

/// When the tetrahedra at each node last changed, and when flips, smoothing and mending last failed.
#[derive(Debug, Default)]
pub(super) struct AttemptCache {
    clock: u32,
    changed_at: Vec<u32>,
    /// By what was tried: of each tetrahedron or node, when.
    attempted_at: [Vec<u32>; 3],
    /// What a transaction under way has overwritten.
    undo: Option<Vec<Overwritten>>,
}

/// What can be tried.
#[derive(Debug, Clone, Copy)]
pub(super) enum AttemptKind {
    /// All flips of a tetrahedron.
    Flip = 0,
    /// Smoothing a node.
    Smooth = 1,
    /// All that mending does to a tetrahedron.
    Mend = 2,
}

#[derive(Debug, Clone, Copy)]
enum Overwritten {
    ChangedAt(u32, u32),
    AttemptedAt(AttemptKind, u32, u32),
}

/// Writes `value` at a place that may not be there yet; gives what was there.
fn replace_at(times: &mut Vec<u32>, at: u32, value: u32) -> u32 {
    let at = at as usize;
    if at >= times.len() {
        times.resize(at + 1, 0);
    }
    std::mem::replace(&mut times[at], value)
}

impl AttemptCache {
    /// The tetrahedra at these nodes change.
    pub fn record_change(&mut self, nodes: impl IntoIterator<Item = u32>) {
        self.clock += 1;
        for node in nodes {
            let before = replace_at(&mut self.changed_at, node, self.clock);
            if let Some(undo) = &mut self.undo {
                undo.push(Overwritten::ChangedAt(node, before));
            }
        }
    }

    /// Something was tried in vain.
    pub fn record_failure(&mut self, trial: AttemptKind, what: u32) {
        let before = replace_at(&mut self.attempted_at[trial as usize], what, self.clock);
        if let Some(undo) = &mut self.undo {
            undo.push(Overwritten::AttemptedAt(trial, what, before));
        }
    }

    /// Whether trying it again is in vain: it depends on the tetrahedra at these nodes only.
    pub fn is_known_to_fail(&self, trial: AttemptKind, what: u32, nodes: &[u32]) -> bool {
        let time = |times: &[u32], i: u32| times.get(i as usize).copied().unwrap_or(0);
        let tried = time(&self.attempted_at[trial as usize], what);
        tried > 0 && nodes.iter().all(|&n| time(&self.changed_at, n) <= tried)
    }

    /// When this is.
    pub fn clock(&self) -> u32 {
        self.clock
    }

    /// Whether the tetrahedra at any of these nodes have changed since.
    pub fn has_changed(&self, since: u32, nodes: &[u32]) -> bool {
        let changed =
            |&n: &u32| (self.changed_at.get(n as usize)).is_some_and(|&time| time > since);
        nodes.iter().any(changed)
    }

    /// Becomes what `whole` has of these nodes and tetrahedra.
    pub fn set_to_part(
        &mut self,
        whole: &Self,
        nodes: impl Iterator<Item = u32> + Clone,
        tets: impl Iterator<Item = u32> + Clone,
    ) {
        fn copy(to: &mut Vec<u32>, from: &[u32], numbers: impl Iterator<Item = u32>) {
            to.clear();
            to.extend(numbers.map(|i| from.get(i as usize).copied().unwrap_or(0)));
        }
        self.clock = whole.clock;
        self.undo = None;
        copy(&mut self.changed_at, &whole.changed_at, nodes.clone());
        for trial in [AttemptKind::Flip, AttemptKind::Smooth, AttemptKind::Mend] {
            let (to, from) = (
                &mut self.attempted_at[trial as usize],
                &whole.attempted_at[trial as usize],
            );
            match trial {
                AttemptKind::Smooth => copy(to, from, nodes.clone()),
                AttemptKind::Flip | AttemptKind::Mend => copy(to, from, tets.clone()),
            }
        }
    }

    /// Everything may be tried again.
    pub fn clear(&mut self) {
        self.attempted_at.iter_mut().for_each(Vec::clear);
    }

    /// From now on all can be taken back.
    pub fn begin(&mut self) {
        self.clock += 1;
        self.undo = Some(Vec::new());
    }

    /// Keeps what has changed since.
    pub fn commit(&mut self) {
        self.undo = None;
    }

    /// Takes it back.
    pub fn rollback(&mut self) {
        for write in self.undo.take().into_iter().flatten().rev() {
            match write {
                Overwritten::ChangedAt(node, before) => self.changed_at[node as usize] = before,
                Overwritten::AttemptedAt(trial, what, before) => {
                    self.attempted_at[trial as usize][what as usize] = before
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_in_vain_before_it_has_failed_or_after_a_change_at_its_nodes() {
        let mut memory = AttemptCache::default();
        let flip =
            |memory: &AttemptCache| memory.is_known_to_fail(AttemptKind::Flip, 5, &[1, 2, 3, 4]);
        memory.record_change([1, 2]);
        assert!(!flip(&memory));
        memory.record_failure(AttemptKind::Flip, 5);
        assert!(flip(&memory));
        assert!(
            !memory.is_known_to_fail(AttemptKind::Smooth, 5, &[1]),
            "not tried"
        );
        memory.record_change([7]);
        assert!(flip(&memory), "far away");
        memory.record_change([4]);
        assert!(!flip(&memory));
        memory.record_failure(AttemptKind::Flip, 5);
        memory.clear();
        assert!(!flip(&memory));
    }

    #[test]
    fn what_is_taken_back_was_neither_changed_nor_tried() {
        let mut memory = AttemptCache::default();
        memory.record_change([0, 1]);
        memory.record_failure(AttemptKind::Smooth, 1);
        memory.begin();
        memory.record_change([1, 2]);
        memory.record_failure(AttemptKind::Smooth, 2);
        memory.rollback();
        assert!(memory.is_known_to_fail(AttemptKind::Smooth, 1, &[1]));
        assert!(!memory.is_known_to_fail(AttemptKind::Smooth, 2, &[2]));
        memory.begin();
        memory.record_change([1]);
        memory.commit();
        memory.rollback();
        assert!(!memory.is_known_to_fail(AttemptKind::Smooth, 1, &[1]));
    }
}
