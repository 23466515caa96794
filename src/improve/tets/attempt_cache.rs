//! A cache of failed attempts. An attempt that failed need not be repeated as long as nothing
//! around it has changed.

/// Times at which the tetrahedra at each node last changed, and at which flips, smoothing and
/// repair last failed.
#[derive(Debug, Default)]
pub(super) struct AttemptCache {
    clock: u32,
    changed_at: Vec<u32>,
    /// Time of the last failure for each kind of attempt and each tetrahedron or node; 0 for none.
    attempted_at: [Vec<u32>; 3],
    /// Values overwritten by the current transaction.
    undo: Option<Vec<Overwritten>>,
}

/// Kind of attempt.
#[derive(Debug, Clone, Copy)]
pub(super) enum AttemptKind {
    /// All flips of a tetrahedron.
    Flip = 0,
    /// Smoothing of a node.
    Smooth = 1,
    /// All operations that may repair a tetrahedron.
    Repair = 2,
}

#[derive(Debug, Clone, Copy)]
enum Overwritten {
    ChangedAt(u32, u32),
    AttemptedAt(AttemptKind, u32, u32),
}

/// Writes `value` at an index that may be beyond the end, and returns the old value.
fn replace_at(times: &mut Vec<u32>, at: u32, value: u32) -> u32 {
    let at = at as usize;
    if at >= times.len() {
        times.resize(at + 1, 0);
    }
    std::mem::replace(&mut times[at], value)
}

impl AttemptCache {
    /// Records that the tetrahedra at these nodes change.
    pub fn record_change(&mut self, nodes: impl IntoIterator<Item = u32>) {
        self.clock += 1;
        for node in nodes {
            // Tetrahedra that change together share most of their nodes.
            if self.changed_at.get(node as usize) == Some(&self.clock) {
                continue;
            }
            let old = replace_at(&mut self.changed_at, node, self.clock);
            if let Some(undo) = &mut self.undo {
                undo.push(Overwritten::ChangedAt(node, old));
            }
        }
    }

    /// Records that an attempt has failed.
    pub fn record_failure(&mut self, kind: AttemptKind, index: u32) {
        let old = replace_at(&mut self.attempted_at[kind as usize], index, self.clock);
        if let Some(undo) = &mut self.undo {
            undo.push(Overwritten::AttemptedAt(kind, index, old));
        }
    }

    /// Returns `true` if the attempt has failed since the tetrahedra at these nodes changed. The
    /// attempt must depend on these tetrahedra only.
    pub fn is_known_to_fail(&self, kind: AttemptKind, index: u32, nodes: &[u32]) -> bool {
        let time = |times: &[u32], i: u32| times.get(i as usize).copied().unwrap_or(0);
        let failed_at = time(&self.attempted_at[kind as usize], index);
        failed_at > 0
            && nodes
                .iter()
                .all(|&n| time(&self.changed_at, n) <= failed_at)
    }

    /// Returns the current time.
    pub fn clock(&self) -> u32 {
        self.clock
    }

    /// Returns `true` if the tetrahedra at any of these nodes have changed since a time.
    pub fn has_changed(&self, since: u32, nodes: &[u32]) -> bool {
        let changed =
            |&n: &u32| (self.changed_at.get(n as usize)).is_some_and(|&time| time > since);
        nodes.iter().any(changed)
    }

    /// Replaces the content by that of `source` for these nodes and tetrahedra.
    pub fn set_to_part(
        &mut self,
        source: &Self,
        nodes: impl Iterator<Item = u32> + Clone,
        tets: impl Iterator<Item = u32> + Clone,
    ) {
        fn copy(to: &mut Vec<u32>, from: &[u32], ids: impl Iterator<Item = u32>) {
            to.clear();
            to.extend(ids.map(|i| from.get(i as usize).copied().unwrap_or(0)));
        }
        self.clock = source.clock;
        self.undo = None;
        copy(&mut self.changed_at, &source.changed_at, nodes.clone());
        for kind in [AttemptKind::Flip, AttemptKind::Smooth, AttemptKind::Repair] {
            let (to, from) = (
                &mut self.attempted_at[kind as usize],
                &source.attempted_at[kind as usize],
            );
            match kind {
                AttemptKind::Smooth => copy(to, from, nodes.clone()),
                AttemptKind::Flip | AttemptKind::Repair => copy(to, from, tets.clone()),
            }
        }
    }

    /// Forgets all failures.
    pub fn clear(&mut self) {
        self.attempted_at.iter_mut().for_each(Vec::clear);
    }

    /// Begins a transaction.
    pub fn begin(&mut self) {
        self.clock += 1;
        self.undo = Some(Vec::new());
    }

    /// Ends the transaction and keeps its changes.
    pub fn commit(&mut self) {
        self.undo = None;
    }

    /// Ends the transaction and undoes its changes.
    pub fn rollback(&mut self) {
        for write in self.undo.take().into_iter().flatten().rev() {
            match write {
                Overwritten::ChangedAt(node, old) => self.changed_at[node as usize] = old,
                Overwritten::AttemptedAt(kind, index, old) => {
                    self.attempted_at[kind as usize][index as usize] = old
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_attempt_is_known_to_fail_until_its_nodes_change() {
        let mut cache = AttemptCache::default();
        let flip_fails =
            |cache: &AttemptCache| cache.is_known_to_fail(AttemptKind::Flip, 5, &[1, 2, 3, 4]);
        cache.record_change([1, 2]);
        assert!(!flip_fails(&cache));
        cache.record_failure(AttemptKind::Flip, 5);
        assert!(flip_fails(&cache));
        assert!(
            !cache.is_known_to_fail(AttemptKind::Smooth, 5, &[1]),
            "not tried"
        );
        cache.record_change([7]);
        assert!(flip_fails(&cache), "far away");
        cache.record_change([4]);
        assert!(!flip_fails(&cache));
        cache.record_failure(AttemptKind::Flip, 5);
        cache.clear();
        assert!(!flip_fails(&cache));
    }

    #[test]
    fn a_rollback_undoes_changes_and_failures() {
        let mut cache = AttemptCache::default();
        cache.record_change([0, 1]);
        cache.record_failure(AttemptKind::Smooth, 1);
        cache.begin();
        cache.record_change([1, 2]);
        cache.record_failure(AttemptKind::Smooth, 2);
        cache.rollback();
        assert!(cache.is_known_to_fail(AttemptKind::Smooth, 1, &[1]));
        assert!(!cache.is_known_to_fail(AttemptKind::Smooth, 2, &[2]));
        cache.begin();
        cache.record_change([1]);
        cache.commit();
        cache.rollback();
        assert!(!cache.is_known_to_fail(AttemptKind::Smooth, 1, &[1]));
    }
}
