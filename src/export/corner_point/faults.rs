//! The surfaces of a model as faces between the cells of a corner-point grid: FAULTS with MULTFLT, and
//! where the factor is not the same all over a surface, MULTX, MULTY and MULTZ.
//!
//! Two cells are neighbours if they share some of a face. Where a pillar is split, a cell has several
//! neighbours on one side of it, in other layers than its own, and a simulator makes a connection to
//! each. A connection is on a surface if the line between the cells' centres crosses the surface, so
//! that two cells on two sides of a surface without holes are never joined past it.
//!
//! A record of FAULTS multiplies all connections of one face of one cell. So that each connection is
//! multiplied once, and only if it is on the surface, faces are chosen like this, group by group of
//! connections that share faces:
//!
//! 1. the faces of the lower cells (`X`, `Y`, `Z`), if all that passes them crosses a surface, or several
//!    that resist alike;
//! 2. else the faces of the upper cells (`X-`, `Y-`);
//! 3. else those faces of lower cells of which that holds, and for every connection that is left a factor
//!    of its own: EDITNNC, and MULTIPLY of TRANX or TRANY between cells of one layer, which are no NNC.

use std::collections::BTreeMap;
use std::io::Write;

use crate::parallel::prelude::*;

use super::cell_walk::CellWalker;
use super::grid::CornerPointGrid;
use crate::export::containers::text::write_numbers;
use crate::export::simulators::deck::{FileWriter, WriteResult};
use crate::geometry::sub;
use crate::geometry::union_find::UnionFind;
use crate::model::reservoir::Model;
use crate::model::surface::SurfaceKind;

/// Factors that are nearer to each other are the same.
const FACTOR_TOLERANCE: f64 = 1e-9;
/// Cells whose common face is no higher than this share of the grid's height share none.
const MIN_CONTACT_HEIGHT_RATIO: f64 = 1e-9;

/// The connection of a cell to one of the next column along an axis, or of the next layer.
#[derive(Debug, Clone, Copy, PartialEq)]
struct GridConnection {
    axis: usize,
    lower: [usize; 3],
    upper: [usize; 3],
    /// Whether the cells share some of a face; if not, they are only of one layer.
    shares_face: bool,
    /// The surface that lies between the centres, and its factor.
    crossed_surface: Option<(u32, f64)>,
}

/// A face of a cell that is on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
struct FaultCellFace {
    surface: u32,
    axis: usize,
    /// Whether it is the face towards the cell before, not towards the one behind.
    is_negative_side: bool,
    cell: [usize; 3],
    factor: f64,
}

/// What resists flow between the cells of a corner-point grid.
pub struct FaultResistances {
    faces: Vec<FaultCellFace>,
    /// Surfaces whose factor is not the same all over them.
    varying_surfaces: Vec<u32>,
    /// Connections that no face stands for, with their factors.
    edits: Vec<([[usize; 3]; 2], f64)>,
}

impl FaultResistances {
    /// Finds all faces on surfaces.
    pub fn new(model: &Model, walk: &CellWalker, grid: &CornerPointGrid) -> Self {
        let mut connections = find_connections(model, walk, grid);
        connections.retain(|c| c.shares_face || c.crossed_surface.is_some());
        let mut range: BTreeMap<u32, [f64; 2]> = BTreeMap::new();
        for (surface, factor) in connections.iter().filter_map(|c| c.crossed_surface) {
            let [low, high] = range.entry(surface).or_insert([factor; 2]);
            (*low, *high) = (low.min(factor), high.max(factor));
        }
        let varying = range
            .iter()
            .filter(|(_, [low, high])| high - low > FACTOR_TOLERANCE);
        let mut found = Self {
            faces: Vec::new(),
            varying_surfaces: varying.map(|(&surface, _)| surface).collect(),
            edits: Vec::new(),
        };
        found.choose_faces(grid, &connections);
        // Scraps last.
        (found.faces).sort_by_key(|f| {
            (
                f.surface.wrapping_sub(1),
                f.axis,
                f.is_negative_side,
                f.cell,
            )
        });
        found.edits.sort_by_key(|edit| edit.0);
        found
    }

