//! From the line numbers of all traces to a grid of inlines and crosslines.

use serde::Serialize;

/// Line numbers along one axis of a survey: `first`, `first + step`, ...
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Lines {
    /// Smallest line number.
    pub first: i64,
    /// Difference of neighbouring line numbers.
    pub step: i64,
    /// Number of lines.
    pub count: u64,
}

impl Lines {
    /// The coarsest regular numbering that contains all `numbers`.
    pub fn of(numbers: &[i32]) -> Self {
        let first = numbers.iter().copied().min().unwrap_or(0);
        let last = numbers.iter().copied().max().unwrap_or(0);
        let step = numbers
            .iter()
            .fold(0, |step, &n| gcd(step, n.abs_diff(first)));
        let span = u64::from(last.abs_diff(first));
        let step = u64::from(step.max(1));
        Self {
            first: i64::from(first),
            step: step as i64,
            count: span / step + 1,
        }
    }

    /// Position of a line, from 0.
    pub fn index(&self, number: i32) -> usize {
        ((i64::from(number) - self.first) / self.step) as usize
    }

    /// Largest line number.
    pub fn last(&self) -> i64 {
        self.first + (self.count as i64 - 1) * self.step
    }
}

impl std::fmt::Display for Lines {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { first, step, count } = self;
        match count {
            1 => write!(f, "{first}"),
            _ => write!(f, "{first} to {} step {step} ({count})", self.last()),
        }
    }
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// No trace in this cell.
pub const MISSING: usize = usize::MAX;

/// Which trace lies in which cell of the survey.
pub struct Grid {
    /// Inline numbers.
    pub inline: Lines,
    /// Crossline numbers.
    pub crossline: Lines,
    /// Trace of each cell, crossline fastest; [`MISSING`] where there is none.
    pub trace: Vec<usize>,
    /// Number of cells without a trace.
    pub missing: usize,
    /// Number of traces left out because their cell has an earlier one.
    pub duplicates: usize,
    /// How many of the duplicates have another offset than the trace they duplicate.
    pub other_offset: usize,
}

/// The most cells for each trace: a survey emptier than this has wrong line numbers.
const MOST_CELLS: u64 = 10;

impl Grid {
    /// Puts traces into cells; the first one in each cell stays.
    ///
    /// # Errors
    /// What is wrong with the line numbers if they cannot be those of a survey.
    pub fn of(inlines: &[i32], crosslines: &[i32], offsets: &[i32]) -> Result<Self, String> {
        let inline = Lines::of(inlines);
        let crossline = Lines::of(crosslines);
        let cells = inline.count.saturating_mul(crossline.count);
        if inlines.len() > 1 && cells == 1 {
            return Err(format!(
                "all {} traces have inline {} and crossline {}",
                inlines.len(),
                inline.first,
                crossline.first
            ));
        }
        if cells > MOST_CELLS * inlines.len() as u64 {
            return Err(format!(
                "inlines {inline} and crosslines {crossline} make {cells} cells for only {} traces",
                inlines.len()
            ));
        }

        let mut grid = Self {
            inline,
            crossline,
            trace: vec![MISSING; cells as usize],
            missing: 0,
            duplicates: 0,
            other_offset: 0,
        };
        for (trace, (&i, &c)) in inlines.iter().zip(crosslines).enumerate() {
            let cell = inline.index(i) * crossline.count as usize + crossline.index(c);
            match grid.trace[cell] {
                MISSING => grid.trace[cell] = trace,
                earlier => {
                    grid.duplicates += 1;
                    grid.other_offset += usize::from(offsets[trace] != offsets[earlier]);
                }
            }
        }
        grid.missing = grid.trace.iter().filter(|&&t| t == MISSING).count();
        Ok(grid)
    }

    /// Whether cells hold gathers instead of single traces.
    pub fn is_prestack(&self) -> bool {
        let filled = self.trace.len() - self.missing;
        self.duplicates > 0
            && (2 * self.other_offset > self.duplicates || self.duplicates >= filled)
    }

    /// Whether the traces fill an area, rather than lie along a path, however crooked: a path of
    /// neighbours through n x m cells has at most n + m - 1 of them.
    pub fn is_volume(&self) -> bool {
        let filled = (self.trace.len() - self.missing) as u64;
        filled >= self.inline.count + self.crossline.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn increments_and_extremes() {
        let lines = Lines::of(&[2121, 1971, 1975, 1973]);
        assert_eq!((lines.first, lines.step, lines.count), (1971, 2, 76));
        assert_eq!((lines.index(1975), lines.last()), (2, 2121));
        let lines = Lines::of(&[i32::MIN, i32::MAX]);
        assert_eq!((lines.count, lines.index(i32::MAX)), (2, 1));
    }

    #[test]
    fn missing_and_duplicate_traces_are_counted() {
        // 2 x 3 cells, one empty, one twice.
        let grid = Grid::of(&[1, 1, 5, 5, 5, 1], &[10, 20, 10, 30, 20, 10], &[0; 6]).unwrap();
        assert_eq!((grid.inline.count, grid.crossline.count), (2, 3));
        assert_eq!((grid.missing, grid.duplicates), (1, 1));
        assert_eq!(grid.trace, [0, 1, MISSING, 2, 4, 3]);
        assert!(grid.is_volume() && !grid.is_prestack());
    }

    #[test]
    fn gathers_and_nonsense() {
        let grid = Grid::of(&[1, 1, 2, 2], &[1, 1, 1, 1], &[100, 200, 100, 200]).unwrap();
        assert!(grid.is_prestack() && !grid.is_volume());
        let diagonal = [1, 2, 3, 4, 5];
        assert!(!Grid::of(&diagonal, &diagonal, &[0; 5]).unwrap().is_volume());
        assert!(Grid::of(&[0; 4], &[0; 4], &[0; 4]).is_err());
        assert!(Grid::of(&[0, 1 << 30, 3], &[7, 9, -(1 << 30)], &[0; 3]).is_err());
    }
}
