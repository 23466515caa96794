//! Corner-point grids as images: a property of the cells, on an even lattice.
//!
//! The lattice runs along the mean direction of the grid's i axis, in a right-handed frame with z
//! upwards, and one sample farther on each side than the active cells. A sample has the value of the cell
//! in which it lies. Samples outside the active cells hold no data (NaN), or, if the values are whole
//! numbers, a label of their own, so that the mesh gets the boundary of the model.
//!
//! At the depth of a sample, the four pillars of a column form a quadrilateral, in which the sample has
//! bilinear fractions u and v. The interpolated depths of the corners at u and v give the layer. Where the
//! pillars of a column are parallel, these are the trilinear cells; elsewhere they differ from them in the
//! second order, but they fill space without gaps.

use std::ops::Range;
use std::path::Path;

use super::ImageFormat;
use super::placement::ImagePlacement;
use super::samples::{Encoding, Endian, SampleType};
use super::stream::{ImageHeader, ImageStream, PlaneReader};
use crate::error::{Error, Result, cause};
use crate::geometry::grid_index::index_at;
use crate::grid_file::{CornerPoints, GridFile, GridProperty, Pillar};
use crate::image::Geometry;
use crate::parallel::prelude::*;

/// Number of samples along each side of a cell on average, if no spacing is given.
const SAMPLES_PER_CELL: f64 = 2.0;

/// Largest number of samples that the default spacing gives.
const MAX_DEFAULT_SAMPLES: f64 = 3e7;

/// Largest number of samples.
const MAX_SAMPLES: f64 = 1e11;

/// Angle, as a sine, up to which the lattice is parallel to x and y.
const MAX_PARALLEL_SINE: f64 = 1e-6;

/// Distance beyond a side of a column, as a fraction of the column, at which a point still lies in it, so
/// that no point falls between two columns.
const COLUMN_TOLERANCE: f64 = 1e-9;

/// Number of Newton steps that find the fractions of a point in a quadrilateral.
const MAX_NEWTON_STEPS: usize = 12;

/// Opens the grid that `FILE` or `FILE:NAME` names, on a lattice whose spacing is that of `placement`, if
/// it gives one.
///
/// # Errors
/// Returns the errors of [`GridFile::open_property`], and [`Error::Job`] for a spacing that does not fit.
pub(super) fn open(path: &Path, placement: &ImagePlacement) -> Result<ImageStream> {
    let (grid, property) = GridFile::open_property(path, &|_| false)?;
    let cells = grid.corner_points();
    let lattice = Lattice::new(&grid, &cells, placement)?;
    let outside = if property.is_whole {
        outside_label(&grid, &property) as f32
    } else {
        f32::NAN
    };
    let encoding = Encoding {
        sample_type: if property.is_whole {
            SampleType::I32
        } else {
            SampleType::F32
        },
        endian: Endian::Little,
    };
    let mut notes = grid.notes.clone();
    notes.push(lattice.note(&grid, cells.mean_thickness()));
    notes.push(if property.is_whole {
        format!("samples outside the active cells have the label {outside}, which --drop {outside} leaves out")
    } else {
        "samples outside the active cells hold no data".to_string()
    });
    let header = ImageHeader {
        dims: lattice.dims,
        geometry: lattice.geometry.clone(),
        missing: Vec::new(),
        label_names: Vec::new(),
        format: ImageFormat::CornerPoints,
        encoding: format!("{}, {}", grid.kind, property.name),
        notes,
        survey: None,
        line_numbers: None,
    };
    let sampler = GridSampler::new(&grid, &cells, &lattice, &property, outside);
    Ok(ImageStream {
        header,
        encoding,
        reader: Box::new(sampler),
        max_magnitude_bits: Default::default(),
    })
}

/// Returns the label of samples outside the active cells: 0, or one below the smallest value.
fn outside_label(grid: &GridFile, property: &GridProperty) -> i64 {
    let values = property.values.iter().enumerate();
    let values = values.filter(|(cell, value)| grid.is_active(*cell) && value.is_finite());
    let min = values.map(|(_, value)| *value as i64).min();
    min.map_or(0, |min| (min.saturating_sub(1)).min(0))
}

