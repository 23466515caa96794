//! What was tried in vain: as long as nothing around it has changed, it need not be tried again.

/// When the tetrahedra at each node last changed, and when flips, smoothing and mending last failed.
#[derive(Debug, Default)]
pub(super) struct Memory {
    now: u32,
    changed: Vec<u32>,
    /// By what was tried: of each tetrahedron or node, when.
    tried: [Vec<u32>; 3],
    /// What a transaction under way has overwritten.
    undo: Option<Vec<Write>>,
}

/// What can be tried.
#[derive(Debug, Clone, Copy)]
pub(super) enum Trial {
    /// All flips of a tetrahedron.
    Flip = 0,
    /// Smoothing a node.
    Smooth = 1,
    /// All that mending does to a tetrahedron.
    Mend = 2,
}

#[derive(Debug, Clone, Copy)]
enum Write {
    Changed(u32, u32),
    Tried(Trial, u32, u32),
}

/// Writes `value` at a place that may not be there yet; gives what was there.
fn put(times: &mut Vec<u32>, at: u32, value: u32) -> u32 {
    let at = at as usize;
    if at >= times.len() {
        times.resize(at + 1, 0);
    }
    std::mem::replace(&mut times[at], value)
}

impl Memory {
    /// The tetrahedra at these nodes change.
    pub fn change(&mut self, nodes: impl IntoIterator<Item = u32>) {
        self.now += 1;
        for node in nodes {
            let before = put(&mut self.changed, node, self.now);
            if let Some(undo) = &mut self.undo {
                undo.push(Write::Changed(node, before));
            }
        }
    }

    /// Something was tried in vain.
    pub fn failed(&mut self, trial: Trial, what: u32) {
        let before = put(&mut self.tried[trial as usize], what, self.now);
        if let Some(undo) = &mut self.undo {
            undo.push(Write::Tried(trial, what, before));
        }
    }

    /// Whether trying it again is in vain: it depends on the tetrahedra at these nodes only.
    pub fn in_vain(&self, trial: Trial, what: u32, nodes: &[u32]) -> bool {
        let time = |times: &[u32], i: u32| times.get(i as usize).copied().unwrap_or(0);
        let tried = time(&self.tried[trial as usize], what);
        tried > 0 && nodes.iter().all(|&n| time(&self.changed, n) <= tried)
    }

    /// When this is.
    pub fn now(&self) -> u32 {
        self.now
    }

    /// Whether the tetrahedra at any of these nodes have changed since.
    pub fn has_changed(&self, since: u32, nodes: &[u32]) -> bool {
        let changed = |&n: &u32| (self.changed.get(n as usize)).is_some_and(|&time| time > since);
        nodes.iter().any(changed)
    }

    /// Becomes what `whole` has of these nodes and tetrahedra.
    pub fn become_part(
        &mut self,
        whole: &Self,
        nodes: impl Iterator<Item = u32> + Clone,
        tets: impl Iterator<Item = u32> + Clone,
    ) {
        fn copy(to: &mut Vec<u32>, from: &[u32], numbers: impl Iterator<Item = u32>) {
            to.clear();
            to.extend(numbers.map(|i| from.get(i as usize).copied().unwrap_or(0)));
        }
        self.now = whole.now;
        self.undo = None;
        copy(&mut self.changed, &whole.changed, nodes.clone());
        for trial in [Trial::Flip, Trial::Smooth, Trial::Mend] {
            let (to, from) = (
                &mut self.tried[trial as usize],
                &whole.tried[trial as usize],
            );
            match trial {
                Trial::Smooth => copy(to, from, nodes.clone()),
                Trial::Flip | Trial::Mend => copy(to, from, tets.clone()),
            }
        }
    }

    /// Everything may be tried again.
    pub fn forget(&mut self) {
        self.tried.iter_mut().for_each(Vec::clear);
    }

    /// From now on all can be taken back.
    pub fn begin(&mut self) {
        self.now += 1;
        self.undo = Some(Vec::new());
    }

    /// Keeps what has changed since.
    pub fn keep(&mut self) {
        self.undo = None;
    }

    /// Takes it back.
    pub fn take_back(&mut self) {
        for write in self.undo.take().into_iter().flatten().rev() {
            match write {
                Write::Changed(node, before) => self.changed[node as usize] = before,
                Write::Tried(trial, what, before) => {
                    self.tried[trial as usize][what as usize] = before
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
        let mut memory = Memory::default();
        let flip = |memory: &Memory| memory.in_vain(Trial::Flip, 5, &[1, 2, 3, 4]);
        memory.change([1, 2]);
        assert!(!flip(&memory));
        memory.failed(Trial::Flip, 5);
        assert!(flip(&memory));
        assert!(!memory.in_vain(Trial::Smooth, 5, &[1]), "not tried");
        memory.change([7]);
        assert!(flip(&memory), "far away");
        memory.change([4]);
        assert!(!flip(&memory));
        memory.failed(Trial::Flip, 5);
        memory.forget();
        assert!(!flip(&memory));
    }

    #[test]
    fn what_is_taken_back_was_neither_changed_nor_tried() {
        let mut memory = Memory::default();
        memory.change([0, 1]);
        memory.failed(Trial::Smooth, 1);
        memory.begin();
        memory.change([1, 2]);
        memory.failed(Trial::Smooth, 2);
        memory.take_back();
        assert!(memory.in_vain(Trial::Smooth, 1, &[1]));
        assert!(!memory.in_vain(Trial::Smooth, 2, &[2]));
        memory.begin();
        memory.change([1]);
        memory.keep();
        memory.take_back();
        assert!(!memory.in_vain(Trial::Smooth, 1, &[1]));
    }
}
