//! Columns (2.5-D PEBI): the cells of a map, extended vertically through the layers between
//! horizons.
//!
//! ```text
//!   map: polygons, faults their edges      horizons: z at every node of the map
//!          +-----+----+                      ─────────── top      ┐
//!         /   1   \ 2 |           ×          ─ ─ ─ ─ ─ ─          │ interval 0: 2 layers
//!        +---------+--+                      ───────╲             ┘ interval 1 ends here
//!                                            ────────────────
//! ```
//!
//! Neighbouring columns share their nodes over the whole height, so that faces conform. Faces
//! between columns are vertical (faults, too); faces between the layers of a column follow the
//! horizons. Where a layer has no thickness, its upper and lower nodes coincide, it has no faces,
//! and the cells above and below are neighbours.
//!
//! Where horizons are offset at faults, the map is torn there (`torn_map`): a cell meets those of the
//! other side that lie at its height, with faces of their common area (`fault_sides`).
//!
//! - `given`: horizons in files, brought to one unit and direction of z
//! - `horizon`: horizons, sampled at the nodes of a map
//! - `file`: columns as a mesh file
//! - `columns_spec`: all options, as one value
//! - `columns_verb`: the whole computation, from a map, horizons and the options

mod columns_spec;
mod columns_verb;
mod fault_sides;
pub mod file;
pub mod given;
pub mod horizon;
pub(crate) mod torn_map;

pub use columns_spec::{ColumnsSpec, LayerCounts};
pub use columns_verb::{ColumnsInput, ColumnsOutcome, columns};

use std::collections::BTreeMap;

use serde::Serialize;

use crate::error::cause;
use crate::geometry::sorted_distinct;
use crate::mesh::complex::NONE;
use crate::mesh::poly::{FIRST_SIDE, PolyMesh};
use crate::{Error, Result, memory};
use fault_sides::{CrossingNodes, Level};
use torn_map::TornMap;

/// Name of the cell array with the column of each cell.
pub const COLUMN: &str = "column";
/// Name of the cell array with the layer of each cell.
pub const LAYER: &str = "layer";

/// Thickness, relative to the mean thickness between the first and the last horizon, that counts as
/// zero.
const MIN_THICKNESS_RATIO: f64 = 1e-9;

/// Number of layers between two horizons.
#[derive(Debug, Clone, PartialEq)]
pub enum LayerDivision {
    /// Number of layers in each interval; a single number applies to all intervals.
    Counts(Vec<usize>),
    /// Average thickness of a layer, in the unit of z.
    Thickness(f64),
}

/// A mesh of columns. Cells are ordered by layer, from the first horizon on, and then by column.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Columns {
    /// The cells. Their region is the number of their interval, from 0. Their sites are at the
    /// map's sites, midway between the faces above and below.
    pub mesh: PolyMesh<3>,
    /// For each cell, its column: the number of the map's cell.
    pub column: Vec<i32>,
    /// For each cell, its layer, from 0.
    pub layer: Vec<i32>,
    /// Number of layers in each interval.
    pub layer_counts: Vec<usize>,
    /// For each layer, the number of columns in which it is missing.
    pub missing_counts: Vec<usize>,
    /// `true` if z increases upwards, from the last horizon to the first.
    pub is_z_up: bool,
    /// The faces at faults where horizons are offset; `None` if the map is not torn.
    pub juxtaposed: Option<Juxtaposed>,
}

/// The faces at faults where horizons are offset.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Juxtaposed {
    /// Number of faces between cells of one layer.
    pub same_layer: usize,
    /// Number of faces between cells of different layers.
    pub other_layer: usize,
    /// Area of these faces.
    pub area: f64,
    /// Area of the sides of cells beside no cell.
    pub exposed_area: f64,
}

