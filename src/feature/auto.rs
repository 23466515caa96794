//! What kind of features an image has, judged by its values.

use super::Kind;
use super::labels::values;
use super::volume::Volume;

/// The kind, and why.
pub fn pick(volume: Volume<'_>) -> (Kind, String) {
    let s = volume.samples;
    if let Some(labels) = values(s) {
        let equal = s.windows(2).filter(|w| w[0] == w[1]).count();
        let share = equal as f64 / (s.len().max(2) - 1) as f64;
        if share > 0.75 {
            let why = format!(
                "{} different values, {:.0} % of neighbours equal",
                labels.len(),
                100.0 * share
            );
            return (Kind::Labels, why);
        }
    }
    let shape = Shape::of(volume);
    let span = (shape.high - shape.low).max(f32::MIN_POSITIVE);
    // Far ends: how much farther the high values lie from the median than the low ones.
    let lean = (shape.high + shape.low - 2.0 * shape.median) / span;
    let figures = format!(
        "1 %, 50 % and 99 % of values at {:.4}, {:.4}, {:.4}; {:.1} % in the upper half of these",
        shape.low,
        shape.median,
        shape.high,
        100.0 * shape.above
    );
    let (least, most) = s
        .iter()
        .fold((f32::MAX, f32::MIN), |(a, b), &v| (a.min(v), b.max(v)));
    let (kind, what) = if least >= -1.0 && least < -0.9 && most <= 0.0 && shape.median > -0.1 {
        (Kind::Potential, "all values in [-1, 0], most near 0")
    } else if lean > 0.25 && shape.above < 0.22 {
        (Kind::Ridges, "few high values on a low background")
    } else if lean < -0.25 && shape.above > 0.78 {
        (Kind::Valleys, "few low values on a high background")
    } else if lean.abs() < 0.35 && shape.median.abs() < 0.15 * span && shape.low < 0.0 {
        (Kind::Horizons, "values swing evenly about zero")
    } else {
        (Kind::Edges, "neither sparse nor swinging about zero")
    };
    (kind, format!("{what}: {figures}"))
}

/// Percentiles of local means, which noise disturbs little.
struct Shape {
    low: f32,
    median: f32,
    high: f32,
    /// Share of values above the middle between `low` and `high`.
    above: f64,
}

impl Shape {
    /// Looks at some 10^5 means over 3 x 3 x 3 samples.
    fn of(volume: Volume<'_>) -> Self {
        let [nx, ny, nz] = volume.dims;
        let stride = (volume.samples.len() / 100_000).max(1) | 1;
        let mut means: Vec<f32> = (0..volume.samples.len())
            .step_by(stride)
            .map(|i| {
                let at = [i % nx, i / nx % ny, i / nx / ny];
                let range =
                    |k: usize| at[k].saturating_sub(1)..=(at[k] + 1).min([nx, ny, nz][k] - 1);
                let (mut sum, mut count) = (0.0, 0.0);
                for z in range(2) {
                    for y in range(1) {
                        for x in range(0) {
                            sum += volume.samples[volume.index([x, y, z])];
                            count += 1.0;
                        }
                    }
                }
                sum / count
            })
            .collect();
        means.sort_by(f32::total_cmp);
        let at = |share: f64| means[((means.len() - 1) as f64 * share) as usize];
        let (low, median, high) = (at(0.01), at(0.5), at(0.99));
        let middle = 0.5 * (low + high);
        let above = means.iter().filter(|m| **m > middle).count() as f64 / means.len() as f64;
        Self {
            low,
            median,
            high,
            above,
        }
    }
}
