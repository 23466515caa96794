//! Checks of polyhedra and polygons: cells are closed and contain their sites; faces are flat and
//! lie between two cells or in a side of the box.

use super::{BoxBounds, CellChecks, Check, CheckHints, OuterBoundary, SideCoverage, flat};
use crate::Result;
use crate::geometry::NONE;
use crate::geometry::dot;
use crate::mesh::Mesh;
use crate::mesh::poly::{FIRST_SIDE, FaceNeighbour, PolyMesh};
use crate::mesh::view::MeshView;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;
use serde::Serialize;

/// Results of the check that exist for polyhedra and polygons only.
#[derive(Debug, Clone, Serialize, PartialEq, Default)]
pub struct CellCheck {
    /// Number of faces, each counted once.
    pub faces: usize,
    /// `true` if the cells are columns whose layers, top or base are not level.
    pub is_columnar: bool,
    /// Number of cells whose faces do not close: an edge (a node in 2-D) is not shared by exactly
    /// two of them.
    pub open_cells: usize,
    /// Number of cells that do not contain their own site.
    pub cells_without_site: usize,
    /// Largest distance of a node from the plane of its face, relative to the box's longest side.
    pub warp: f64,
    /// Largest width of a part that the outline of a face cuts off where it crosses itself,
    /// relative to the box's longest side.
    pub self_crossing_width: f64,
}

impl<const D: usize> CellChecks<D> for PolyMesh<D> {
    fn unreadable_reason(&self, _: usize) -> Option<String> {
        let (nodes, cells, faces) = (self.nodes.len(), self.sites.len(), self.face_cells.len());
        if self.faces.len() != faces || self.region.len() != cells || self.on_feature.len() != faces
        {
            return Some("its arrays differ in length".into());
        }
        for f in 0..faces {
            let ring = self.faces.get(f);
            if ring.iter().any(|&n| n as usize >= nodes) {
                return Some(format!("face {f} names a node that does not exist"));
            }
            if ring.len() < D || (1..ring.len()).any(|i| ring[..i].contains(&ring[i])) {
                return Some(format!("face {f} has the nodes {ring:?}"));
            }
            let [a, b] = self.face_cells[f];
            let known = b >= FIRST_SIDE && (b - FIRST_SIDE < 2 * D as u32 || b == NONE);
            if a as usize >= cells || !(known || (a < b && (b as usize) < cells)) {
                return Some(format!("face {f} lies between the cells {a} and {b}"));
            }
        }
        None
    }

    fn used_nodes(&self) -> Vec<bool> {
        let mut used = vec![false; self.nodes.len()];
        for &n in &self.faces.items {
            used[n as usize] = true;
        }
        used
    }

    fn target_volume(&self, bounds: &BoxBounds<D>) -> f64 {
        if is_columnar(self, bounds) {
            self.enclosed_volume()
        } else {
            bounds.extent().iter().product()
        }
    }

    fn check_faces(
        view: &MeshView<'_, D, Self>,
        hints: CheckHints<'_>,
        bounds: &BoxBounds<D>,
        report: &mut Check,
        cancel: &CancelToken<'_>,
    ) -> Result<Option<SideCoverage<D>>> {
        let mesh = view.mesh;
        let in_columns = is_columnar(mesh, bounds);
        let faces = mesh.faces_of_cells();
        let validity: Vec<[bool; 2]> = (0..mesh.sites.len())
            .into_par_iter()
            .map(|cell| {
                if cancel.is_cancelled() {
                    return [true; 2];
                }
                let faces = faces.get(cell);
                let holds_site = contains_site(mesh, cell, faces, in_columns);
                [is_closed(mesh, cell, faces), holds_site]
            })
            .collect();
        let mut count_failures = |criterion: usize, problem: &str| {
            let count = validity.iter().filter(|c| !c[criterion]).count();
            if let Some(first) = validity.iter().position(|c| !c[criterion]) {
                report.add_problem(format!(
                    "{count} {} {problem}, the first is {first}",
                    Self::CELLS_NAME
                ));
            }
            count
        };
        let (not_closed, without_site) = (
            count_failures(0, "are not closed"),
            count_failures(1, "do not contain their site"),
        );

        let max_excess = |deviation: &(dyn Fn(usize) -> f64 + Sync)| {
            let excess = |f: usize| {
                if cancel.is_cancelled() {
                    0.0
                } else {
                    (deviation(f) - flat::weld_offset(mesh, f, hints.weld)).max(0.0)
                }
            };
            let excesses = (0..mesh.face_cells.len()).into_par_iter().map(excess);
            excesses.reduce(|| 0.0, f64::max) / bounds.longest_side()
        };
        let warp = max_excess(&|f| {
            if in_columns && !mesh.is_upright(f) {
                0.0
            } else {
                flat::warp(mesh, f)
            }
        });
        if warp > bounds.tolerance {
            report.add_problem(format!("a face is not flat, by {warp:.1e} of the box"));
        }
        let crossing_width = max_excess(&|f| flat::self_crossing_width(mesh, f));
        if crossing_width > bounds.tolerance {
            report.add_problem(format!(
                "the outline of a face crosses itself, by {crossing_width:.1e} of the box"
            ));
        }
        report.cell_check = Some(CellCheck {
            faces: mesh.face_cells.len(),
            is_columnar: in_columns,
            open_cells: not_closed,
            cells_without_site: without_site,
            warp,
            self_crossing_width: crossing_width,
        });
        Ok(boundary_sides(
            mesh,
            in_columns,
            hints.outer,
            bounds,
            report,
        ))
    }
}