/// Extends the cells of a map vertically through the layers between horizons.
///
/// `z[h][n]` is the z of horizon `h` at torn node `n` of the map, and `names[h]` the horizon's name
/// in errors. The first horizon is the top; z may increase upwards or downwards. Layers thinner than
/// `min_thickness` at a node have no thickness there, and horizons may cross by as much.
///
/// # Errors
/// Returns [`Error::Mesh`] if there are fewer than two horizons, if they cross or have nothing
/// between them, or if the division does not fit them.
pub fn extend(
    torn: &TornMap<'_>,
    z: &[Vec<f64>],
    names: &[String],
    division: &LayerDivision,
    min_thickness: f64,
) -> Result<Columns> {
    let refuse = |place: &str, problem: String, remedy: &str| {
        Err(Error::Mesh(cause(place, problem, remedy)))
    };
    if z.len() < 2 {
        let problem = format!("{} given", z.len());
        return refuse("horizons", problem, "give at least two, the top first");
    }
    let (map, nodes) = (torn.map, torn.node_count());
    let (first, last) = (&z[0], &z[z.len() - 1]);
    let mean_thickness: f64 =
        first.iter().zip(last).map(|(a, b)| a - b).sum::<f64>() / nodes as f64;
    if mean_thickness == 0.0 || !mean_thickness.is_finite() {
        let problem = "coincide everywhere".to_string();
        return refuse(&names.join(", "), problem, "give different horizons");
    }
    let is_z_up = mean_thickness > 0.0;
    let sign = mean_thickness.signum();
    let zero_thickness = MIN_THICKNESS_RATIO * mean_thickness.abs();
    for h in 1..z.len() {
        let overlap = |n: &usize| sign * (z[h][*n] - z[h - 1][*n]);
        let worst = (0..nodes).max_by(|a, b| overlap(a).total_cmp(&overlap(b)));
        if let Some(n) = worst.filter(|n| overlap(n) > min_thickness.max(zero_thickness)) {
            let [x, y] = torn.position(n);
            return refuse(
                &format!("horizons {} and {}", names[h - 1], names[h]),
                format!(
                    "cross: at x = {x}, y = {y} the second is above the first by {:.6}",
                    overlap(&n)
                ),
                "give horizons from the top down that do not cross, or a larger minimum thickness",
            );
        }
    }
    let counts = division.layer_counts(z, nodes)?;
    let layers: f64 = counts.iter().map(|&n| n as f64).sum();
    let (levels, cells) = (layers * nodes as f64, layers * map.sites.len() as f64);
    memory::ensure_available(
        "layers",
        32.0 * levels + 400.0 * cells,
        format!("{layers} layers of {} cells", map.sites.len()),
        "give fewer layers",
    )?;
    let tolerances = [min_thickness.max(zero_thickness), zero_thickness];
    let result = Builder::new(torn, z, &counts, is_z_up, tolerances).build(counts);
    if result.column.is_empty() {
        let problem = format!("have no layer between them that is thicker than {min_thickness}");
        return refuse(
            &names.join(", "),
            problem,
            "give a smaller minimum thickness",
        );
    }
    Ok(result)
}

impl LayerDivision {
    fn layer_counts(&self, z: &[Vec<f64>], nodes: usize) -> Result<Vec<usize>> {
        let intervals = z.len() - 1;
        match self {
            Self::Counts(counts) => match counts[..] {
                [count] if count > 0 => Ok(vec![count; intervals]),
                _ if counts.len() == intervals && counts.iter().all(|&c| c > 0) => {
                    Ok(counts.clone())
                }
                _ => Err(Error::Mesh(cause(
                    "layers",
                    format!("{counts:?} do not fit {intervals} intervals"),
                    "give one positive number, or one for each interval between horizons",
                ))),
            },
            Self::Thickness(t) if *t > 0.0 && t.is_finite() => Ok((0..intervals)
                .map(|h| {
                    let thickness = z[h].iter().zip(&z[h + 1]).map(|(a, b)| (a - b).abs());
                    let mean = thickness.sum::<f64>() / nodes as f64;
                    (mean / t).round().max(1.0) as usize
                })
                .collect()),
            Self::Thickness(t) => Err(Error::Mesh(cause(
                "layers",
                format!("a thickness of {t} is not positive"),
                "give a positive thickness in the unit of the horizons",
            ))),
        }
    }
}

impl Columns {
    /// Measures the faces over the torn edges of a map.
    fn juxtaposed_faces(&self, torn: &TornMap<'_>) -> Juxtaposed {
        let mut faces = Juxtaposed::default();
        let torn_edges = torn.edges.iter().zip(&torn.map.face_cells);
        let torn_edges = torn_edges.filter(|(edge, _)| edge[0] != edge[1]);
        let pairs = sorted_distinct(torn_edges.map(|(_, cells)| *cells));
        let mesh = &self.mesh;
        for (f, &[a, b]) in mesh.face_cells.iter().enumerate() {
            if b == NONE {
                faces.exposed_area += mesh.face_shape(f).area();
            } else if b < FIRST_SIDE {
                let mut columns = [a, b].map(|cell| self.column[cell as usize] as u32);
                columns.sort_unstable();
                if pairs.binary_search(&columns).is_ok() {
                    let [k, l] = [a, b].map(|cell| self.layer[cell as usize]);
                    faces.area += mesh.face_shape(f).area();
                    *(if k == l {
                        &mut faces.same_layer
                    } else {
                        &mut faces.other_layer
                    }) += 1;
                }
            }
        }
        faces
    }
}

