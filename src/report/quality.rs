//! Measures the shapes of cells: tetrahedra by their dihedral angles, triangles by their angles.

use super::Angles;
use crate::Result;
use crate::files::codec::codec_fields;
use crate::geometry::statistics::lower_index;
use crate::mesh::Simplices;
use crate::mesh::view::{MeshView, WHOLE_MESH_NEVER_FAILS};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use serde::Serialize;
use std::borrow::Cow;

/// Number of bins of the histogram of angles, of 10 degrees each.
pub const BINS: usize = 18;
/// Number of cells in one task. It is fixed, so that sums do not depend on the number of threads.
pub(super) const CELLS_PER_TASK: usize = 1 << 14;
/// Number of worst cells that are listed.
const MAX_LISTED_CELLS: usize = 10;

/// Worst value of all cells, and the values than which 0.1, 1 and 50 % of the cells are worse.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantiles {
    /// Worst value.
    pub worst: f64,
    /// Value than which one cell in a thousand is worse.
    pub permille: f64,
    /// Value than which one cell in a hundred is worse.
    pub percent: f64,
    /// Median.
    pub median: f64,
}

/// One of the worst cells.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Worst {
    /// Number of the cell in the mesh.
    pub cell: usize,
    /// Centroid of the cell, in the space that was measured.
    pub centroid: Vec<f64>,
    /// Smallest angle of the cell, in degrees.
    pub smallest: f64,
    /// Largest angle of the cell, in degrees.
    pub largest: f64,
}

/// Shapes of all cells: tetrahedra or triangles. Angles are in degrees, and dihedral in tetrahedra.
/// For an empty mesh, values that do not exist are NaN (null in JSON).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Quality {
    /// Space in which the shapes were measured: `lattice` or `physical`.
    pub space: Cow<'static, str>,
    /// Number of nodes.
    pub nodes: usize,
    /// Number of cells.
    pub cells: usize,
    /// Kind of cells: `tetrahedra` or `triangles`.
    pub kind: Cow<'static, str>,
    /// Smallest angle of each cell. The worst is the smallest.
    pub smallest_angle: Quantiles,
    /// Largest angle of each cell. The worst is the largest.
    pub largest_angle: Quantiles,
    /// Number of cells with an angle below 20 degrees.
    pub below_20: usize,
    /// Number of cells with an angle below 30 degrees.
    pub below_30: usize,
    /// Number of cells with an angle above 120 degrees. In a triangle, the smallest angle is then
    /// below 30 degrees.
    pub above_120: usize,
    /// Number of cells with an angle above 150 degrees.
    pub above_150: usize,
    /// Number of cells with an angle above 160 degrees.
    pub above_160: usize,
    /// Number of angles (six per tetrahedron, three per triangle) in each bin of 10 degrees.
    pub histogram: [u64; BINS],
    /// Mean ratio: 1 for the regular cell, 0 for a flat one. In 2-D this is Q = 4 sqrt(3) A / (l1^2
    /// + l2^2 + l3^2).
    pub mean_ratio: Quantiles,
    /// Circumradius over shortest edge: 0.612 for the regular tetrahedron, 0.577 for the
    /// equilateral triangle. The worst is the largest.
    pub radius_edge: Quantiles,
    /// Mean of all mean ratios.
    pub mean_ratio_mean: f64,
    /// Sum of the signed volumes; in 2-D of areas.
    pub volume: f64,
    /// Smallest signed volume.
    pub smallest_volume: f64,
    /// Largest volume.
    pub largest_volume: f64,
    /// Cells whose angles are farthest from 90 degrees, worst first.
    pub worst: Vec<Worst>,
    /// Assessment of angles beyond [30, 150] degrees that the features explain, if it was
    /// requested.
    pub angles: Option<Angles>,
}

/// Returns the smallest angle of every cell, in degrees.
pub fn smallest_angles<const D: usize, M: Simplices<D>>(mesh: &M) -> Vec<f32> {
    let mut angles = vec![0.0f32; mesh.len()];
    let chunks = angles.par_chunks_mut(CELLS_PER_TASK).enumerate();
    chunks.for_each(|(chunk, angles)| {
        let first = chunk * CELLS_PER_TASK;
        let mut slots = angles.iter_mut();
        mesh.shapes(first..first + slots.len(), |shape| {
            if let Some(angle) = slots.next() {
                *angle = max_value(shape.cosines.as_ref()).acos().to_degrees() as f32;
            }
        });
    });
    angles
}

