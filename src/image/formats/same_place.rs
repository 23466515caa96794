//! Compares the positions of two images that have as many samples, and orders the samples of the one as
//! those of the other.

use std::path::Path;

use super::stream::{AnyHeader, ImageHeader};
use super::{AnyImage, LoadedImage};
use crate::error::{Error, Result, cause};
use crate::geometry::grid_index::{index_at, offset_of};
use crate::image::placing::ranges;
use crate::image::{Geometry, Image, Modality};
use crate::units;

/// Largest distance, in samples, between positions that are the same except for rounding.
pub(crate) const ROUNDING: f64 = 1e-3;

/// The place of the samples of an image relative to those of another one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum RelativePlace<const D: usize> {
    /// At least one of the images has no position, or their coordinates cannot be compared.
    Unknown,
    /// The samples are the same, in reverse order along the axes that are `true`.
    Same([bool; D]),
    /// The samples lie elsewhere.
    Elsewhere,
}

/// Returns `true` if a geometry is a position. The samples of a bare array are only numbered.
pub(crate) fn is_placed<const D: usize>(geometry: &Geometry<D>) -> bool {
    let array = Geometry::<D>::default();
    let is_array = geometry.origin == array.origin && geometry.axes == array.axes;
    !is_array && geometry.determinant() != 0.0
}

/// Returns the factors that convert coordinates of `from` to the units of `to`. A coordinate without a
/// known unit is in the unit of the other geometry. Returns `None` if the coordinates cannot be
/// compared: one geometry is no position, or has numbers of lines, or time where the other has a
/// length.
pub(crate) fn unit_factors<const D: usize>(
    from: &Geometry<D>,
    to: &Geometry<D>,
) -> Option<[f64; D]> {
    let has_line_numbers =
        |g: &Geometry<D>| g.units[0].is_empty() && g.modality() == Modality::Survey;
    if !is_placed(from) || !is_placed(to) || has_line_numbers(from) != has_line_numbers(to) {
        return None;
    }
    let mut factors = [1.0; D];
    for (c, factor) in factors.iter_mut().enumerate() {
        let (Some(own), Some(other)) = (units::find(&from.units[c]), units::find(&to.units[c]))
        else {
            continue;
        };
        if own.quantity != other.quantity {
            return None;
        }
        *factor = own.size / other.size;
    }
    Some(factors)
}

/// Returns the place of an image with the geometry `other` relative to one with `geometry`. Both have
/// `dims` samples. Positions at most `tolerance` samples apart are the same. In 3-D, the sign of z may
/// differ.
pub(crate) fn relative_place<const D: usize>(
    geometry: &Geometry<D>,
    other: &Geometry<D>,
    dims: [usize; D],
    tolerance: f64,
) -> RelativePlace<D> {
    let Some(factors) = unit_factors(geometry, other) else {
        return RelativePlace::Unknown;
    };
    let signs: &[f64] = if D == 3 { &[1.0, -1.0] } else { &[1.0] };
    for sign in signs {
        let index_of = |index: [f64; D]| {
            let mut position = geometry.to_physical(index);
            for (value, factor) in position.iter_mut().zip(factors) {
                *value *= factor;
            }
            position[D - 1] *= sign;
            other.to_index(position)
        };
        if let Some(is_reversed) = reversed_axes(index_of, dims, tolerance) {
            return RelativePlace::Same(is_reversed);
        }
    }
    RelativePlace::Elsewhere
}

/// Returns the axes along which an affine map between the samples of two images of `dims` samples
/// reverses their order; `None` if the map changes more than that.
fn reversed_axes<const D: usize>(
    index_of: impl Fn([f64; D]) -> Option<[f64; D]>,
    dims: [usize; D],
    tolerance: f64,
) -> Option<[bool; D]> {
    let last = dims.map(|n| n.max(1) as f64 - 1.0);
    let first = index_of([0.0; D])?;
    let is_reversed: [bool; D] =
        std::array::from_fn(|k| dims[k] > 1 && (first[k] - last[k]).abs() <= tolerance);
    let is_mapped = |corner: [f64; D]| {
        index_of(corner).is_some_and(|found| {
            (0..D).all(|k| {
                let expected = if is_reversed[k] {
                    last[k] - corner[k]
                } else {
                    corner[k]
                };
                dims[k] == 1 || (found[k] - expected).abs() <= tolerance
            })
        })
    };
    corners(dims).all(is_mapped).then_some(is_reversed)
}

/// Returns the indices of the corners of an image.
fn corners<const D: usize>(dims: [usize; D]) -> impl Iterator<Item = [f64; D]> {
    (0..1usize << D).map(move |corner| {
        std::array::from_fn(|k| {
            if (corner >> k) & 1 == 1 {
                dims[k].max(1) as f64 - 1.0
            } else {
                0.0
            }
        })
    })
}

/// Returns an image with its samples in reverse order along the axes that are `true`.
pub(crate) fn reversed<const D: usize>(image: Image<D>, is_reversed: [bool; D]) -> Image<D> {
    if !is_reversed.contains(&true) {
        return image;
    }
    let dims = image.dims();
    let samples = image.as_slice();
    let sample = |offset: usize| {
        let index = index_at(dims, offset);
        let source = std::array::from_fn(|k| {
            if is_reversed[k] {
                dims[k] - 1 - index[k]
            } else {
                index[k]
            }
        });
        samples[offset_of(dims, source)]
    };
    let reversed = (0..samples.len()).map(sample).collect();
    Image::new(dims, reversed, image.geometry.clone())
}