/// Builds columns: the nodes of all levels (tops and bottoms of layers), and then the cells.
struct Builder<'a> {
    torn: &'a TornMap<'a>,
    layer_count: usize,
    is_z_up: bool,
    nodes: Vec<[f64; 3]>,
    /// For each level and each torn node of the map, the number of the node, level by level.
    node_numbers: Vec<u32>,
    /// For each node of the map that is torn, the nodes over it, upwards.
    lines: Vec<Vec<u32>>,
}

impl<'a> Builder<'a> {
    /// Creates the nodes. Levels are one where they are closer than the first of the tolerances, and
    /// levels of the two sides of a fault where they are closer than the second.
    fn new(
        torn: &'a TornMap<'a>,
        z: &[Vec<f64>],
        counts: &[usize],
        is_z_up: bool,
        [min_thickness, same_level]: [f64; 2],
    ) -> Self {
        let count = torn.node_count();
        let layers = counts.iter().sum();
        let mut builder = Self {
            torn,
            layer_count: layers,
            is_z_up,
            nodes: Vec::new(),
            node_numbers: Vec::with_capacity((layers + 1) * count),
            lines: vec![Vec::new(); torn.map.nodes.len()],
        };
        let mut parts = vec![0u32; torn.map.nodes.len()];
        torn.nodes.iter().for_each(|&n| parts[n as usize] += 1);
        let mut add_level = |h: usize, fraction: f64| {
            for n in 0..count {
                let [x, y] = torn.position(n);
                let next = z[(h + 1).min(z.len() - 1)][n];
                let z = z[h][n] + fraction * (next - z[h][n]);
                let above = builder.node_numbers.len().checked_sub(count);
                let above = above.map(|index| builder.node_numbers[index]);
                let distance = |m: u32| (builder.nodes[m as usize][2] - z).abs();
                let map_node = torn.nodes[n] as usize;
                let line = &mut builder.lines[map_node];
                let number = (above.filter(|&m| distance(m) <= min_thickness))
                    .or_else(|| line.iter().copied().find(|&m| distance(m) <= same_level))
                    .unwrap_or_else(|| {
                        let number = builder.nodes.len() as u32;
                        builder.nodes.push([x, y, z]);
                        if parts[map_node] > 1 {
                            line.push(number);
                        }
                        number
                    });
                builder.node_numbers.push(number);
            }
        };
        for (h, &layers) in counts.iter().enumerate() {
            (0..layers).for_each(|l| add_level(h, l as f64 / layers as f64));
        }
        add_level(z.len() - 1, 0.0);
        let z = |n: &u32| builder.nodes[*n as usize][2];
        for line in &mut builder.lines {
            line.sort_by(|a, b| z(a).total_cmp(&z(b)));
        }
        builder
    }

    fn node_at(&self, level: usize, torn_node: u32) -> u32 {
        self.node_numbers[level * self.torn.node_count() + torn_node as usize]
    }

    fn build(mut self, counts: Vec<usize>) -> Columns {
        let mut columns = Columns {
            missing_counts: vec![0; self.layer_count],
            is_z_up: self.is_z_up,
            ..Columns::default()
        };
        let interval: Vec<i32> = (0..).zip(&counts).flat_map(|(i, &n)| vec![i; n]).collect();
        let cell = self.number_cells(&interval, &mut columns);
        let mut nodes = std::mem::take(&mut self.nodes);
        let mut crossings = CrossingNodes {
            nodes: &mut nodes,
            on_levels: BTreeMap::new(),
            lines: &self.lines,
        };
        let mut faces = self.side_faces(&cell, &mut crossings);
        self.add_level_faces(&cell, &crossings.on_levels, &mut faces);
        faces.sort_by_key(|f| (f.cells[1] >= FIRST_SIDE, f.cells));
        for face in faces {
            columns.mesh.faces.push(face.ring);
            columns.mesh.face_cells.push(face.cells);
            columns.mesh.on_feature.push(face.on_feature);
        }
        columns.mesh.nodes = nodes;
        columns.layer_counts = counts;
        centre_sites(&mut columns.mesh);
        let is_torn = self.torn.node_count() > self.torn.map.nodes.len();
        columns.juxtaposed = is_torn.then(|| columns.juxtaposed_faces(self.torn));
        columns
    }

