//! Converts the image to a texture.

use crate::geometry::grid_index::index_at;
use crate::parallel::prelude::*;
use serde_json::{Value, json};

use super::pack::base64;
use crate::image::Image;
use crate::model::slice::ColorMap;

/// Maximum size of a texture in bytes.
const MAX_TEXTURE_BYTES: usize = 128 * 128 * 128;
/// Maximum length of the longest side of a texture, in 3-D and in 2-D, that every browser can draw.
const MAX_SIDES: [usize; 2] = [256, 2048];

/// Image as bytes, x fastest.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Texture {
    /// Number of bytes along each axis. In 2-D it is 1 along z.
    pub dims: [usize; 3],
    pub bytes: Vec<u8>,
    /// Description of the texture for the page.
    pub metadata: Value,
}

/// Converts an image. Where there are more samples than bytes, each byte is the mean of a block of
/// samples.
pub(super) fn from_image<const D: usize>(image: &Image<D>) -> Texture {
    let dims = image.dims();
    let image_dims: [usize; 3] = std::array::from_fn(|k| dims.get(k).copied().unwrap_or(1));
    let texture_dims = fitted_dims(image_dims, if D == 2 { MAX_SIDES[1] } else { MAX_SIDES[0] });
    let samples = image.as_slice();
    let color_map = ColorMap::from_samples(samples);
    let [low, high] = color_map.range();
    let block = |k: usize, i: usize| {
        let first = i * image_dims[k] / texture_dims[k];
        first..((i + 1) * image_dims[k] / texture_dims[k]).max(first + 1)
    };
    let byte = |index: usize| {
        let [x, y, z] = index_at(texture_dims, index);
        let (mut sum, mut count) = (0.0f64, 0u32);
        for k in block(2, z) {
            for j in block(1, y) {
                let row = (k * image_dims[1] + j) * image_dims[0];
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
    let bytes = (0..texture_dims.iter().product())
        .into_par_iter()
        .map(byte)
        .collect();
    let colors: Vec<u8> = (0..=255u8)
        .flat_map(|byte| {
            let [r, g, b, _] = color_map.color(low + (high - low) * f32::from(byte) / 255.0);
            [r, g, b]
        })
        .collect();
    Texture {
        dims: texture_dims,
        bytes,
        metadata: json!({
            "dims": texture_dims,
            "samples": image_dims,
            "low": low,
            "high": high,
            "colors": base64(&colors),
            "line": color_map.mesh_color(),
        }),
    }
}

/// Returns the number of bytes along each axis. It is at most the number of samples and at most
/// `max_side`, and all bytes are at most [`MAX_TEXTURE_BYTES`]. The longest side is reduced first.
fn fitted_dims(samples: [usize; 3], max_side: usize) -> [usize; 3] {
    let mut dims = samples.map(|n| n.min(max_side));
    while dims.iter().product::<usize>() > MAX_TEXTURE_BYTES {
        let longest_axis = (0..3).fold(
            0,
            |longest, k| if dims[k] > dims[longest] { k } else { longest },
        );
        dims[longest_axis] -= 1;
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
        // There are twice as many samples as bytes along x.
        let samples: Vec<f32> = (0..4096 * 2).map(|i| (i % 4096) as f32).collect();
        let texture = from_image(&Image::new([4096, 2], samples, Geometry::default()));
        assert_eq!(texture.dims, [2048, 2, 1]);
        let (first, last) = (texture.bytes[0], texture.bytes[2047]);
        assert!(first == 0 && last == 255, "{first} {last}");
        let middle = texture.bytes[1024];
        assert!((127..=128).contains(&middle), "{middle}");
    }
}