/// Returns the number of cells with an angle, in degrees, below `min_angle` or above 180 degrees less
/// this, up to rounding.
pub(crate) fn cells_below<const D: usize, M: Simplices<D>>(mesh: &M, min_angle: f64) -> usize {
    const ROUNDING: f64 = 1e-3;
    let max_cosine = (min_angle - ROUNDING).to_radians().cos();
    let mut count = 0;
    mesh.shapes(0..mesh.len(), |shape| {
        let is_outside = |cosine: &f64| cosine.abs() > max_cosine;
        count += usize::from(shape.cosines.as_ref().iter().any(is_outside));
    });
    count
}

/// Shape of a cell. Angles are stored as versines (1 - cos), which grow with the angle and are
/// precise for small angles. So no arc cosine is needed for each of millions of cells.
#[derive(Clone, Copy, Default)]
struct CellShape {
    /// Versine of the smallest angle: 1 - cos.
    smallest: f32,
    /// Versine of 180 degrees minus the largest angle: 1 + cos of the largest angle.
    largest: f32,
    mean_ratio: f32,
    radius_edge: f32,
}

impl CellShape {
    /// Returns the versine of the angle that is farther from 90 degrees, measured from 0 or 180.
    fn worst_versine(&self) -> f32 {
        self.smallest.min(self.largest)
    }
}

/// Sums over the cells of one task.
struct ShapeSums {
    histogram: [u64; BINS],
    ratio_sum: f64,
    volume: f64,
    volume_range: [f64; 2],
}

/// Measures every cell in the space in which the nodes of the mesh are given.
pub fn quality<const D: usize, M: Simplices<D>>(mesh: &M) -> Quality {
    quality_of_partition(&MeshView::from_mesh(mesh), &CancelToken::never())
        .expect(WHOLE_MESH_NEVER_FAILS)
}

/// Measures a mesh that may be distributed, until `cancel` is cancelled. The result of a cancelled
/// call is meaningless. Collective.
///
/// # Errors
/// Returns the communication errors of the view.
pub(crate) fn quality_of_partition<const D: usize, M: Simplices<D>>(
    view: &MeshView<'_, D, M>,
    cancel: &CancelToken<'_>,
) -> Result<Quality> {
    let mesh = view.mesh;
    let mut shapes = vec![CellShape::default(); mesh.len()];
    let sums: Vec<ShapeSums> = (shapes.par_chunks_mut(CELLS_PER_TASK).enumerate())
        .take_any_while(|_| !cancel.is_cancelled())
        .map(|(chunk, chunk_shapes)| measure_shapes(mesh, chunk * CELLS_PER_TASK, chunk_shapes))
        .collect();
    let local = ShapeTotals::new(view, &shapes, &sums);
    let totals = view.merge_parts("shapes", local, ShapeTotals::merged)?;
    let series: [ShapeMeasure; 4] = [
        |c| c.smallest,
        |c| c.largest,
        |c| c.mean_ratio,
        |c| c.radius_edge,
    ];
    let series = series.map(|measure| shapes.iter().map(measure));
    let [smallest, largest, mean_ratio, radius_edge] = quantiles(
        view,
        series,
        [BadEnd::Small, BadEnd::Small, BadEnd::Small, BadEnd::Large],
    )?;
    let [below_20, below_30, above_120, above_150, above_160] =
        [0, 1, 2, 3, 4].map(|k| totals.counts[k] as usize);
    let mut worst = totals.worst;
    worst.sort_by_key(|(_, worst)| worst.cell);
    Ok(Quality {
        space: "lattice".into(),
        nodes: view.global_counts[0],
        cells: view.global_counts[1],
        kind: M::CELLS_NAME.into(),
        smallest_angle: smallest.map(angle_from_versine),
        largest_angle: largest.map(|v| 180.0 - angle_from_versine(v)),
        below_20,
        below_30,
        above_120,
        above_150,
        above_160,
        histogram: std::array::from_fn(|bin| totals.counts[ANGLE_LIMITS.len() + bin]),
        worst: worst_cells(worst)
            .into_iter()
            .map(|(_, worst)| worst)
            .collect(),
        angles: None,
        mean_ratio,
        radius_edge,
        mean_ratio_mean: totals.sums[0] / view.global_counts[1] as f64,
        volume: totals.sums[1],
        smallest_volume: totals.volume_range[0],
        largest_volume: totals.volume_range[1],
    })
}

/// Function that returns a measure of a cell.
type ShapeMeasure = fn(&CellShape) -> f32;