    /// Adds the cells to `columns`, without their faces; `interval` is that of each layer. Returns
    /// the cell of each layer and column, layer by layer; `NONE` where a layer has no thickness.
    fn number_cells(&self, interval: &[i32], columns: &mut Columns) -> Vec<u32> {
        let map = self.torn.map;
        let column_count = map.sites.len();
        let mut cell = vec![NONE; self.layer_count * column_count];
        for layer in 0..self.layer_count {
            for column in 0..column_count {
                let ring = self.torn.rings.get(column);
                if ring
                    .iter()
                    .all(|&n| self.node_at(layer, n) == self.node_at(layer + 1, n))
                {
                    columns.missing_counts[layer] += 1;
                    continue;
                }
                cell[layer * column_count + column] = columns.column.len() as u32;
                columns.column.push(column as i32);
                columns.layer.push(layer as i32);
                columns.mesh.region.push(interval[layer]);
                let [x, y] = map.sites[column];
                columns.mesh.sites.push([x, y, 0.0]);
            }
        }
        cell
    }

    /// Returns the faces between columns and on the sides of the box.
    fn side_faces(&self, cell: &[u32], crossings: &mut CrossingNodes<'_>) -> Vec<ColumnFace> {
        let (map, column_count) = (self.torn.map, self.torn.map.sites.len());
        let mut faces = Vec::new();
        for f in 0..map.face_cells.len() {
            let map_nodes = [0, 1].map(|i| map.faces.get(f)[i]);
            let [a, b] = map.face_cells[f];
            let [first, second] = self.torn.edges[f];
            let cell_at = |column: u32, layer: usize| cell[layer * column_count + column as usize];
            let on_feature = map.on_feature[f];
            if first != second {
                let layer = |k: usize| {
                    if self.is_z_up {
                        self.layer_count - 1 - k
                    } else {
                        k
                    }
                };
                let levels = [first, second].map(|edge| self.levels_upwards(edge));
                for face in crossings.shared_faces(map_nodes, &levels[0], &levels[1]) {
                    let [a, b] = [(a, face.layers[0]), (b, face.layers[1])]
                        .map(|(column, k)| k.map_or(NONE, |k| cell_at(column, layer(k))));
                    faces.push(ColumnFace::new([a, b], face.ring, on_feature));
                }
                continue;
            }
            let [p, q] = first;
            for layer in 0..self.layer_count {
                let (low, high) = if self.is_z_up {
                    (layer + 1, layer)
                } else {
                    (layer, layer + 1)
                };
                let [[low_p, low_q], [high_p, high_q]] =
                    [low, high].map(|level| [p, q].map(|n| self.node_at(level, n)));
                let mut ring = vec![low_p, low_q];
                ring.extend(crossings.nodes_between(map_nodes[1], [low_q, high_q]));
                ring.extend([high_q, high_p]);
                let between = crossings.nodes_between(map_nodes[0], [low_p, high_p]);
                ring.extend(between.iter().rev());
                ring.dedup();
                if ring.first() == ring.last() {
                    ring.pop();
                }
                if ring.len() < 3 {
                    continue;
                }
                let other_cell = if b < FIRST_SIDE { cell_at(b, layer) } else { b };
                faces.push(ColumnFace {
                    cells: [cell_at(a, layer), other_cell],
                    ring,
                    on_feature,
                });
            }
        }
        faces
    }

    /// Returns the nodes of all levels over an edge between torn nodes, upwards.
    fn levels_upwards(&self, edge: [u32; 2]) -> Vec<Level> {
        let levels = (0..=self.layer_count).map(|level| edge.map(|n| self.node_at(level, n)));
        let mut levels: Vec<Level> = levels.collect();
        if self.is_z_up {
            levels.reverse();
        }
        levels
    }

