//! Writes the surfaces of a model as faces between the cells of a corner-point grid: FAULTS with
//! MULTFLT. If the multiplier of a surface varies, MULTX, MULTY and MULTZ are written instead of
//! MULTFLT.
//!
//! Two cells are neighbours if they share a part of a face. At a split pillar, a cell has several
//! neighbours on one side, in other layers than its own, and a simulator makes a connection to
//! each. A connection crosses a surface if the line between the centres of its two cells does. So
//! no connection bypasses a surface without holes.
//!
//! A record of FAULTS multiplies all connections of one face of one cell. Each connection must be
//! multiplied exactly once, and only if it crosses the surface. Connections that share faces form a
//! group, and for each group the faces are chosen as follows:
//!
//! 1. the faces of the lower cells (`X`, `Y`, `Z`), if all connections of these faces cross one
//!    surface, or several surfaces with equal multipliers
//! 2. otherwise, on the same condition, the faces of the upper cells (`X-`, `Y-`)
//! 3. otherwise those faces of lower cells that meet the condition. Every other connection gets a
//!    multiplier of its own: EDITNNC, or MULTIPLY of TRANX or TRANY between cells of one layer,
//!    which are not NNCs.

use std::collections::BTreeMap;
use std::io::Write;

use crate::parallel::prelude::*;

use super::cell_walk::CellWalker;
use super::grid::CornerPointGrid;
use crate::files::text::write_numbers;
use crate::files::text::{FileWriter, WriteResult};
use crate::geometry::union_find::UnionFind;
use crate::geometry::{bounding_box, norm, sorted_distinct, sub};
use crate::model::reservoir::Model;

/// Multipliers that differ by less than this are equal.
const FACTOR_TOLERANCE: f64 = 1e-9;
/// Minimum height of a common face, relative to the height of the grid. Cells with a lower common
/// face share none.
const MIN_CONTACT_HEIGHT_RATIO: f64 = 1e-9;

/// Connection of a cell to a cell of the next column along an axis, or of the next layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct GridConnection {
    pub axis: usize,
    pub lower: [usize; 3],
    pub upper: [usize; 3],
    /// `true` if the cells share a part of a face. Otherwise they are only in the same layer.
    pub shares_face: bool,
    /// Surface between the centres of the cells, and its multiplier.
    pub crossed_surface: Option<(u32, f64)>,
}

/// Face of a cell that lies on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
struct FaultCellFace {
    surface: u32,
    axis: usize,
    /// `true` if the face is on the negative side of the cell along the axis, `false` if on the
    /// positive side.
    is_negative_side: bool,
    cell: [usize; 3],
    factor: f64,
}

/// Fault multipliers of the cells of a corner-point grid.
pub struct FaultResistances {
    faces: Vec<FaultCellFace>,
    /// Surfaces whose multiplier varies, ascending.
    varying_surfaces: Vec<u32>,
    /// Connections that no face represents, with their multipliers.
    edits: Vec<([[usize; 3]; 2], f64)>,
}

/// The connections of each face of a grid through which a connection crosses a surface. Each cell
/// has a number for its face towards larger indices along each axis, and one for the opposite face.
struct FaceConnections<'a> {
    grid: &'a CornerPointGrid<'a>,
    cells: usize,
    connections: &'a [GridConnection],
    /// Pairs of a face and the index of one of its connections, ascending.
    by_face: Vec<(usize, usize)>,
}

impl<'a> FaceConnections<'a> {
    fn new(grid: &'a CornerPointGrid<'a>, connections: &'a [GridConnection]) -> Self {
        let mut faces = Self {
            grid,
            cells: grid.dims().iter().product(),
            connections,
            by_face: Vec::new(),
        };
        let faces_of = |c: &GridConnection| [faces.lower(c), faces.upper(c)];
        let crossing = connections.iter().filter(|c| c.crossed_surface.is_some());
        let crossed = sorted_distinct(crossing.flat_map(faces_of));
        let pairs = connections.iter().enumerate().flat_map(|(index, c)| {
            let is_crossed = |face: &usize| crossed.binary_search(face).is_ok();
            let selected = faces_of(c).into_iter().filter(is_crossed);
            selected.map(move |face| (face, index)).collect::<Vec<_>>()
        });
        let mut by_face: Vec<(usize, usize)> = pairs.collect();
        by_face.par_sort_unstable();
        faces.by_face = by_face;
        faces
    }

