//! Atoms that were moved one by one must not end at one place.

/// Moves atoms back that came nearer than `gap` to another: `before` holds where each atom was, and
/// there they all were farther apart. Of two that meet, the one of the higher number goes back.
/// Returns how many did.
pub fn keep_apart(positions: &mut [[f64; 3]], before: &[[f64; 3]], gap: f64) -> usize {
    let mut returned = 0;
    // One that goes back may meet another that has come near its old place: look again.
    loop {
        let moved = |k: usize| positions[k] != before[k];
        let cells = Cells::new(positions, gap);
        let meets = |k: usize| {
            cells.any_near(positions[k], gap, |other| {
                let square: f64 = (0..3)
                    .map(|axis| (positions[k][axis] - positions[other][axis]).powi(2))
                    .sum();
                other != k && square < gap * gap && (other < k || !moved(other))
            })
        };
        let back: Vec<usize> = (0..positions.len())
            .filter(|&k| moved(k) && meets(k))
            .collect();
        if back.is_empty() {
            return returned;
        }
        for &k in &back {
            positions[k] = before[k];
        }
        returned += back.len();
    }
}

/// No atom.
const NONE: u32 = u32::MAX;

/// Atoms in the cells of a grid, about one in each.
struct Cells {
    low: [f64; 3],
    size: f64,
    dims: [usize; 3],
    /// The latest atom in each cell, and for each atom the one before it there.
    latest: Vec<u32>,
    previous: Vec<u32>,
}

impl Cells {
    /// Cells at least `size` wide.
    fn new(positions: &[[f64; 3]], size: f64) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for x in positions {
            for k in 0..3 {
                low[k] = low[k].min(x[k]);
                high[k] = high[k].max(x[k]);
            }
        }
        let spans: [f64; 3] = std::array::from_fn(|k| (high[k] - low[k]).max(0.0));
        let wide = spans.iter().filter(|&&s| s > size);
        let (axes, room) = wide.fold((0, 1.0), |(n, room), s| (n + 1, room * s));
        let roomy = (room / positions.len().max(1) as f64).powf(1.0 / f64::from(axes.max(1)));
        let size = size.max(roomy);
        let mut cells = Self {
            low,
            size,
            dims: spans.map(|s| (s / size) as usize + 1),
            latest: Vec::new(),
            previous: Vec::with_capacity(positions.len()),
        };
        cells.latest = vec![NONE; cells.dims.iter().product()];
        for (k, &x) in positions.iter().enumerate() {
            let cell = cells.index([0, 1, 2].map(|axis| cells.along(axis, x[axis])));
            cells.previous.push(cells.latest[cell]);
            cells.latest[cell] = k as u32;
        }
        cells
    }

    fn along(&self, axis: usize, x: f64) -> usize {
        (((x - self.low[axis]) / self.size) as usize).min(self.dims[axis] - 1)
    }

    fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        (k * self.dims[1] + j) * self.dims[0] + i
    }

    /// Whether any atom in the cells within `reach` of `x` will do.
    fn any_near(&self, x: [f64; 3], reach: f64, will_do: impl Fn(usize) -> bool) -> bool {
        let [xs, ys, zs] =
            [0, 1, 2].map(|k| self.along(k, x[k] - reach)..=self.along(k, x[k] + reach));
        for k in zs {
            for j in ys.clone() {
                for i in xs.clone() {
                    let mut atom = self.latest[self.index([i, j, k])];
                    while atom != NONE {
                        if will_do(atom as usize) {
                            return true;
                        }
                        atom = self.previous[atom as usize];
                    }
                }
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_that_meet_one_goes_back_and_may_push_a_third() {
        let before = [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [9.0, 0.0, 0.0]];
        // 0 and 1 meet at 0.5; 2 has gone to where 1 must return to.
        let mut positions = [
            [0.5, 0.0, 0.0],
            [0.5, 0.01, 0.0],
            [1.0, 0.0, 0.02],
            [9.5, 0.0, 0.0],
        ];
        assert_eq!(keep_apart(&mut positions, &before, 0.1), 2);
        assert_eq!(
            positions,
            [[0.5, 0.0, 0.0], before[1], before[2], [9.5, 0.0, 0.0]]
        );
    }
}