    /// Adds the faces above and below cells.
    fn add_level_faces(
        &self,
        cell: &[u32],
        crossings: &BTreeMap<Level, Vec<(f64, u32)>>,
        faces: &mut Vec<ColumnFace>,
    ) {
        let column_count = self.torn.map.sites.len();
        let mut add_face = |cells: [u32; 2], ring: Vec<u32>| {
            faces.push(ColumnFace {
                cells,
                ring,
                on_feature: false,
            });
        };
        let (first, last) = if self.is_z_up { (5, 4) } else { (4, 5) };
        for column in 0..column_count {
            let surface = |level: usize, upwards: bool| -> Vec<u32> {
                let corners = self.torn.rings.get(column);
                let corners: Vec<u32> = corners.iter().map(|&n| self.node_at(level, n)).collect();
                let mut ring = Vec::with_capacity(corners.len());
                for (i, &p) in corners.iter().enumerate() {
                    ring.push(p);
                    let q = corners[(i + 1) % corners.len()];
                    // An edge of the map has one direction, so only one of these has crossings.
                    let forward = crossings.get(&[p, q]).into_iter().flatten();
                    let backward = crossings.get(&[q, p]).into_iter().flatten().rev();
                    ring.extend(forward.chain(backward).map(|crossing| crossing.1));
                }
                if !upwards {
                    ring.reverse();
                }
                ring
            };
            let mut above = NONE;
            for layer in 0..self.layer_count {
                let current = cell[layer * column_count + column];
                if current == NONE {
                    continue;
                }
                match above {
                    NONE => add_face([current, FIRST_SIDE + first], surface(layer, self.is_z_up)),
                    _ => add_face([above, current], surface(layer, !self.is_z_up)),
                }
                above = current;
            }
            if above != NONE {
                let lowest = surface(self.layer_count, !self.is_z_up);
                add_face([above, FIRST_SIDE + last], lowest);
            }
        }
    }
}

/// A face of columns.
struct ColumnFace {
    cells: [u32; 2],
    ring: Vec<u32>,
    on_feature: bool,
}

impl ColumnFace {
    /// Creates a face between two cells, one of which may be missing, from its ring as seen from the
    /// first.
    fn new(mut cells: [u32; 2], mut ring: Vec<u32>, on_feature: bool) -> Self {
        if cells[0] > cells[1] {
            cells.reverse();
            ring.reverse();
        }
        Self {
            cells,
            ring,
            on_feature,
        }
    }
}