/// The lattice on which a grid is sampled.
struct Lattice {
    dims: [usize; 3],
    geometry: Geometry<3>,
}

impl Lattice {
    fn new(grid: &GridFile, cells: &CornerPoints<'_>, placement: &ImagePlacement) -> Result<Self> {
        let along_i = main_direction(grid, cells);
        let frame = [along_i, [-along_i[1], along_i[0]]];
        let coordinates = |p: [f64; 3]| {
            [
                frame[0][0] * p[0] + frame[0][1] * p[1],
                frame[1][0] * p[0] + frame[1][1] * p[1],
                p[2],
            ]
        };
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        for cell in (0..grid.cell_count()).filter(|&cell| grid.is_active(cell)) {
            for corner in cells.corners(index_at(grid.dims, cell)) {
                let position = coordinates(corner);
                for c in 0..3 {
                    low[c] = low[c].min(position[c]);
                    high[c] = high[c].max(position[c]);
                }
            }
        }
        let extent: [f64; 3] = std::array::from_fn(|c| high[c] - low[c]);
        if let Some(c) = (0..3).find(|&c| !(extent[c] > 0.0 && extent[c].is_finite())) {
            let axis = ["x", "y", "z"][c];
            let problem = format!("has no extent along {axis}");
            return Err(grid.error(problem, "give a grid whose active cells have a volume"));
        }
        let spacing = spacing(grid, cells, extent, placement)?;
        let dims = [0, 1, 2].map(|c| {
            // Rounding must not add a sample where the spacing divides the extent.
            let count = (extent[c] / spacing[c] - 1e-6).ceil().max(1.0);
            count as usize + 2
        });
        // The samples are in the middles of cells of the lattice, which begin at the lower corner.
        let first: [f64; 3] = std::array::from_fn(|c| low[c] - spacing[c] / 2.0);
        let axes3 = [
            [frame[0][0], frame[0][1], 0.0],
            [frame[1][0], frame[1][1], 0.0],
            [0.0, 0.0, 1.0],
        ];
        let unit = grid.frame.unit().symbol.to_string();
        let geometry = Geometry {
            origin: std::array::from_fn(|c| (0..3).map(|k| first[k] * axes3[k][c]).sum()),
            axes: std::array::from_fn(|k| axes3[k].map(|part| part * spacing[k] + 0.0)),
            units: [unit.clone(), unit.clone(), unit],
            ..Geometry::default()
        };
        Ok(Self { dims, geometry })
    }

    fn note(&self, grid: &GridFile, thickness: Option<f64>) -> String {
        let [nx, ny, nz] = grid.dims;
        let active = (0..grid.cell_count()).filter(|&cell| grid.is_active(cell));
        let [sx, sy, sz] = self.geometry.spacing();
        let thickness = thickness.map_or(String::new(), |thickness| {
            format!(" of a mean thickness of {thickness:.4}")
        });
        format!(
            "{nx} x {ny} x {nz} cells{thickness}, {} of them active, are sampled every {sx:.4}, {sy:.4} and {sz:.4} {} (--spacing)",
            active.count(),
            grid.frame.unit().symbol
        )
    }
}

/// Returns the distances between samples: the given ones, or a fraction of the mean size of cells.
fn spacing(
    grid: &GridFile,
    cells: &CornerPoints<'_>,
    extent: [f64; 3],
    placement: &ImagePlacement,
) -> Result<[f64; 3]> {
    let refuse = |place: String, problem: &str| {
        let remedy = "give the distances between samples along x, y and z, or one for all";
        Error::Job(cause(place, problem, remedy))
    };
    let mut spacing = match placement.spacing.as_deref() {
        Some(&[all]) => [all; 3],
        Some(&[x, y, z]) => [x, y, z],
        Some(given) => {
            let text: Vec<String> = given.iter().map(f64::to_string).collect();
            return Err(refuse(
                format!("spacing {}", text.join(",")),
                "does not have one or three values",
            ));
        }
        None => default_spacing(grid, cells, extent),
    };
    if let Some(interval) = placement.interval {
        spacing[2] = interval;
    }
    if let Some(value) = spacing.iter().find(|s| !(**s > 0.0 && s.is_finite())) {
        return Err(refuse(format!("spacing {value}"), "is not positive"));
    }
    let count: f64 = (0..3).map(|c| extent[c] / spacing[c] + 2.0).product();
    if count > MAX_SAMPLES {
        let text = spacing.map(|s| s.to_string()).join(",");
        let problem = format!("makes more than {MAX_SAMPLES} samples");
        return Err(refuse(format!("spacing {text}"), &problem));
    }
    Ok(spacing)
}

