//! Closes holes in feature surfaces by marking further faces.
//!
//! Where the mesh could not follow a surface, cells straddle it, and the marked faces leave a hole
//! through which a fluid could flow. The centroid of each cell is on one side of the surface, so
//! the faces between cells on different sides form a surface that has no rim, except where the
//! feature surface itself has one. The faces that close a hole are marked. Faces that hang over a
//! rim (at the tip of a fault, or across a hole that the image shows) are removed again.
//!
//! - `surface`: marked faces, and the compartments between them
//! - `local_surface`: the marked faces of one rank, and those that it shares with other ranks
//! - `gathered_cells`: the cells near rims, gathered on all ranks

mod gathered_cells;
mod local_surface;
mod surface;

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};

use crate::parallel::prelude::*;

use super::feature_planes::{FeaturePlanes, NearbyPlanes, SAME_SURFACE_COSINE};
use crate::Result;
use crate::feature::FeaturePoint;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{dot, norm, sorted_distinct, sub, to_3d};
use crate::lattice::distance::Distance;
use crate::mesh::Simplices;
use crate::mesh::complex::NOT_LOCAL;
use crate::mesh::view::MeshView;
use crate::progress::CancelToken;
use gathered_cells::GatheredCells;
use local_surface::LocalSurface;
use surface::{CompartmentPairs, MarkedSurface, Ridge, RidgeFan, ridge_nodes};

/// Radius, in units of d, of the patches that determine on which side of a surface a cell is.
const PATCH_RADIUS: f64 = 0.8;
/// Radius of these patches in the plane, in units of d. It is larger because patches contain fewer
/// points there.
const CURVE_PATCH_RADIUS: f64 = 1.2;
/// Smallest and largest radius of the patches, in samples.
const PATCH_RADIUS_RANGE: [f64; 2] = [2.5, 6.5];
/// Radius, in samples, above which patches of surfaces take only every second point.
const MIN_DENSE_RADIUS: f64 = 4.5;

/// Largest difference between the planes at two cells that belong to one surface, in units of the
/// distance of the cells.
const SAME_SURFACE_SLOPE: f64 = 0.35;

/// Smallest volume of a compartment between faces, in units of d^D. A smaller one is a pocket.
const MIN_COMPARTMENT_VOLUME: f64 = 0.5;

/// Largest number of rings of cells that are gathered in addition when surfaces grow beyond the
/// gathered cells.
const MAX_RINGS: usize = 4;

/// Returns the radius of patches where the lattice has spacing d.
fn radius_at<const D: usize>(d: f64) -> f64 {
    let patch = if D == 2 {
        CURVE_PATCH_RADIUS
    } else {
        PATCH_RADIUS
    };
    (patch * d).clamp(PATCH_RADIUS_RANGE[0], PATCH_RADIUS_RANGE[1])
}

/// Report of closing holes.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct SealReport {
    /// Number of faces added.
    pub faces: usize,
    /// Area of these faces (length in the plane).
    pub area: f64,
    /// Number of pockets that were opened: a few cells enclosed by these faces and others.
    pub pockets: usize,
    /// Number of compartments into which the faces on features divide the mesh. Two cells are in
    /// one compartment if a path connects them without crossing such a face.
    pub compartments: usize,
}

