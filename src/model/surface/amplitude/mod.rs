//! Measures of surfaces from the amplitudes of an image: throw, polarity, amplitude, confidence.
//!
//! *Throw* of a fault is the vertical displacement of the hanging wall, positive downwards. Traces
//! on both sides of each face are correlated along the fault's dip (`traces`). The correlations are
//! averaged over neighbouring faces, in two steps: a wide average decides which reflectors belong
//! together, a narrow one near that lag gives the throw. The hanging wall lies above a fault that dips;
//! of a vertical fault it is the side that its faces show. Horizons that end on both sides give the throw
//! a second time (`horizon_pairs`). Where the two differ much, the correlation is searched for near the throw of
//! the horizons, because layers that repeat also match a wavelength too high or too low.
//!
//! *Polarity* of a horizon is the sign of its mean amplitude: peak or trough.
//!
//! *Confidence* is a contrast over the same contrast at random places of the image. The contrast at a
//! fault is how much better traces on one side agree than those on both sides do; at a horizon it is
//! the amplitude, with the horizon's sign. It is about 1 where an image has only noise.

mod horizon_pairs;
mod reflectors;

use std::collections::BTreeMap;

use serde::Serialize;

use super::facets::FacetComplex;
use super::{SurfaceKind, Surfaces};
use crate::geometry::statistics::weighted_quantiles;
use crate::geometry::{dot, norm, normal, unit};
use crate::image::contrast::{AmplitudeScale, fault_confidence, random_contrast};
use crate::image::fault_traces::{FaultPoint, MAX_LAG, best_lag};
use crate::image::{Geometry, Image};
use crate::parallel::prelude::*;
use horizon_pairs::{HorizonFaces, PairThrows};

/// Passes over neighbouring faces that average correlations before reflectors are matched, and
/// before the throw is measured.
const WIDE_PASSES: usize = 24;
const NARROW_PASSES: usize = 4;

/// Largest difference (samples) of the throw at a face from that of the wide average.
const MAX_LAG_CHANGE: isize = 5;

/// Largest difference (samples) of the throw at a face from that by pairs of horizons. If it is larger, the
/// correlation is searched for near the throw by pairs.
const MAX_PAIR_DIFFERENCE: f64 = 6.0;

/// Smallest correlation of both sides at which a throw counts.
const MIN_CORRELATION: f64 = 0.7;

/// Smallest difference of the largest correlation from that of other reflectors, so that reflectors
/// match without doubt.
const MIN_PEAK_EXCESS: f64 = 0.1;

/// The sign of the amplitude of a horizon.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Polarity {
    /// The amplitude is larger than the image's mean.
    Peak,
    /// The amplitude is smaller than the image's mean.
    Trough,
}

impl Polarity {
    /// Returns the name in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Peak => "peak",
            Self::Trough => "trough",
        }
    }
}

/// Throw of a fault, in the unit of the vertical coordinate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Throw {
    /// The throw that 5 % of the area do not reach.
    pub min: f64,
    /// The median throw: half of the area has less.
    pub median: f64,
    /// The throw that 5 % of the area exceed.
    pub max: f64,
    /// The mean correlation of both sides.
    pub correlation: f64,
    /// The share of the fault's area at which a throw is measured.
    pub area_share: f64,
    /// `true` if `min` and `max` differ in sign: the fault is normal in one place and reverse in
    /// another, or layers were matched wrongly.
    pub is_doubtful: bool,
}

/// Throw of a fault by pairs of horizons that end on both sides of it, in the unit of the vertical
/// coordinate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HorizonThrow {
    /// The median throw: half of the area has less.
    pub median: f64,
    /// Number of pairs of horizons.
    pub pairs: usize,
    /// The share of the fault's area at which they give a throw.
    pub area_share: f64,
}

/// Measures of a surface from amplitudes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct AmplitudeMeasure {
    /// Throw of a fault; `None` for other surfaces, and where it cannot be measured.
    pub throw: Option<Throw>,
    /// Throw of a fault by pairs of horizons, if there are any.
    pub horizon_throw: Option<HorizonThrow>,
    /// Polarity of a horizon.
    pub polarity: Option<Polarity>,
    /// Mean amplitude of a horizon.
    pub amplitude: Option<f64>,
    /// Mean contrast of the surface over that at random places.
    pub confidence: Option<f64>,
}

