//! The map from samples to colours, and colours of lines that are visible on it.

use crate::geometry::statistics::nearest_quantile;

/// Colours for the samples of an image: grey from dark to bright, or blue, white and red for
/// samples that oscillate around zero, as seismic amplitudes do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ColorMap {
    /// Values of the first colour (black or blue) and of the last one (white or red).
    range: [f32; 2],
    /// `true` if the values oscillate around zero.
    is_signed: bool,
    /// `true` if half of the samples are in the lowest 30 % of the range.
    is_dark: bool,
}

/// Maximum number of samples that are used to determine the range.
const MAX_RANGE_SAMPLES: usize = 1 << 18;

impl ColorMap {
    /// Creates a colour map for samples. One sample in 200 is beyond either end of the range.
    pub(crate) fn from_samples(samples: &[f32]) -> Self {
        let stride = Self::stride(samples.len());
        Self::from_selected_samples(samples.iter().step_by(stride).copied().collect())
    }

    /// Returns the stride with which to select samples for
    /// [`from_selected_samples`](Self::from_selected_samples), out of `count` samples.
    pub(crate) fn stride(count: usize) -> usize {
        count.div_ceil(MAX_RANGE_SAMPLES).max(1)
    }

    /// Creates a colour map from selected samples.
    pub(crate) fn from_selected_samples(mut values: Vec<f32>) -> Self {
        values.retain(|v| v.is_finite());
        let mut quantile = |share: f64| nearest_quantile(&mut values, share).unwrap_or(0.0);
        let (low, middle, high) = (quantile(0.005), quantile(0.5), quantile(0.995));
        let max_abs = low.abs().max(high.abs());
        // The values extend about as far below zero as above it, and most are near zero.
        if low < -0.4 * max_abs && high > 0.4 * max_abs && middle.abs() < 0.2 * max_abs {
            return Self {
                range: [-max_abs, max_abs],
                is_signed: true,
                is_dark: false,
            };
        }
        // Labels and masks have so few values that the full range must be used.
        let [low, high] = if high > low {
            [low, high]
        } else {
            [
                quantile(0.0),
                quantile(1.0).max(quantile(0.0) + f32::MIN_POSITIVE),
            ]
        };
        Self {
            range: [low, high],
            is_signed: false,
            is_dark: middle < low + 0.3 * (high - low),
        }
    }

    /// Returns the colour of a sample; NaN is light brown.
    pub(crate) fn color(&self, value: f32) -> [u8; 4] {
        if value.is_nan() {
            return [205, 190, 160, 255];
        }
        let [low, high] = self.range;
        let t = ((value - low) / (high - low)).clamp(0.0, 1.0);
        let mix = |start: [f32; 3], end: [f32; 3], t: f32| {
            let [r, g, b] =
                std::array::from_fn(|k| (start[k] + t * (end[k] - start[k])).round() as u8);
            [r, g, b, 255]
        };
        const WHITE: [f32; 3] = [250.0; 3];
        if self.is_signed && t < 0.5 {
            mix([40.0, 70.0, 170.0], WHITE, 2.0 * t)
        } else if self.is_signed {
            mix(WHITE, [190.0, 40.0, 35.0], 2.0 * t - 1.0)
        } else if self.is_dark {
            // Images of faults and the like have few bright samples on a dark background.
            mix([32.0; 3], [235.0; 3], t)
        } else {
            mix([20.0; 3], WHITE, t)
        }
    }

    /// Returns the values of the first and the last colour.
    pub(crate) fn range(&self) -> [f32; 2] {
        self.range
    }

    /// Returns the colour of the mesh.
    pub(crate) fn mesh_color(&self) -> [u8; 4] {
        if self.is_signed {
            [20, 20, 20, 120]
        } else if self.is_dark {
            [95, 170, 245, 190]
        } else {
            [0, 60, 160, 160]
        }
    }

    /// Returns the colour of faces on horizons.
    pub(crate) fn horizon_color(&self) -> [u8; 4] {
        if self.is_signed {
            [225, 150, 0, 255]
        } else {
            [0, 190, 160, 255]
        }
    }

    /// Returns the colour of faces on other features.
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
        let color_map = ColorMap::from_samples(&seismic);
        assert!(color_map.is_signed);
        assert_eq!(color_map.color(0.0), [250, 250, 250, 255]);
        let ([r, _, b, _], [s, _, c, _]) = (color_map.color(1.0), color_map.color(-1.0));
        assert!(r > b && c > s);

        let grey = ColorMap::from_samples(&(0..1000).map(|i| i as f32).collect::<Vec<_>>());
        assert!(!grey.is_signed && !grey.is_dark);
        let [r, g, b, _] = grey.color(500.0);
        assert!(r == g && g == b && (100..160).contains(&r), "{r}");

        // A mask in which one sample of 4000 is set.
        let mut mask = vec![0.0; 4000];
        mask[7] = 1.0;
        let mask = ColorMap::from_samples(&mask);
        assert!(mask.is_dark && mask.color(1.0) != mask.color(0.0));
        assert_eq!(ColorMap::from_samples(&[]).color(f32::NAN)[3], 255);
    }
}