    /// Returns the number of the face of a connection's lower cell.
    fn lower(&self, c: &GridConnection) -> usize {
        c.axis * self.cells + self.grid.cell_index(c.lower)
    }

    /// Returns the number of the face of a connection's upper cell.
    fn upper(&self, c: &GridConnection) -> usize {
        (3 + c.axis) * self.cells + self.grid.cell_index(c.upper)
    }

    /// Returns the connections of a face to cells that share it.
    fn touching(&self, face: usize) -> impl Iterator<Item = &'a GridConnection> {
        let connections = self.connections;
        let start = self.by_face.partition_point(|pair| pair.0 < face);
        let of_face = self.by_face[start..]
            .iter()
            .take_while(move |pair| pair.0 == face);
        let of_face = of_face.map(move |&(_, at)| &connections[at]);
        of_face.filter(|c| c.shares_face)
    }

    /// Returns `true` if all connections of the face cross surfaces: one surface, or several with
    /// equal multipliers.
    fn is_pure(&self, face: usize) -> bool {
        let mut surfaces = self.touching(face).map(|c| c.crossed_surface);
        let Some(Some(first)) = surfaces.next() else {
            return false;
        };
        let is_equivalent =
            |other: (u32, f64)| other.0 == first.0 || (other.1 - first.1).abs() <= FACTOR_TOLERANCE;
        surfaces.all(|other| other.is_some_and(is_equivalent))
    }

    /// Returns the connections across surfaces, grouped: connections with a face in common are in
    /// one group.
    fn groups(&self) -> Vec<Vec<&'a GridConnection>> {
        let on_surface: Vec<&GridConnection> = (self.connections.iter())
            .filter(|c| c.shares_face && c.crossed_surface.is_some())
            .collect();
        let mut face_number: BTreeMap<usize, u32> = BTreeMap::new();
        for c in &on_surface {
            for face in [self.lower(c), self.upper(c)] {
                let next = face_number.len() as u32;
                face_number.entry(face).or_insert(next);
            }
        }
        let mut sets = UnionFind::new(face_number.len());
        for c in &on_surface {
            sets.unite(face_number[&self.lower(c)], face_number[&self.upper(c)]);
        }
        let mut groups: BTreeMap<u32, Vec<&GridConnection>> = BTreeMap::new();
        for c in on_surface {
            let set = sets.find(face_number[&self.lower(c)]);
            groups.entry(set).or_default().push(c);
        }
        groups.into_values().collect()
    }
}

impl FaultResistances {
    /// Finds all faces on surfaces.
    pub fn new(model: &Model, walker: &CellWalker, grid: &CornerPointGrid) -> Self {
        Self::of_connections(grid, find_connections(model, walker, grid))
    }

    /// Finds all faces on surfaces among the connections of a grid.
    pub(super) fn of_connections(
        grid: &CornerPointGrid,
        mut connections: Vec<GridConnection>,
    ) -> Self {
        connections.retain(|c| c.shares_face || c.crossed_surface.is_some());
        let mut range: BTreeMap<u32, [f64; 2]> = BTreeMap::new();
        for (surface, factor) in connections.iter().filter_map(|c| c.crossed_surface) {
            let [low, high] = range.entry(surface).or_insert([factor; 2]);
            (*low, *high) = (low.min(factor), high.max(factor));
        }
        let varying = range
            .iter()
            .filter(|(_, [low, high])| high - low > FACTOR_TOLERANCE);
        let mut resistances = Self {
            faces: Vec::new(),
            varying_surfaces: varying.map(|(&surface, _)| surface).collect(),
            edits: Vec::new(),
        };
        resistances.choose_faces(grid, &connections);
        // Fragments (surface 0) come last.
        (resistances.faces).sort_by_key(|f| {
            (
                f.surface.wrapping_sub(1),
                f.axis,
                f.is_negative_side,
                f.cell,
            )
        });
        resistances.edits.sort_by_key(|edit| edit.0);
        resistances
    }

