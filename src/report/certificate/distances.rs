//! Distances between the voxels' boundary and the faces between regions, in both directions, and the
//! thickness of parts.

use super::labelled_cells::LabelledCells;
use super::mesh_parts::{MeshParts, PartFacet};
use super::voxel_parts::{VoxelFace, VoxelParts};
use crate::geometry::box_tree::BoxTree;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::grid_index::{index_at, offset_of};
use crate::geometry::statistics::weighted_quantiles;
use crate::geometry::{
    add_scaled, bounding_box, cross, dot, norm, normal, squared_distance_to_face, sub, to_3d,
};
use crate::parallel::prelude::*;

/// Number of faces or facets in one task.
const ITEMS_PER_TASK: usize = 1 << 10;

/// Longest edge, in samples, of the pieces of facets whose distance is measured.
const MAX_PIECE_EDGE: f64 = 1.0;

/// Largest number of faces of a part at which its thickness is measured.
const MAX_THICKNESS_FACES: usize = 256;

/// Largest thickness that is measured, in samples.
const MAX_THICKNESS: f64 = 16.0;

/// Length of the steps in which the thickness of a part of the image is measured, in samples.
const THICKNESS_STEP: f64 = 0.25;

/// Share of a part's boundary where the part may be thinner than its least thickness. The rest are
/// edges and corners, where every part tapers off.
const THIN_SHARE: f64 = 0.05;

/// Distance up to which rounding is ignored, in samples.
const ROUNDING: f64 = 1e-9;

/// Edge length of the cells of the grid in which rays search for facets, in samples.
const GRID_CELL: f64 = 2.0;

/// Sums of distances over a boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DistanceSum<const D: usize> {
    /// Measured area, in square samples.
    pub area: f64,
    /// Integral of the distance.
    pub integral: f64,
    /// Area within half a sample, and within one.
    pub within: [f64; 2],
    /// Largest distance, and its place in index space.
    pub worst: f64,
    /// Place of the largest distance.
    pub worst_at: [f64; D],
}

impl<const D: usize> Default for DistanceSum<D> {
    fn default() -> Self {
        Self {
            area: 0.0,
            integral: 0.0,
            within: [0.0; 2],
            worst: 0.0,
            worst_at: [0.0; D],
        }
    }
}

impl<const D: usize> DistanceSum<D> {
    /// Adds a place with its area.
    fn add(&mut self, distance: f64, area: f64, at: [f64; D]) {
        if self.area == 0.0 || distance > self.worst {
            (self.worst, self.worst_at) = (distance, at);
        }
        self.area += area;
        self.integral += area * distance;
        for (within, limit) in self.within.iter_mut().zip([0.5, 1.0]) {
            *within += if distance <= limit + ROUNDING {
                area
            } else {
                0.0
            };
        }
    }

    /// Adds the sums over another part of the boundary.
    pub fn merge(&mut self, other: &Self) {
        if other.area == 0.0 {
            return;
        }
        if self.area == 0.0 || other.worst > self.worst {
            (self.worst, self.worst_at) = (other.worst, other.worst_at);
        }
        self.area += other.area;
        self.integral += other.integral;
        self.within = [0, 1].map(|k| self.within[k] + other.within[k]);
    }
}

/// The boundary of a mesh's parts, for searches.
pub struct PartSurfaces<'a, const D: usize> {
    voxels: &'a VoxelParts<'a, D>,
    /// The facets between different labels.
    facets: Vec<PartFacet<D>>,
    shapes: Vec<[[f64; D]; D]>,
    /// Facets of each part, seen from its side: those of part p are `sides[start[p]..start[p + 1]]`,
    /// twice the number of the facet plus the side.
    start: Vec<u32>,
    sides: Vec<u32>,
}

impl<'a, const D: usize> PartSurfaces<'a, D> {
    /// Collects the facets between different labels.
    pub fn new(
        cells: &LabelledCells<'_, D>,
        mesh: &MeshParts<D>,
        voxels: &'a VoxelParts<'a, D>,
    ) -> Self {
        let interfaces = mesh.facets.iter().filter(|facet| facet.is_interface());
        let facets: Vec<PartFacet<D>> = interfaces.copied().collect();
        let shape = |facet: &PartFacet<D>| facet.nodes.map(|node| cells.position(node));
        let shapes = facets.par_iter().map(shape).collect();
        let part_count = voxels.components.components.len();
        let parts = facets.iter().flat_map(|facet| facet.parts);
        let (start, sides) = sort_by_group(part_count, parts.map(|part| part as usize));
        Self {
            voxels,
            facets,
            shapes,
            start,
            sides,
        }
    }

