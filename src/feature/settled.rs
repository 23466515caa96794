//! What detection settles on for a whole image, so that a part of it can be treated alike: a local
//! edit looks for features near the edit only, and must find those that the whole image has there.

use serde::{Deserialize, Serialize};

use super::sheets::Open;
use super::{Features, Kind, Options, both, check, empty, follow};
use crate::Result;
use crate::image::Image;

/// Scale and thresholds for one kind of feature, found from a whole image.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct Settled {
    /// The kind of feature, never [`Kind::Auto`] and only one.
    pub kind: Kind,
    /// Width in samples of the Gaussian under which sheets are sought.
    pub scale: f64,
    /// Strength down to which a sheet is followed.
    pub low: f32,
    /// Strength that a sheet has somewhere.
    pub high: f32,
    /// Least area of a sheet, in square lattice units (in 2-D length).
    pub min_area: f64,
    /// Of labels: the value of a thin mask, whose middle is the feature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mask: Option<f32>,
}

/// How far (samples) detection looks to either side: beyond this from where a part of an image was
/// cut, the features are those of the whole image.
pub fn reach(settled: &[Settled]) -> usize {
    let reach = |s: &Settled| match s.kind {
        // Averages over windows of 4 samples, twice for semblance.
        Kind::Horizons | Kind::Faults => 14,
        _ => (3.0 * s.scale).ceil() as usize + 3,
    };
    settled.iter().map(reach).max().unwrap_or(0)
}

/// Finds the features of a part of an image as [`detect`](super::detect) finds those of the whole,
/// for which it `settled` on scales and thresholds. `open` tells the sides beyond which the image
/// goes on: sheets that reach them are kept however small they are here.
///
/// # Errors
/// Those of [`detect`](super::detect), but that a part may well be constant.
pub fn detect_part<const D: usize>(
    part: &Image<D>,
    options: &Options<D>,
    settled: &[Settled],
    open: &Open<D>,
) -> Result<Features<D>> {
    let samples = part.as_slice();
    if samples.iter().all(|s| *s == samples[0]) {
        return Ok(empty(part.dims(), options));
    }
    check(part, options)?;
    let mut found = Vec::new();
    for one in settled {
        let known = Some((one, open));
        found.push(follow(part, one.kind, options, known, Vec::new())?);
    }
    let mut found = found.into_iter();
    Ok(match (found.next(), found.next()) {
        (Some(first), Some(second)) => both(first, second, options.weights),
        (Some(only), None) => only,
        _ => empty(part.dims(), options),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::{FeaturePoint, detect};
    use crate::image::Geometry;
    use crate::synth::{self, Kind as Scene};

    /// The box from `first` on, `dims` long.
    fn cut(image: &Image<3>, first: [usize; 3], dims: [usize; 3]) -> Image<3> {
        let [nx, ny, _] = image.dims();
        let at = |i: usize| {
            let x = [i % dims[0], i / dims[0] % dims[1], i / (dims[0] * dims[1])];
            let [x, y, z]: [usize; 3] = std::array::from_fn(|k| x[k] + first[k]);
            image.as_slice()[(z * ny + y) * nx + x]
        };
        let samples = (0..dims.iter().product()).map(at).collect();
        Image::new(dims, samples, Geometry::default())
    }

    #[test]
    fn a_part_has_the_features_of_the_whole_away_from_where_it_was_cut() {
        for (scene, kind) in [
            (Scene::Faults, Kind::Ridges),
            (Scene::Amplitude, Kind::Horizons),
            (Scene::Blocks, Kind::Labels),
        ] {
            let made = synth::make(
                scene,
                &synth::Options {
                    dims: [96, 80, 72],
                    ..Default::default()
                },
            );
            let image = made.unwrap().image;
            let options = Options {
                kind,
                d_min: 6.0,
                ..Options::default()
            };
            let whole = detect(&image, &options).unwrap();
            assert_eq!(whole.settled.len(), 1);
            // Through the text in which it is stored.
            let text = serde_json::to_string(&whole.settled).unwrap();
            let settled: Vec<Settled> = serde_json::from_str(&text).unwrap();
            assert_eq!(settled, whole.settled);

            let (first, dims) = ([20, 0, 12], [60, 64, 50]);
            let open = [[true, true], [false, true], [true, true]];
            let part = detect_part(&cut(&image, first, dims), &options, &settled, &open).unwrap();
            let rim = reach(&settled) as f32;
            // Inside the part, by `rim` from where it was cut.
            let inside = |p: &FeaturePoint<3>, first: [usize; 3]| {
                (0..3).all(|k| {
                    let x = p.position[k] - first[k] as f32;
                    let (low, high) = (
                        if open[k][0] { rim } else { 0.0 },
                        dims[k] as f32 - 1.0 - rim,
                    );
                    x >= low && x <= high
                })
            };
            let of_whole: Vec<[f32; 3]> = (whole.points.iter())
                .filter(|p| inside(p, first))
                .map(|p| std::array::from_fn(|k| p.position[k] - first[k] as f32))
                .collect();
            let of_part: Vec<[f32; 3]> = (part.points.iter())
                .filter(|p| inside(p, [0; 3]))
                .map(|p| p.position)
                .collect();
            assert!(of_whole.len() > 300, "{kind}: {}", of_whole.len());
            let near = |p: &[f32; 3], others: &[[f32; 3]]| {
                let square = |q: &[f32; 3]| (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>();
                others.iter().any(|q| square(q) < 0.1 * 0.1)
            };
            let lost = of_whole.iter().filter(|p| !near(p, &of_part)).count();
            let extra = of_part.iter().filter(|p| !near(p, &of_whole)).count();
            println!(
                "{kind}: {} points, {lost} lost, {extra} more",
                of_whole.len()
            );
            for p in of_whole.iter().filter(|p| !near(p, &of_part)).step_by(200) {
                let q = of_part.iter().map(|q| (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>().sqrt()).fold(f32::MAX, f32::min);
                println!("lost {p:?} nearest {q}");
            }
            println!("{:?} {:?} {:?}", settled, whole.notes, part.notes);
            assert!(
                lost * 100 <= of_whole.len(),
                "{kind}: {lost} of {}",
                of_whole.len()
            );
            assert!(
                extra * 20 <= of_part.len(),
                "{kind}: {extra} of {}",
                of_part.len()
            );
        }
    }

    #[test]
    fn a_constant_part_has_no_features() {
        let part = Image::new([20, 20], vec![3.0; 400], Geometry::default());
        let found = detect_part(&part, &Options::default(), &[], &[[true; 2]; 2]).unwrap();
        assert!(found.points.is_empty() && found.potential.samples.iter().all(|b| *b == 0.0));
    }
}
