//! Maps sample indices to physical coordinates.

use serde::Serialize;

use super::modality::Modality;
use super::time::{metres_per_unit, seconds_per_unit};
use crate::geometry::{dot, hypot, norm, unit};

/// Reason why the physical coordinates of an image cannot be compared, so that angles in physical
/// space have no meaning.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NoAngles {
    /// A coordinate is time, in this unit.
    Time(String),
    /// The coordinates are numbers of lines and samples.
    LineNumbers,
    /// The coordinates differ in their units, of which at least one is not known.
    UnknownUnits,
}

impl std::fmt::Display for NoAngles {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Time(unit) => write!(f, "one coordinate is time ({unit})"),
            Self::LineNumbers => write!(f, "coordinates are numbers of lines"),
            Self::UnknownUnits => write!(f, "units of coordinates differ or are not known"),
        }
    }
}

/// Affine map from sample indices (x first) to physical coordinates: `origin + sum_k index[k] *
/// axes[k]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Geometry<const D: usize> {
    /// Physical position of sample `[0, 0, ..]`.
    pub origin: [f64; D],
    /// `axes[k]` is the physical step from one sample to the next along axis `k` (x first).
    pub axes: [[f64; D]; D],
    /// Name of each *image axis*, e.g. `["sample", "crossline", "inline"]`.
    pub names: [String; D],
    /// Unit of each *physical coordinate*, e.g. `["m", "m", "ms"]`; empty if unknown.
    pub units: [String; D],
}

impl<const D: usize> Default for Geometry<D> {
    /// Returns the geometry with unit spacing and origin zero: physical coordinates are sample
    /// indices.
    fn default() -> Self {
        let names = ["x", "y", "z"];
        Self {
            origin: [0.0; D],
            axes: std::array::from_fn(|k| std::array::from_fn(|c| f64::from(u8::from(k == c)))),
            names: std::array::from_fn(|k| names.get(k).copied().unwrap_or("w").to_string()),
            units: std::array::from_fn(|_| String::new()),
        }
    }
}

/// Returns the whole number that a ratio of two units is but for rounding, or else the ratio.
fn without_rounding(ratio: f64) -> f64 {
    let whole = ratio.round();
    if (ratio - whole).abs() < 1e-9 * ratio {
        whole
    } else {
        ratio
    }
}

impl<const D: usize> Geometry<D> {
    /// Creates an axis-aligned geometry with the given spacing.
    pub fn with_spacing(origin: [f64; D], spacing: [f64; D]) -> Self {
        let mut geometry = Self {
            origin,
            ..Self::default()
        };
        for k in 0..D {
            geometry.axes[k][k] = spacing[k];
        }
        geometry
    }

    /// Returns the distance between neighbouring samples along each axis.
    pub fn spacing(&self) -> [f64; D] {
        self.axes.map(norm)
    }

    /// Returns the geometry with all coordinates in the unit of the first, if all units are known lengths.
    #[must_use]
    pub(crate) fn in_one_length_unit(mut self) -> Self {
        let sizes = self.units.each_ref().map(|unit| metres_per_unit(unit));
        let Some(unit_size) = sizes[0].filter(|_| !sizes.contains(&None)) else {
            return self;
        };
        for c in 1..D {
            let factor = sizes[c].unwrap_or(unit_size) / unit_size;
            let scale = |value: f64| {
                if factor < 1.0 {
                    value / without_rounding(1.0 / factor)
                } else {
                    value * without_rounding(factor)
                }
            };
            self.origin[c] = scale(self.origin[c]);
            for axis in &mut self.axes {
                axis[c] = scale(axis[c]);
            }
            self.units[c] = self.units[0].clone();
        }
        self
    }

    /// Returns the factor of each physical coordinate that brings all of them to one unit, so that
    /// angles have a meaning. The factors are 1 if all coordinates have the same unit, or none.
    ///
    /// # Errors
    /// Returns the reason why the coordinates cannot be compared.
    pub fn length_scales(&self) -> Result<[f64; D], NoAngles> {
        if let Some(time) = self.time_coordinate() {
            return Err(NoAngles::Time(self.units[time].clone()));
        }
        if self.units.iter().all(|unit| *unit == self.units[0]) {
            // Coordinates without a unit beside the names of lines are numbers of lines.
            let are_lines = self.units[0].is_empty() && self.modality() == Modality::Survey;
            return if are_lines {
                Err(NoAngles::LineNumbers)
            } else {
                Ok([1.0; D])
            };
        }
        let sizes = self.units.each_ref().map(|unit| metres_per_unit(unit));
        if sizes.contains(&None) {
            return Err(NoAngles::UnknownUnits);
        }
        Ok(sizes.map(Option::unwrap_or_default))
    }