    /// Returns for each part the distances from the voxels' boundary to the facets of its label.
    pub fn distances_from_voxels(&self) -> Vec<DistanceSum<D>> {
        let boxes: Vec<[[f64; D]; 2]> = self.shapes.par_iter().map(bounding_box).collect();
        // Eight sets of labels make the search faster.
        let set = |label: u32| 1u8 << (label % 8);
        let sets = self
            .facets
            .iter()
            .map(|facet| set(facet.labels[0]) | set(facet.labels[1]));
        let sets: Vec<u8> = sets.collect();
        let tree = BoxTree::new(&boxes, &sets);
        let measure = |faces: &[VoxelFace]| {
            let mut hint = None;
            let mut sums: Vec<(u32, DistanceSum<D>)> = Vec::new();
            for &face in faces {
                let part = self.voxels.part_at(face.sample as usize);
                let label = self.voxels.label_of(part);
                let x = self.voxels.centre(face);
                let square_to = |f: usize| {
                    if self.facets[f].labels.contains(&label) {
                        squared_distance_to_face(x, &self.shapes[f])
                    } else {
                        f64::INFINITY
                    }
                };
                let nearest = tree.nearest(x, set(label), f64::INFINITY, hint, square_to);
                hint = nearest.map(|(f, _)| f);
                if let Some((_, square)) = nearest {
                    sum_of(&mut sums, part).add(square.sqrt(), 1.0, x);
                }
            }
            sums
        };
        let chunks = self.voxels.faces.par_chunks(ITEMS_PER_TASK);
        self.collect_sums(chunks.map(measure).collect())
    }

    /// Returns for each part the distances from its facets to the boundary of its label between samples.
    pub fn distances_to_voxels(&self) -> Vec<DistanceSum<D>> {
        let measure = |sides: &[u32]| {
            let mut sums: Vec<(u32, DistanceSum<D>)> = Vec::new();
            for &side in sides {
                let (f, side) = (side as usize / 2, side as usize % 2);
                let (part, label) = (self.facets[f].parts[side], self.facets[f].labels[side]);
                let sum = sum_of(&mut sums, part);
                visit_pieces(&self.shapes[f], |x, area| {
                    sum.add(self.voxels.boundary_distance(x, label), area, x);
                });
            }
            sums
        };
        let chunks = self.sides.par_chunks(ITEMS_PER_TASK);
        self.collect_sums(chunks.map(measure).collect())
    }

    fn collect_sums(&self, found: Vec<Vec<(u32, DistanceSum<D>)>>) -> Vec<DistanceSum<D>> {
        let mut sums = vec![DistanceSum::default(); self.voxels.components.components.len()];
        for (part, sum) in found.iter().flatten() {
            sums[*part as usize].merge(sum);
        }
        sums
    }

    /// Returns the least thickness of each part in the mesh, `None` if it is not known.
    pub fn mesh_thickness(&self) -> Vec<Option<f64>> {
        let grid = FacetGrid::new(self.voxels.components.dims, &self.shapes);
        let thickness = |part: usize| {
            let sides = &self.sides[self.start[part] as usize..self.start[part + 1] as usize];
            let stride = sides.len().div_ceil(MAX_THICKNESS_FACES).max(1);
            let chords = sides.iter().step_by(stride).filter_map(|&side| {
                let (f, side) = (side as usize / 2, side as usize % 2);
                let shape = &self.shapes[f];
                let area_vector = normal(shape);
                let area = norm(area_vector);
                if area < ROUNDING {
                    return None;
                }
                let inwards = if side == 0 { -1.0 / area } else { 1.0 / area };
                let direction = area_vector.map(|n| n * inwards);
                let origin: [f64; D] =
                    std::array::from_fn(|k| shape.iter().map(|x| x[k]).sum::<f64>() / D as f64);
                let bounds_part =
                    |other: usize| other != f && self.facets[other].parts.contains(&(part as u32));
                let chord = grid.first_hit(origin, direction, &self.shapes, bounds_part)?;
                Some([chord, area])
            });
            least_thickness(chords.collect())
        };
        let part_count = self.start.len() - 1;
        (0..part_count).into_par_iter().map(thickness).collect()
    }
}

