//! Surfaces of a corner-point grid: its faults, and the horizons at which a property changes from layer to
//! layer.
//!
//! A fault lies where the corners of two columns disagree on the pillars between them. It is made of
//! quadrilaterals between two pillars, one for each layer, from the highest to the lowest corner of the
//! active cells on both sides. Named faults of the file (FAULTS) keep their names. Others are connected
//! pieces; where three or more pieces meet at a pillar, those that continue one another most
//! straight belong together.
//!
//! A horizon is made of the tops of the cells below it. It is open at faults.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::path::Path;

use super::SurfaceFile;
use crate::error::Result;
use crate::files::vtk::DataArray;
use crate::geometry::union_find::UnionFind;
use crate::grid_file::{CornerPoints, FAULTS_NAME, GridFile, GridProperty, split_name};
use crate::image::stated::{StatedCoordinates, ZDirection};

/// Distance between corners up to which they agree, in mean thicknesses of cells.
const AGREEMENT: f64 = 1e-3;

/// Distance between corners up to which they agree, relative to the largest depth: a few roundings of the
/// single precision of EGRID files.
const ROUNDING: f64 = 5e-7;

/// Thickness of a cell up to which its layer is pinched out, in mean thicknesses of cells.
const PINCHED: f64 = 1e-6;

/// Reads the surfaces of the grid that `FILE` or `FILE:NAME` names: its faults, and the horizons at which
/// the property `NAME` changes. `FILE:FAULTS` has only faults, and `FILE:NAME` only horizons; without a
/// name there are both, the horizons of FIPNUM or, if the file has none, of layers. Also returns notes.
///
/// # Errors
/// Returns the errors of [`GridFile::open_property`], and [`Error::Io`](crate::Error::Io) if the property is
/// not whole numbers.
pub(crate) fn read_grid_surfaces(path: &Path) -> Result<(SurfaceFile<3>, Vec<String>)> {
    let name = split_name(path).map(|(_, name)| name);
    let (grid, property) = if name.as_deref() == Some(FAULTS_NAME) {
        (GridFile::open(path, &|_| false)?.0, None)
    } else {
        let (grid, property) = GridFile::open_property(path, &|_| false)?;
        (grid, Some(property))
    };
    let cells = grid.corner_points();
    let mut surfaces = GridSurfaces::new(&grid, &cells);
    if name.is_none() || property.is_none() {
        surfaces.add_faults();
    }
    if let Some(property) = &property {
        if !property.is_whole {
            let problem = format!(
                "{} has no whole numbers, between which horizons lie",
                property.name
            );
            return Err(grid.error(
                problem,
                "name a property of whole numbers, such as FIPNUM or K",
            ));
        }
        surfaces.add_horizons(property);
    }
    let GridSurfaces {
        mut file, throws, ..
    } = surfaces;
    file.cell_data = vec![DataArray::scalars("throw", throws)];
    Ok((file, grid.notes.clone()))
}

/// An edge between two neighbouring columns, seen from above.
#[derive(Debug, Clone, PartialEq)]
struct ColumnEdge {
    /// Columns on both sides, [i, j] each.
    columns: [[usize; 2]; 2],
    /// For each side the corners of the columns at the two pillars.
    corners: [[usize; 2]; 2],
    /// The two pillars.
    pillars: [usize; 2],
    /// Layers from the first to the last that is active on a side.
    layers: Range<usize>,
    /// Layers at which the fault lies, as flags from `layers.start` on.
    faulted: Vec<bool>,
    /// Index of the name of the fault.
    name: Option<usize>,
}

impl ColumnEdge {
    /// Returns z of a corner at the top of the edge.
    fn top_z(&self, cells: &CornerPoints<'_>) -> f64 {
        let [i, j] = self.columns[0];
        cells.z([i, j, self.layers.start], self.corners[0][0])
    }
}

/// Number of a named fault, and layers that it has at an edge.
type NamedLayers = (usize, Range<usize>);

/// A cell, and whether its bottom is meant or its top.
type HorizonFace = ([usize; 3], bool);

/// The surfaces of a grid, as they are collected.
struct GridSurfaces<'a> {
    grid: &'a GridFile,
    cells: &'a CornerPoints<'a>,
    /// Distance up to which two corners agree.
    tolerance: f64,
    /// Thickness up to which a cell is pinched out.
    pinched: f64,
    /// First and last active layer of each column; an empty range if none is active.
    active_layers: Vec<Range<usize>>,
    /// Nodes on pillars, by pillar and the bits of z.
    nodes: HashMap<(usize, u64), u32>,
    file: SurfaceFile<3>,
    throws: Vec<f32>,
}