/// Measures of surfaces and of their faces.
#[derive(Debug, Clone, PartialEq)]
pub struct AmplitudeMeasures {
    /// The measures of each surface.
    pub surfaces: Vec<AmplitudeMeasure>,
    /// The throw at each face, NaN where there is none.
    pub throws: Vec<f32>,
    /// The throw at each face by pairs of horizons, NaN where there is none.
    pub horizon_throws: Vec<f32>,
    /// The correlation of both sides at each face, NaN away from faults.
    pub correlations: Vec<f32>,
    /// The amplitude at each face.
    pub amplitudes: Vec<f32>,
    /// The confidence at each face, NaN where it cannot be measured.
    pub confidences: Vec<f32>,
}

/// Measures surfaces in an image. `nodes` are positions in samples, `geometry` is that of the mesh and
/// `up` points up in it.
pub fn measure_amplitudes<const D: usize>(
    surfaces: &Surfaces<D>,
    kinds: &[SurfaceKind],
    nodes: &[[f64; D]],
    image: &Image<D>,
    geometry: &Geometry<D>,
    up: [f64; D],
) -> AmplitudeMeasures {
    let space = AmplitudeSpace::new(image, geometry, up);
    let count = surfaces.facets.len();
    let mut measures = AmplitudeMeasures {
        surfaces: Vec::with_capacity(surfaces.len()),
        throws: vec![f32::NAN; count],
        horizon_throws: vec![f32::NAN; count],
        correlations: vec![f32::NAN; count],
        amplitudes: vec![f32::NAN; count],
        confidences: vec![f32::NAN; count],
    };
    let complex = |s: usize| FacetComplex::new(nodes, surfaces.facets_of(s).to_vec());
    let are_horizons = kinds.iter().map(|kind| *kind == SurfaceKind::Horizon);
    let horizons = (are_horizons.enumerate()).filter(|(_, is_horizon)| *is_horizon);
    let horizons = HorizonFaces::new(horizons.map(|(s, _)| (s, complex(s))));
    for (s, kind) in kinds.iter().enumerate() {
        let facets = complex(s);
        let start = surfaces.start[s];
        let faces = match kind {
            SurfaceKind::Fault => space.fault(&facets, &horizons),
            SurfaceKind::Horizon => space.horizon(&facets),
            SurfaceKind::Interface => Faces::default(),
        };
        let fill = |array: &mut [f32], values: &[f32]| {
            array[start..start + values.len()].copy_from_slice(values);
        };
        fill(&mut measures.throws, &faces.throws);
        fill(&mut measures.horizon_throws, &faces.horizon_throws);
        fill(&mut measures.correlations, &faces.correlations);
        fill(&mut measures.amplitudes, &faces.amplitudes);
        fill(&mut measures.confidences, &faces.confidences);
        measures.surfaces.push(faces.measure);
    }
    measures
}

/// Splits horizons without names where they jump from one reflector to another. Nodes are in samples.
/// Parts of fewer than ten faces are dropped.
pub fn split_horizons<const D: usize>(
    surfaces: &mut Surfaces<D>,
    kinds: &[SurfaceKind],
    nodes: &[[f64; D]],
    image: &Image<D>,
    geometry: &Geometry<D>,
    up: [f64; D],
) {
    let space = AmplitudeSpace::new(image, geometry, up);
    let area = |facets: &[[u32; D]]| -> f64 {
        let areas = facets
            .iter()
            .map(|f| norm(normal(&f.map(|n| nodes[n as usize]))));
        areas.sum()
    };
    let named_count = surfaces.names.len();
    let mut parts: Vec<Vec<[u32; D]>> = Vec::new();
    for (s, kind) in kinds.iter().enumerate() {
        let facets = surfaces.facets_of(s).to_vec();
        if s < named_count || *kind != SurfaceKind::Horizon {
            parts.push(facets);
            continue;
        }
        let complex = FacetComplex::new(nodes, facets);
        let reflector = reflectors::reflectors(&complex, image, space.vertical, space.scale.mean);
        let mut by_reflector: BTreeMap<usize, Vec<[u32; D]>> = BTreeMap::new();
        for (facet, reflector) in complex.facets.iter().zip(reflector) {
            by_reflector.entry(reflector).or_default().push(*facet);
        }
        let is_whole = by_reflector.len() == 1;
        for part in by_reflector.into_values() {
            if is_whole || part.len() as f64 >= super::min_facet_count::<D>() {
                parts.push(part);
            } else {
                surfaces.dropped_count += 1;
                surfaces.dropped_area += area(&part);
            }
        }
    }
    // Surfaces without names are in the order of their areas.
    let areas: Vec<f64> = parts.iter().map(|part| area(part)).collect();
    let mut order: Vec<usize> = (0..parts.len()).collect();
    order[named_count..].sort_by(|&a, &b| areas[b].total_cmp(&areas[a]).then(a.cmp(&b)));
    surfaces.facets.clear();
    surfaces.start = vec![0];
    for s in order {
        surfaces.facets.extend(&parts[s]);
        surfaces.start.push(surfaces.facets.len());
    }
}