    /// Returns the geometry with all coordinates in one unit, so that its angles are those of space.
    ///
    /// # Errors
    /// Returns the errors of [`length_scales`](Self::length_scales).
    pub fn in_one_unit(&self) -> Result<Self, NoAngles> {
        let scales = self.length_scales()?;
        let scaled = |p: [f64; D]| std::array::from_fn(|c| p[c] * scales[c]);
        Ok(Self {
            origin: scaled(self.origin),
            axes: self.axes.map(scaled),
            ..self.clone()
        })
    }

    /// Returns the physical coordinates of a (fractional) sample index.
    pub fn to_physical(&self, index: [f64; D]) -> [f64; D] {
        let mut p = self.origin;
        for k in 0..D {
            for c in 0..D {
                p[c] += index[k] * self.axes[k][c];
            }
        }
        p
    }

    /// Returns `true` if physical space is similar to the space in which samples are `step` apart
    /// along each axis: all angles are the same in both, to a relative tolerance of 1e-6.
    pub fn preserves_shapes(&self, step: [f64; D]) -> bool {
        let unit = |k: usize| self.axes[k].map(|a| a / step[k]);
        let product =
            |k: usize, l: usize| -> f64 { unit(k).iter().zip(unit(l)).map(|(a, b)| a * b).sum() };
        let size = product(0, 0);
        (0..D).all(|k| {
            (0..=k).all(|l| {
                let expected = if k == l { size } else { 0.0 };
                (product(k, l) - expected).abs() <= 1e-6 * size
            })
        })
    }

    /// Returns the (fractional) sample index of a physical position: the inverse of
    /// [`Geometry::to_physical`]. Returns `None` if the axes do not span the space.
    pub fn to_index(&self, position: [f64; D]) -> Option<[f64; D]> {
        let mut offset = position;
        for c in 0..D {
            offset[c] -= self.origin[c];
        }
        let (_, index) = self.eliminate(offset);
        index
    }

    /// Returns the signed physical volume (area in 2-D) of one cell. It is negative if the image
    /// axes are left-handed in physical space, and zero if they do not span it.
    pub fn determinant(&self) -> f64 {
        self.eliminate([0.0; D]).0
    }

    /// Solves `sum_k x[k] axes[k] = rhs` by Gaussian elimination with partial pivoting. Returns the
    /// determinant, and `x` unless the determinant is zero.
    fn eliminate(&self, rhs: [f64; D]) -> (f64, Option<[f64; D]>) {
        // Row c, column k is `axes[k][c]`.
        let mut matrix: [[f64; D]; D] =
            std::array::from_fn(|c| std::array::from_fn(|k| self.axes[k][c]));
        let is_diagonal = (0..D).all(|c| (0..D).all(|k| c == k || matrix[c][k] == 0.0));
        let determinant = (0..D).fold(1.0, |product, k| product * matrix[k][k]);
        if is_diagonal && determinant != 0.0 && determinant.is_finite() {
            // The elimination below would give the same result.
            let x = std::array::from_fn(|k| rhs[k] / matrix[k][k]);
            return (determinant, Some(x));
        }
        let mut x = rhs;
        let mut determinant = 1.0;
        for k in 0..D {
            let mut pivot = k;
            for row in k + 1..D {
                if matrix[row][k].abs() > matrix[pivot][k].abs() {
                    pivot = row;
                }
            }
            if pivot != k {
                matrix.swap(k, pivot);
                x.swap(k, pivot);
                determinant = -determinant;
            }
            determinant *= matrix[k][k];
            if determinant == 0.0 || !determinant.is_finite() {
                return (0.0, None);
            }
            for row in 0..D {
                if row != k {
                    let factor = matrix[row][k] / matrix[k][k];
                    for column in k..D {
                        matrix[row][column] -= factor * matrix[k][column];
                    }
                    x[row] -= factor * x[k];
                }
            }
        }
        for k in 0..D {
            x[k] /= matrix[k][k];
        }
        (determinant, Some(x))
    }
}