impl<'a> GridSurfaces<'a> {
    fn new(grid: &'a GridFile, cells: &'a CornerPoints<'a>) -> Self {
        let [nx, ny, nz] = grid.dims;
        let thickness = cells.mean_thickness().unwrap_or(0.0);
        let max_depth = grid.zcorn.iter().fold(0.0, |max: f64, z| max.max(z.abs()));
        let scaled_depth = max_depth * cells.scale;
        let active_layers = (0..nx * ny).map(|column| {
            let mut active = (0..nz).filter(|k| grid.is_active(k * nx * ny + column));
            let first = active.next();
            first.map_or(0..0, |first| first..active.next_back().unwrap_or(first) + 1)
        });
        let unit = grid.frame.unit().symbol.to_string();
        let mut file = SurfaceFile {
            surface_starts: vec![0],
            ..SurfaceFile::default()
        };
        file.set_stated(StatedCoordinates {
            units: [Some(unit.clone()), Some(unit.clone()), Some(unit)],
            z_direction: Some(ZDirection::Up),
            ..StatedCoordinates::default()
        });
        Self {
            grid,
            cells,
            tolerance: (AGREEMENT * thickness).max(ROUNDING * scaled_depth),
            pinched: PINCHED * thickness,
            active_layers: active_layers.collect(),
            nodes: HashMap::new(),
            file,
            throws: Vec::new(),
        }
    }

    /// Returns z of a corner of a column at a level: the top of the layer, or the bottom of the last one.
    fn level_z(&self, [i, j]: [usize; 2], corner: usize, level: usize) -> f64 {
        match level.checked_sub(1) {
            Some(last) if level == self.grid.dims[2] => self.cells.z([i, j, last], corner + 4),
            _ => self.cells.z([i, j, level], corner),
        }
    }

    fn active_layers(&self, [i, j]: [usize; 2]) -> Range<usize> {
        self.active_layers[j * self.grid.dims[0] + i].clone()
    }

    /// Returns the node on a pillar at `z`.
    fn node(&mut self, pillar: usize, z: f64) -> u32 {
        let next = self.file.nodes.len() as u32;
        let node = *self.nodes.entry((pillar, z.to_bits())).or_insert(next);
        if node == next {
            self.file.nodes.push(self.cells.pillars[pillar].point(z));
        }
        node
    }

    /// Adds a triangle, unless two of its corners are one node.
    fn add_triangle(&mut self, nodes: [u32; 3], throw: f64) {
        let [a, b, c] = nodes;
        if a != b && b != c && c != a {
            self.file.facets.push(nodes);
            self.throws.push(throw as f32);
        }
    }

    /// Ends a surface, unless it has no triangle.
    fn end_surface(&mut self, name: String) {
        let count = self.file.facets.len();
        if self.file.surface_starts.last() != Some(&count) {
            self.file.names.push(name);
            self.file.surface_starts.push(count);
        }
    }

    /// Adds all faults, those with names first.
    fn add_faults(&mut self) {
        let (edges, names) = self.fault_edges();
        let groups = group_edges(&edges, self.cells);
        let levels = self.pillar_levels(&edges);
        for (number, group) in groups.iter().enumerate() {
            for &edge in group {
                self.add_fault_faces(&edges[edge], &levels);
            }
            let name = group.first().and_then(|&edge| edges[edge].name);
            let name = name.map(|name| names[name].clone());
            let count = groups[..number]
                .iter()
                .filter(|g| edges[g[0]].name.is_none())
                .count();
            self.end_surface(name.unwrap_or_else(|| format!("fault{}", count + 1)));
        }
    }

    /// Returns the edges between columns at which a fault lies, and the names of faults.
    fn fault_edges(&self) -> (Vec<ColumnEdge>, Vec<String>) {
        let [nx, ny, _] = self.grid.dims;
        let mut names: Vec<String> = Vec::new();
        // Layers of named faults at an edge, by its axis and its upper column.
        let mut named: BTreeMap<(usize, [usize; 2]), Vec<NamedLayers>> = BTreeMap::new();
        for fault in self.grid.faults.iter().filter(|fault| fault.axis < 2) {
            let known = names.iter().position(|name| *name == fault.name);
            let index = known.unwrap_or_else(|| {
                names.push(fault.name.clone());
                names.len() - 1
            });
            let [[i1, i2], [j1, j2], [k1, k2]] = fault.cells;
            for j in j1..=j2 {
                for i in i1..=i2 {
                    let mut column = [i, j];
                    column[fault.axis] += usize::from(fault.is_upper);
                    let layers = named.entry((fault.axis, column)).or_default();
                    layers.push((index, k1..k2 + 1));
                }
            }
        }
        let mut edges = Vec::new();
        for axis in 0..2 {
            for j in 0..ny {
                for i in 0..nx {
                    let upper = [i, j];
                    let Some(before) = upper[axis].checked_sub(1) else {
                        continue;
                    };
                    let mut lower = upper;
                    lower[axis] = before;
                    let layers = named.get(&(axis, upper)).map_or(&[][..], Vec::as_slice);
                    edges.extend(self.fault_edge(axis, [lower, upper], layers));
                }
            }
        }
        (edges, names)
    }

