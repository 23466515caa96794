//! Fits the affine map that places a survey to the coordinates of all traces.

use crate::geometry::hypot;
use crate::geometry::statistics::upper_median;
use serde::Serialize;

/// Largest share of the traces whose coordinates may be far off.
const MAX_OUTLIER_SHARE: f64 = 0.05;

/// Smallest distance of an outlier from the fit, in units of the median distance, and of the distance
/// between lines.
const OUTLIER_RATIO: f64 = 20.0;
const OUTLIER_SPACING: f64 = 2.0;

/// Largest number of fits, each without the outliers of the one before.
const MAX_FITS: usize = 10;

/// Position of a survey: `origin + i * inline + c * crossline` for the `i`th inline and `c`th
/// crossline, fitted by least squares to all traces.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurveyFit {
    /// Position of the first inline and first crossline.
    pub origin: [f64; 2],
    /// Step from one inline to the next.
    pub inline: [f64; 2],
    /// Step from one crossline to the next.
    pub crossline: [f64; 2],
    /// Root mean square distance of the traces from their fitted positions.
    pub rms: f64,
    /// Largest distance of a trace from its fitted position.
    pub max: f64,
    /// Number of traces used for the fit.
    pub traces: usize,
    /// Number of traces whose coordinates are far off, which are not used.
    pub outliers: usize,
}

impl SurveyFit {
    /// Returns the distance between inlines and between crosslines.
    pub fn line_spacing(&self) -> [f64; 2] {
        [self.inline, self.crossline].map(|[x, y]| hypot(x, y))
    }

    /// Fits the positions of traces to their cells, `[inline, crossline]` from 0. Traces at exactly
    /// (0, 0) have no coordinates and are not used.
    ///
    /// # Errors
    /// Returns a message if the positions are not coordinates of a survey.
    pub fn from_positions(cells: &[[usize; 2]], positions: &[[f64; 2]]) -> Result<Self, String> {
        let known: Vec<usize> = (0..positions.len())
            .filter(|&t| positions[t] != [0.0, 0.0])
            .collect();
        if known.is_empty() {
            return Err("are all zero".into());
        }
        let first = positions[known[0]];
        if known.iter().all(|&t| positions[t] == first) {
            return Err("are the same for all traces".into());
        }
        let fit = Self::solve_without_outliers(cells, positions, known)
            .ok_or("are known for traces of one line only")?;
        let [a, b] = [fit.inline, fit.crossline];
        let area = (a[0] * b[1] - a[1] * b[0]).abs();
        let pitch = fit.line_spacing();
        if area <= 1e-3 * pitch[0] * pitch[1] {
            return Err("lie on one straight line".into());
        }
        if fit.rms > 0.25 * pitch[0].min(pitch[1]) {
            return Err(format!(
                "do not follow the line numbers (they deviate from the best regular grid, of pitch {:.4} x {:.4}, by {:.4} rms)",
                pitch[0], pitch[1], fit.rms
            ));
        }
        Ok(fit)
    }

    /// Solves the least-squares problem for the traces `known`, without those that lie much farther from
    /// the fit than most. At most [`MAX_OUTLIER_SHARE`] of the traces are left out.
    fn solve_without_outliers(
        cells: &[[usize; 2]],
        positions: &[[f64; 2]],
        mut known: Vec<usize>,
    ) -> Option<Self> {
        let count = known.len();
        let min_count = ((1.0 - MAX_OUTLIER_SHARE) * count as f64).ceil() as usize;
        let mut fit = Self::solve(cells, positions, &known)?;
        for _ in 0..MAX_FITS {
            let residuals: Vec<f64> = (known.iter())
                .map(|&t| fit.residual(cells[t], positions[t]))
                .collect();
            let median = upper_median(&mut residuals.clone())?;
            let spacing = fit.line_spacing();
            let limit = (OUTLIER_RATIO * median).max(OUTLIER_SPACING * spacing[0].min(spacing[1]));
            let near: Vec<usize> = known
                .iter()
                .zip(&residuals)
                .filter(|(_, residual)| **residual <= limit)
                .map(|(&t, _)| t)
                .collect();
            if near.len() == known.len() || near.len() < min_count {
                break;
            }
            let Some(better) = Self::solve(cells, positions, &near) else {
                break;
            };
            (fit, known) = (better, near);
        }
        fit.outliers = count - known.len();
        Some(fit)
    }

    /// Returns the distance of a position from that of its cell.
    fn residual(&self, cell: [usize; 2], position: [f64; 2]) -> f64 {
        let [i, c] = cell.map(|k| k as f64);
        let [x, y] = [0, 1]
            .map(|k| position[k] - self.origin[k] - i * self.inline[k] - c * self.crossline[k]);
        hypot(x, y)
    }