    /// Chooses the faces that stand for connections on surfaces.
    fn choose_faces(&mut self, grid: &CornerPointGrid, connections: &[GridConnection]) {
        let cells: usize = grid.dims().iter().product();
        let lower = |c: &GridConnection| c.axis * cells + grid.cell_index(c.lower);
        let upper = |c: &GridConnection| (3 + c.axis) * cells + grid.cell_index(c.upper);
        // Of each face the connections.
        let mut of_face: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (at, c) in connections.iter().enumerate() {
            of_face.entry(lower(c)).or_default().push(at);
            of_face.entry(upper(c)).or_default().push(at);
        }
        let touching = |face: usize| {
            of_face[&face]
                .iter()
                .filter(|&&at| connections[at].shares_face)
        };
        // All connections of the face are on surfaces: on one, or on several that resist alike.
        let is_pure = |face: usize| {
            let mut all = touching(face).map(|&at| connections[at].crossed_surface);
            let Some(Some(first)) = all.next() else {
                return false;
            };
            let alike = |other: (u32, f64)| {
                other.0 == first.0 || (other.1 - first.1).abs() <= FACTOR_TOLERANCE
            };
            all.all(|other| other.is_some_and(alike))
        };
        let on: Vec<&GridConnection> = (connections.iter())
            .filter(|c| c.shares_face && c.crossed_surface.is_some())
            .collect();
        let mut number: BTreeMap<usize, u32> = BTreeMap::new();
        for c in &on {
            for face in [lower(c), upper(c)] {
                let next = number.len() as u32;
                number.entry(face).or_insert(next);
            }
        }
        let mut sets = UnionFind::new(number.len());
        for c in &on {
            sets.unite(number[&lower(c)], number[&upper(c)]);
        }
        let mut groups: BTreeMap<u32, Vec<&GridConnection>> = BTreeMap::new();
        for c in on {
            groups
                .entry(sets.find(number[&lower(c)]))
                .or_default()
                .push(c);
        }
        for group in groups.values() {
            let front = group.iter().all(|c| is_pure(lower(c)));
            let back = !front && group[0].axis < 2 && group.iter().all(|c| is_pure(upper(c)));
            let mut factors: BTreeMap<usize, f64> = BTreeMap::new();
            for c in group {
                let face = if back { upper(c) } else { lower(c) };
                let Some((surface, factor)) = c.crossed_surface else {
                    continue;
                };
                if !is_pure(face) {
                    self.edits.push(([c.lower, c.upper], factor));
                    continue;
                }
                // The face has the greatest factor, and what resists more is edited.
                let all = touching(face).filter_map(|&at| connections[at].crossed_surface);
                let most = all.map(|(_, factor)| factor).fold(0.0, f64::max);
                if factors.insert(face, most).is_none() {
                    self.faces.push(FaultCellFace {
                        surface,
                        axis: c.axis,
                        is_negative_side: back,
                        cell: if back { c.upper } else { c.lower },
                        factor: most,
                    });
                }
                if factor < most - FACTOR_TOLERANCE {
                    self.edits.push(([c.lower, c.upper], factor / most));
                }
            }
        }
        // Cells of one layer that share nothing are named if that multiplies no other connection.
        for c in connections.iter().filter(|c| !c.shares_face) {
            let Some((surface, factor)) = c.crossed_surface else {
                continue;
            };
            if touching(lower(c)).next().is_none() {
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
            .retain(|(_, factor)| *factor < 1.0 - FACTOR_TOLERANCE);
    }

    /// Writes the surfaces, and how they resist flow, for a deck's section GRID.
    pub fn write(&self, out: FileWriter, model: &Model, grid: &CornerPointGrid) -> WriteResult {
        if self.faces.is_empty() {
            return Ok(());
        }
        let names = surface_names(model);
        writeln!(out, "FAULTS")?;
        for faces in self.faces.chunk_by(|a, b| a.surface == b.surface) {
            let name = &names[faces[0].surface as usize];
            for run in faces.chunk_by(is_continued_by) {
                let ([i, j, k], last) =
                    (run[0].cell.map(|n| n + 1), run[run.len() - 1].cell[2] + 1);
                let side = ["X", "Y", "Z"][run[0].axis];
                let back = if run[0].is_negative_side { "-" } else { "" };
                writeln!(out, " '{name}' {i} {i} {j} {j} {k} {last} '{side}{back}' /")?;
            }
        }
        writeln!(out, "/\n")?;
        let varies = |surface: u32| self.varying_surfaces.binary_search(&surface).is_ok();
        let mut alike = Vec::new();
        for faces in self.faces.chunk_by(|a, b| a.surface == b.surface) {
            let FaultCellFace {
                surface, factor, ..
            } = faces[0];
            if factor < 1.0 - FACTOR_TOLERANCE && !varies(surface) {
                alike.push((&names[surface as usize], factor));
            }
        }
        if !alike.is_empty() {
            writeln!(out, "MULTFLT")?;
            for (name, factor) in alike {
                writeln!(out, " '{name}' {factor} /")?;
            }
            writeln!(out, "/\n")?;
        }
        let others: Vec<&FaultCellFace> = (self.faces.iter())
            .filter(|face| varies(face.surface))
            .collect();
        if others.is_empty() {
            return Ok(());
        }
        for back in [false, true] {
            if back && !others.iter().any(|face| face.is_negative_side) {
                continue;
            }
            for (axis, keyword) in ["MULTX", "MULTY", "MULTZ"].into_iter().enumerate() {
                let mut all = vec![1.0; grid.dims().iter().product()];
                let own =
                    |face: &&&FaultCellFace| face.axis == axis && face.is_negative_side == back;
                for face in others.iter().filter(own) {
                    all[grid.cell_index(face.cell)] = face.factor;
                }
                writeln!(out, "{keyword}{}", if back { "-" } else { "" })?;
                write_numbers(out, all.len(), |at| all[at])?;
                writeln!(out, "/\n")?;
            }
        }
        Ok(())
    }

    /// Whether there is something to write for a deck's section EDIT.
    pub fn has_edits(&self) -> bool {
        !self.edits.is_empty()
    }

    /// Writes the factors of single connections, for a deck's section EDIT.
    pub fn write_edits(&self, out: FileWriter) -> WriteResult {
        let is_neighbour = |[a, b]: &[[usize; 3]; 2]| a[2] == b[2];
        let (near, far): (Vec<_>, Vec<_>) =
            (self.edits.iter()).partition(|(cells, _)| is_neighbour(cells));
        if !near.is_empty() {
            writeln!(out, "MULTIPLY")?;
            for ([lower, upper], factor) in near {
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
        if !far.is_empty() {
            writeln!(out, "EDITNNC")?;
            for (cells, factor) in far {
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

/// Whether one record holds two faces: those of a cell and of the one below it. Faces towards the next
/// layer have a record each, which OPM Flow insists on.
fn is_continued_by(a: &FaultCellFace, b: &FaultCellFace) -> bool {
    let [i, j, k] = a.cell;
    a.axis < 2
        && (a.axis, a.is_negative_side) == (b.axis, b.is_negative_side)
        && b.cell == [i, j, k + 1]
}

/// The letters that a name may have.
const MAX_NAME_LEN: usize = 8;

/// The names of surfaces 1, 2 ...; that of 0, no more than scraps, is the first. What parts regions 1 and 11
/// is `I1_11`, if that is short enough and no other surface would be called so.
fn surface_names(model: &Model) -> Vec<String> {
    let surfaces = &model.surfaces;
    let short = |at: usize| {
        let regions = surfaces.names.get(at)?.strip_prefix("interface_")?;
        let short = format!("I{}", regions.to_uppercase());
        (short.is_ascii() && short.len() <= MAX_NAME_LEN).then_some(short)
    };
    let mut uses: BTreeMap<String, usize> = BTreeMap::new();
    for name in (0..surfaces.kinds.len()).filter_map(short) {
        *uses.entry(name).or_default() += 1;
    }
    let name = |(at, kind): (usize, &SurfaceKind)| match kind {
        SurfaceKind::Fault => format!("FAULT{}", at + 1),
        SurfaceKind::Horizon => format!("HORIZ{}", at + 1),
        SurfaceKind::Interface => {
            (short(at).filter(|name| uses[name] == 1)).unwrap_or_else(|| format!("INTER{}", at + 1))
        }
    };
    let all = surfaces.kinds.iter().enumerate().map(name);
    std::iter::once("SCRAPS".into()).chain(all).collect()
}

/// The layers of the next column along an axis whose cells share some of a face with a cell.
fn adjacent_layers(grid: &CornerPointGrid, axis: usize, [i, j, k]: [usize; 3]) -> Vec<usize> {
    let [n, m, layers] = grid.dims();
    let mut next = [i, j];
    next[axis] += 1;
    if next[axis] == [n, m][axis] {
        return Vec::new();
    }
    // The corners on the two pillars between the columns.
    let corners = [[(1, 0), (3, 2)], [(2, 0), (3, 1)]][axis];
    let [own, other] = [[i, j], next].map(|[i, j]| j * n + i);
    let pillars = corners.map(|(here, there)| {
        [
            grid.layers.corner_depths(own, here),
            grid.layers.corner_depths(other, there),
        ]
    });
    let [high, low] = grid.pillars.z;
    let least = MIN_CONTACT_HEIGHT_RATIO * (high - low);
    let touches = |l: usize| {
        // How high the common face is on both pillars, and where tops or bottoms cross between these.
        let at = |share: f64| {
            let z = |column: usize, k: usize| {
                let [a, b] = pillars.map(|pillar| pillar[column][k]);
                a + share * (b - a)
            };
            z(0, k).min(z(1, l)) - z(0, k + 1).max(z(1, l + 1))
        };
        let crossing = |k: usize, l: usize| {
            let [a, b] = pillars.map(|pillar| pillar[0][k] - pillar[1][l]);
            if a * b < 0.0 { a / (a - b) } else { 0.0 }
        };
        [0.0, 1.0, crossing(k, l), crossing(k + 1, l + 1)]
            .into_iter()
            .any(|share| at(share) > least)
    };
    (0..layers).filter(|&l| touches(l)).collect()
}

/// All connections near surfaces, with what they cross: axis by axis, layer by layer, row by row.
fn find_connections(
    model: &Model,
    walk: &CellWalker,
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
    let of_row = |row: usize| {
        let (axis, row) = (row / (dims[1] * dims[2]), row % (dims[1] * dims[2]));
        let mut from = 0;
        let mut found = Vec::new();
        for i in 0..dims[0] {
            let cell = [i, row % dims[1], row / dims[1]];
            let mut next = cell;
            next[axis] += 1;
            if next[axis] == dims[axis] {
                continue;
            }
            let p = grid.point(cell, [0.5; 3]);
            from = walk.cell_at(p, from);
            let crosses = |other: [usize; 3]| {
                let line = walk.trace_line(p, sub(grid.point(other, [0.5; 3]), p), from);
                let between = line.iter().filter(|piece| (0.0..1.0).contains(&piece.end));
                // A rough face is crossed more than once: the tightest counts.
                let on = between.filter_map(|piece| {
                    let connection = piece.exit_connection? as usize;
                    match surfaces.connection_surfaces[connection] {
                        0 => None,
                        surface => Some((model.fault_factor(connection), surface)),
                    }
                });
                let (factor, surface) = on.min_by(|a, b| a.0.total_cmp(&b.0))?;
                let scrap = surface as usize > surfaces.kept_count;
                Some((if scrap { 0 } else { surface }, factor))
            };
            let beyond = if axis < 2 {
                adjacent_layers(grid, axis, cell)
            } else {
                vec![next[2]]
            };
            let connection = |upper: [usize; 3], touches: bool| GridConnection {
                axis,
                lower: cell,
                upper,
                shares_face: touches,
                crossed_surface: crosses(upper),
            };
            found.push(connection(next, beyond.contains(&next[2])));
            for &layer in beyond.iter().filter(|&&layer| layer != next[2]) {
                found.push(connection([next[0], next[1], layer], true));
            }
        }
        found
    };
    let rows = 3 * dims[1] * dims[2];
    (0..rows).into_par_iter().flat_map_iter(of_row).collect()
}