    /// Returns the edge between two columns if a fault lies there.
    fn fault_edge(
        &self,
        axis: usize,
        columns: [[usize; 2]; 2],
        named: &[(usize, Range<usize>)],
    ) -> Option<ColumnEdge> {
        let [a, b] = columns.map(|column| self.active_layers(column));
        if a.is_empty() || b.is_empty() {
            return None;
        }
        let layers = a.start.min(b.start)..a.end.max(b.end);
        let corners = if axis == 0 {
            [[1, 3], [0, 2]]
        } else {
            [[2, 3], [0, 1]]
        };
        let disagrees = |level: usize| {
            (0..2).any(|pillar| {
                let [a, b] =
                    [0, 1].map(|side| self.level_z(columns[side], corners[side][pillar], level));
                (a - b).abs() > self.tolerance
            })
        };
        let at_levels: Vec<bool> = (layers.start..=layers.end).map(disagrees).collect();
        let is_named = |layer: usize| named.iter().any(|(_, range)| range.contains(&layer));
        let faulted: Vec<bool> = layers
            .clone()
            .zip(at_levels.windows(2))
            .map(|(layer, ends)| ends[0] || ends[1] || is_named(layer))
            .collect();
        faulted.contains(&true).then(|| ColumnEdge {
            columns,
            corners,
            pillars: corners[1].map(|corner| self.cells.pillar_index(columns[1], corner)),
            layers,
            faulted,
            name: named.first().map(|(name, _)| *name),
        })
    }

    /// Returns for each pillar of the edges the highest, the mean and the lowest z of the corners at each
    /// level, over the columns around it that have active cells.
    fn pillar_levels(&self, edges: &[ColumnEdge]) -> HashMap<usize, Vec<[f64; 3]>> {
        let [nx, ny, nz] = self.grid.dims;
        let pillars = edges.iter().flat_map(|edge| edge.pillars);
        let levels_of = |pillar: usize| {
            let [i, j] = [pillar % (nx + 1), pillar / (nx + 1)];
            let corners: Vec<([usize; 2], usize)> = (0..4)
                .filter_map(|corner| {
                    let column = [i.checked_sub(corner % 2)?, j.checked_sub(corner / 2)?];
                    let is_inside = column[0] < nx && column[1] < ny;
                    let is_active = is_inside && !self.active_layers(column).is_empty();
                    is_active.then_some((column, corner))
                })
                .collect();
            let level = |level: usize| {
                let heights = corners
                    .iter()
                    .map(|(c, corner)| self.level_z(*c, *corner, level));
                let start = [f64::NEG_INFINITY, 0.0, f64::INFINITY];
                let [high, sum, low] = heights.fold(start, |[high, sum, low], z| {
                    [high.max(z), sum + z, low.min(z)]
                });
                [high, sum / corners.len() as f64, low]
            };
            (0..=nz).map(level).collect()
        };
        pillars.map(|pillar| (pillar, levels_of(pillar))).collect()
    }

    /// Adds the faces of a fault between two columns.
    fn add_fault_faces(&mut self, edge: &ColumnEdge, levels: &HashMap<usize, Vec<[f64; 3]>>) {
        let mut is_run_start = true;
        let last = edge.faulted.iter().rposition(|is_faulted| *is_faulted);
        for (at, layer) in edge.layers.clone().enumerate() {
            if !edge.faulted[at] {
                is_run_start = true;
                continue;
            }
            let is_run_end = Some(at) == last || edge.faulted.get(at + 1) == Some(&false);
            // A run of faces reaches from the highest to the lowest corner.
            let kinds = [
                if is_run_start { 0 } else { 1 },
                if is_run_end { 2 } else { 1 },
            ];
            is_run_start = false;
            let mut throw = 0.0;
            for pillar in 0..2 {
                for level in [layer, layer + 1] {
                    let [a, b] = [0, 1].map(|side| {
                        self.level_z(edge.columns[side], edge.corners[side][pillar], level)
                    });
                    throw += (a - b).abs() / 4.0;
                }
            }
            let node = |surfaces: &mut Self, pillar: usize, end: usize| {
                let pillar = edge.pillars[pillar];
                let z = levels[&pillar][layer + end][kinds[end]];
                surfaces.node(pillar, z)
            };
            let [a, b] = [0, 1].map(|pillar| node(self, pillar, 0));
            let [c, d] = [0, 1].map(|pillar| node(self, pillar, 1));
            self.add_triangle([a, c, b], throw);
            self.add_triangle([b, c, d], throw);
        }
    }