/// The measures of one surface and of its faces.
#[derive(Debug, Clone, Default)]
struct Faces {
    measure: AmplitudeMeasure,
    throws: Vec<f32>,
    horizon_throws: Vec<f32>,
    correlations: Vec<f32>,
    amplitudes: Vec<f32>,
    confidences: Vec<f32>,
}

/// An image, its vertical axis, and the scales of its amplitudes.
struct AmplitudeSpace<'a, const D: usize> {
    image: &'a Image<D>,
    scale: AmplitudeScale,
    vertical: usize,
    /// 1 if the index of samples grows downwards, otherwise -1.
    down: f64,
    /// Length of a sample along the vertical axis.
    step: f64,
}

impl<'a, const D: usize> AmplitudeSpace<'a, D> {
    fn new(image: &'a Image<D>, geometry: &Geometry<D>, up: [f64; D]) -> Self {
        let rise = geometry.axes.map(|axis| dot(axis, up) / norm(axis));
        let vertical = (1..D).fold(0, |best, k| {
            if rise[k].abs() > rise[best].abs() {
                k
            } else {
                best
            }
        });
        Self {
            image,
            scale: AmplitudeScale::new(image),
            vertical,
            down: -rise[vertical].signum(),
            step: dot(geometry.axes[vertical], up).abs(),
        }
    }

    /// Measures a horizon.
    fn horizon(&self, facets: &FacetComplex<'_, D>) -> Faces {
        let amplitudes: Vec<f64> = (facets.centroids().into_iter())
            .map(|x| f64::from(self.image.interpolate_linear(x)))
            .collect();
        let areas: Vec<f64> = (0..facets.len()).map(|f| norm(facets.normal(f))).collect();
        let mean = weighted_mean(&amplitudes, &areas);
        let is_peak = mean >= self.scale.mean;
        let confidence = |amplitude: f64| self.scale.horizon_confidence(amplitude, is_peak);
        Faces {
            measure: AmplitudeMeasure {
                polarity: Some(if is_peak {
                    Polarity::Peak
                } else {
                    Polarity::Trough
                }),
                amplitude: Some(mean),
                confidence: Some(confidence(mean)),
                throw: None,
                horizon_throw: None,
            },
            confidences: amplitudes.iter().map(|&a| confidence(a) as f32).collect(),
            amplitudes: amplitudes.iter().map(|&a| a as f32).collect(),
            ..Faces::default()
        }
    }