/// Marks further faces of a mesh that close holes in the surfaces of `points`, and marks every
/// marked face on both of its sides. The mesh may be distributed; then every rank gets the report
/// on the global mesh. Collective.
///
/// `marks` has bit k of a cell for its face k. `neighbours` has, for every cell and face in order,
/// the adjacent cell, `NONE` or `NOT_LOCAL`. `points` must contain at least the feature points near
/// the local cells. `distance_near` returns d near some positions, and `max_distance` is its
/// maximum.
///
/// All holes lie at the rims of surfaces. If the mesh is distributed, each rank gathers the cells
/// near all rims and performs the same operations on them. The rank that owns a cell computes the
/// feature planes near it and sends them to all.
///
/// # Errors
/// Returns [`Error::Mesh`](crate::Error::Mesh) if the partitions do not fit each other, and an
/// error if another rank fails.
#[expect(
    clippy::too_many_arguments,
    reason = "mesh, features, distances and marks belong to different owners"
)]
pub fn seal<'a, const D: usize, M: Simplices<D>>(
    view: &MeshView<'_, D, M>,
    neighbours: &[u32],
    points: &[FeaturePoint<D>],
    extent: [f64; D],
    max_distance: f64,
    distance_near: impl Fn(&[[f64; D]]) -> Result<Cow<'a, Distance<D>>>,
    marks: &mut [u8],
    cancel: &CancelToken<'_>,
) -> Result<SealReport> {
    let radius = radius_at::<D>(max_distance);
    let planes = FeaturePlanes::new(points, extent, radius, radius);
    let surface = MarkedSurface {
        mesh: view.mesh,
        neighbours,
        marks,
    };
    let mut local = LocalSurface { view, surface };
    local.mark_both_sides()?;
    let is_cancelled = || view.is_any("cancellation", cancel.is_cancelled());
    if !view.is_partitioned() {
        let mut marks = local.surface.marks.to_vec();
        let surface = MarkedSurface {
            mesh: view.mesh,
            neighbours,
            marks: &mut marks,
        };
        let distance = distance_near(view.mesh.nodes())?;
        let mut sealer = Sealer::new(surface, &planes, &distance);
        sealer.grow(is_cancelled, |sealer, cells| {
            Ok(sealer.planes_near_cells(&cells))
        })?;
        sealer.remove_overhangs();
        return local.close_holes(&sealer, |c| c as usize);
    }
    let mut gathered = GatheredCells::default();
    let mut pending_nodes = local.rim_nodes()?;
    let mut rings = 1;
    let mut known_planes = Vec::new();
    loop {
        for _ in 0..rings {
            pending_nodes = gathered.gather(&pending_nodes, &local)?;
        }
        let (mesh, neighbours) = gathered.local_mesh::<M>()?;
        let mut marks = gathered.local_marks();
        let surface = MarkedSurface {
            mesh: &mesh,
            neighbours: &neighbours,
            marks: &mut marks,
        };
        // The distance is fetched for all gathered cells, whichever rank owns them.
        let distance = distance_near(mesh.nodes())?;
        let mut sealer = Sealer::new(surface, &planes, &distance);
        let to_local = |(global_id, planes)| (gathered.local_cell(global_id), planes);
        sealer.cell_planes = known_planes.into_iter().map(to_local).collect();
        sealer.grow(is_cancelled, |sealer, cells| {
            let owned_cells = cells
                .into_iter()
                .filter(|&c| local.has_cell(gathered.global_cell(c)));
            let owned_cells: Vec<u32> = owned_cells.collect();
            let planes = sealer.planes_near_cells(&owned_cells);
            view.concatenate("planes near cells", planes)
        })?;
        if sealer.incomplete_nodes.is_empty() {
            sealer.remove_overhangs();
            return local.close_holes(&sealer, |c| gathered.global_cell(c));
        }
        // Repeat with the missing cells. The planes that are known need not be computed again.
        let incomplete = sealer.incomplete_nodes.iter();
        pending_nodes = sorted_distinct(incomplete.map(|&n| gathered.global_node(n)));
        let cell_planes = sealer.cell_planes.into_iter();
        known_planes = cell_planes
            .map(|(c, planes)| (gathered.global_cell(c), planes))
            .collect();
        rings = MAX_RINGS.min(2 * rings);
    }
}

/// State of closing holes in the gathered part of a mesh. Nodes at which cells are missing are
/// recorded.
struct Sealer<'a, const D: usize, M> {
    surface: MarkedSurface<'a, D, M>,
    planes: &'a FeaturePlanes,
    distance: &'a Distance<D>,
    /// Planes near the centroids of cells, as far as they have been computed.
    cell_planes: HashMap<u32, NearbyPlanes>,
    /// Faces that may close holes, by the smaller of their two indices.
    new_faces: Vec<u32>,
    /// Number of faces, marked or new, that meet at each ridge of these.
    faces_at_ridge: HashMap<Ridge, u32>,
    /// Nodes of ridges of new faces around which cells are not local.
    incomplete_nodes: Vec<u32>,
}

impl<'a, const D: usize, M: Simplices<D>> Sealer<'a, D, M> {
    fn new(
        surface: MarkedSurface<'a, D, M>,
        planes: &'a FeaturePlanes,
        distance: &'a Distance<D>,
    ) -> Self {
        Self {
            surface,
            planes,
            distance,
            cell_planes: HashMap::new(),
            new_faces: Vec::new(),
            faces_at_ridge: HashMap::new(),
            incomplete_nodes: Vec::new(),
        }
    }

    /// Returns `true` if a surface may end at a ridge of cell c, because the ridge lies on the
    /// outside of the mesh.
    fn may_end(&self, c: u32, ridge: Ridge) -> bool {
        self.surface.visit_ridge_cells(c, ridge, |_| ()) != RidgeFan::Closed
    }

