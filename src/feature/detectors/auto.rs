//! What kind of features an image has, judged by its values.
//!
//! In this order: labels where there are few values and neighbours mostly share one; b(x) where all
//! values are in [-1, 0] and most near 0; ridges or valleys where the rarer half of the values, that
//! farther from the median, lies in thin sheets; horizons where values are spread symmetrically about zero; edges
//! otherwise. Values are means over 3^D samples, which noise disturbs little, of some 10^5 places.
//!
//! Assumption: the features are what most of the rarer values belong to. Faults, Canny's edges and paths
//! are never chosen: an amplitude volume has horizons as well, and the others are other ways to edges.

use super::Detector;
use super::edges::Edges;
use super::horizons::Horizons;
use super::labels::Labels;
use super::potential::Potential;
use super::ridges::{Ridges, Valleys};
use crate::feature::volume::Volume;
use crate::image::Image;

/// The detector that fits an image, and why.
pub fn choose<const D: usize>(image: &Image<D>) -> (&'static dyn Detector<D>, String) {
    let s = image.as_slice();
    let volume = Volume::new(image.dims(), s);
    if let Some(labels) = image.looks_labelled() {
        let why = format!(
            "{} different values, {:.0} % of neighbours equal",
            labels.values,
            100.0 * labels.equal
        );
        return (&Labels, why);
    }
    let spread = Spread::of(volume);
    let span = (spread.high - spread.low).max(f32::MIN_POSITIVE);
    // Far ends: how much farther the high values lie from the median than the low ones.
    let lean = (spread.high + spread.low - 2.0 * spread.median) / span;
    let figures = format!(
        "1 %, 50 % and 99 % of values at {:.4}, {:.4}, {:.4}; {:.0} % in the upper \
         half, {:.0} % of the rarer half thin",
        spread.low,
        spread.median,
        spread.high,
        100.0 * spread.above,
        100.0 * spread.thin,
    );
    let (least, most) = s
        .iter()
        .fold((f32::MAX, f32::MIN), |(a, b), &v| (a.min(v), b.max(v)));
    let (detector, what): (&dyn Detector<D>, _) =
        if (-1.0..-0.9).contains(&least) && most <= 0.0 && spread.median > -0.1 {
            (&Potential, "all values in [-1, 0], most near 0")
        } else if lean > 0.3 && spread.above < 0.4 && spread.thin > THIN_SHARE {
            (&Ridges, "thin sheets of high values on a low background")
        } else if lean < -0.3 && spread.above > 0.6 && spread.thin > THIN_SHARE {
            (&Valleys, "thin sheets of low values on a high background")
        } else if lean.abs() < 0.35 && spread.median.abs() < 0.15 * span && spread.low < 0.0 {
            (&Horizons, "values are spread symmetrically about zero")
        } else {
            (&Edges, "neither thin sheets nor values about zero")
        };
    (detector, format!("{what}: {figures}"))
}

/// The rarer values are thin sheets if at least this share of them lies in something thin: less than
/// half of it does where sheets run close together.
const THIN_SHARE: f64 = 0.33;

/// Samples to either side of a thin sheet that are outside it, this far along some axis.
const THIN: usize = 6;

/// Percentiles of local means, which noise disturbs little.
struct Spread {
    low: f32,
    median: f32,
    high: f32,
    /// Share of values above the middle between `low` and `high`.
    above: f64,
    /// Share of the values on the rarer side of the middle that lie in something thin.
    thin: f64,
}

impl Spread {
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

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{Noise, crossing_sheets, image_of, ridge_image};
    use crate::feature::{Detection, FeatureKind, detect};
    use crate::image::Image;

    #[test]
    fn auto_tells_ridges_and_edges() {
        let (dims, sheets) = crossing_sheets();
        let note = |image: &Image<3>| {
            detect(image, &Detection::of(FeatureKind::Auto, 8.0))
                .unwrap()
                .notes[0]
                .clone()
        };
        let ridges = note(&ridge_image(dims, &sheets, 1.5, 0.25));
        assert!(ridges.contains("features: ridges"), "{ridges}");
        let mut noise = Noise::new(9);
        let blob = image_of([48, 48, 48], |p| {
            let r = (0..3).map(|k| (p[k] - 24.0).powi(2)).sum::<f64>().sqrt();
            80.0 + 60.0 * f64::from(u8::from(r < 18.0)) + 4.0 * noise.normal()
        });
        let edges = note(&blob);
        assert!(edges.contains("features: edges"), "{edges}");
    }

    #[test]
    fn a_threshold_is_refused_where_auto_chooses_labels() {
        let image = image_of([32, 32, 32], |p| f64::from(u8::from(p[0] < 16.0)));
        let threshold = |threshold| Detection {
            threshold,
            ..Detection::of(FeatureKind::Auto, 8.0)
        };
        let found = detect(&image, &threshold(None)).unwrap();
        assert!(found.notes[0].contains("labels"), "{:?}", found.notes);
        let said = detect(&image, &threshold(Some(0.5))).unwrap_err();
        let said = said.to_string();
        for word in ["threshold 0.5", "labels", "2 different values", "omit it"] {
            assert!(said.contains(word), "no '{word}' in: {said}");
        }
    }
}
