//! Arranges traces in a grid of inlines and crosslines by their line numbers.

use serde::Serialize;

/// Line numbers along one axis of a survey: `first`, `first + step`, ...
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct LineNumbers {
    /// Smallest line number.
    pub first: i64,
    /// Difference of neighbouring line numbers.
    pub step: i64,
    /// Number of lines.
    pub count: u64,
}

impl LineNumbers {
    /// Returns the numbering with the largest step that contains all `numbers`.
    pub fn from_numbers(numbers: &[i32]) -> Self {
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

    /// Returns the index of a line, counted from 0.
    pub fn index(&self, number: i32) -> usize {
        ((i64::from(number) - self.first) / self.step) as usize
    }

    /// Returns the largest line number.
    pub fn last(&self) -> i64 {
        self.first + (self.count as i64 - 1) * self.step
    }
}

impl std::fmt::Display for LineNumbers {
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

/// Index that stands for a cell without a trace.
pub const NO_TRACE: usize = usize::MAX;

/// Assignment of traces to the cells of a survey.
pub struct TraceGrid {
    /// Inline numbers.
    pub inline: LineNumbers,
    /// Crossline numbers.
    pub crossline: LineNumbers,
    /// Trace of each cell, crossline fastest; [`NO_TRACE`] if the cell has none.
    pub traces: Vec<usize>,
    /// Number of cells without a trace.
    pub missing_count: usize,
    /// Number of traces that are not used because an earlier trace is in their cell.
    pub duplicate_count: usize,
    /// Number of duplicates whose offset differs from that of the trace they duplicate.
    pub other_offset_count: usize,
}

/// Largest number of cells per trace. A survey with more empty cells has wrong line numbers.
const MAX_CELLS_PER_TRACE: u64 = 10;

impl TraceGrid {
    /// Assigns traces to cells; the first trace of each cell is used.
    ///
    /// # Errors
    /// Returns a message if the line numbers cannot be those of a survey.
    pub fn from_line_numbers(
        inlines: &[i32],
        crosslines: &[i32],
        offsets: &[i32],
    ) -> Result<Self, String> {
        let inline = LineNumbers::from_numbers(inlines);
        let crossline = LineNumbers::from_numbers(crosslines);
        let cells = inline.count.saturating_mul(crossline.count);
        if inlines.len() > 1 && cells == 1 {
            return Err(format!(
                "all {} traces have inline {} and crossline {}",
                inlines.len(),
                inline.first,
                crossline.first
            ));
        }
        if cells > MAX_CELLS_PER_TRACE * inlines.len() as u64 {
            return Err(format!(
                "inlines {inline} and crosslines {crossline} make {cells} cells for only {} traces",
                inlines.len()
            ));
        }

        let mut grid = Self {
            inline,
            crossline,
            traces: vec![NO_TRACE; cells as usize],
            missing_count: 0,
            duplicate_count: 0,
            other_offset_count: 0,
        };
        for (trace, (&i, &c)) in inlines.iter().zip(crosslines).enumerate() {
            let cell = inline.index(i) * crossline.count as usize + crossline.index(c);
            match grid.traces[cell] {
                NO_TRACE => grid.traces[cell] = trace,
                earlier => {
                    grid.duplicate_count += 1;
                    grid.other_offset_count += usize::from(offsets[trace] != offsets[earlier]);
                }
            }
        }
        grid.missing_count = grid.traces.iter().filter(|&&t| t == NO_TRACE).count();
        Ok(grid)
    }

    /// Returns `true` if cells hold gathers instead of single traces.
    pub fn is_prestack(&self) -> bool {
        let filled = self.traces.len() - self.missing_count;
        self.duplicate_count > 0
            && (2 * self.other_offset_count > self.duplicate_count
                || self.duplicate_count >= filled)
    }

    /// Returns `true` if the traces fill an area rather than a path. A path of neighbours through n
    /// x m cells has at most n + m - 1 of them.
    pub fn is_volume(&self) -> bool {
        let filled = (self.traces.len() - self.missing_count) as u64;
        filled >= self.inline.count + self.crossline.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn increments_and_extremes() {
        let lines = LineNumbers::from_numbers(&[2121, 1971, 1975, 1973]);
        assert_eq!((lines.first, lines.step, lines.count), (1971, 2, 76));
        assert_eq!((lines.index(1975), lines.last()), (2, 2121));
        let lines = LineNumbers::from_numbers(&[i32::MIN, i32::MAX]);
        assert_eq!((lines.count, lines.index(i32::MAX)), (2, 1));
    }

    #[test]
    fn missing_and_duplicate_traces_are_counted() {
        // Of 2 x 3 cells one is empty and one has two traces.
        let grid =
            TraceGrid::from_line_numbers(&[1, 1, 5, 5, 5, 1], &[10, 20, 10, 30, 20, 10], &[0; 6])
                .unwrap();
        assert_eq!((grid.inline.count, grid.crossline.count), (2, 3));
        assert_eq!((grid.missing_count, grid.duplicate_count), (1, 1));
        assert_eq!(grid.traces, [0, 1, NO_TRACE, 2, 4, 3]);
        assert!(grid.is_volume() && !grid.is_prestack());
    }

    #[test]
    fn gathers_and_nonsense() {
        let grid =
            TraceGrid::from_line_numbers(&[1, 1, 2, 2], &[1, 1, 1, 1], &[100, 200, 100, 200])
                .unwrap();
        assert!(grid.is_prestack() && !grid.is_volume());
        let diagonal = [1, 2, 3, 4, 5];
        assert!(
            !TraceGrid::from_line_numbers(&diagonal, &diagonal, &[0; 5])
                .unwrap()
                .is_volume()
        );
        assert!(TraceGrid::from_line_numbers(&[0; 4], &[0; 4], &[0; 4]).is_err());
        assert!(
            TraceGrid::from_line_numbers(&[0, 1 << 30, 3], &[7, 9, -(1 << 30)], &[0; 3]).is_err()
        );
    }
}