/// Limits for the counts of cells, in degrees: cells are counted if the smallest angle, or 180
/// degrees minus the largest angle, is below the limit.
const ANGLE_LIMITS: [(ShapeMeasure, f64); 5] = [
    (|c| c.smallest, 20.0),
    (|c| c.smallest, 30.0),
    (|c| c.largest, 60.0),
    (|c| c.largest, 30.0),
    (|c| c.largest, 20.0),
];

/// Measures of some cells, those of one part of a mesh or of several.
struct ShapeTotals {
    /// Counts for [`ANGLE_LIMITS`], then the bins of the histogram.
    counts: Vec<u64>,
    /// Sum of mean ratios, and sum of volumes.
    sums: [f64; 2],
    /// Smallest and largest volume.
    volume_range: [f64; 2],
    /// Cells whose angles are farthest from 90 degrees, with their [`CellShape::worst_versine`].
    worst: Vec<(f32, Worst)>,
}

codec_fields! { ShapeTotals as ShapeTotals { counts, sums, volume_range, worst } }

impl ShapeTotals {
    fn new<const D: usize, M: Simplices<D>>(
        view: &MeshView<'_, D, M>,
        shapes: &[CellShape],
        sums: &[ShapeSums],
    ) -> Self {
        let count_below = |(measure, angle): (ShapeMeasure, f64)| {
            let limit = 1.0 - angle.to_radians().cos();
            let values = shapes.par_iter().map(measure);
            values.filter(|&v| f64::from(v) < limit).count() as u64
        };
        let mut counts = ANGLE_LIMITS.map(count_below).to_vec();
        counts.extend((0..BINS).map(|bin| sums.iter().map(|s| s.histogram[bin]).sum::<u64>()));
        let worst = worst_cells(shapes.iter().map(CellShape::worst_versine).zip(0..));
        let to_listed_cell = |(versine, c): (f32, usize)| {
            let cell = &shapes[c];
            let worst = Worst {
                cell: view.first_cell + c,
                centroid: centroid(view.mesh, c),
                smallest: angle_from_versine(cell.smallest.into()),
                largest: 180.0 - angle_from_versine(cell.largest.into()),
            };
            (versine, worst)
        };
        Self {
            counts,
            sums: [
                sums.iter().map(|s| s.ratio_sum).sum(),
                sums.iter().map(|s| s.volume).sum(),
            ],
            volume_range: [
                (sums.iter().map(|s| s.volume_range[0])).fold(f64::NAN, f64::min),
                (sums.iter().map(|s| s.volume_range[1])).fold(f64::NAN, f64::max),
            ],
            worst: worst.into_iter().map(to_listed_cell).collect(),
        }
    }

    /// Returns the measures of the cells of both.
    fn merged(mut self, other: Self) -> Self {
        (self.counts.iter_mut().zip(other.counts)).for_each(|(sum, count)| *sum += count);
        (self.sums.iter_mut().zip(other.sums)).for_each(|(sum, part)| *sum += part);
        let ([low, high], [other_low, other_high]) = (self.volume_range, other.volume_range);
        self.volume_range = [low.min(other_low), high.max(other_high)];
        self.worst.extend(other.worst);
        self
    }
}

/// Measures the cells from `first` on, one for each item of `shapes`.
fn measure_shapes<const D: usize>(
    mesh: &impl Simplices<D>,
    first: usize,
    shapes: &mut [CellShape],
) -> ShapeSums {
    let cells = first..first + shapes.len();
    let mut slots = shapes.iter_mut();
    let mut sums = ShapeSums {
        histogram: [0; BINS],
        ratio_sum: 0.0,
        volume: 0.0,
        volume_range: [f64::INFINITY, f64::NEG_INFINITY],
    };
    let bins = AngleBins::new();
    mesh.shapes(cells, |shape| {
        let cosines = shape.cosines.as_ref();
        for &cosine in cosines {
            sums.histogram[bins.bin_index(cosine)] += 1;
        }
        if let Some(cell) = slots.next() {
            *cell = CellShape {
                smallest: (1.0 - max_value(cosines)) as f32,
                largest: (1.0 + min_value(cosines)) as f32,
                mean_ratio: shape.mean_ratio as f32,
                radius_edge: shape.radius_edge as f32,
            };
        }
        sums.ratio_sum += shape.mean_ratio;
        sums.volume += shape.volume;
        sums.volume_range = [
            sums.volume_range[0].min(shape.volume),
            sums.volume_range[1].max(shape.volume),
        ];
    });
    sums
}