/// Returns the ranges of the coordinates of an image, for messages.
pub(crate) fn extent_text<const D: usize>(geometry: &Geometry<D>, dims: [usize; D]) -> String {
    let positions = corners(dims).map(|corner| geometry.to_physical(corner));
    ranges(positions, &geometry.units)
}

/// Largest distance, in samples, between the samples of an image and those of its mask, so that the
/// nearest samples are those of the same index, and a rounded position is no other one.
const MAX_MASK_OFFSET: f64 = 0.1;

/// Returns a mask whose samples have the order of those of the image at `place`: that of the first of
/// `headers` with as many samples. A mask without a position, or in coordinates that cannot be compared,
/// stays as it is. `file` is the file of the mask, and `option` gives it.
///
/// # Errors
/// Returns [`Error::Image`] for a mask with as many samples that lie elsewhere.
pub(super) fn in_place_of(
    headers: &[&AnyHeader],
    mask: AnyImage,
    place: &Path,
    file: &Path,
    option: &'static str,
) -> Result<AnyImage> {
    fn ordered<const D: usize>(
        header: &ImageHeader<D>,
        mut loaded: LoadedImage<D>,
        refuse: impl Fn([String; 2]) -> Error,
    ) -> Result<LoadedImage<D>> {
        let dims = header.dims;
        let geometry = &loaded.image.geometry;
        match relative_place(&header.geometry, geometry, dims, MAX_MASK_OFFSET) {
            RelativePlace::Unknown => {}
            RelativePlace::Same(is_reversed) => loaded.image = reversed(loaded.image, is_reversed),
            RelativePlace::Elsewhere => {
                let extents = [geometry, &header.geometry].map(|g| extent_text(g, dims));
                return Err(refuse(extents));
            }
        }
        Ok(loaded)
    }
    let refuse = |[own, other]: [String; 2]| {
        let problem = format!("lies at {own}, but {} at {other}", place.display());
        let remedy = "give one in the place of the image, or without a position, such as .npy, with its samples";
        Error::Image(cause(file.display(), problem, remedy).with_parameter(option))
    };
    match mask {
        AnyImage::Plane(loaded) => {
            let dims = loaded.image.dims();
            let header = headers.iter().find_map(|header| match header {
                AnyHeader::Plane(header) if header.dims == dims => Some(header),
                _ => None,
            });
            match header {
                Some(header) => ordered(header, loaded, refuse).map(AnyImage::Plane),
                None => Ok(AnyImage::Plane(loaded)),
            }
        }
        AnyImage::Space(loaded) => {
            let dims = loaded.image.dims();
            let header = headers.iter().find_map(|header| match header {
                AnyHeader::Space(header) if header.dims == dims => Some(header),
                _ => None,
            });
            match header {
                Some(header) => ordered(header, loaded, refuse).map(AnyImage::Space),
                None => Ok(AnyImage::Space(loaded)),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_compared_in_one_unit_and_with_reversed_axes() {
        let dims = [4, 5, 6];
        let geometry = |origin: [f64; 3], spacing: [f64; 3], unit: &str| {
            let mut geometry = Geometry::with_spacing(origin, spacing);
            geometry.units = std::array::from_fn(|_| unit.to_string());
            geometry
        };
        let metres = geometry([100.0, 0.0, -2000.0], [25.0, 25.0, 20.0], "m");
        let place = |other: &Geometry<3>| relative_place(&metres, other, dims, ROUNDING);
        let same = RelativePlace::Same([false; 3]);
        assert_eq!(place(&metres), same);
        let kilometres = geometry([0.1, 0.0, -2.0], [0.025, 0.025, 0.02], "km");
        assert_eq!(place(&kilometres), same);
        // The sign of z differs, so that the samples are in reverse order.
        let depth = geometry([100.0, 0.0, 1900.0], [25.0, 25.0, 20.0], "");
        assert_eq!(place(&depth), RelativePlace::Same([false, false, true]));
        let turned = geometry([100.0, 100.0, -2000.0], [25.0, -25.0, 20.0], "m");
        assert_eq!(place(&turned), RelativePlace::Same([false, true, false]));
        let moved = geometry([100.0, 10.0, -2000.0], [25.0, 25.0, 20.0], "m");
        assert_eq!(place(&moved), RelativePlace::Elsewhere);
        assert_eq!(place(&Geometry::default()), RelativePlace::Unknown);
        let time = geometry([100.0, 0.0, -2000.0], [25.0, 25.0, 20.0], "ms");
        assert_eq!(place(&time), RelativePlace::Unknown);
        assert_eq!(
            extent_text(&metres, dims),
            "x 100 to 175 m, y 0 to 100 m, z -2000 to -1900 m"
        );
    }

    #[test]
    fn samples_are_reversed_along_an_axis() {
        let image = Image::new([2, 2], vec![1.0, 2.0, 3.0, 4.0], Geometry::default());
        let flipped = reversed(image.clone(), [false, true]);
        assert_eq!(flipped.as_slice(), [3.0, 4.0, 1.0, 2.0]);
        assert_eq!(reversed(image.clone(), [false; 2]), image);
    }
}