/// Returns the least thickness of each part of an image, `None` if it is not known.
pub fn voxel_thickness<const D: usize>(voxels: &VoxelParts<'_, D>) -> Vec<Option<f64>> {
    let thickness = |part: u32| {
        let faces = voxels.faces_of(part);
        let stride = faces.len().div_ceil(MAX_THICKNESS_FACES).max(1);
        let chords = faces.iter().step_by(stride);
        least_thickness(
            chords
                .filter_map(|face| voxel_chord(voxels, part, *face))
                .collect(),
        )
    };
    let part_count = voxels.components.components.len() as u32;
    (0..part_count).into_par_iter().map(thickness).collect()
}

/// Returns the length of the way through a part, from a face along the normal of the boundary there;
/// `None` if it ends at a side of the box.
fn voxel_chord<const D: usize>(
    voxels: &VoxelParts<'_, D>,
    part: u32,
    face: VoxelFace,
) -> Option<[f64; 2]> {
    let centre = voxels.centre(face);
    let axis = face.axis as usize;
    let dims = voxels.components.dims;
    // The normal points to where the part is in a window of 4 by 5 by 5 samples around the face.
    let mut direction = [0.0; D];
    for number in 0..5usize.pow(D as u32) {
        let step = |k: usize| (number / 5usize.pow(k as u32) % 5) as f64 - 2.0;
        let offset: [f64; D] =
            std::array::from_fn(|k| if k == axis { step(k) - 0.5 } else { step(k) });
        if offset[axis] < -2.0 {
            continue;
        }
        let x = std::array::from_fn(|k| (centre[k] + offset[k]).clamp(0.0, dims[k] as f64 - 1.0));
        if voxels
            .sample_at(x)
            .is_some_and(|sample| voxels.part_at(sample) == part)
        {
            direction = add_scaled(direction, 1.0, offset);
        }
    }
    let length = norm(direction);
    let inwards = if face.is_upper { -1.0 } else { 1.0 };
    if length < ROUNDING || direction[axis] * inwards <= 0.0 {
        direction = [0.0; D];
        direction[axis] = inwards;
    } else {
        direction = direction.map(|x| x / length);
    }
    let mut t = 0.5 * THICKNESS_STEP;
    while t < MAX_THICKNESS {
        let sample = voxels.sample_at(add_scaled(centre, t, direction))?;
        if voxels.part_at(sample) != part {
            break;
        }
        t += THICKNESS_STEP;
    }
    Some([t - 0.5 * THICKNESS_STEP, 1.0])
}

fn least_thickness(chords: Vec<[f64; 2]>) -> Option<f64> {
    weighted_quantiles(chords, [THIN_SHARE]).map(|[thickness]| thickness)
}

/// Returns the sum of a part, which is the last one or a new one.
fn sum_of<const D: usize>(sums: &mut Vec<(u32, DistanceSum<D>)>, part: u32) -> &mut DistanceSum<D> {
    if sums.last().is_none_or(|(last, _)| *last != part) {
        sums.push((part, DistanceSum::default()));
    }
    let last = sums.len() - 1;
    &mut sums[last].1
}

/// Calls `visit` with the centroid and the area of each of the equal small pieces of a facet.
fn visit_pieces<const D: usize>(shape: &[[f64; D]; D], mut visit: impl FnMut([f64; D], f64)) {
    let (u, v) = (sub(shape[1], shape[0]), sub(shape[D - 1], shape[0]));
    let longest = norm(u).max(norm(v)).max(norm(sub(v, u)));
    let n = (longest / MAX_PIECE_EDGE).ceil().clamp(1.0, 64.0) as usize;
    let area = norm(normal(shape)) / n.pow(D as u32 - 1) as f64;
    let mut visit_at = |i: f64, j: f64| {
        let (s, t) = (i / n as f64, j / n as f64);
        visit(add_scaled(add_scaled(shape[0], s, u), t, v), area);
    };
    for i in 0..n {
        if D == 2 {
            visit_at(i as f64 + 0.5, 0.0);
            continue;
        }
        for j in 0..n - i {
            let (i, j) = (i as f64, j as f64);
            visit_at(i + 1.0 / 3.0, j + 1.0 / 3.0);
            if i + j + 1.5 < n as f64 {
                visit_at(i + 2.0 / 3.0, j + 2.0 / 3.0);
            }
        }
    }
}