/// Returns a fraction of the mean size of the active cells along i, j and k.
fn default_spacing(grid: &GridFile, cells: &CornerPoints<'_>, extent: [f64; 3]) -> [f64; 3] {
    let [nx, ny, _] = grid.dims;
    let mean_edge = |is_along_i: bool| {
        let ends = if is_along_i { [0, 1] } else { [0, 2] };
        let columns = (0..nx * ny).map(|column| [column % nx, column / nx]);
        let edges = columns.map(|[i, j]| {
            let [a, b] = ends.map(|corner| {
                let z = cells.z([i, j, 0], corner);
                cells.pillars[cells.pillar_index([i, j], corner)].at(z)
            });
            (a[0] - b[0]).hypot(a[1] - b[1])
        });
        edges.sum::<f64>() / (nx * ny) as f64
    };
    let positive = |size: f64, extent: f64| {
        if size > 0.0 && size.is_finite() {
            size
        } else {
            extent
        }
    };
    // The first axis of the lattice is the axis i or j of the grid, whichever is nearer to x.
    let [mut along_x, mut along_y] = [mean_edge(true), mean_edge(false)];
    let along_i = grid_direction(grid, cells);
    if along_i[1].abs() > along_i[0].abs() {
        std::mem::swap(&mut along_x, &mut along_y);
    }
    let sizes = [along_x, along_y, cells.mean_thickness().unwrap_or(0.0)];
    let spacing: [f64; 3] =
        std::array::from_fn(|c| positive(sizes[c], extent[c]) / SAMPLES_PER_CELL);
    let count: f64 = (0..3).map(|c| extent[c] / spacing[c] + 2.0).product();
    let factor = (count / MAX_DEFAULT_SAMPLES).cbrt().max(1.0);
    spacing.map(|s| s * factor)
}

/// Returns the mean direction of the axis i in map view; x if there is none.
fn grid_direction(grid: &GridFile, cells: &CornerPoints<'_>) -> [f64; 2] {
    let [nx, ny, _] = grid.dims;
    let mut sum = [0.0; 2];
    for j in 0..ny {
        let ends = [(0, 0), (nx - 1, 1)].map(|(i, corner)| {
            let z = cells.z([i, j, 0], corner);
            cells.pillars[cells.pillar_index([i, j], corner)].at(z)
        });
        (0..2).for_each(|c| sum[c] += ends[1][c] - ends[0][c]);
    }
    let length = sum[0].hypot(sum[1]);
    if length > 0.0 && length.is_finite() {
        sum.map(|c| c / length)
    } else {
        [1.0, 0.0]
    }
}

/// Returns the direction of the first axis of the lattice: that of the axis i or a multiple of 90 degrees
/// from it, whichever is nearest to x.
fn main_direction(grid: &GridFile, cells: &CornerPoints<'_>) -> [f64; 2] {
    let [x, y] = grid_direction(grid, cells);
    let candidates = [[x, y], [-x, -y], [y, -x], [-y, x]];
    let mut nearest = candidates[0];
    for candidate in candidates {
        if candidate[0] > nearest[0] {
            nearest = candidate;
        }
    }
    if nearest[1].abs() <= MAX_PARALLEL_SINE {
        [1.0, 0.0]
    } else {
        nearest
    }
}

/// A column of cells in lattice coordinates: x and y are fractional indices of samples, z is in the world.
struct Column {
    /// Pillars at the corners towards (smaller i, smaller j), (larger i, smaller j), (smaller i, larger j)
    /// and (larger i, larger j).
    pillars: [Pillar; 4],
    /// Range of z of the active cells.
    z: [f64; 2],
    /// Index of the column.
    index: usize,
}

