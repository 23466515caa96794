//! Horizons: crests and troughs of seismic amplitude.
//!
//! Along a layer the amplitude hardly changes, so that the crest of a layer is an extremum along
//! any direction across it. Each column of samples along the image axis nearest to the layer's
//! normal crosses the crest once, at the maximum of the parabola through three samples. The normal
//! is the eigenvector of the structure tensor's largest eigenvalue ([`NormalField`]), as for the
//! ridges of Hale (2002).
//!
//! Scale: one sample for derivatives, four for the tensor's window. Thresholds are multiples of the
//! root mean square amplitude. Assumptions: layers are about four samples thick or more and dip
//! little within the window; the mean amplitude is zero.

use super::{Detector, DetectorInput, DetectorOutput, Thresholds};
use crate::error::Result;
use crate::feature::FeatureKind;
use crate::feature::candidate::{Candidate, Voxel, dominant_axes};
use crate::feature::structure_tensor::NormalField;
use crate::feature::volume::Volume;
use crate::feature::windows::{CoveredLayers, LayerWindow};
use crate::progress::CancelToken;

/// Detector of crests and troughs of seismic amplitude.
pub struct Horizons;

/// Width (samples) of the structure tensor's window.
const TENSOR_WINDOW: f64 = 4.0;

/// Width (samples) from which parts of horizons are kept, whatever the distance between atoms.
const MAX_MIN_WIDTH: usize = 12;

impl<const D: usize> Detector<D> for Horizons {
    fn kind(&self) -> FeatureKind {
        FeatureKind::Horizons
    }

    fn find(
        &self,
        input: &DetectorInput<'_, D>,
        notes: &mut Vec<String>,
    ) -> Result<DetectorOutput<D>> {
        let scale = input.scale();
        let window = input.options.smoothing.unwrap_or(TENSOR_WINDOW);
        let samples = input.smoothed_in_layers()?;
        let (normals, rms) = NormalField::new(&samples, window, input.live_mask, input.cancel)?;
        let thresholds = input.thresholds().unwrap_or(Thresholds {
            low: 0.8 * rms.smoothed,
            high: 1.3 * rms.smoothed,
            origin: "1.3 times the rms amplitude",
        });
        notes.push(format!(
            "horizons: crests and troughs along layers, smoothed over {scale} samples, their dips over {window}; \
             {thresholds}"
        ));
        let (mut candidates, mut layers) = (Vec::new(), CoveredLayers::default());
        let mut collect = |window: &LayerWindow<'_, D>| {
            layers.add(&window.interior);
            candidates.extend(crests(window, &normals, thresholds.low, input.cancel));
        };
        let cancel = input.cancel;
        samples.for_each_window(1, None, &|_| 1, cancel, &mut collect, &mut |()| ())?;
        let mut output = DetectorOutput {
            layers: Some(layers.0),
            ..DetectorOutput::new(candidates, scale, thresholds)
        };
        let keep_chaos = input.options.keep_chaos;
        output.drop_chaotic(
            normals.chaotic_zones(),
            FeatureKind::Horizons,
            keep_chaos,
            notes,
        );
        Ok(output)
    }

    fn is_streamable(&self) -> bool {
        true
    }

    fn is_horizon(&self) -> bool {
        true
    }

    /// Returns a large area: short pieces of reflectors are everywhere, and the mesh need not
    /// follow them.
    fn min_surface_cells(&self) -> f64 {
        if D == 3 { 16.0 } else { 8.0 }
    }

    /// Returns three times the smallest distance between atoms, within limits. The amplitude of
    /// reflectors exceeds the threshold in narrow strips and patches that a lattice cannot follow.
    fn min_width(&self, d_min: f64) -> usize {
        ((3.0 * d_min).round() as usize).clamp(4, MAX_MIN_WIDTH)
    }

    /// Returns a large distance: reflectors lie one above the other, and a layer of atoms must fit
    /// between them.
    fn resolution(&self) -> f64 {
        1.5
    }

    /// Returns the reach of normals averaged over windows of four samples, and of the smallest
    /// width.
    fn reach(&self, _scale: f64) -> usize {
        14 + MAX_MIN_WIDTH
    }
}