    /// Solves the least-squares problem on centred values, which keeps the digits of large
    /// coordinates. Returns `None` if the cells lie on one line.
    fn solve(cells: &[[usize; 2]], positions: &[[f64; 2]], known: &[usize]) -> Option<Self> {
        let count = known.len() as f64;
        let cell_of = |t: usize| cells[t].map(|k| k as f64);
        let mean = |value: &dyn Fn(usize) -> [f64; 2]| {
            let mut sum = [0.0; 2];
            for &t in known {
                let v = value(t);
                sum = [sum[0] + v[0], sum[1] + v[1]];
            }
            sum.map(|s| s / count)
        };
        let mean_cell = mean(&cell_of);
        let mean_position = mean(&|t| positions[t]);

        // Normal equations: [ii ic; ic cc] [step_i; step_c] = [iv; cv] for v = x and v = y.
        let (mut ii, mut ic, mut cc) = (0.0, 0.0, 0.0);
        let (mut iv, mut cv) = ([0.0; 2], [0.0; 2]);
        for &t in known {
            let cell = cell_of(t);
            let (i, c) = (cell[0] - mean_cell[0], cell[1] - mean_cell[1]);
            ii += i * i;
            ic += i * c;
            cc += c * c;
            for k in 0..2 {
                let v = positions[t][k] - mean_position[k];
                iv[k] += i * v;
                cv[k] += c * v;
            }
        }
        let determinant = ii * cc - ic * ic;
        if determinant <= 1e-9 * ii * cc || determinant <= 0.0 {
            return None;
        }
        let inline = [0, 1].map(|k| (cc * iv[k] - ic * cv[k]) / determinant);
        let crossline = [0, 1].map(|k| (ii * cv[k] - ic * iv[k]) / determinant);
        let origin = [0, 1]
            .map(|k| mean_position[k] - mean_cell[0] * inline[k] - mean_cell[1] * crossline[k]);

        let (mut sum, mut max) = (0.0, 0.0f64);
        for &t in known {
            let [i, c] = cell_of(t);
            let residual =
                [0, 1].map(|k| positions[t][k] - origin[k] - i * inline[k] - c * crossline[k]);
            let squared = residual[0] * residual[0] + residual[1] * residual[1];
            sum += squared;
            max = max.max(squared);
        }
        Some(Self {
            origin,
            inline,
            crossline,
            rms: (sum / count).sqrt(),
            max: max.sqrt(),
            traces: known.len(),
            outliers: 0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit_survey(position_of: impl Fn(f64, f64) -> [f64; 2]) -> Result<SurveyFit, String> {
        let (mut cells, mut positions) = (Vec::new(), Vec::new());
        for i in 0..11 {
            for c in 0..7 {
                cells.push([i, c]);
                positions.push(position_of(i as f64, c as f64));
            }
        }
        SurveyFit::from_positions(&cells, &positions)
    }

    #[test]
    fn a_rotated_survey_far_from_the_origin_is_found_exactly() {
        let (s, c) = 0.3f64.sin_cos();
        let fit = fit_survey(|i, j| {
            [
                710_000.0 + 25.0 * c * i - 12.5 * s * j,
                9_261_000.0 + 25.0 * s * i + 12.5 * c * j,
            ]
        })
        .unwrap();
        assert!((fit.origin[1] - 9_261_000.0).abs() < 1e-6);
        assert!((fit.inline[0] - 25.0 * c).abs() < 1e-8);
        assert!((fit.crossline[0] + 12.5 * s).abs() < 1e-8);
        assert!(fit.max < 1e-6);
        let [inline, crossline] = fit.line_spacing();
        assert!((inline - 25.0).abs() < 1e-8 && (crossline - 12.5).abs() < 1e-8);
    }

    #[test]
    fn the_residual_is_that_of_the_noise() {
        let noise = |i: f64, j: f64| if (i + j) % 2.0 == 0.0 { 0.5 } else { -0.5 };
        let fit = fit_survey(|i, j| [25.0 * i + noise(i, j), 25.0 * j]).unwrap();
        assert!((fit.rms - 0.5).abs() < 0.01, "{}", fit.rms);
        assert!(fit.max < 0.6);
    }

    #[test]
    fn traces_without_coordinates_are_left_out() {
        let fit = fit_survey(|i, j| {
            if i == 3.0 {
                [0.0, 0.0]
            } else {
                [1e5 + 10.0 * i, 2e5 + 10.0 * j]
            }
        })
        .unwrap();
        assert_eq!(fit.traces, 70);
        assert!(fit.max < 1e-6);
    }

    #[test]
    fn coordinates_far_off_do_not_move_the_survey() {
        // Unset coordinates of several kinds, at most one in twenty.
        let wild = [
            [f64::from(i32::MIN); 2],
            [f64::from(i32::MAX), 0.0],
            [1.0, 1.0],
        ];
        for count in 1..=3 {
            let fit = fit_survey(|i, j| match (i as usize, j as usize) {
                (i, j) if i == 3 * j && j < count => wild[j],
                _ => [1e5 + 10.0 * i, 2e5 + 12.5 * j],
            })
            .unwrap();
            assert_eq!((fit.traces, fit.outliers), (77 - count, count));
            assert!((fit.inline[0] - 10.0).abs() < 1e-8, "{fit:?}");
            assert!((fit.crossline[1] - 12.5).abs() < 1e-8, "{fit:?}");
            assert!(fit.max < 1e-6);
        }
    }

    #[test]
    fn unusable_coordinates_are_refused() {
        for (position_of, expected) in [
            ((|_, _| [0.0, 0.0]) as fn(f64, f64) -> [f64; 2], "all zero"),
            (|_, _| [7.0, 8.0], "same for all"),
            (|i, j| [1.0 + i + j, 2.0 * (i + j)], "straight line"),
            (|i, j| [1.0 + (i * 7.3 + j * 3.1).sin(), j], "do not follow"),
        ] {
            let reason = fit_survey(position_of).unwrap_err();
            assert!(reason.contains(expected), "{reason} (expected: {expected})");
        }
    }
}