    /// Returns the factors by which a simulator multiplies connections as these records say.
    pub(super) fn record_factors(&self, connections: &[GridConnection]) -> Vec<f64> {
        let mut face_factors = BTreeMap::new();
        for face in &self.faces {
            let key = (face.axis, face.is_negative_side, face.cell);
            *face_factors.entry(key).or_insert(1.0) *= face.factor;
        }
        let edits: BTreeMap<[[usize; 3]; 2], f64> = self.edits.iter().copied().collect();
        let factor = |c: &GridConnection| {
            let faces = [(c.axis, false, c.lower), (c.axis, true, c.upper)];
            let of_face = |key| face_factors.get(&key).copied().unwrap_or(1.0);
            let edit = edits.get(&[c.lower, c.upper]).copied().unwrap_or(1.0);
            faces.into_iter().map(of_face).product::<f64>() * edit
        };
        connections.iter().map(factor).collect()
    }

    /// Chooses the faces that represent the connections across surfaces.
    fn choose_faces(&mut self, grid: &CornerPointGrid, connections: &[GridConnection]) {
        let faces = FaceConnections::new(grid, connections);
        for group in faces.groups() {
            self.choose_group_faces(&faces, &group);
        }
        // Cells of one layer that share no face get a record if it multiplies no other connection.
        for c in connections.iter().filter(|c| !c.shares_face) {
            let Some((surface, factor)) = c.crossed_surface else {
                continue;
            };
            if faces.touching(faces.lower(c)).next().is_none() {
                self.faces.push(FaultCellFace {
                    surface,
                    axis: c.axis,
                    is_negative_side: false,
                    cell: c.lower,
                    factor,
                });
            }
        }
        self.edits
            .retain(|(_, factor)| (factor - 1.0).abs() > FACTOR_TOLERANCE);
    }

    /// Chooses the faces of a group of connections: their lower faces or their upper faces. Where
    /// neither represents a connection, the connection is edited.
    fn choose_group_faces(&mut self, faces: &FaceConnections<'_>, group: &[&GridConnection]) {
        let use_lower = group.iter().all(|c| faces.is_pure(faces.lower(c)));
        let use_upper =
            !use_lower && group[0].axis < 2 && group.iter().all(|c| faces.is_pure(faces.upper(c)));
        let mut factors: BTreeMap<usize, f64> = BTreeMap::new();
        for c in group {
            let face = if use_upper {
                faces.upper(c)
            } else {
                faces.lower(c)
            };
            let Some((surface, factor)) = c.crossed_surface else {
                continue;
            };
            if !faces.is_pure(face) {
                self.edits.push(([c.lower, c.upper], factor));
                continue;
            }
            // The face gets the largest multiplier, and connections with smaller ones are edited.
            let face_factors = faces.touching(face).filter_map(|c| c.crossed_surface);
            let max_factor = face_factors.map(|(_, factor)| factor).fold(0.0, f64::max);
            if factors.insert(face, max_factor).is_none() {
                self.faces.push(FaultCellFace {
                    surface,
                    axis: c.axis,
                    is_negative_side: use_upper,
                    cell: if use_upper { c.upper } else { c.lower },
                    factor: max_factor,
                });
            }
            if factor < max_factor - FACTOR_TOLERANCE {
                self.edits.push(([c.lower, c.upper], factor / max_factor));
            }
        }
    }