    /// Returns the centroid of a cell.
    fn centroid(&self, c: u32) -> [f64; 3] {
        let mesh = self.surface.mesh;
        let nodes = mesh
            .cell(c as usize)
            .iter()
            .map(|&n| mesh.nodes()[n as usize]);
        to_3d(nodes.fold([0.0; D], |sum, x| {
            std::array::from_fn(|k| sum[k] + x[k] / (D + 1) as f64)
        }))
    }

    /// Returns the planes near the centroid of a cell.
    fn planes_near(&self, c: u32) -> NearbyPlanes {
        let radius = radius_at::<D>(self.spacing(c));
        let every_second = D == 3 && radius > MIN_DENSE_RADIUS;
        self.planes
            .planes_within(self.centroid(c), radius, every_second)
    }

    /// Returns each of the cells with the planes near its centroid.
    fn planes_near_cells(&self, cells: &[u32]) -> Vec<(u32, NearbyPlanes)> {
        cells
            .par_iter()
            .map(|&c| (c, self.planes_near(c)))
            .collect()
    }

    /// Returns `true` if a surface passes between two cells.
    fn are_separated(&self, a: u32, b: u32) -> bool {
        let (Some(planes_a), Some(planes_b)) = (self.cell_planes.get(&a), self.cell_planes.get(&b))
        else {
            return false;
        };
        let displacement = sub(self.centroid(b), self.centroid(a));
        let distance = norm(displacement);
        planes_a.iter().any(|plane_a| {
            planes_b.iter().any(|plane_b| {
                let cosine = dot(plane_a.normal, plane_b.normal);
                // Signed distance of b from the surface: as fitted at b, and as predicted by the
                // plane at a.
                let offset = plane_b.offset * cosine.signum();
                let predicted = plane_a.offset + dot(displacement, plane_a.normal);
                cosine.abs() > SAME_SURFACE_COSINE
                    && (plane_a.offset < 0.0) != (offset < 0.0)
                    && (predicted - offset).abs() < SAME_SURFACE_SLOPE * distance
            })
        })
    }

    /// Adds the faces that separate cells on different sides of a surface, starting at the rims of
    /// the marked faces, until none is left or `is_cancelled` returns `true`. `find_planes` returns
    /// the planes near some cells.
    fn grow(
        &mut self,
        is_cancelled: impl Fn() -> Result<bool>,
        find_planes: impl Fn(&Self, Vec<u32>) -> Result<Vec<(u32, NearbyPlanes)>>,
    ) -> Result<()> {
        let n = D as u32 + 1;
        let mut face_count: HashMap<Ridge, u32> = HashMap::new();
        let marked = self.surface.unique_marked_faces();
        for &face in &marked {
            for ridge in self.surface.ridges(face) {
                *face_count.entry(ridge).or_default() += 1;
            }
        }
        let mut next = Vec::new();
        for &face in &marked {
            for ridge in self.surface.ridges(face) {
                if face_count[&ridge] == 1 {
                    let old_len = next.len();
                    // If the cells around a ridge do not form a closed fan, the surface ends at a
                    // side of the box there. All cells around rims are local.
                    let fan = self
                        .surface
                        .visit_ridge_cells(face / n, ridge, |c| next.push(c));
                    if fan != RidgeFan::Closed {
                        next.truncate(old_len);
                    }
                }
            }
        }
        self.faces_at_ridge = face_count;
        let mut is_visited = vec![false; self.surface.mesh.len()];
        while !next.is_empty() && !is_cancelled()? {
            let mut cells = std::mem::take(&mut next);
            cells.sort_unstable();
            cells.dedup();
            cells.retain(|&c| !std::mem::replace(&mut is_visited[c as usize], true));
            let unseen = cells.iter().filter(|c| !self.cell_planes.contains_key(*c));
            self.cell_planes
                .extend(find_planes(self, unseen.copied().collect())?);
            for &c in &cells {
                for face in n * c..n * (c + 1) {
                    let neighbour = self.surface.neighbours[face as usize];
                    // If both cells of a face are new, only the second one adds the face.
                    let seen = neighbour < NOT_LOCAL && is_visited[neighbour as usize];
                    let twice = seen && neighbour > c && cells.binary_search(&neighbour).is_ok();
                    if !seen
                        || twice
                        || self.surface.is_marked(face)
                        || !self.are_separated(c, neighbour)
                    {
                        continue;
                    }
                    let twin = self.surface.twin(face).unwrap_or(face);
                    self.new_faces.push(face.min(twin));
                    for ridge in self.surface.ridges(face) {
                        *self.faces_at_ridge.entry(ridge).or_default() += 1;
                        if self.surface.visit_ridge_cells(c, ridge, |c| next.push(c))
                            == RidgeFan::NotLocal
                        {
                            self.incomplete_nodes.extend(ridge_nodes(ridge));
                        }
                    }
                }
            }
        }
        self.new_faces.sort_unstable();
        Ok(())
    }