/// Reader of samples: finds for each sample the cell in which it lies.
struct GridSampler {
    /// Columns with an active cell.
    columns: Vec<Column>,
    /// Number of cells along i, j and k.
    grid_dims: [usize; 3],
    /// z of the tops and bottoms of the cells of each column, at its four pillars.
    corner_z: Vec<[f64; 4]>,
    /// Value of each cell; NaN where it is not active.
    values: Vec<f32>,
    outside: f32,
    nx: usize,
    ny: usize,
    first_z: f64,
    step_z: f64,
}

impl GridSampler {
    fn new(
        grid: &GridFile,
        cells: &CornerPoints<'_>,
        lattice: &Lattice,
        property: &GridProperty,
        outside: f32,
    ) -> Self {
        let [nx, ny, nz] = grid.dims;
        let geometry = &lattice.geometry;
        let [a, b] = [geometry.axes[0], geometry.axes[1]];
        let size = [a, b].map(|axis| axis[0] * axis[0] + axis[1] * axis[1]);
        let to_index = |p: [f64; 2]| {
            let [x, y] = [p[0] - geometry.origin[0], p[1] - geometry.origin[1]];
            [
                (x * a[0] + y * a[1]) / size[0],
                (x * b[0] + y * b[1]) / size[1],
            ]
        };
        let values: Vec<f32> = (0..grid.cell_count())
            .map(|cell| {
                if grid.is_active(cell) {
                    property.values[cell] as f32
                } else {
                    f32::NAN
                }
            })
            .collect();
        // Two rows of corners for each cell of a column: its top and its bottom.
        let corner_z: Vec<[f64; 4]> = (0..nx * ny)
            .into_par_iter()
            .flat_map_iter(|column| {
                let [i, j] = [column % nx, column / nx];
                (0..2 * nz).map(move |level| {
                    let (k, side) = (level / 2, 4 * (level % 2));
                    std::array::from_fn(|corner| cells.z([i, j, k], corner + side))
                })
            })
            .collect();
        let columns = (0..nx * ny).filter_map(|index| {
            let active = (0..nz).filter(|k| grid.is_active(k * nx * ny + index));
            let levels = active.flat_map(|k| [2 * k, 2 * k + 1]);
            let heights = levels.flat_map(|level| corner_z[2 * nz * index + level]);
            let start = [f64::INFINITY, f64::NEG_INFINITY];
            let z = heights.fold(start, |[low, high], z| [low.min(z), high.max(z)]);
            let at = [index % nx, index / nx];
            let pillar = |corner| cells.pillars[cells.pillar_index(at, corner)].mapped(to_index);
            (z[0] < z[1]).then(|| Column {
                pillars: std::array::from_fn(pillar),
                z,
                index,
            })
        });
        Self {
            columns: columns.collect(),
            grid_dims: grid.dims,
            corner_z,
            values,
            outside,
            nx: lattice.dims[0],
            ny: lattice.dims[1],
            first_z: geometry.origin[2],
            step_z: geometry.axes[2][2],
        }
    }

    /// Fills a range of rows of a plane.
    fn fill_plane(&self, plane: usize, rows: &Range<usize>, out: &mut [f32]) {
        let z = self.first_z + plane as f64 * self.step_z;
        out.fill(f32::NAN);
        for column in self
            .columns
            .iter()
            .filter(|column| column.z[0] <= z && z <= column.z[1])
        {
            let corners = column.pillars.map(|pillar| pillar.at(z));
            let range = |c: usize, limits: Range<usize>| {
                let low = corners.iter().fold(f64::INFINITY, |low, p| low.min(p[c]));
                let high = corners
                    .iter()
                    .fold(f64::NEG_INFINITY, |high, p| high.max(p[c]));
                // Conversions from floats to integers saturate.
                let first = ((low - 1e-6).ceil().max(0.0) as usize).max(limits.start);
                let end = (((high + 1e-6).floor() + 1.0).max(0.0) as usize).min(limits.end);
                first..end
            };
            for y in range(1, rows.clone()) {
                for x in range(0, 0..self.nx) {
                    let sample = &mut out[(y - rows.start) * self.nx + x];
                    if !sample.is_nan() {
                        continue;
                    }
                    let fractions = quad_fractions(&corners, [x as f64, y as f64]);
                    if let Some(fractions) = fractions {
                        *sample = self.value_in_column(column.index, fractions, z);
                    }
                }
            }
        }
        if !self.outside.is_nan() {
            let samples = out.iter_mut().filter(|sample| sample.is_nan());
            samples.for_each(|sample| *sample = self.outside);
        }
    }

