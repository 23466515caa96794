//! Columns (2.5-D PEBI): the cells of a map, extended down through layers between horizons.
//!
//! ```text
//!   map: polygons, faults their edges      horizons: z at every node of the map
//!          +-----+----+                      ─────────── top      ┐
//!         /   1   \ 2 |           ×          ─ ─ ─ ─ ─ ─          │ interval 0: 2 layers
//!        +---------+--+                      ───────╲             ┘ interval 1 ends here
//!                                            ────────────────
//! ```
//!
//! Nodes of neighbouring cells are the same all the way down, so that faces conform: between columns
//! they are upright (a fault is upright, too), between the layers of a column they follow the horizon.
//! Where a layer has no thickness its nodes are one, its faces are gone, and the cells above and below
//! meet.
//!
//! - `horizon`: horizons, sampled at the nodes of a map

pub mod file;
pub mod horizon;

use crate::error::cause;
use crate::mesh::poly::{FIRST_SIDE, Lists, PolyMesh};
use crate::{Error, Result, memory};

/// The cell array that numbers columns.
pub const COLUMN: &str = "column";
/// The cell array that numbers layers.
pub const LAYER: &str = "layer";

/// Thickness, over the whole, that is taken for rounding.
const MIN_THICKNESS_RATIO: f64 = 1e-9;

/// How many layers there are between two horizons.
#[derive(Debug, Clone, PartialEq)]
pub enum LayerDivision {
    /// This many in each interval; one number counts for all.
    Counts(Vec<usize>),
    /// As many as make layers that are this thick on average.
    Thickness(f64),
}

/// A mesh of columns. Cells are ordered by layer, from the first horizon on, and then by column.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Columns {
    /// The cells; their region is the number of their interval, from 0. Sites are above one another,
    /// midway between the faces above and below.
    pub mesh: PolyMesh<3>,
    /// For each cell its column: the number of the map's cell.
    pub column: Vec<i32>,
    /// For each cell its layer, from 0.
    pub layer: Vec<i32>,
    /// Number of layers of each interval.
    pub layer_counts: Vec<usize>,
    /// Number of columns in which each layer is missing.
    pub missing_counts: Vec<usize>,
    /// Whether z grows upwards: from the last horizon to the first.
    pub is_z_up: bool,
}

/// Draws the cells of a map down through the layers between horizons: `z[h][n]` is horizon h at node
/// n of the map, `names[h]` what errors call it; the first is the top. z may grow either way. Layers
/// thinner than `least` at a node have no thickness there; so far horizons may cross.
///
/// # Errors
/// [`Error::Mesh`] if horizons cross, have nothing between them, or are too few; or the division does
/// not fit them.
pub fn columns(
    map: &PolyMesh<2>,
    z: &[Vec<f64>],
    names: &[String],
    division: &LayerDivision,
    least: f64,
) -> Result<Columns> {
    let refuse = |place: &str, problem: String, remedy: &str| {
        Err(Error::Mesh(cause(place, problem, remedy)))
    };
    if z.len() < 2 {
        let problem = format!("{} given", z.len());
        return refuse("horizons", problem, "give at least two, the top first");
    }
    let nodes = map.nodes.len();
    let (first, last) = (&z[0], &z[z.len() - 1]);
    let whole: f64 = first.iter().zip(last).map(|(a, b)| a - b).sum::<f64>() / nodes as f64;
    if whole == 0.0 || !whole.is_finite() {
        let problem = "coincide everywhere".to_string();
        return refuse(&names.join(", "), problem, "give different horizons");
    }
    let z_up = whole > 0.0;
    let sign = whole.signum();
    let nothing = MIN_THICKNESS_RATIO * whole.abs();
    for h in 1..z.len() {
        let over = |n: &usize| sign * (z[h][*n] - z[h - 1][*n]);
        let worst = (0..nodes).max_by(|a, b| over(a).total_cmp(&over(b)));
        if let Some(n) = worst.filter(|n| over(n) > least.max(nothing)) {
            let [x, y] = map.nodes[n];
            return refuse(
                &format!("horizons {} and {}", names[h - 1], names[h]),
                format!(
                    "cross: at x = {x}, y = {y} the second is above the first by {:.6}",
                    over(&n)
                ),
                "give horizons from the top down that at most touch, or let thicker layers vanish",
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
        "ask for fewer",
    )?;
    let found = Builder::new(map, z, &counts, z_up, least.max(nothing)).build(counts);
    if found.column.is_empty() {
        let problem = format!("have no layer between them that is thicker than {least}");
        return refuse(&names.join(", "), problem, "allow thinner layers");
    }
    Ok(found)
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
                    let off = z[h].iter().zip(&z[h + 1]).map(|(a, b)| (a - b).abs());
                    let mean = off.sum::<f64>() / nodes as f64;
                    (mean / t).round().max(1.0) as usize
                })
                .collect()),
            Self::Thickness(t) => Err(Error::Mesh(cause(
                "layers",
                format!("a thickness of {t} is not positive"),
                "give one in the unit of the horizons",
            ))),
        }
    }
}

