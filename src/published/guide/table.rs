//! Draws numbers with given probabilities, each in constant time.

/// A table that draws numbers with given probabilities in expected constant time, however many
/// there are (Chen & Asau 1974; Devroye 1986, chapter III.2.4). The interval [0, 1) is cut into as
/// many equal parts as there are numbers, and for each part the table stores where the search
/// through cumulative probabilities starts.
#[derive(Debug, Clone)]
pub struct GuideTable {
    /// Probability of a number or any before it.
    cumulative: Vec<f64>,
    /// The smallest number whose cumulative probability is above the start of each part.
    guide: Vec<u32>,
}

impl GuideTable {
    /// Creates a table of the numbers from 0 on with the given weights. Returns `None` unless the
    /// weights are finite, not negative, fewer than 2^32, and some are positive.
    pub fn new(weights: &[f64]) -> Option<Self> {
        let total: f64 = weights.iter().sum();
        let is_valid = weights.iter().all(|&w| w >= 0.0) && u32::try_from(weights.len()).is_ok();
        if !(is_valid && total > 0.0 && total.is_finite()) {
            return None;
        }
        let last = weights.iter().rposition(|&w| w > 0.0)?;
        let mut sum = 0.0;
        let cumulative: Vec<f64> = weights
            .iter()
            .enumerate()
            .map(|(n, w)| {
                sum += w;
                // The last value must be exactly 1, without a rounding error.
                if n >= last { 1.0 } else { sum / total }
            })
            .collect();
        let mut n = 0;
        let guide = (0..weights.len())
            .map(|part| {
                let start = part as f64 / weights.len() as f64;
                while cumulative[n] <= start {
                    n += 1;
                }
                n as u32
            })
            .collect();
        Some(Self { cumulative, guide })
    }

    /// Returns the number that belongs to `chance`, a uniform random number in [0, 1).
    #[inline]
    pub fn draw(&self, chance: f64) -> usize {
        self.search(chance).0
    }

    /// Returns the number, and the count of cumulative probabilities inspected: less than 2 on
    /// average.
    pub(super) fn search(&self, chance: f64) -> (usize, usize) {
        let first = self.guide[(chance * self.guide.len() as f64) as usize] as usize;
        let mut n = first;
        while self.cumulative[n] <= chance {
            n += 1;
        }
        (n, n - first + 1)
    }
}
