//! The order of sticks along a fault: the shortest path that visits each stick once.

/// Symmetric distances between lines.
#[derive(Debug, Clone)]
pub(super) struct Distances {
    count: usize,
    values: Vec<f64>,
}

impl Distances {
    /// Computes the distances of `count` lines.
    pub fn new(count: usize, distance: impl Fn(usize, usize) -> f64) -> Self {
        let mut values = vec![0.0; count * count];
        for i in 0..count {
            for j in 0..i {
                let value = distance(i, j);
                values[i * count + j] = value;
                values[j * count + i] = value;
            }
        }
        Self { count, values }
    }

    /// Returns the distance between two lines.
    pub fn get(&self, i: usize, j: usize) -> f64 {
        self.values[i * self.count + j]
    }

    /// Returns the lines in the order of a short path through all of them: from an end to the nearest
    /// line that was not visited, and so on, improved by turning parts of the path and by moving single
    /// lines until no such change makes it shorter (2-opt and or-opt).
    pub fn path(&self) -> Vec<usize> {
        if self.count == 0 {
            return Vec::new();
        }
        let farthest = |from: usize| {
            (0..self.count).fold(from, |best, i| {
                if self.get(from, i) > self.get(from, best) {
                    i
                } else {
                    best
                }
            })
        };
        let mut path = vec![farthest(0)];
        let mut is_visited = vec![false; self.count];
        is_visited[path[0]] = true;
        while path.len() < self.count {
            let last = path[path.len() - 1];
            let open = (0..self.count).filter(|&i| !is_visited[i]);
            let Some(next) = open.min_by(|&i, &j| self.get(last, i).total_cmp(&self.get(last, j)))
            else {
                break;
            };
            is_visited[next] = true;
            path.push(next);
        }
        while self.turn_parts(&mut path) | self.move_lines(&mut path) {}
        path
    }

    /// Returns the length of the step between two places of a path; 0 beyond its ends.
    fn step(&self, path: &[usize], from: Option<usize>, to: Option<usize>) -> f64 {
        let line = |place: Option<usize>| place.and_then(|place| path.get(place));
        match (line(from), line(to)) {
            (Some(&i), Some(&j)) => self.get(i, j),
            _ => 0.0,
        }
    }

    /// Reverses parts of the path that make it shorter. Returns `true` if there were any.
    fn turn_parts(&self, path: &mut [usize]) -> bool {
        let mut is_changed = false;
        for start in 0..path.len() {
            for end in start + 1..path.len() {
                let (before, after) = (start.checked_sub(1), Some(end + 1));
                let old = self.step(path, before, Some(start)) + self.step(path, Some(end), after);
                let new = self.step(path, before, Some(end)) + self.step(path, Some(start), after);
                if is_shorter(new, old) {
                    path[start..=end].reverse();
                    is_changed = true;
                }
            }
        }
        is_changed
    }

    /// Moves single lines to where they make the path shorter. Returns `true` if there were any.
    fn move_lines(&self, path: &mut Vec<usize>) -> bool {
        let mut is_changed = false;
        for place in 0..path.len() {
            let (before, after) = (place.checked_sub(1), Some(place + 1));
            let gain = self.step(path, before, Some(place)) + self.step(path, Some(place), after)
                - self.step(path, before.filter(|_| place + 1 < path.len()), after);
            let mut rest = path.clone();
            let line = rest.remove(place);
            let cost = |at: usize| {
                let left = at.checked_sub(1).map(|k| rest[k]);
                let right = rest.get(at).copied();
                let to = |other: Option<usize>| other.map_or(0.0, |other| self.get(other, line));
                let between = match (left, right) {
                    (Some(left), Some(right)) => self.get(left, right),
                    _ => 0.0,
                };
                to(left) + to(right) - between
            };
            let best = (0..=rest.len()).min_by(|&a, &b| cost(a).total_cmp(&cost(b)));
            if let Some(best) = best.filter(|&best| is_shorter(cost(best), gain)) {
                rest.insert(best, line);
                *path = rest;
                is_changed = true;
            }
        }
        is_changed
    }
}

/// Returns `true` if a length is smaller than another by more than rounding.
fn is_shorter(new: f64, old: f64) -> bool {
    new + 1e-9 * (new.abs() + old.abs()) < old
}