    /// Adds the top and the base of the active cells, and a horizon for each pair of values of which one
    /// lies above the other.
    fn add_horizons(&mut self, property: &GridProperty) {
        let [nx, ny, _] = self.grid.dims;
        // Corners of faces (column, and layer whose top or bottom they are) by the values above and below.
        let mut faces: BTreeMap<[Option<i64>; 2], Vec<HorizonFace>> = BTreeMap::new();
        for column in 0..nx * ny {
            let at = [column % nx, column / nx];
            let mut above = None;
            let mut last = [at[0], at[1], 0];
            for k in self.active_layers(at) {
                let cell = [at[0], at[1], k];
                if self.cells.thickness(cell) <= self.pinched {
                    continue;
                }
                let index = self.grid.cell_index(cell);
                let value = Some(property.values[index])
                    .filter(|value| self.grid.is_active(index) && value.is_finite())
                    .map(|value| value as i64);
                if value != above {
                    let face = if value.is_some() {
                        (cell, false)
                    } else {
                        (last, true)
                    };
                    faces.entry([above, value]).or_default().push(face);
                }
                above = value;
                last = cell;
            }
            if above.is_some() {
                faces.entry([above, None]).or_default().push((last, true));
            }
        }
        // Tops and bases of all values are one surface each.
        let mut named: BTreeMap<(u8, [i64; 2]), Vec<HorizonFace>> = BTreeMap::new();
        for (values, faces) in faces {
            let key = match values {
                [None, _] => (0, [0; 2]),
                [Some(above), Some(below)] => (1, [above, below]),
                [Some(_), None] => (2, [0; 2]),
            };
            named.entry(key).or_default().extend(faces);
        }
        for ((kind, [above, below]), faces) in named {
            for (cell, is_bottom) in faces {
                self.add_horizon_face(cell, is_bottom);
            }
            self.end_surface(match kind {
                0 => "horizon_top".into(),
                1 => format!("horizon_{above}_{below}"),
                _ => "horizon_base".into(),
            });
        }
    }

    /// Adds the top or the bottom of a cell: four triangles around its middle.
    fn add_horizon_face(&mut self, cell: [usize; 3], is_bottom: bool) {
        let column = [cell[0], cell[1]];
        let side = 4 * usize::from(is_bottom);
        let corners = self.cells.corners(cell);
        let nodes = [0, 1, 2, 3].map(|corner| {
            let pillar = self.cells.pillar_index(column, corner);
            self.node(pillar, self.cells.z(cell, corner + side))
        });
        let middle = self.file.nodes.len() as u32;
        let mean = |c: usize| (0..4).map(|corner| corners[corner + side][c]).sum::<f64>() / 4.0;
        self.file.nodes.push(std::array::from_fn(mean));
        for [a, b] in [[0, 1], [1, 3], [3, 2], [2, 0]] {
            self.add_triangle([nodes[a], nodes[b], middle], 0.0);
        }
    }
}

/// Returns the edges of each fault, in the order of their first edges; faults with names come first.
fn group_edges(edges: &[ColumnEdge], cells: &CornerPoints<'_>) -> Vec<Vec<usize>> {
    let mut at_pillar: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    let unnamed = || (0..edges.len()).filter(|&edge| edges[edge].name.is_none());
    for edge in unnamed() {
        for pillar in edges[edge].pillars {
            at_pillar.entry(pillar).or_default().push(edge);
        }
    }
    let mut connected = UnionFind::new(edges.len());
    for (pillar, meeting) in at_pillar {
        // All pairs, the straightest first.
        let direction = |edge: usize| {
            let [a, b] = edges[edge].pillars;
            let other = if a == pillar { b } else { a };
            let z = edges[edge].top_z(cells);
            let [from, to] = [pillar, other].map(|pillar| cells.pillars[pillar].at(z));
            let [x, y] = [to[0] - from[0], to[1] - from[1]];
            let length = x.hypot(y).max(f64::MIN_POSITIVE);
            [x / length, y / length]
        };
        let mut pairs: Vec<(f64, [usize; 2])> = Vec::new();
        for (n, &a) in meeting.iter().enumerate() {
            for &b in &meeting[..n] {
                let [u, v] = [direction(a), direction(b)];
                pairs.push((u[0] * v[0] + u[1] * v[1], [b, a]));
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut used: Vec<usize> = Vec::new();
        for (_, pair) in pairs {
            if !pair.iter().any(|edge| used.contains(edge)) {
                connected.unite(pair[0] as u32, pair[1] as u32);
                used.extend(pair);
            }
        }
    }
    let mut groups: BTreeMap<(bool, usize), Vec<usize>> = BTreeMap::new();
    for (edge, found) in edges.iter().enumerate() {
        let key = match found.name {
            Some(name) => (false, name),
            None => (true, connected.find(edge as u32) as usize),
        };
        groups.entry(key).or_default().push(edge);
    }
    groups.into_values().collect()
}
