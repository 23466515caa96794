//! What kind of features an image has, judged by its values.

use super::Kind;
use super::labels::values;
use super::volume::Volume;

/// The kind, and why.
pub fn pick<const D: usize>(volume: Volume<'_, D>) -> (Kind, String) {
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
        "1 %, 50 % and 99 % of values at {:.4}, {:.4}, {:.4}; {:.0} % in the upper \
         half, {:.0} % of the rarer half thin",
        shape.low,
        shape.median,
        shape.high,
        100.0 * shape.above,
        100.0 * shape.thin,
    );
    let (least, most) = s
        .iter()
        .fold((f32::MAX, f32::MIN), |(a, b), &v| (a.min(v), b.max(v)));
    let (kind, what) = if (-1.0..-0.9).contains(&least) && most <= 0.0 && shape.median > -0.1 {
        (Kind::Potential, "all values in [-1, 0], most near 0")
    } else if lean > 0.3 && shape.above < 0.4 && shape.thin > 0.5 {
        (
            Kind::Ridges,
            "thin sheets of high values on a low background",
        )
    } else if lean < -0.3 && shape.above > 0.6 && shape.thin > 0.5 {
        (
            Kind::Valleys,
            "thin sheets of low values on a high background",
        )
    } else if lean.abs() < 0.35 && shape.median.abs() < 0.15 * span && shape.low < 0.0 {
        (Kind::Horizons, "values swing evenly about zero")
    } else {
        (Kind::Edges, "neither thin sheets nor swings about zero")
    };
    (kind, format!("{what}: {figures}"))
}

/// Samples to either side of a thin sheet that are outside it, this far along some axis.
const THIN: usize = 6;

/// Percentiles of local means, which noise disturbs little.
struct Shape {
    low: f32,
    median: f32,
    high: f32,
    /// Share of values above the middle between `low` and `high`.
    above: f64,
    /// Share of the values on the rarer side of the middle that lie in something thin.
    thin: f64,
}

impl Shape {
    /// Looks at some 10^5 means over 3^D samples.
    fn of<const D: usize>(volume: Volume<'_, D>) -> Self {
        let stride = (volume.samples.len() / 100_000).max(1) | 1;
        let places = (0..volume.samples.len())
            .step_by(stride)
            .map(|i| volume.coordinates(i));
        let means: Vec<f32> = places.clone().map(|at| local_mean(volume, at)).collect();
        let mut sorted = means.clone();
        sorted.sort_by(f32::total_cmp);
        let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share) as usize];
        let (low, median, high) = (at(0.01), at(0.5), at(0.99));
        let middle = 0.5 * (low + high);
        let above = means.iter().filter(|m| **m > middle).count() as f64 / means.len() as f64;
        let rare = above < 0.5;
        let (mut inside, mut thin) = (0usize, 0usize);
        for (at, _) in places.zip(&means).filter(|(_, m)| (**m > middle) == rare) {
            inside += 1;
            let outside = |at: [usize; D]| (local_mean(volume, at) > middle) != rare;
            thin += usize::from((0..D).any(|k| {
                let (mut before, mut after) = (at, at);
                before[k] = at[k].saturating_sub(THIN);
                after[k] = (at[k] + THIN).min(volume.dims[k] - 1);
                outside(before) && outside(after)
            }));
        }
        Self {
            low,
            median,
            high,
            above,
            thin: thin as f64 / inside.max(1) as f64,
        }
    }
}

/// Mean over the samples that touch one, and itself.
fn local_mean<const D: usize>(volume: Volume<'_, D>, at: [usize; D]) -> f32 {
    let low = at.map(|i| i.saturating_sub(1));
    let span: [usize; D] =
        std::array::from_fn(|k| (at[k] + 1).min(volume.dims[k] - 1) + 1 - low[k]);
    let mut sum = 0.0;
    let rows: usize = span[1..].iter().product();
    for number in 0..rows {
        let mut rest = number;
        let mut first = low;
        for k in 1..D {
            first[k] += rest % span[k];
            rest /= span[k];
        }
        let start = volume.index(first);
        sum += volume.samples[start..start + span[0]].iter().sum::<f32>();
    }
    sum / (rows * span[0]) as f32
}