/// Returns the crests and troughs of at least `low` in amplitude in the interior of a window, in
/// the order of samples.
fn crests<const D: usize>(
    window: &LayerWindow<'_, D>,
    normals: &NormalField<D>,
    low: f32,
    cancel: &CancelToken<'_>,
) -> Vec<Candidate<D>> {
    let (stack, image_volume) = (window.smoothed, Volume::new(window.dims, &[]));
    let volume = stack.volume;
    let strides = volume.strides();
    window.map_rows(cancel, |first, (): &mut (), found| {
        let start = volume.index(first);
        for x in 0..volume.dims[0] {
            let i = start + x;
            let amplitude = volume.samples[i].abs();
            if amplitude < low {
                continue;
            }
            let mut at = stack.to_volume(first);
            at[0] = x;
            let sign = volume.samples[i].signum();
            for axis in dominant_axes(normals.cell_normal(at).map(f64::from)) {
                if at[axis] == 0 || at[axis] + 1 >= image_volume.dims[axis] {
                    continue;
                }
                let before = sign * volume.samples[i - strides[axis]];
                let after = sign * volume.samples[i + strides[axis]];
                // Of two equal samples, the first counts.
                if before >= amplitude || after > amplitude {
                    continue;
                }
                let offset = 0.5 * (before - after) / (before + after - 2.0 * amplitude);
                let mut position = at.map(|i| i as f32);
                position[axis] += offset;
                found.push(Candidate {
                    voxel: Voxel::new(image_volume.dims, at),
                    axis: axis as u8,
                    position,
                    normal: normals.normal_at(position),
                    strength: amplitude - 0.25 * (before - after) * offset,
                });
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use crate::feature::scenes::{ExactSurface, Noise, image_of};
    use crate::feature::{DetectionOptions, FeatureKind, detect};

    #[test]
    fn horizons_keep_the_lattice_resolution() {
        // Crests and troughs are 6 samples apart across dipping layers. Every second one fits d =
        // 8, which leaves room for a layer of atoms between.
        let dims = [72, 64, 56];
        let layers = ExactSurface::plane([1.0, 0.25, -0.15], [36.0, 32.0, 28.0]);
        let mut noise = Noise::new(5);
        let image = image_of(dims, |p| {
            let s = layers.distance(p);
            let strength = if (s / 12.0).round() as i64 == 0 {
                1.5
            } else {
                1.0
            };
            strength * (std::f64::consts::TAU * s / 12.0).cos() + 0.1 * noise.normal()
        });
        let features =
            detect(&image, &DetectionOptions::with_kind(FeatureKind::Auto, 8.0)).unwrap();
        assert!(
            features.notes[0].contains("horizons"),
            "{:?}",
            features.notes
        );
        assert!(features.points.len() > 5000);
        // Level n is the extremum at s = 6 n.
        let mut levels = [0usize; 41];
        let (mut squares, mut count) = (0.0, 0.0);
        for point in &features.points {
            let p = point.position.map(f64::from);
            if (0..3).all(|k| p[k] > 4.0 && p[k] < dims[k] as f64 - 5.0) {
                let level = (layers.distance(p) / 6.0).round();
                squares += (layers.distance(p) - 6.0 * level).powi(2);
                count += 1.0;
                levels[(level + 20.0) as usize] += 1;
            }
        }
        let rms = f64::sqrt(squares / count);
        assert!(rms < 0.3, "{rms}");
        assert!(levels[20] > 2400, "the strongest is kept whole: {levels:?}");
        for pair in levels.windows(2) {
            let (smaller, larger) = (pair[0].min(pair[1]), pair[0].max(pair[1]));
            assert!(
                smaller * 10 <= larger,
                "two levels nearer than 7.2: {levels:?}"
            );
        }
    }
}
