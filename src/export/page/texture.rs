//! The image as a texture.

use crate::parallel::prelude::*;
use serde_json::{Value, json};

use super::pack::base64;
use crate::image::Image;
use crate::model::slice::ColorMap;

/// The largest texture, in bytes.
const MAX_TEXTURE_BYTES: usize = 128 * 128 * 128;
/// The longest side of a texture in space, and in the plane, that every browser can draw.
const MAX_SIDES: [usize; 2] = [256, 2048];

/// An image as bytes, x fastest.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Texture {
    /// Number of bytes along each axis; 1 along z in the plane.
    pub dims: [usize; 3],
    pub bytes: Vec<u8>,
    /// What the page needs to know of it.
    pub metadata: Value,
}

/// The image, each byte the mean of a block of samples where there are more samples than bytes.
pub(super) fn from_image<const D: usize>(image: &Image<D>) -> Texture {
    let dims = image.dims();
    let from: [usize; 3] = std::array::from_fn(|k| dims.get(k).copied().unwrap_or(1));
    let to = fitted_dims(from, if D == 2 { MAX_SIDES[1] } else { MAX_SIDES[0] });
    let samples = image.as_slice();
    let shades = ColorMap::from_samples(samples);
    let [low, high] = shades.range();
    let block = |k: usize, i: usize| {
        let first = i * from[k] / to[k];
        first..((i + 1) * from[k] / to[k]).max(first + 1)
    };
    let byte = |at: usize| {
        let [x, y, z] = [at % to[0], at / to[0] % to[1], at / (to[0] * to[1])];
        let (mut sum, mut count) = (0.0f64, 0u32);
        for k in block(2, z) {
            for j in block(1, y) {
                let row = (k * from[1] + j) * from[0];
                for i in block(0, x) {
                    let sample = samples[row + i];
                    if sample.is_finite() {
                        sum += f64::from(sample);
                        count += 1;
                    }
                }
            }
        }
        let mean = (sum / f64::from(count.max(1))) as f32;
        (255.0 * (mean - low) / (high - low))
            .clamp(0.0, 255.0)
            .round() as u8
    };
    let bytes = (0..to.iter().product()).into_par_iter().map(byte).collect();
    let colors: Vec<u8> = (0..=255u8)
        .flat_map(|byte| {
            let [r, g, b, _] = shades.color(low + (high - low) * f32::from(byte) / 255.0);
            [r, g, b]
        })
        .collect();
    Texture {
        dims: to,
        bytes,
        metadata: json!({
            "dims": to,
            "samples": from,
            "low": low,
            "high": high,
            "colors": base64(&colors),
            "line": shades.mesh_color(),
        }),
    }
}

/// As many bytes along each axis as there are samples, or fewer: no side is longer than `longest`, and
/// all make [`MAX_PAGE_BYTES`] at most. The longest side gives way first.
fn fitted_dims(samples: [usize; 3], longest: usize) -> [usize; 3] {
    let mut dims = samples.map(|n| n.min(longest));
    while dims.iter().product::<usize>() > MAX_TEXTURE_BYTES {
        let most = (0..3).fold(0, |most, k| if dims[k] > dims[most] { k } else { most });
        dims[most] -= 1;
    }
    dims
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Geometry;

    #[test]
    fn textures_are_small_enough_and_keep_what_fits() {
        assert_eq!(fitted_dims([100, 90, 80], 256), [100, 90, 80]);
        assert_eq!(fitted_dims([600, 300, 1], 2048), [600, 300, 1]);
        for samples in [[1000, 900, 800], [3000, 20, 20], [5000, 4000, 1]] {
            let [x, y, z] = fitted_dims(samples, if samples[2] == 1 { 2048 } else { 256 });
            assert!(
                x * y * z <= MAX_TEXTURE_BYTES && x * y * z > MAX_TEXTURE_BYTES / 21,
                "{x} {y} {z}"
            );
        }
        assert_eq!(fitted_dims([1000, 900, 800], 256), [128; 3]);
    }

    #[test]
    fn bytes_are_means_of_blocks() {
        // Twice as many samples as bytes along x.
        let samples: Vec<f32> = (0..4096 * 2).map(|i| (i % 4096) as f32).collect();
        let texture = from_image(&Image::new([4096, 2], samples, Geometry::default()));
        assert_eq!(texture.dims, [2048, 2, 1]);
        let (first, last) = (texture.bytes[0], texture.bytes[2047]);
        assert!(first == 0 && last == 255, "{first} {last}");
        let middle = texture.bytes[1024];
        assert!((127..=128).contains(&middle), "{middle}");
    }
}