/// Returns the invalid cells, in ascending order: cells that are not closed, do not contain their
/// site, are flat or inverted, or have a face that uses a node twice, or that is bent or crosses itself by
/// more than welding by the fraction `weld` explains and `max_offset`.
pub fn broken_cells<const D: usize>(mesh: &PolyMesh<D>, weld: f64, max_offset: f64) -> Vec<u32> {
    let faces = mesh.faces_of_cells();
    let shapes = mesh.cell_shapes();
    let is_ring = |&f: &u32| {
        let ring = mesh.faces.get(f as usize);
        ring.len() >= D && (1..ring.len()).all(|i| !ring[..i].contains(&ring[i]))
    };
    let is_flat = |&f: &u32| {
        let f = f as usize;
        let offset = flat::warp(mesh, f).max(flat::self_crossing_width(mesh, f));
        offset - flat::weld_offset(mesh, f, weld) <= max_offset
    };
    let is_broken = |cell: &u32| {
        let (cell, cell_faces) = (*cell as usize, faces.get(*cell as usize));
        let is_valid = cell_faces.iter().all(is_ring)
            && cell_faces.iter().all(is_flat)
            && is_closed(mesh, cell, cell_faces)
            && contains_site(mesh, cell, cell_faces, false)
            && shapes[cell].0 > 0.0;
        !is_valid
    };
    let cells = 0..mesh.sites.len() as u32;
    cells.into_par_iter().filter(is_broken).collect()
}

/// Returns `true` if the cells are columns whose layers, top or base are not level.
fn is_columnar<const D: usize>(mesh: &PolyMesh<D>, bounds: &BoxBounds<D>) -> bool {
    let max_offset = bounds.tolerance * bounds.longest_side();
    mesh.is_columnar() && has_bent_layer(mesh, bounds.low, bounds.high, max_offset)
}

/// Returns `true` if a face above or below a cell of a column is not level, or the top or the base
/// is not in a side of the box. A height may differ by `max_offset`.
fn has_bent_layer<const D: usize>(
    mesh: &PolyMesh<D>,
    low: [f64; D],
    high: [f64; D],
    max_offset: f64,
) -> bool {
    (0..mesh.face_cells.len()).any(|f| {
        let ring = mesh.faces.get(f);
        let plane = match mesh.face_neighbour(f) {
            FaceNeighbour::Cell(_) if !mesh.is_upright(f) => mesh.nodes[ring[0] as usize][D - 1],
            FaceNeighbour::Side(4) => low[D - 1],
            FaceNeighbour::Side(5) => high[D - 1],
            _ => return false,
        };
        let offset = |&n: &u32| (mesh.nodes[n as usize][D - 1] - plane).abs();
        ring.iter().map(offset).any(|off| off > max_offset)
    })
}

/// Returns `true` if every edge of a cell is shared by two of its faces, in opposite directions (in
/// 2-D: every node is the end of one edge and the start of another).
fn is_closed<const D: usize>(mesh: &PolyMesh<D>, cell: usize, faces: &[u32]) -> bool {
    let mut edges: Vec<([u32; 2], i32)> = Vec::with_capacity(6 * faces.len());
    for &f in faces {
        let ring = mesh.faces.get(f as usize);
        let is_first_cell = mesh.face_cells[f as usize][0] as usize == cell;
        let sign = if is_first_cell { 1 } else { -1 };
        if D == 2 {
            edges.push(([ring[0]; 2], sign));
            edges.push(([ring[1]; 2], -sign));
            continue;
        }
        for i in 0..ring.len() {
            let (p, q) = (ring[i], ring[(i + 1) % ring.len()]);
            edges.push(([p.min(q), p.max(q)], if p < q { sign } else { -sign }));
        }
    }
    edges.sort_unstable();
    let pairs = edges.chunk_by(|a, b| a.0 == b.0);
    faces.len() > D
        && pairs
            .into_iter()
            .all(|e| e.len() == 2 && e[0].1 + e[1].1 == 0)
}

/// Returns `true` if a cell's site is on the inner side of all its faces that have an area.
fn contains_site<const D: usize>(
    mesh: &PolyMesh<D>,
    cell: usize,
    faces: &[u32],
    in_columns: bool,
) -> bool {
    faces.iter().all(|&f| {
        let shape = mesh.face_shape(f as usize);
        let site = mesh.sites[cell];
        // Layers may be bent, so the point of the face directly above or below the site is
        // compared.
        let projection = (in_columns && !mesh.is_upright(f as usize))
            .then(|| mesh.vertical_projection(f as usize, site));
        let point = projection.flatten().unwrap_or(shape.apex);
        let out: [f64; D] = std::array::from_fn(|k| point[k] - site[k]);
        let is_first_cell = mesh.face_cells[f as usize][0] as usize == cell;
        let height = dot(out, shape.area_vector) * if is_first_cell { 1.0 } else { -1.0 };
        // The normal of such a small face (or of a narrow one, which has a small area too) is
        // dominated by rounding.
        let distance = dot(out, out).sqrt();
        shape.area() < (1e-4 * distance).powi(D as i32 - 1)
            || height >= -1e-12 * distance * shape.area()
    })
}