    /// Writes the surfaces and their multipliers for the GRID section of a deck.
    pub fn write(&self, out: FileWriter, names: &[String], grid: &CornerPointGrid) -> WriteResult {
        if self.faces.is_empty() {
            return Ok(());
        }
        writeln!(out, "FAULTS")?;
        for faces in self.faces.chunk_by(|a, b| a.surface == b.surface) {
            let name = &names[faces[0].surface as usize];
            for run in faces.chunk_by(is_continued_by) {
                let ([i, j, k], last) =
                    (run[0].cell.map(|n| n + 1), run[run.len() - 1].cell[2] + 1);
                let side = ["X", "Y", "Z"][run[0].axis];
                let sign = if run[0].is_negative_side { "-" } else { "" };
                writeln!(out, " '{name}' {i} {i} {j} {j} {k} {last} '{side}{sign}' /")?;
            }
        }
        writeln!(out, "/\n")?;
        let varies = |surface: u32| self.varying_surfaces.binary_search(&surface).is_ok();
        let mut multipliers = Vec::new();
        for faces in self.faces.chunk_by(|a, b| a.surface == b.surface) {
            let FaultCellFace {
                surface, factor, ..
            } = faces[0];
            if (factor - 1.0).abs() > FACTOR_TOLERANCE && !varies(surface) {
                multipliers.push((&names[surface as usize], without_rounding_error(factor)));
            }
        }
        if !multipliers.is_empty() {
            writeln!(out, "MULTFLT")?;
            for (name, factor) in multipliers {
                writeln!(out, " '{name}' {factor} /")?;
            }
            writeln!(out, "/\n")?;
        }
        let varying_faces: Vec<&FaultCellFace> = (self.faces.iter())
            .filter(|face| varies(face.surface))
            .collect();
        if varying_faces.is_empty() {
            return Ok(());
        }
        for is_negative in [false, true] {
            if is_negative && !varying_faces.iter().any(|face| face.is_negative_side) {
                continue;
            }
            for (axis, keyword) in ["MULTX", "MULTY", "MULTZ"].into_iter().enumerate() {
                let mut factors = vec![1.0; grid.dims().iter().product()];
                let is_selected = |face: &&&FaultCellFace| {
                    face.axis == axis && face.is_negative_side == is_negative
                };
                for face in varying_faces.iter().filter(is_selected) {
                    factors[grid.cell_index(face.cell)] = face.factor;
                }
                writeln!(out, "{keyword}{}", if is_negative { "-" } else { "" })?;
                write_numbers(out, factors.len(), |at| factors[at])?;
                writeln!(out, "/\n")?;
            }
        }
        Ok(())
    }

    /// Returns `true` if there are multipliers for the EDIT section of a deck.
    pub fn has_edits(&self) -> bool {
        !self.edits.is_empty()
    }

    /// Writes the multipliers of single connections for the EDIT section of a deck.
    pub fn write_edits(&self, out: FileWriter) -> WriteResult {
        let is_neighbour = |[a, b]: &[[usize; 3]; 2]| a[2] == b[2];
        let (neighbours, non_neighbours): (Vec<_>, Vec<_>) =
            (self.edits.iter()).partition(|(cells, _)| is_neighbour(cells));
        if !neighbours.is_empty() {
            writeln!(out, "MULTIPLY")?;
            for ([lower, upper], factor) in neighbours {
                let keyword = if upper[0] > lower[0] {
                    "TRANX"
                } else {
                    "TRANY"
                };
                let [i, j, k] = lower.map(|n| n + 1);
                writeln!(out, " '{keyword}' {factor} {i} {i} {j} {j} {k} {k} /")?;
            }
            writeln!(out, "/\n")?;
        }
        if !non_neighbours.is_empty() {
            writeln!(out, "EDITNNC")?;
            for (cells, factor) in non_neighbours {
                for [i, j, k] in cells.map(|cell| cell.map(|n| n + 1)) {
                    write!(out, " {i} {j} {k}")?;
                }
                writeln!(out, " {factor} /")?;
            }
            writeln!(out, "/\n")?;
        }
        Ok(())
    }
}

/// Returns `true` if one record can hold both faces: `b` belongs to the cell below the cell of `a`.
/// Faces towards the next layer need a record each, as OPM Flow requires.
fn is_continued_by(a: &FaultCellFace, b: &FaultCellFace) -> bool {
    let [i, j, k] = a.cell;
    a.axis < 2
        && (a.axis, a.is_negative_side) == (b.axis, b.is_negative_side)
        && b.cell == [i, j, k + 1]
}