    /// Returns the value of the cell of a column that contains a point; NaN if none does.
    fn value_in_column(&self, column: usize, [u, v]: [f64; 2], z: f64) -> f32 {
        let [nx, ny, nz] = self.grid_dims;
        let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
        let levels = &self.corner_z[2 * nz * column..2 * nz * (column + 1)];
        let height = |level: usize| -> f64 {
            let corners = levels[level].iter().zip(weights);
            corners.map(|(z, weight)| z * weight).sum()
        };
        // The last layer whose top is not below the point. Tops descend with k.
        let mut layers = 0..nz;
        while layers.start < layers.end {
            let middle = (layers.start + layers.end) / 2;
            if height(2 * middle) >= z {
                layers.start = middle + 1;
            } else {
                layers.end = middle;
            }
        }
        match layers.start.checked_sub(1) {
            Some(k) if height(2 * k + 1) <= z => self.values[k * nx * ny + column],
            _ => f32::NAN,
        }
    }
}

impl PlaneReader for GridSampler {
    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        let plane_samples = (rows.len() * self.nx).max(1);
        debug_assert!(rows.end <= self.ny);
        out.par_chunks_mut(plane_samples)
            .enumerate()
            .for_each(|(plane, out)| self.fill_plane(first + plane, &rows, out));
        Ok(())
    }
}

/// Returns the bilinear fractions of a point in a quadrilateral whose corners are at the fractions (0, 0),
/// (1, 0), (0, 1) and (1, 1); `None` if the point is outside.
fn quad_fractions(corners: &[[f64; 2]; 4], point: [f64; 2]) -> Option<[f64; 2]> {
    let part = |c: usize| {
        let [p, q, r, s] = corners.map(|corner| corner[c]);
        [p - point[c], q - p, r - p, p - q - r + s]
    };
    let [x, y] = [part(0), part(1)];
    let [mut u, mut v] = [0.5, 0.5];
    for _ in 0..MAX_NEWTON_STEPS {
        let offset = [x, y].map(|[p, q, r, s]| p + q * u + r * v + s * u * v);
        let along_u = [x, y].map(|[_, q, _, s]| q + s * v);
        let along_v = [x, y].map(|[_, _, r, s]| r + s * u);
        let area = along_u[0] * along_v[1] - along_u[1] * along_v[0];
        let du = (along_v[0] * offset[1] - along_v[1] * offset[0]) / area;
        let dv = (along_u[1] * offset[0] - along_u[0] * offset[1]) / area;
        u += du;
        v += dv;
        if du.abs() + dv.abs() < 0.1 * COLUMN_TOLERANCE {
            break;
        }
    }
    // A flat quadrilateral gives NaN, which lies in no range.
    let range = -COLUMN_TOLERANCE..=1.0 + COLUMN_TOLERANCE;
    (range.contains(&u) && range.contains(&v)).then_some([u, v])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fractions_of_a_quadrilateral_are_bilinear() {
        let corners = [[1.0, 1.0], [4.0, 2.0], [0.5, 5.0], [6.0, 6.5]];
        for [u, v] in [[0.0, 0.0], [1.0, 1.0], [0.3, 0.8], [0.9, 0.05]] {
            let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
            let point = [0, 1].map(|c| (0..4).map(|n| weights[n] * corners[n][c]).sum());
            let found = quad_fractions(&corners, point).unwrap();
            assert!(
                (found[0] - u).abs() + (found[1] - v).abs() < 1e-9,
                "{found:?}"
            );
            // The orientation does not matter.
            let turned = [corners[2], corners[3], corners[0], corners[1]];
            let found = quad_fractions(&turned, point).unwrap();
            assert!(
                (found[0] - u).abs() + (found[1] - 1.0 + v).abs() < 1e-9,
                "{found:?}"
            );
        }
        for outside in [[0.9, 1.0], [5.0, 2.0], [3.0, 6.0]] {
            assert_eq!(quad_fractions(&corners, outside), None);
        }
        assert_eq!(quad_fractions(&[[1.0, 1.0]; 4], [1.0, 1.0]), None);
    }
}