    /// Removes new faces that hang over a rim.
    fn remove_overhangs(&mut self) {
        let mut faces_at: HashMap<Ridge, Vec<u32>> = HashMap::new();
        for &face in &self.new_faces {
            for ridge in self.surface.ridges(face) {
                faces_at.entry(ridge).or_default().push(face);
            }
        }
        let mut is_removed = vec![false; self.new_faces.len()];
        let mut queue = self.new_faces.clone();
        while let Some(face) = queue.pop() {
            let Ok(index) = self.new_faces.binary_search(&face) else {
                continue;
            };
            let ridges: Vec<Ridge> = self.surface.ridges(face).collect();
            let cell = face / (D as u32 + 1);
            let hangs =
                |ridge: &Ridge| self.faces_at_ridge[ridge] == 1 && !self.may_end(cell, *ridge);
            if is_removed[index] || !ridges.iter().any(hangs) {
                continue;
            }
            is_removed[index] = true;
            for ridge in ridges {
                if let Some(count) = self.faces_at_ridge.get_mut(&ridge) {
                    *count -= 1;
                }
                queue.extend(faces_at[&ridge].iter().filter(|&&f| f != face));
            }
        }
        let mut removed_flags = is_removed.iter();
        self.new_faces
            .retain(|_| !removed_flags.next().is_some_and(|removed| *removed));
        for i in 0..self.new_faces.len() {
            self.surface.set_mark(self.new_faces[i], true);
        }
    }

    /// Returns the pockets that new faces have created, each with the compartment with which it
    /// shares most of their area. They are to be opened. `volumes` are those of the compartments,
    /// and `adjacent` has the compartments on both sides of each new face.
    fn find_pockets(&self, volumes: &[f64], adjacent: &[[u32; 2]]) -> CompartmentPairs {
        // For each pocket and adjacent compartment, the area of the new faces between them.
        let mut between: BTreeMap<u32, BTreeMap<u32, f64>> = BTreeMap::new();
        for (&face, &[r, s]) in self.new_faces.iter().zip(adjacent) {
            let d = self.spacing(face / (D as u32 + 1));
            for (compartment, other) in [(r, s), (s, r)] {
                if r != s
                    && volumes[compartment as usize] < MIN_COMPARTMENT_VOLUME * d.powi(D as i32)
                {
                    let areas = between.entry(compartment).or_default();
                    *areas.entry(other).or_default() += self.surface.face_area(face);
                }
            }
        }
        let mut merged = UnionFind::new(volumes.len());
        let mut opened = Vec::new();
        for (pocket, areas) in between {
            let larger = |best: (u32, f64), (&other, &area): (&u32, &f64)| {
                if area > best.1 { (other, area) } else { best }
            };
            let (other, _) = areas.iter().fold((pocket, 0.0), larger);
            if merged.find(pocket) != merged.find(other) {
                merged.unite(pocket, other);
                opened.push([pocket, other]);
            }
        }
        CompartmentPairs::new(opened)
    }

    /// Returns the lattice spacing at a cell.
    fn spacing(&self, c: u32) -> f64 {
        let mesh = self.surface.mesh;
        self.distance
            .value_at(mesh.nodes()[mesh.cell(c as usize)[0] as usize])
    }

    /// Returns the report after pockets are opened. `adjacent` has the compartments on both sides
    /// of each new face, and `compartment_count` is their number before.
    fn report(
        &self,
        opened: &CompartmentPairs,
        adjacent: &[[u32; 2]],
        compartment_count: usize,
    ) -> SealReport {
        let new_faces = self.new_faces.iter().zip(adjacent);
        let remaining = new_faces.filter(|(_, adjacent)| !opened.contains(**adjacent));
        SealReport {
            faces: remaining.clone().count(),
            area: remaining
                .map(|(&face, _)| self.surface.face_area(face))
                .sum(),
            pockets: opened.count(),
            compartments: compartment_count - opened.count(),
        }
    }
}

#[cfg(test)]
mod tests;