    /// Measures a fault.
    fn fault(&self, facets: &FacetComplex<'_, D>, horizons: &HorizonFaces<D>) -> Faces {
        let points = self.fault_points(facets);
        let pairs = self.pair_throws(&points, horizons);
        let correlations: Vec<_> = (points.par_iter())
            .map(|point| point.correlate(self.image, self.vertical, self.scale.mean))
            .collect();
        let neighbours = neighbours(facets);
        let curves: Vec<Option<Vec<f32>>> = correlations
            .iter()
            .map(|c| c.as_ref().map(|c| c.by_lag.clone()))
            .collect();
        let narrow = average_over_neighbours(curves, &neighbours, NARROW_PASSES);
        let wide =
            average_over_neighbours(narrow.clone(), &neighbours, WIDE_PASSES - NARROW_PASSES);
        let coarse = coarse_lags(&wide, &neighbours);
        let lag_near = |f: usize, centre: f64, min_share: f64| {
            let centre = centre.round() as isize;
            let range = [centre - MAX_LAG_CHANGE, centre + MAX_LAG_CHANGE];
            best_lag(narrow[f].as_ref()?, range[0], range[1], min_share)
        };
        let lag = |f: usize| {
            let lag = coarse[f].and_then(|coarse| lag_near(f, coarse, 1.0));
            match (pairs.throws[f], lag) {
                (None, lag) => lag,
                (Some(pair), Some((lag, peak))) if (lag - pair).abs() <= MAX_PAIR_DIFFERENCE => {
                    Some((lag, peak))
                }
                (Some(pair), _) => lag_near(f, pair, 0.5),
            }
        };
        let lags: Vec<Option<(f64, f64)>> = (0..facets.len()).map(lag).collect();
        let areas: Vec<f64> = (0..facets.len()).map(|f| norm(facets.normal(f))).collect();
        let scale = self.down * self.step;
        let measured: Vec<[f64; 3]> = (lags.iter().zip(&areas))
            .filter_map(|(lag, &area)| lag.map(|(lag, peak)| [lag * scale, peak, area]))
            .filter(|m| m[1] >= MIN_CORRELATION)
            .collect();
        let random_contrast = random_contrast(&points, self.image, self.vertical, self.scale.mean);
        let confidence = |contrast: f64| fault_confidence(contrast, random_contrast);
        let contrasts = correlations.iter().zip(&areas);
        let (contrasts, contrast_areas): (Vec<f64>, Vec<f64>) = contrasts
            .filter_map(|(c, &area)| c.as_ref().map(|c| (c.contrast, area)))
            .unzip();
        let has_contrast = !contrasts.is_empty();
        let mean_contrast = weighted_mean(&contrasts, &contrast_areas);
        Faces {
            measure: AmplitudeMeasure {
                throw: throw_of(&measured, areas.iter().sum()),
                horizon_throw: horizon_throw_of(&pairs, &areas, scale),
                confidence: has_contrast.then(|| confidence(mean_contrast)),
                ..AmplitudeMeasure::default()
            },
            throws: (lags.iter())
                .map(|lag| match lag {
                    Some((lag, peak)) if *peak >= MIN_CORRELATION => (lag * scale) as f32,
                    _ => f32::NAN,
                })
                .collect(),
            horizon_throws: (pairs.throws.iter())
                .map(|throw| throw.map_or(f32::NAN, |throw| (throw * scale) as f32))
                .collect(),
            correlations: (lags.iter())
                .map(|lag| lag.map_or(f32::NAN, |(_, peak)| peak as f32))
                .collect(),
            confidences: (correlations.iter())
                .map(|c| {
                    c.as_ref()
                        .map_or(f32::NAN, |c| confidence(c.contrast) as f32)
                })
                .collect(),
            amplitudes: Vec::new(),
        }
    }

    /// Returns the centres of the faces of a fault and their normals, which point into the hanging
    /// wall.
    fn fault_points(&self, facets: &FacetComplex<'_, D>) -> Vec<FaultPoint<D>> {
        let normals: Vec<[f64; D]> = (facets.facets.iter())
            .map(|facet| normal(&facet.map(|n| facets.nodes[n as usize])))
            .collect();
        let rise: f64 = normals.iter().map(|n| -self.down * n[self.vertical]).sum();
        let area: f64 = normals.iter().map(|n| norm(*n)).sum();
        let sign = if rise < -1e-6 * area { -1.0 } else { 1.0 };
        // Normals are averaged: single faces deviate from the fault.
        let mut means: Vec<Option<Vec<f32>>> = (normals.iter())
            .map(|n| Some(n.map(|c| (sign * c) as f32).to_vec()))
            .collect();
        means = average_over_neighbours(means, &neighbours(facets), 3);
        (facets.centroids().into_iter().zip(means))
            .map(|(position, mean)| {
                let mean = mean.unwrap_or_default();
                FaultPoint {
                    position,
                    normal: unit(std::array::from_fn(|k| {
                        mean.get(k).copied().map_or(0.0, f64::from)
                    })),
                }
            })
            .collect()
    }
}