/// A grid of the facets that overlap each of its cells.
struct FacetGrid<const D: usize> {
    dims: [usize; D],
    start: Vec<u32>,
    facets: Vec<u32>,
}

impl<const D: usize> FacetGrid<D> {
    fn new(image_dims: [usize; D], shapes: &[[[f64; D]; D]]) -> Self {
        let dims = image_dims.map(|n| (n as f64 / GRID_CELL) as usize + 1);
        let grid = Self {
            dims,
            start: Vec::new(),
            facets: Vec::new(),
        };
        let (mut places, mut facets) = (Vec::new(), Vec::new());
        for (f, shape) in shapes.iter().enumerate() {
            grid.visit_cells(bounding_box(shape), |place| {
                places.push(place);
                facets.push(f as u32);
            });
        }
        let (start, order) = sort_by_group(dims.iter().product(), places.into_iter());
        Self {
            start,
            facets: order.iter().map(|&i| facets[i as usize]).collect(),
            ..grid
        }
    }

    /// Visits the cells that overlap a box.
    fn visit_cells(&self, [low, high]: [[f64; D]; 2], mut visit: impl FnMut(usize)) {
        let cell = |x: f64, k: usize| ((x / GRID_CELL).max(0.0) as usize).min(self.dims[k] - 1);
        let first: [usize; D] = std::array::from_fn(|k| cell(low[k], k));
        let counts: [usize; D] = std::array::from_fn(|k| cell(high[k], k) - first[k] + 1);
        for number in 0..counts.iter().product() {
            let step = index_at(counts, number);
            visit(offset_of(
                self.dims,
                std::array::from_fn(|k| first[k] + step[k]),
            ));
        }
    }

    /// Returns the distance along a ray to the first facet that `is_searched`, at most
    /// [`MAX_THICKNESS`] if there is one farther away; `None` if the ray leaves the image before.
    fn first_hit(
        &self,
        origin: [f64; D],
        direction: [f64; D],
        shapes: &[[[f64; D]; D]],
        is_searched: impl Fn(usize) -> bool,
    ) -> Option<f64> {
        let mut begin = 0.0;
        while begin < MAX_THICKNESS {
            let end = begin + GRID_CELL;
            let ends = [begin, end].map(|t| add_scaled(origin, t, direction));
            let mut nearest = f64::INFINITY;
            self.visit_cells(bounding_box(ends), |place| {
                for &f in &self.facets[self.start[place] as usize..self.start[place + 1] as usize] {
                    let f = f as usize;
                    if is_searched(f)
                        && let Some(t) = hit_distance(origin, direction, &shapes[f])
                        && t > ROUNDING
                    {
                        nearest = nearest.min(t);
                    }
                }
            });
            if nearest <= end {
                return Some(nearest.min(MAX_THICKNESS));
            }
            let is_inside =
                (0..D).all(|k| (0.0..=GRID_CELL * self.dims[k] as f64).contains(&ends[1][k]));
            if !is_inside {
                return None;
            }
            begin = end;
        }
        Some(MAX_THICKNESS)
    }
}

/// Returns the distance along a ray at which it meets a facet.
fn hit_distance<const D: usize>(
    origin: [f64; D],
    direction: [f64; D],
    shape: &[[f64; D]; D],
) -> Option<f64> {
    let (d, u) = (to_3d(direction), to_3d(sub(shape[1], shape[0])));
    // In 2-D, an edge becomes a strip across the plane.
    let v = if D == 2 {
        [0.0, 0.0, 1.0]
    } else {
        to_3d(sub(shape[D - 1], shape[0]))
    };
    let p = cross(d, v);
    let determinant = dot(u, p);
    if determinant.abs() < 1e-12 {
        return None;
    }
    let offset = to_3d(sub(origin, shape[0]));
    let s = dot(offset, p) / determinant;
    let q = cross(offset, u);
    let t = if D == 2 { 0.0 } else { dot(d, q) / determinant };
    let is_inside = s >= -ROUNDING && t >= -ROUNDING && s + t <= 1.0 + ROUNDING;
    is_inside.then(|| dot(v, q) / determinant)
}