/// Levels (tops and bottoms of layers) of nodes, as they are joined to cells.
struct Builder<'a> {
    map: &'a PolyMesh<2>,
    layer_count: usize,
    is_z_up: bool,
    nodes: Vec<[f64; 3]>,
    /// The node of each level at each node of the map, level by level.
    node_numbers: Vec<u32>,
    /// The nodes of each column's polygon, anticlockwise.
    rings: Lists,
}

impl<'a> Builder<'a> {
    fn new(map: &'a PolyMesh<2>, z: &[Vec<f64>], counts: &[usize], z_up: bool, least: f64) -> Self {
        let count = map.nodes.len();
        let layers = counts.iter().sum();
        let mut builder = Self {
            map,
            layer_count: layers,
            is_z_up: z_up,
            nodes: Vec::new(),
            node_numbers: Vec::with_capacity((layers + 1) * count),
            rings: Lists::default(),
        };
        let mut level = |h: usize, share: f64| {
            for n in 0..count {
                let [x, y] = map.nodes[n];
                let next = z[(h + 1).min(z.len() - 1)][n];
                let z = z[h][n] + share * (next - z[h][n]);
                let above = builder.node_numbers.len().checked_sub(count);
                let above = above.map(|at| builder.node_numbers[at]);
                let same = |m: &u32| (builder.nodes[*m as usize][2] - z).abs() <= least;
                let number = above.filter(same).unwrap_or_else(|| {
                    builder.nodes.push([x, y, z]);
                    builder.nodes.len() as u32 - 1
                });
                builder.node_numbers.push(number);
            }
        };
        for (h, &layers) in counts.iter().enumerate() {
            (0..layers).for_each(|l| level(h, l as f64 / layers as f64));
        }
        level(z.len() - 1, 0.0);
        let lists = map.faces_of_cells();
        let mut ring = Vec::new();
        for cell in 0..map.sites.len() {
            ring.clear();
            map.append_ring(cell, lists.get(cell), &mut ring);
            builder.rings.push(ring.iter().copied());
        }
        builder
    }

    fn node_at(&self, level: usize, node: u32) -> u32 {
        self.node_numbers[level * self.map.nodes.len() + node as usize]
    }

