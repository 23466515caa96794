//! From samples to colours, and colours that stand out from them.

/// How the samples of an image are coloured: grey from dark to bright or, where they swing about
/// zero as seismic amplitudes do, blue, white and red.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ColorMap {
    /// The values that are black (or blue) and white (or red).
    range: [f32; 2],
    /// About zero.
    is_signed: bool,
    /// Half of the image is darker than a quarter of the greys.
    is_dark: bool,
}

/// At most this many samples are looked at for the range.
const MAX_RANGE_SAMPLES: usize = 1 << 18;

impl ColorMap {
    /// Chosen so that one sample in 200 is beyond either end.
    pub(crate) fn from_samples(samples: &[f32]) -> Self {
        let stride = Self::stride(samples.len());
        Self::from_selected_samples(samples.iter().step_by(stride).copied().collect())
    }

    /// Of so many samples, those are looked at whose number is a multiple of this.
    pub(crate) fn stride(count: usize) -> usize {
        count.div_ceil(MAX_RANGE_SAMPLES).max(1)
    }

    /// From those of the samples that are looked at.
    pub(crate) fn from_selected_samples(mut values: Vec<f32>) -> Self {
        values.retain(|v| v.is_finite());
        values.sort_unstable_by(f32::total_cmp);
        let rank = |share: f64| {
            let at = share * values.len().saturating_sub(1) as f64;
            values.get(at.round() as usize).copied().unwrap_or(0.0)
        };
        let (low, middle, high) = (rank(0.005), rank(0.5), rank(0.995));
        let largest = low.abs().max(high.abs());
        // As far below zero as above it, and mostly near it.
        if low < -0.4 * largest && high > 0.4 * largest && middle.abs() < 0.2 * largest {
            return Self {
                range: [-largest, largest],
                is_signed: true,
                is_dark: false,
            };
        }
        // Labels and masks have few values: all of them count.
        let [low, high] = match high > low {
            true => [low, high],
            false => [rank(0.0), rank(1.0).max(rank(0.0) + f32::MIN_POSITIVE)],
        };
        Self {
            range: [low, high],
            is_signed: false,
            is_dark: middle < low + 0.3 * (high - low),
        }
    }

    /// The colour of a sample; NaN is light brown.
    pub(crate) fn color(&self, value: f32) -> [u8; 4] {
        if value.is_nan() {
            return [205, 190, 160, 255];
        }
        let [low, high] = self.range;
        let t = ((value - low) / (high - low)).clamp(0.0, 1.0);
        let mix = |from: [f32; 3], to: [f32; 3], t: f32| {
            let [r, g, b] =
                std::array::from_fn(|k| (from[k] + t * (to[k] - from[k])).round() as u8);
            [r, g, b, 255]
        };
        const WHITE: [f32; 3] = [250.0; 3];
        if self.is_signed && t < 0.5 {
            mix([40.0, 70.0, 170.0], WHITE, 2.0 * t)
        } else if self.is_signed {
            mix(WHITE, [190.0, 40.0, 35.0], 2.0 * t - 1.0)
        } else if self.is_dark {
            // Faults and the like: few bright samples on a dark ground.
            mix([32.0; 3], [235.0; 3], t)
        } else {
            mix([20.0; 3], WHITE, t)
        }
    }

    /// The values with the first and the last colour.
    pub(crate) fn range(&self) -> [f32; 2] {
        self.range
    }

    /// The colour of the mesh.
    pub(crate) fn mesh_color(&self) -> [u8; 4] {
        if self.is_signed {
            [20, 20, 20, 120]
        } else if self.is_dark {
            [95, 170, 245, 190]
        } else {
            [0, 60, 160, 160]
        }
    }

    /// The colour of its faces on horizons.
    pub(crate) fn horizon_color(&self) -> [u8; 4] {
        if self.is_signed {
            [225, 150, 0, 255]
        } else {
            [0, 190, 160, 255]
        }
    }

    /// The colour of its faces on other features.
    pub(crate) fn feature_color(&self) -> [u8; 4] {
        if self.is_signed {
            [0, 135, 60, 255]
        } else {
            [255, 120, 0, 255]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amplitudes_are_white_at_zero_and_others_are_grey() {
        let seismic: Vec<f32> = (0..1000).map(|i| (i as f32 * 0.37).sin()).collect();
        let shades = ColorMap::from_samples(&seismic);
        assert!(shades.is_signed);
        assert_eq!(shades.color(0.0), [250, 250, 250, 255]);
        let ([r, _, b, _], [s, _, c, _]) = (shades.color(1.0), shades.color(-1.0));
        assert!(r > b && c > s);

        let grey = ColorMap::from_samples(&(0..1000).map(|i| i as f32).collect::<Vec<_>>());
        assert!(!grey.is_signed && !grey.is_dark);
        let [r, g, b, _] = grey.color(500.0);
        assert!(r == g && g == b && (100..160).contains(&r), "{r}");

        // A mask: one sample in a thousand is set.
        let mut mask = vec![0.0; 4000];
        mask[7] = 1.0;
        let mask = ColorMap::from_samples(&mask);
        assert!(mask.is_dark && mask.color(1.0) != mask.color(0.0));
        assert_eq!(ColorMap::from_samples(&[]).color(f32::NAN)[3], 255);
    }
}