/// Scale of positions along an image axis: values run evenly from the first sample to the last.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisScale {
    /// Name of the quantity, with its unit.
    pub label: String,
    /// Value at the first sample.
    pub first: f64,
    /// Value at the last sample.
    pub last: f64,
}

/// Returns a name with its unit in brackets, or the name alone if it has no unit.
fn with_unit(name: &str, unit: &str) -> String {
    match unit {
        "" => name.to_string(),
        unit => format!("{name} [{unit}]"),
    }
}

impl<const D: usize> Geometry<D> {
    /// Returns the physical coordinate that changes most along image axis `k`.
    pub(crate) fn main_coordinate(&self, k: usize) -> usize {
        let step = self.axes[k];
        (1..D).fold(0, |main, c| {
            if step[c].abs() > step[main].abs() {
                c
            } else {
                main
            }
        })
    }

    /// Returns the scale of image axis `k`, which is `steps` samples long. The scale is the
    /// physical coordinate that the axis is parallel to. If the axis is oblique, as the lines of a
    /// rotated survey are, the scale is the distance from its first sample.
    pub fn axis_scale(&self, k: usize, steps: f64) -> AxisScale {
        let along = self.main_coordinate(k);
        let length = norm(self.axes[k]);
        let (name, unit) = (&self.names[k], &self.units[along]);
        if self.axes[k][along].abs() >= (1.0 - 1e-6) * length {
            return AxisScale {
                label: with_unit(name, unit),
                first: self.origin[along],
                last: self.origin[along] + steps * self.axes[k][along],
            };
        }
        AxisScale {
            label: with_unit(&format!("{name}, from the first"), unit),
            first: 0.0,
            last: steps * length,
        }
    }

    /// Returns the factor by which each physical coordinate is scaled for display, 1 for all if
    /// they have the same unit. A coordinate with another unit than the first is scaled so that the
    /// image axis along it has the same proportion to the other axes as in a box of `extent` that
    /// holds `samples` samples.
    pub fn display_scale(&self, samples: [f64; D], extent: [f64; D]) -> [f64; D] {
        // Physical length per length of the box.
        let scale = |k: usize| samples[k] * norm(self.axes[k]) / extent[k].max(f64::MIN_POSITIVE);
        let same_unit = (0..D).filter(|&k| self.units[self.main_coordinate(k)] == self.units[0]);
        let scales: Vec<f64> = same_unit.map(scale).collect();
        let mean = match scales.len() {
            0 => scale(0),
            count => scales.iter().sum::<f64>() / count as f64,
        };
        std::array::from_fn(|c| {
            if self.units[c] == self.units[0] {
                return 1.0;
            }
            let share = |k: usize| unit(self.axes[k])[c].abs();
            let along = (1..D).fold(0, |best, k| if share(k) > share(best) { k } else { best });
            mean / scale(along).max(f64::MIN_POSITIVE)
        })
    }

    /// Returns `true` if the last physical coordinate increases downwards. That holds for times and
    /// depths that increase from sample to sample, for coordinates without units, and for 2-D
    /// images whose rows increase. The coordinate of a survey in heights, or in negative times,
    /// increases upwards.
    pub fn points_down(&self) -> bool {
        const DOWNWARD_NAMES: [&str; 5] = ["sample", "time", "depth", "twt", "tvd"];
        let last = D - 1;
        let along = (0..D).find(|&k| self.main_coordinate(k) == last);
        let grows = along.is_none_or(|k| self.axes[k][last] >= 0.0);
        let has_downward_name =
            along.is_some_and(|k| DOWNWARD_NAMES.contains(&&*self.names[k].to_ascii_lowercase()));
        let without_units = self.units.iter().all(String::is_empty);
        grows
            && (D == 2
                || has_downward_name
                || without_units
                || seconds_per_unit(&self.units[last]).is_some())
    }
}

impl<const D: usize> Geometry<D> {
    /// Returns the geometry extended to 3-D; missing components are those of the default geometry.
    pub fn to_3d(&self) -> Geometry<3> {
        let mut space = Geometry::<3>::default();
        for k in 0..D.min(3) {
            space.origin[k] = self.origin[k];
            space.names[k].clone_from(&self.names[k]);
            space.units[k].clone_from(&self.units[k]);
            for c in 0..D.min(3) {
                space.axes[k][c] = self.axes[k][c];
            }
        }
        space
    }
}