/// Returns the layers of the next column along an axis whose cells share a part of a face with the
/// given cell.
pub(super) fn adjacent_layers(
    grid: &CornerPointGrid,
    axis: usize,
    [i, j, k]: [usize; 3],
) -> Vec<usize> {
    let [n, m, layers] = grid.dims();
    let mut next = [i, j];
    next[axis] += 1;
    if next[axis] == [n, m][axis] {
        return Vec::new();
    }
    // Corners on the two pillars between the columns.
    let corners = [[(1, 0), (3, 2)], [(2, 0), (3, 1)]][axis];
    let [this_column, next_column] = [[i, j], next].map(|[i, j]| j * n + i);
    let pillars = corners.map(|(this_corner, next_corner)| {
        [
            grid.layers.corner_depths(this_column, this_corner),
            grid.layers.corner_depths(next_column, next_corner),
        ]
    });
    let [high, low] = grid.pillars.z;
    let min_height = MIN_CONTACT_HEIGHT_RATIO * (high - low);
    let touches = |l: usize| {
        // The height of the common face is measured on both pillars, and where tops or bottoms
        // cross between them.
        let contact_height = |fraction: f64| {
            let z = |column: usize, k: usize| {
                let [a, b] = pillars.map(|pillar| pillar[column][k]);
                a + fraction * (b - a)
            };
            z(0, k).min(z(1, l)) - z(0, k + 1).max(z(1, l + 1))
        };
        let crossing = |k: usize, l: usize| {
            let [a, b] = pillars.map(|pillar| pillar[0][k] - pillar[1][l]);
            if a * b < 0.0 { a / (a - b) } else { 0.0 }
        };
        [0.0, 1.0, crossing(k, l), crossing(k + 1, l + 1)]
            .into_iter()
            .any(|fraction| contact_height(fraction) > min_height)
    };
    if pillars.iter().all(|[this, next]| this == next) {
        // Where the pillars are not split, only cells of one layer can touch.
        return (k..=k).filter(|&l| touches(l)).collect();
    }
    (0..layers).filter(|&l| touches(l)).collect()
}

/// Boxes of space near surfaces. Lines outside them cross no surface.
struct SurfaceBoxes {
    low: [f64; 3],
    edge: f64,
    dims: [usize; 3],
    is_near: Vec<bool>,
}

/// Number of boxes near surfaces for each cell of the model.
const BOXES_PER_CELL: f64 = 4.0;
/// Margin of the box of a face, relative to its size, because faces may be bent a little.
const FACE_MARGIN: f64 = 0.1;

impl SurfaceBoxes {
    /// Marks the boxes near all faces on surfaces.
    fn new(model: &Model) -> Self {
        let [low, high] = bounding_box(&model.mesh.nodes);
        let size = sub(high, low);
        let count = BOXES_PER_CELL * model.len() as f64;
        // A flat model has boxes in two directions, and a long one in one.
        let mut sorted = size;
        sorted.sort_by(f64::total_cmp);
        let [c, b, a] = sorted;
        let edge = (a / count)
            .max((a * b / count).sqrt())
            .max((a * b * c / count).cbrt());
        let dims = size.map(|length| (length / edge) as usize + 1);
        let mut boxes = Self {
            low,
            edge,
            dims,
            is_near: vec![false; dims.iter().product()],
        };
        for (f, &surface) in model.surfaces.connection_surfaces.iter().enumerate() {
            if surface != 0 {
                let nodes = model
                    .mesh
                    .faces
                    .get(model.graph.connections[f].face as usize);
                let nodes = nodes.iter().map(|&n| model.mesh.nodes[n as usize]);
                let bounds @ [low, high] = bounding_box(nodes);
                let margin = FACE_MARGIN * norm(sub(high, low));
                boxes.for_each(bounds, margin, |is_near| *is_near = true);
            }
        }
        boxes
    }

    /// Calls a function for all boxes that a box touches which is larger by `margin`.
    fn for_each(&mut self, bounds: [[f64; 3]; 2], margin: f64, mut call: impl FnMut(&mut bool)) {
        self.indices(bounds, margin)
            .for_each(|index| call(&mut self.is_near[index]));
    }

    /// Returns `true` if a line may cross a surface.
    fn may_cross(&self, ends: [[f64; 3]; 2]) -> bool {
        let mut indices = self.indices(bounding_box(ends), 0.0);
        indices.any(|index| self.is_near[index])
    }