/// Returns the angle, in degrees, with the given versine.
pub(super) fn angle_from_versine(versine: f64) -> f64 {
    (1.0 - versine).acos().to_degrees()
}

pub(super) fn max_value(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

pub(super) fn min_value(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Bins of the histogram, for cosines. So no arc cosine is needed for each of millions of angles.
struct AngleBins {
    /// Cosines of the upper ends of the bins. The last end is never reached.
    upper_ends: [f64; BINS],
    /// Bin of the largest cosine in each of the equal intervals of [-1, 1]. No interval contains
    /// more than one end.
    bin_of_interval: [u8; COSINE_INTERVALS + 1],
}

const COSINE_INTERVALS: usize = 512;

impl AngleBins {
    fn new() -> Self {
        let width = std::f64::consts::PI / BINS as f64;
        let mut upper_ends: [f64; BINS] =
            std::array::from_fn(|bin| ((bin + 1) as f64 * width).cos());
        upper_ends[BINS - 1] = -2.0;
        let bin_of_interval = std::array::from_fn(|interval| {
            let top = 2.0 * (interval + 1) as f64 / COSINE_INTERVALS as f64 - 1.0;
            upper_ends.iter().filter(|&&end| top <= end).count() as u8
        });
        Self {
            upper_ends,
            bin_of_interval,
        }
    }

    /// Returns the bin of an angle with the given cosine: the number of ends that it has reached.
    #[inline]
    fn bin_index(&self, cosine: f64) -> usize {
        let interval = ((cosine + 1.0) * (0.5 * COSINE_INTERVALS as f64)) as usize;
        let bin = usize::from(self.bin_of_interval[interval.min(COSINE_INTERVALS)]);
        bin + usize::from(cosine <= self.upper_ends[bin])
    }
}

/// Bad end of a range of values.
#[derive(Clone, Copy)]
enum BadEnd {
    Small,
    Large,
}

impl Quantiles {
    fn map(self, f: impl Fn(f64) -> f64) -> Self {
        Self {
            worst: f(self.worst),
            permille: f(self.permille),
            percent: f(self.percent),
            median: f(self.median),
        }
    }
}

/// Returns the quantiles of each series of values of all parts of a mesh. Collective.
fn quantiles<const N: usize, const D: usize, M>(
    view: &MeshView<'_, D, M>,
    series: [impl Iterator<Item = f32> + Clone + Sync; N],
    bad: [BadEnd; N],
) -> Result<[Quantiles; N]> {
    let ranks = bad.map(|bad| {
        move |total: usize| {
            let last = total - 1;
            let ranks = [0.0, 0.001, 0.01, 0.5].map(|share| lower_index(total, share));
            match bad {
                BadEnd::Small => ranks,
                BadEnd::Large => ranks.map(|rank| last - rank),
            }
        }
    });
    let values = view.order_statistics(&series, &ranks)?;
    Ok(std::array::from_fn(|i| {
        let [worst, permille, percent, median] = std::array::from_fn(|rank| values[i][rank]);
        Quantiles {
            worst,
            permille,
            percent,
            median,
        }
    }))
}

/// Returns the mean of the corners of a cell.
pub(super) fn centroid<const D: usize>(mesh: &impl Simplices<D>, c: usize) -> Vec<f64> {
    let corners = mesh.cell(c);
    let sum = |k: usize| -> f64 { corners.iter().map(|&n| mesh.nodes()[n as usize][k]).sum() };
    (0..D).map(|k| sum(k) / corners.len() as f64).collect()
}

/// Returns the few cells whose angles are farthest from 90 degrees, worst first, each with its
/// [`CellShape::worst_versine`]. `cells` must be in the order of cell numbers.
fn worst_cells<T>(cells: impl IntoIterator<Item = (f32, T)>) -> Vec<(f32, T)> {
    let mut worst: Vec<(f32, T)> = Vec::with_capacity(MAX_LISTED_CELLS + 1);
    for (versine, cell) in cells {
        if worst.len() == MAX_LISTED_CELLS && worst.last().is_some_and(|last| versine >= last.0) {
            continue;
        }
        let index = worst.partition_point(|other| other.0 <= versine);
        worst.insert(index, (versine, cell));
        worst.truncate(MAX_LISTED_CELLS);
    }
    worst
}

#[cfg(test)]
#[path = "quality_tests.rs"]
mod tests;