impl Geometry<3> {
    /// Returns `true` if the plane of the first two axes is not parallel to the physical x and y
    /// axes.
    pub fn is_oblique(&self) -> bool {
        self.axes[0][2] != 0.0 || self.axes[1][2] != 0.0
    }

    /// Returns `true` if the plane of the first two axes is vertical and one of the two runs along
    /// the last coordinate, as in the section of a seismic line.
    pub fn is_upright(&self) -> bool {
        let [a, b, _] = self.axes;
        let is_horizontal = |v: [f64; 3]| v[2] == 0.0 && (v[0] != 0.0 || v[1] != 0.0);
        let is_vertical = |v: [f64; 3]| v[0] == 0.0 && v[1] == 0.0 && v[2] != 0.0;
        (is_vertical(a) && is_horizontal(b)) || (is_horizontal(a) && is_vertical(b))
    }

    /// Returns the geometry of the section along the first two image axes; see
    /// [`Image::flatten`](super::Image::flatten).
    pub fn flatten(&self) -> Geometry<2> {
        let [a, b, _] = self.axes;
        let names = [self.names[0].clone(), self.names[1].clone()];
        let units = [self.units[0].clone(), self.units[1].clone()];
        if !self.is_oblique() {
            return Geometry {
                origin: [self.origin[0], self.origin[1]],
                axes: [[a[0], a[1]], [b[0], b[1]]],
                names,
                units,
            };
        }
        if self.is_upright() {
            // Coordinates are the distance along the section from its first sample, and the height.
            let unit = (0..2)
                .find(|&c| [a, b].iter().any(|v| v[c] != 0.0))
                .unwrap_or(0);
            return Geometry {
                origin: [0.0, self.origin[2]],
                axes: [a, b].map(|v| [hypot(v[0], v[1]), v[2]]),
                names,
                units: [self.units[unit].clone(), self.units[2].clone()],
            };
        }
        let length = norm(a);
        let along = dot(a, b) / length;
        let across = (dot(b, b) - along * along).max(0.0).sqrt();
        Geometry {
            origin: [0.0; 2],
            axes: [[length, 0.0], [along, across]],
            names,
            units: Default::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_compared_in_one_unit_or_not_at_all() {
        let geometry = |units: [&str; 3]| Geometry::<3> {
            units: units.map(str::to_owned),
            ..Geometry::with_spacing([0.0; 3], [10.0, 10.0, 10.0])
        };
        let scales = |units: [&str; 3]| geometry(units).length_scales();
        assert_eq!(scales([""; 3]), Ok([1.0; 3]));
        assert_eq!(scales(["mm"; 3]), Ok([1.0; 3]));
        assert_eq!(scales(["m", "m", "ft"]), Ok([1.0, 1.0, 0.3048]));
        let time = NoAngles::Time("ms".into());
        assert_eq!(scales(["m", "m", "ms"]), Err(time));
        assert_eq!(scales(["", "", "m"]), Err(NoAngles::UnknownUnits));
        let lines = Geometry::<3> {
            names: ["sample", "crossline", "inline"].map(str::to_owned),
            ..geometry([""; 3])
        };
        assert_eq!(lines.length_scales(), Err(NoAngles::LineNumbers));

        let feet = geometry(["m", "m", "ft"]);
        assert!(feet.preserves_shapes([1.0; 3]));
        let metres = feet.in_one_unit().unwrap();
        assert!((metres.spacing()[2] - 3.048).abs() < 1e-12);
        assert!(!metres.preserves_shapes([1.0; 3]));
    }

    #[test]
    fn index_to_physical_and_back() {
        // A rotated survey far from the origin with time downwards is left-handed.
        let geometry = Geometry::<3> {
            origin: [620_197.2, 6_074_232.9, -1000.0],
            axes: [[0.0, 0.0, -4.0], [24.9, 0.7, 0.0], [-0.7, 24.9, 0.0]],
            ..Geometry::default()
        };
        let cell = 4.0 * (24.9 * 24.9 + 0.7 * 0.7);
        assert!((geometry.determinant() + cell).abs() < 1e-9 * cell);
        let index = [12.25, 100.5, -3.0];
        let found = geometry.to_index(geometry.to_physical(index)).unwrap();
        for k in 0..3 {
            assert!((found[k] - index[k]).abs() < 1e-8, "{found:?}");
        }
    }

    #[test]
    fn shapes_are_kept_by_rotation_and_even_scaling_only() {
        let mut geometry = Geometry::<3>::with_spacing([5.0; 3], [25.0, 25.0, 5.0]);
        assert!(!geometry.preserves_shapes([1.0; 3]));
        assert!(geometry.preserves_shapes([5.0, 5.0, 1.0]));
        geometry.axes = [[0.0, 0.0, -4.0], [2.4, 3.2, 0.0], [-3.2, 2.4, 0.0]];
        assert!(geometry.preserves_shapes([1.0; 3]));
        geometry.axes[1] = [2.5, 3.1, 0.0];
        assert!(!geometry.preserves_shapes([1.0; 3]));
    }

    #[test]
    fn a_section_keeps_its_lengths_and_angles() {
        let flat = Geometry::<2>::with_spacing([7.0, 8.0], [2.0, -3.0]);
        assert_eq!(flat.to_3d().flatten(), flat);
        // An upright section has its time or depth axis first.
        let geometry = Geometry::<3> {
            axes: [[0.0, 0.0, -4.0], [3.0, 4.0, 12.0], [0.0, 1.0, 0.0]],
            ..Geometry::default()
        };
        let [a, b] = geometry.flatten().axes;
        assert_eq!(a, [4.0, 0.0]);
        assert_eq!(b, [-12.0, 5.0]);
    }

    #[test]
    fn axes_are_read_off_in_the_world_or_by_distance() {
        let mut survey = Geometry::<3> {
            origin: [620_000.0, 6_000_000.0, -1000.0],
            axes: [[0.0, 0.0, -4.0], [0.0, 25.0, 0.0], [3.0, 4.0, 0.0]],
            names: ["sample", "crossline", "inline"].map(String::from),
            units: ["m", "m", "ms"].map(String::from),
        };
        let scale_of = |geometry: &Geometry<3>, k: usize| {
            let AxisScale { label, first, last } = geometry.axis_scale(k, 100.0);
            (label, [first, last])
        };
        assert_eq!(
            scale_of(&survey, 0),
            ("sample [ms]".into(), [-1000.0, -1400.0])
        );
        let across = ("crossline [m]".into(), [6_000_000.0, 6_002_500.0]);
        assert_eq!(scale_of(&survey, 1), across);
        // Along an oblique axis neither x nor y alone identifies the position.
        let along = ("inline, from the first [m]".into(), [0.0, 500.0]);
        assert_eq!(scale_of(&survey, 2), along);

        // A sample of 4 ms is drawn as long as the mean of 25 m and 5 m.
        let cube = [100.0; 3];
        let aspect = survey.display_scale(cube, cube);
        assert!(aspect[0] == 1.0 && aspect[1] == 1.0 && (aspect[2] - 3.75).abs() < 1e-12);
        survey.units = Default::default();
        assert_eq!(survey.display_scale(cube, cube), [1.0; 3]);
    }

    #[test]
    fn times_depths_and_rows_point_down_and_heights_up() {
        let mut geometry = Geometry::<3>::default();
        assert!(geometry.points_down(), "samples in units of themselves");
        geometry.units = ["mm", "mm", "mm"].map(String::from);
        assert!(!geometry.points_down(), "millimetres of a head");
        geometry.names[2] = "Depth".into();
        assert!(geometry.points_down());
        geometry.axes[2][2] = -1.0;
        assert!(!geometry.points_down(), "depth below zero");
        let survey = Geometry::<3> {
            axes: [[0.0, 0.0, 4.0], [25.0, 0.0, 0.0], [0.0, 25.0, 0.0]],
            units: ["m", "m", "ms"].map(String::from),
            ..Geometry::default()
        };
        assert!(survey.points_down());
        let mut photograph = Geometry::<2>::with_spacing([0.0; 2], [2.0, 2.0]);
        assert!(photograph.points_down());
        photograph.axes[1][1] = -2.0;
        assert!(!photograph.points_down());
    }

    #[test]
    fn flat_axes_have_no_inverse() {
        let mut geometry = Geometry::<3>::default();
        geometry.axes[2] = [1.0, 1.0, 0.0];
        assert_eq!(geometry.determinant(), 0.0);
        assert_eq!(geometry.to_index([0.0; 3]), None);
    }
}