/// Returns the lag of the largest correlation at each face. Faces at which other reflectors match
/// nearly as well, or some lags are unknown because the traces would leave the image, take the mean of
/// their neighbours.
fn coarse_lags(curves: &[Option<Vec<f32>>], neighbours: &[Vec<u32>]) -> Vec<Option<f64>> {
    let max = MAX_LAG as isize;
    let lags = |min_share: f64, min_excess: f64| -> Vec<Option<f64>> {
        let curves = curves.iter();
        let lag = |curve: &Option<Vec<f32>>| {
            let curve = curve.as_ref()?;
            let (lag, peak) = best_lag(curve, -max, max, min_share)?;
            let is_other = |other: isize| (other as f64 - lag).abs() > MAX_LAG_CHANGE as f64;
            let others = (-max..=max).zip(curve).filter(|other| is_other(other.0));
            let second = others.fold(-1.0, |second, other| f32::max(second, *other.1));
            (f64::from(second) <= peak - min_excess).then_some(lag)
        };
        curves.map(lag).collect()
    };
    let mut known = lags(1.0, MIN_PEAK_EXCESS);
    if known.iter().all(Option::is_none) {
        return lags(0.5, 0.0);
    }
    loop {
        let fill = |f: usize| {
            let lags = neighbours[f].iter().filter_map(|&n| known[n as usize]);
            let (sum, count) = lags.fold((0.0, 0), |(sum, n), lag| (sum + lag, n + 1));
            known[f].or((count > 0).then(|| sum / f64::from(count)))
        };
        let filled: Vec<Option<f64>> = (0..known.len()).map(fill).collect();
        if filled == known {
            return known;
        }
        known = filled;
    }
}

/// Returns the throw of a fault from throw, correlation and area of faces. `total_area` is that of all
/// faces.
fn throw_of(faces: &[[f64; 3]], total_area: f64) -> Option<Throw> {
    let areas: Vec<f64> = faces.iter().map(|face| face[2]).collect();
    let correlations: Vec<f64> = faces.iter().map(|face| face[1]).collect();
    let throws: Vec<[f64; 2]> = faces.iter().map(|face| [face[0], face[2]]).collect();
    let [min, median, max] = weighted_quantiles(throws, [0.05, 0.5, 0.95])?;
    Some(Throw {
        min,
        median,
        max,
        correlation: weighted_mean(&correlations, &areas),
        area_share: areas.iter().sum::<f64>() / total_area,
        is_doubtful: min < 0.0 && max > 0.0,
    })
}

/// Returns the throw of a fault by pairs of horizons. `scale` converts samples to the unit of throws.
fn horizon_throw_of(pairs: &PairThrows, areas: &[f64], scale: f64) -> Option<HorizonThrow> {
    let throws = pairs.throws.iter().zip(areas);
    let throws: Vec<[f64; 2]> = throws
        .filter_map(|(throw, area)| Some([scale * (*throw)?, *area]))
        .collect();
    let known_area: f64 = throws.iter().map(|[_, area]| area).sum();
    let [median] = weighted_quantiles(throws, [0.5])?;
    Some(HorizonThrow {
        median,
        pairs: pairs.pairs,
        area_share: known_area / areas.iter().sum::<f64>(),
    })
}

/// Returns the faces that share a ridge with each face.
fn neighbours<const D: usize>(facets: &FacetComplex<'_, D>) -> Vec<Vec<u32>> {
    let of_face = |f: usize| {
        let sides = facets.ridges[f].into_iter();
        sides
            .flat_map(|ridge| facets.sides(ridge as usize))
            .map(|side| side / D as u32)
            .filter(|other| *other as usize != f)
            .collect()
    };
    (0..facets.len()).map(of_face).collect()
}

/// Averages the values of each face with those of its neighbours, several times. `None`
/// does not count. A mean is NaN if more than half of the values are.
fn average_over_neighbours(
    mut values: Vec<Option<Vec<f32>>>,
    neighbours: &[Vec<u32>],
    passes: usize,
) -> Vec<Option<Vec<f32>>> {
    for _ in 0..passes {
        let mean = |f: usize| {
            let others = neighbours[f].iter().map(|&n| &values[n as usize]);
            let present: Vec<&Vec<f32>> = std::iter::once(&values[f])
                .chain(others)
                .flatten()
                .collect();
            let length = present.first()?.len();
            let mean_at = |k: usize| {
                let known = present.iter().map(|v| v[k]).filter(|v| !v.is_nan());
                let (sum, count) = known.fold((0.0, 0), |(sum, n), v| (sum + v, n + 1));
                if 2 * count < present.len() {
                    return f32::NAN;
                }
                sum / count as f32
            };
            Some((0..length).map(mean_at).collect::<Vec<f32>>())
        };
        values = (0..values.len()).into_par_iter().map(mean).collect();
    }
    values
}

/// Returns the mean of values with weights; 0 without any.
fn weighted_mean(values: &[f64], weights: &[f64]) -> f64 {
    let sum: f64 = values.iter().zip(weights).map(|(v, w)| v * w).sum();
    sum / weights.iter().sum::<f64>().max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests;