/// Adds every face with one cell to the coverage of its side of the box, except those where cells were
/// left out. Returns `None` if such a face lies in no side.
fn boundary_sides<const D: usize>(
    mesh: &PolyMesh<D>,
    in_columns: bool,
    outer: Option<&OuterBoundary>,
    bounds: &BoxBounds<D>,
    report: &mut Check,
) -> Option<SideCoverage<D>> {
    // The upright sides of columns end at the top and the base, so they need not cover the box's
    // sides.
    let mut sides = SideCoverage::uncovered();
    if in_columns {
        sides.must_be_covered = std::array::from_fn(|axis| axis == 2);
    }
    for f in mesh.inner_face_count()..mesh.face_cells.len() {
        if outer.is_some_and(|outer| outer.contains(mesh.faces.get(f))) {
            sides.declared_faces += 1;
            continue;
        }
        let FaceNeighbour::Side(side) = mesh.face_neighbour(f) else {
            // A cell of a column may lie beside no cell where a fault offsets the next column.
            if in_columns && mesh.is_upright(f) {
                continue;
            }
            report.add_problem(format!(
                "face {f} has one cell and lies in no side of the box"
            ));
            return None;
        };
        let (axis, upper) = (side / 2, side % 2 == 1);
        let plane = if upper { bounds.high } else { bounds.low }[axis];
        let bent = in_columns && axis == 2;
        let nodes = mesh.faces.get(f).iter().filter(|_| !bent);
        let offsets = nodes.map(|&n| (mesh.nodes[n as usize][axis] - plane).abs());
        let max_offset = offsets.fold(0.0, f64::max);
        let area = mesh.face_shape(f).area_vector[axis];
        let area = if upper { area } else { -area };
        sides.add(axis, upper, area, max_offset, bounds, report);
    }
    Some(sides)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::check::check;
    use crate::mesh::poly::samples::two_cells;

    fn faults<const D: usize>() {
        let checked = |change: &dyn Fn(&mut PolyMesh<D>)| {
            let mut mesh = two_cells::<D>(0.75);
            change(&mut mesh);
            let mut high = [1.0; D];
            high[0] = 2.0;
            check(&mesh, [0.0; D], high, 1e-12)
        };
        let good = checked(&|_| ());
        assert!(good.passed(), "{good:?}");
        assert_eq!((good.cells, good.volume_error), (2, 0.0));
        let last = 1 << D;
        for (change, want) in [
            (
                (&|m: &mut PolyMesh<D>| m.nodes[last][0] = 2.5) as &dyn Fn(&mut PolyMesh<D>),
                "fill",
            ),
            (&|m| m.nodes[last][0] = f64::NAN, "not finite"),
            (&|m| m.nodes.push([0.0; D]), "1 nodes belong to no poly"),
            (&|m| m.faces.items[0] = 99, "face 0 names a node"),
            (
                &|m| m.faces.items[0] = m.faces.items[1],
                "face 0 has the nodes",
            ),
            (&|m| m.face_cells[0] = [1, 0], "between the cells 1 and 0"),
            (&|m| m.sites[0][0] = 1.0, " do not contain their site"),
            (&|m| m.region.clear(), "differ in length"),
            (
                &|m| {
                    m.face_cells.pop();
                    m.on_feature.pop();
                    let end = m.faces.offsets.len() - 2;
                    m.faces.items.truncate(m.faces.offsets[end] as usize);
                    m.faces.offsets.pop();
                },
                " are not closed, the first is 1",
            ),
            (&|m| m.face_cells[1][1] = NONE, "lies in no side"),
            (&|m| m.sites.swap(0, 1), "contain their site"),
            (
                &|m| m.nodes.iter_mut().for_each(|p| p[0] = -p[0]),
                " are flat or inverted",
            ),
        ] {
            let report = checked(change);
            let problems = report.problems.join("\n");
            assert!(problems.contains(want), "{want}: {problems:?}");
        }
    }

    #[test]
    fn each_fault_is_found() {
        faults::<2>();
        faults::<3>();
    }

    #[test]
    fn warped_faces_are_found() {
        let mut mesh = two_cells::<3>(0.75);
        // One corner of the face between the cells moves along x, so the face is no longer flat.
        mesh.nodes[5][0] += 0.04;
        let report = check(&mesh, [0.0; 3], [2.0, 1.0, 1.0], 1e-12);
        let cell_check = report.cell_check.clone().unwrap();
        assert!(
            (0.004..0.02).contains(&cell_check.warp),
            "{}",
            cell_check.warp
        );
        assert_eq!((cell_check.open_cells, report.volume_error), (0, 0.0));
        assert!(!report.passed());
    }
}