    /// Returns the indices of all boxes that a box touches which is larger by `margin`.
    fn indices(
        &self,
        [low, high]: [[f64; 3]; 2],
        margin: f64,
    ) -> impl Iterator<Item = usize> + use<> {
        let dims = self.dims;
        let index = |k: usize, x: f64| (((x - self.low[k]) / self.edge) as usize).min(dims[k] - 1);
        let [i, j, k] =
            std::array::from_fn(|k| index(k, low[k] - margin)..=index(k, high[k] + margin));
        k.flat_map(move |k| {
            let i = i.clone();
            j.clone()
                .flat_map(move |j| i.clone().map(move |i| (k * dims[1] + j) * dims[0] + i))
        })
    }
}

/// Returns all connections near surfaces, with the surface that each crosses, ordered by axis,
/// layer and row.
pub(super) fn find_connections(
    model: &Model,
    walker: &CellWalker,
    grid: &CornerPointGrid,
) -> Vec<GridConnection> {
    let surfaces = &model.surfaces;
    if surfaces
        .connection_surfaces
        .iter()
        .all(|&surface| surface == 0)
    {
        return Vec::new();
    }
    let dims = grid.dims();
    let boxes = SurfaceBoxes::new(model);
    let row_connections = |row: usize| {
        let (axis, row) = (row / (dims[1] * dims[2]), row % (dims[1] * dims[2]));
        let mut start_cell = 0;
        let mut connections = Vec::new();
        for i in 0..dims[0] {
            let cell = [i, row % dims[1], row / dims[1]];
            let mut next = cell;
            next[axis] += 1;
            // Vertically, the neighbour of a cell is the next one that is not pinched out.
            while axis == 2 && next[2] < dims[2] && grid.is_pinched(next) {
                next[2] += 1;
            }
            if next[axis] == dims[axis] || axis == 2 && grid.is_pinched(cell) {
                continue;
            }
            let p = grid.point(cell, [0.5; 3]);
            let mut crosses = |other: [usize; 3]| {
                let q = grid.point(other, [0.5; 3]);
                if !boxes.may_cross([p, q]) {
                    return None;
                }
                start_cell = walker.cell_at(p, start_cell);
                let line = walker.trace_between(p, sub(q, p), start_cell);
                let crossings = line
                    .iter()
                    .filter(|segment| (0.0..1.0).contains(&segment.end));
                // A line can cross a rough surface more than once. The smallest multiplier counts.
                let crossed = crossings.filter_map(|segment| {
                    let connection = segment.exit_connection? as usize;
                    match surfaces.connection_surfaces[connection] {
                        0 => None,
                        surface => Some((model.fault_factor(connection), surface)),
                    }
                });
                let (factor, surface) = crossed.min_by(|a, b| a.0.total_cmp(&b.0))?;
                let is_fragment = surface as usize > surfaces.kept_count;
                Some((if is_fragment { 0 } else { surface }, factor))
            };
            let adjacent = if axis < 2 {
                adjacent_layers(grid, axis, cell)
            } else {
                vec![next[2]]
            };
            let mut connection = |upper: [usize; 3], touches: bool| GridConnection {
                axis,
                lower: cell,
                upper,
                shares_face: touches,
                crossed_surface: crosses(upper),
            };
            connections.push(connection(next, adjacent.contains(&next[2])));
            for &layer in adjacent.iter().filter(|&&layer| layer != next[2]) {
                connections.push(connection([next[0], next[1], layer], true));
            }
        }
        connections
    };
    let rows = 3 * dims[1] * dims[2];
    (0..rows)
        .into_par_iter()
        .flat_map_iter(row_connections)
        .collect()
}

/// Returns a multiplier, which is a ratio of transmissibilities, with twelve digits.
fn without_rounding_error(factor: f64) -> f64 {
    if factor == 0.0 {
        return factor;
    }
    let scale = 10f64.powi(12 - factor.abs().log10().ceil() as i32);
    (factor * scale).round() / scale
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn multipliers_have_twelve_digits() {
        let expected = [0.0, 0.01, 1.0, 0.123456789012, 1e-9, 2500.0];
        for factor in expected {
            assert_eq!(without_rounding_error(factor), factor);
            assert_eq!(without_rounding_error(factor * (1.0 + 4e-16)), factor);
        }
    }
}