    fn build(self, counts: Vec<usize>) -> Columns {
        let map = self.map;
        let interval: Vec<i32> = (0..).zip(&counts).flat_map(|(i, &n)| vec![i; n]).collect();
        let mut all = Columns {
            missing_counts: vec![0; self.layer_count],
            is_z_up: self.is_z_up,
            ..Columns::default()
        };
        // The number of the cell in each layer of each column; none where layers have no thickness.
        const NONE: u32 = u32::MAX;
        let columns = map.sites.len();
        let mut cell = vec![NONE; self.layer_count * columns];
        for layer in 0..self.layer_count {
            for column in 0..columns {
                let ring = self.rings.get(column);
                if ring
                    .iter()
                    .all(|&n| self.node_at(layer, n) == self.node_at(layer + 1, n))
                {
                    all.missing_counts[layer] += 1;
                    continue;
                }
                cell[layer * columns + column] = all.column.len() as u32;
                all.column.push(column as i32);
                all.layer.push(layer as i32);
                all.mesh.region.push(interval[layer]);
                let [x, y] = map.sites[column];
                all.mesh.sites.push([x, y, 0.0]);
            }
        }
        let mut faces: Vec<(bool, [u32; 2], Vec<u32>, bool)> = Vec::new();
        let mut put = |cells: [u32; 2], ring: Vec<u32>, on_feature: bool| {
            faces.push((cells[1] >= FIRST_SIDE, cells, ring, on_feature));
        };
        for f in 0..map.face_cells.len() {
            let [p, q] = [0, 1].map(|i| map.faces.get(f)[i]);
            let [a, b] = map.face_cells[f];
            for layer in 0..self.layer_count {
                let (low, high) = if self.is_z_up {
                    (layer + 1, layer)
                } else {
                    (layer, layer + 1)
                };
                let mut ring = vec![
                    self.node_at(low, p),
                    self.node_at(low, q),
                    self.node_at(high, q),
                    self.node_at(high, p),
                ];
                ring.dedup();
                if ring.first() == ring.last() {
                    ring.pop();
                }
                if ring.len() < 3 {
                    continue;
                }
                let of = |column: u32| cell[layer * columns + column as usize];
                let beyond = if b < FIRST_SIDE { of(b) } else { b };
                put([of(a), beyond], ring, map.on_feature[f]);
            }
        }
        let (first, last) = if self.is_z_up { (5, 4) } else { (4, 5) };
        for column in 0..columns {
            let surface = |level: usize, upwards: bool| -> Vec<u32> {
                let ring = self
                    .rings
                    .get(column)
                    .iter()
                    .map(|&n| self.node_at(level, n));
                if upwards {
                    ring.collect()
                } else {
                    ring.rev().collect()
                }
            };
            let mut above = NONE;
            for layer in 0..self.layer_count {
                let own = cell[layer * columns + column];
                if own == NONE {
                    continue;
                }
                match above {
                    NONE => put(
                        [own, FIRST_SIDE + first],
                        surface(layer, self.is_z_up),
                        false,
                    ),
                    _ => put([above, own], surface(layer, !self.is_z_up), false),
                }
                above = own;
            }
            if above != NONE {
                put(
                    [above, FIRST_SIDE + last],
                    surface(self.layer_count, !self.is_z_up),
                    false,
                );
            }
        }
        faces.sort_by_key(|f| (f.0, f.1));
        for (_, cells, ring, on_feature) in faces {
            all.mesh.faces.push(ring);
            all.mesh.face_cells.push(cells);
            all.mesh.on_feature.push(on_feature);
        }
        all.mesh.nodes = self.nodes;
        all.layer_counts = counts;
        // Sites lie midway between the faces above and below.
        for f in 0..all.mesh.face_cells.len() {
            for cell in all.mesh.face_cells[f]
                .into_iter()
                .filter(|&cell| cell < FIRST_SIDE)
            {
                let site = all.mesh.sites[cell as usize];
                if let Some(on) = all
                    .mesh
                    .vertical_projection(f, site)
                    .filter(|_| !all.mesh.is_upright(f))
                {
                    all.mesh.sites[cell as usize][2] += 0.5 * on[2];
                }
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::check::check;
    use crate::mesh::graph::Graph;
    use crate::mesh::voronoi::voronoi_plane;

    fn map() -> PolyMesh<2> {
        let atoms: Vec<[f64; 2]> = (0..42)
            .map(|i| {
                let off = |k: i32| 0.6 * ((f64::from(i * 7 + k) * 12.9).sin());
                [
                    f64::from(i % 7) * 3.0 + 1.5 + off(0),
                    f64::from(i / 7) * 3.0 + 1.5 + off(3),
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
        for z_up in [true, false] {
            let sign = if z_up { -1.0 } else { 1.0 };
            let z = [100.0, 104.0, 110.0].map(|d: f64| vec![sign * d; map.nodes.len()]);
            let division = LayerDivision::Counts(vec![2, 3]);
            let found = columns(&map, &z, &horizon_names(3), &division, 0.0).unwrap();
            assert_eq!((found.is_z_up, found.mesh.sites.len()), (z_up, 5 * 42));
            let (low, high) = if z_up {
                (-110.0, -100.0)
            } else {
                (100.0, 110.0)
            };
            let check = check(&found.mesh, [0.0, 0.0, low], [21.0, 18.0, high], 1e-12);
            assert!(check.passed(), "{check:?}");
            assert_eq!(found.mesh.region[..84], [0; 84]);
            let (graph, plane) = (Graph::from_poly(&found.mesh), Graph::from_poly(&map));
            assert_eq!(
                graph.connections.len(),
                5 * plane.connections.len() + 4 * 42
            );
            for c in &graph.connections {
                let [a, b] = c
                    .cells
                    .map(|c| (found.column[c as usize], found.layer[c as usize]));
                let thick = |layer: i32| 2.0 - 0.0 * f64::from(layer);
                let want = if a.0 == b.0 {
                    assert_eq!(b.1, a.1 + 1);
                    plane.volume[a.0 as usize] / 2.0
                } else {
                    let cells = [a.0 as u32, b.0 as u32];
                    let flat = plane.connections.iter().find(|f| f.cells == cells).unwrap();
                    flat.unit_transmissibility() * thick(a.1)
                };
                assert!(
                    (c.unit_transmissibility() / want - 1.0).abs() < 1e-9,
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
        let found = columns(
            &map,
            &z,
            &horizon_names(3),
            &LayerDivision::Thickness(2.0),
            0.0,
        )
        .unwrap();
        assert!(
            !found.is_z_up && found.layer_counts[0] >= 2,
            "{:?}",
            found.layer_counts
        );
        let (low, high) = crate::store::stored_mesh::bounding_box(&found.mesh.nodes);
        let check = check(&found.mesh, low, high, 1e-12);
        assert!(check.passed(), "{check:?}");
        let graph = Graph::from_poly(&found.mesh);
        let plane = Graph::from_poly(&map);
        for c in &graph.connections {
            assert!(c.distance.iter().all(|d| *d > 0.0), "{c:?}");
            let [a, b] = c.cells.map(|c| c as usize);
            let columns = [a, b].map(|c| found.column[c] as usize);
            if columns[0] == columns[1] {
                let height = graph.site[b][2] - graph.site[a][2];
                let want = plane.volume[columns[0]] / height;
                assert!((c.unit_transmissibility() / want - 1.0).abs() < 1e-9);
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
        let found = columns(&map, &z, &horizon_names(4), &division, 0.0).unwrap();
        assert!(
            found.missing_counts[0] == 0
                && found.missing_counts[1] == found.missing_counts[2]
                && found.missing_counts[1] > 10
        );
        let check = check(&found.mesh, [0.0; 3], [21.0, 18.0, 12.0], 1e-12);
        assert!(check.passed(), "{check:?}");
        let graph = Graph::from_poly(&found.mesh);
        let across = |c: &&crate::mesh::graph::Connection<3>| {
            let [a, b] = c.cells.map(|c| found.layer[c as usize]);
            (a, b) == (0, 3)
        };
        assert_eq!(
            graph.connections.iter().filter(across).count(),
            found.missing_counts[1]
        );
        // All of it is gone where it is thinner than asked for.
        assert!(columns(&map, &z, &horizon_names(4), &division, 100.0).is_err());
        let fewer = columns(&map, &z, &horizon_names(4), &division, 2.9).unwrap();
        assert_eq!((fewer.missing_counts[0], fewer.missing_counts[1]), (0, 42));
    }

    #[test]
    fn impossible_horizons_are_refused() {
        let map = map();
        let flat = |d: f64| vec![d; map.nodes.len()];
        let bent = sample_nodes(&map, |x, _| 9.0 + 0.2 * x);
        let one = LayerDivision::Counts(vec![1]);
        for (z, division, want) in [
            (vec![flat(0.0)], &one, "at least two"),
            (vec![flat(1.0), flat(1.0)], &one, "coincide everywhere"),
            (
                vec![flat(0.0), bent, flat(10.0)],
                &one,
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
            let said = columns(&map, &z, &horizon_names(z.len()), division, 0.0)
                .unwrap_err()
                .to_string();
            assert!(said.contains(want), "{said}");
        }
        // What is as little as may vanish may cross.
        let z = [
            flat(0.0),
            sample_nodes(&map, |x, _| 9.0 + 0.2 * x),
            flat(10.0),
        ];
        let found = columns(&map, &z, &horizon_names(3), &one, 3.3).unwrap();
        assert_eq!(found.missing_counts, [0, 42]);
        let (low, high) = crate::store::stored_mesh::bounding_box(&found.mesh.nodes);
        assert!(check(&found.mesh, low, high, 1e-12).passed());
    }
}