/// Moves the sites midway between the faces above and below.
fn centre_sites(mesh: &mut PolyMesh<3>) {
    for f in 0..mesh.face_cells.len() {
        for cell in mesh.face_cells[f]
            .into_iter()
            .filter(|&cell| cell < FIRST_SIDE)
        {
            let site = mesh.sites[cell as usize];
            let projection = mesh.vertical_projection(f, site);
            if let Some(projection) = projection.filter(|_| !mesh.is_upright(f)) {
                mesh.sites[cell as usize][2] += 0.5 * projection[2];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::bounding_box;
    use crate::mesh::check::check;
    use crate::mesh::graph::Graph;
    use crate::mesh::voronoi::voronoi_plane;

    fn map() -> PolyMesh<2> {
        let atoms: Vec<[f64; 2]> = (0..42)
            .map(|i| {
                let jitter = |k: i32| 0.6 * ((f64::from(i * 7 + k) * 12.9).sin());
                [
                    f64::from(i % 7) * 3.0 + 1.5 + jitter(0),
                    f64::from(i / 7) * 3.0 + 1.5 + jitter(3),
                ]
            })
            .collect();
        voronoi_plane(&atoms, [21.0, 18.0]).unwrap()
    }

    fn sample_nodes(map: &PolyMesh<2>, z: impl Fn(f64, f64) -> f64) -> Vec<f64> {
        map.nodes.iter().map(|&[x, y]| z(x, y)).collect()
    }

    fn horizon_names(count: usize) -> Vec<String> {
        (0..count).map(|i| format!("h{i}")).collect()
    }

    #[test]
    fn flat_layers_are_prisms_with_map_distances() {
        let map = map();
        for is_z_up in [true, false] {
            let sign = if is_z_up { -1.0 } else { 1.0 };
            let z = [100.0, 104.0, 110.0].map(|d: f64| vec![sign * d; map.nodes.len()]);
            let division = LayerDivision::Counts(vec![2, 3]);
            let result =
                extend(&TornMap::whole(&map), &z, &horizon_names(3), &division, 0.0).unwrap();
            assert_eq!((result.is_z_up, result.mesh.sites.len()), (is_z_up, 5 * 42));
            let (low, high) = if is_z_up {
                (-110.0, -100.0)
            } else {
                (100.0, 110.0)
            };
            let check = check(&result.mesh, [0.0, 0.0, low], [21.0, 18.0, high], 1e-12);
            assert!(check.passed(), "{check:?}");
            assert_eq!(result.mesh.region[..84], [0; 84]);
            let (graph, plane) = (Graph::from_poly(&result.mesh), Graph::from_poly(&map));
            assert_eq!(
                graph.connections.len(),
                5 * plane.connections.len() + 4 * 42
            );
            for c in &graph.connections {
                let [a, b] = c
                    .cells
                    .map(|c| (result.column[c as usize], result.layer[c as usize]));
                let thickness = |layer: i32| 2.0 - 0.0 * f64::from(layer);
                let expected = if a.0 == b.0 {
                    assert_eq!(b.1, a.1 + 1);
                    plane.volume[a.0 as usize] / 2.0
                } else {
                    let cells = [a.0 as u32, b.0 as u32];
                    let flat = plane.connections.iter().find(|f| f.cells == cells).unwrap();
                    flat.unit_transmissibility() * thickness(a.1)
                };
                assert!(
                    (c.unit_transmissibility() / expected - 1.0).abs() < 1e-9,
                    "{c:?}"
                );
            }
        }
    }

    #[test]
    fn dipping_and_bent_layers_conform_and_conduct_along_the_column() {
        let map = map();
        let z = [
            sample_nodes(&map, |x, y| 50.0 + 0.3 * x - 0.1 * y),
            sample_nodes(&map, |x, y| {
                56.0 + 0.3 * x + (0.4 * x).sin() * (0.3 * y).cos()
            }),
            sample_nodes(&map, |x, y| 66.0 + 0.2 * x + 0.02 * x * y),
        ];
        let result = extend(
            &TornMap::whole(&map),
            &z,
            &horizon_names(3),
            &LayerDivision::Thickness(2.0),
            0.0,
        )
        .unwrap();
        assert!(
            !result.is_z_up && result.layer_counts[0] >= 2,
            "{:?}",
            result.layer_counts
        );
        let [low, high] = bounding_box(&result.mesh.nodes);
        let check = check(&result.mesh, low, high, 1e-12);
        assert!(check.passed(), "{check:?}");
        let graph = Graph::from_poly(&result.mesh);
        let plane = Graph::from_poly(&map);
        for c in &graph.connections {
            assert!(c.distance.iter().all(|d| *d > 0.0), "{c:?}");
            let [a, b] = c.cells.map(|c| c as usize);
            let columns = [a, b].map(|c| result.column[c] as usize);
            if columns[0] == columns[1] {
                let height = graph.site[b][2] - graph.site[a][2];
                let expected = plane.volume[columns[0]] / height;
                assert!((c.unit_transmissibility() / expected - 1.0).abs() < 1e-9);
            } else {
                let flat = plane
                    .connections
                    .iter()
                    .find(|f| f.cells == columns.map(|c| c as u32));
                let sum = |d: [f64; 2]| d[0] + d[1];
                assert!((sum(c.distance) / sum(flat.unwrap().distance) - 1.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn layers_that_pinch_out_join_what_is_above_and_below() {
        let map = map();
        let z = [
            vec![0.0; map.nodes.len()],
            vec![3.0; map.nodes.len()],
            sample_nodes(&map, |x, _| 3.0 + (0.5 * (x - 10.0)).max(0.0)),
            vec![12.0; map.nodes.len()],
        ];
        let division = LayerDivision::Counts(vec![1, 2, 1]);
        let result = extend(&TornMap::whole(&map), &z, &horizon_names(4), &division, 0.0).unwrap();
        assert!(
            result.missing_counts[0] == 0
                && result.missing_counts[1] == result.missing_counts[2]
                && result.missing_counts[1] > 10
        );
        let check = check(&result.mesh, [0.0; 3], [21.0, 18.0, 12.0], 1e-12);
        assert!(check.passed(), "{check:?}");
        let graph = Graph::from_poly(&result.mesh);
        let crosses_missing_layer = |c: &&crate::mesh::graph::Connection<3>| {
            let [a, b] = c.cells.map(|c| result.layer[c as usize]);
            (a, b) == (0, 3)
        };
        assert_eq!(
            graph
                .connections
                .iter()
                .filter(crosses_missing_layer)
                .count(),
            result.missing_counts[1]
        );
        // All layers vanish if they are thinner than the minimum thickness.
        assert!(
            extend(
                &TornMap::whole(&map),
                &z,
                &horizon_names(4),
                &division,
                100.0
            )
            .is_err()
        );
        let with_min_thickness =
            extend(&TornMap::whole(&map), &z, &horizon_names(4), &division, 2.9).unwrap();
        assert_eq!(
            (
                with_min_thickness.missing_counts[0],
                with_min_thickness.missing_counts[1]
            ),
            (0, 42)
        );
    }

    /// Returns 6 x 4 squares with a fault along x = 3 from y = 0 up to `end`.
    fn faulted_map(end: f64) -> PolyMesh<2> {
        let row = |n: u32| (0..n).map(|i| 0.5 + f64::from(i));
        let sites: Vec<[f64; 2]> = row(4).flat_map(|y| row(6).map(move |x| [x, y])).collect();
        let mut map = voronoi_plane(&sites, [6.0, 4.0]).unwrap();
        for f in 0..map.inner_face_count() {
            let mut ends = [0, 1]
                .map(|i| map.nodes[map.faces.get(f)[i] as usize])
                .into_iter();
            map.on_feature[f] = ends.all(|p| (p[0] - 3.0).abs() < 1e-9 && p[1] < end + 1e-9);
        }
        map
    }

    /// Returns columns of a torn map. `z` is that of the first horizon on the left (`false`) or on the
    /// right of x = 3; the others lie 10 below each other.
    fn torn_columns(map: &PolyMesh<2>, is_z_up: bool, z: impl Fn(bool, f64) -> f64) -> Columns {
        let torn = TornMap::torn(map, 0.5);
        let mut is_right = vec![false; torn.node_count()];
        for cell in 0..map.sites.len() {
            for &n in torn.rings.get(cell) {
                is_right[n as usize] |= map.sites[cell][0] > 3.0;
            }
        }
        let sign = if is_z_up { -1.0 } else { 1.0 };
        let horizon = |h: usize| -> Vec<f64> {
            let z_at = |n: usize| z(is_right[n], torn.position(n)[1]) + 10.0 * h as f64;
            (0..torn.node_count()).map(|n| sign * z_at(n)).collect()
        };
        let z = [0, 1, 2].map(horizon);
        let division = LayerDivision::Counts(vec![1]);
        extend(&torn, &z, &horizon_names(3), &division, 0.0).unwrap()
    }

    /// Returns the rate into the side xmin of columns of uniform rock, with a pressure that is larger by 2
    /// there than at xmax.
    fn inflow(columns: &Columns) -> f64 {
        use crate::model::flow::{CellFlow, FaultLaw, Rock, Tensor};
        let graph = Graph::from_poly(&columns.mesh);
        let rock = Rock::uniform(Tensor::isotropic(2.0), 1.0);
        let flow = CellFlow::new(&graph, &rock, FaultLaw::OPEN).unwrap();
        let rates = vec![0.0; graph.volume.len()];
        let solution = flow.solve(&rates, &[(0, 3.0), (1, 1.0)]).unwrap();
        solution.inflow[graph.volume.len()]
    }

    #[test]
    fn cells_of_offset_columns_share_exact_areas_and_flow_in_series() {
        let map = faulted_map(4.0);
        for is_z_up in [false, true] {
            let columns = torn_columns(&map, is_z_up, |right, _| if right { 4.0 } else { 0.0 });
            let [low, high] = bounding_box(&columns.mesh.nodes);
            let check = check(&columns.mesh, low, high, 1e-12);
            assert!(check.passed(), "{check:?}");
            let faces = columns.juxtaposed.unwrap();
            assert_eq!((faces.same_layer, faces.other_layer), (8, 4));
            // Over each of the four edges: 6 for each layer, 4 for the lower left and the upper
            // right one; 4 above and below.
            assert!((faces.area - 4.0 * 16.0).abs() < 1e-12, "{faces:?}");
            assert!((faces.exposed_area - 4.0 * 8.0).abs() < 1e-12, "{faces:?}");

            // The layers are one flow path of five connections and two half cells, as nothing
            // distinguishes them: it has 20 high and 4 wide, and 16 high at the fault.
            let inflow = inflow(&columns);
            let least = 2.0 * 2.0 / (4.0 / 80.0 + 1.0 / 64.0 + 2.0 * 0.5 / 80.0);
            // Flow between the layers is slow, so that the resistance is larger than in series.
            assert!(inflow < least && inflow > 0.9 * least, "{inflow} {least}");
        }
        // One thick layer is in series exactly.
        let columns = {
            let torn = TornMap::torn(&map, 0.5);
            let mut z = [vec![0.0; torn.node_count()], vec![10.0; torn.node_count()]];
            for cell in (0..map.sites.len()).filter(|&cell| map.sites[cell][0] > 3.0) {
                for &n in torn.rings.get(cell) {
                    z[0][n as usize] = 4.0;
                    z[1][n as usize] = 14.0;
                }
            }
            let division = LayerDivision::Counts(vec![1]);
            extend(&torn, &z, &horizon_names(2), &division, 0.0).unwrap()
        };
        let inflow = inflow(&columns);
        let expected = 2.0 * 2.0 / (4.0 / 40.0 + 1.0 / 24.0 + 2.0 * 0.5 / 40.0);
        assert!(
            (inflow / expected - 1.0).abs() < 1e-9,
            "{inflow} {expected}"
        );
    }

    #[test]
    fn throws_may_change_sign_and_end_inside() {
        // The throw falls from 14 to -14 along the fault, and another ends at y = 3.
        for (end, throw) in [(4.0, 7.0), (3.0, 5.0)] {
            let map = faulted_map(end);
            for is_z_up in [false, true] {
                let z = |right: bool, y: f64| {
                    let length = if end == 4.0 {
                        2.0 - y
                    } else {
                        (3.0 - y).max(0.0)
                    };
                    if right { throw * length } else { 0.0 }
                };
                let columns = torn_columns(&map, is_z_up, z);
                let [low, high] = bounding_box(&columns.mesh.nodes);
                let check = check(&columns.mesh, low, high, 1e-12);
                assert!(check.passed(), "{check:?}");
                let faces = columns.juxtaposed.unwrap();
                // Each side has 20 x `end`, either shared or exposed.
                let sides = 2.0 * faces.area + faces.exposed_area;
                assert!((sides - 40.0 * end).abs() < 1e-9, "{faces:?}");
                // The columns overlap by 20 - |throw| at each place.
                let overlap = 20.0 * end - throw * if end == 4.0 { 4.0 } else { 4.5 };
                assert!((faces.area - overlap).abs() < 1e-9, "{faces:?} {overlap}");
            }
        }
    }

    #[test]
    fn impossible_horizons_are_refused() {
        let map = map();
        let flat = |d: f64| vec![d; map.nodes.len()];
        let bent = sample_nodes(&map, |x, _| 9.0 + 0.2 * x);
        let single = LayerDivision::Counts(vec![1]);
        for (z, division, expected) in [
            (vec![flat(0.0)], &single, "at least two"),
            (vec![flat(1.0), flat(1.0)], &single, "coincide everywhere"),
            (
                vec![flat(0.0), bent, flat(10.0)],
                &single,
                "horizons h1 and h2: cross: at x = 21",
            ),
            (
                vec![flat(0.0), flat(1.0)],
                &LayerDivision::Counts(vec![1, 2]),
                "do not fit 1 intervals",
            ),
            (
                vec![flat(0.0), flat(1.0)],
                &LayerDivision::Counts(vec![0]),
                "do not fit",
            ),
            (
                vec![flat(0.0), flat(1.0)],
                &LayerDivision::Thickness(-1.0),
                "not positive",
            ),
        ] {
            let message = extend(
                &TornMap::whole(&map),
                &z,
                &horizon_names(z.len()),
                division,
                0.0,
            )
            .unwrap_err()
            .to_string();
            assert!(message.contains(expected), "{message}");
        }
        // Horizons may cross by less than the minimum thickness.
        let z = [
            flat(0.0),
            sample_nodes(&map, |x, _| 9.0 + 0.2 * x),
            flat(10.0),
        ];
        let result = extend(&TornMap::whole(&map), &z, &horizon_names(3), &single, 3.3).unwrap();
        assert_eq!(result.missing_counts, [0, 42]);
        let [low, high] = bounding_box(&result.mesh.nodes);
        assert!(check(&result.mesh, low, high, 1e-12).passed());
    }
}
