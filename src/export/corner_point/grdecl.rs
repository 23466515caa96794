//! A corner-point grid (Eclipse's GRDECL) for simulators that take no connections of their own: a model
//! resampled on [`pillars`](super::pillars) and [`layers`](super::layers).
//!
//! Two files: `NAME.GRDECL` for a deck's section GRID, and `NAME-regions.GRDECL` with FIPNUM for
//! REGIONS. METRIC units; z is depth.

use std::io::Write;
use std::path::Path;

use rayon::prelude::*;

use super::layers::{Layers, lines_of};
use super::pillars::{Outline, Pillars};
use super::walk::Walk;
use crate::Result;
use crate::export::containers::text::{Text, write_items, write_numbers};
use crate::files::Batch;
use crate::model::reservoir::{MILLIDARCY, Model};

/// Lines through a column along i and j, on which cells are averaged.
const LINES: usize = 3;
const NEEDS: &str = "a corner-point grid";

/// What a cell of the grid holds.
#[derive(Clone, Default)]
struct Sum {
    weight: f64,
    porosity: f64,
    /// Logarithms of the permeability along i, j and z.
    permeability: [f64; 3],
    regions: Vec<(i32, f64)>,
}

/// Writes the grid, of the model's [`grid`](Model::grid) columns and layers.
///
/// # Errors
/// [`Error::Export`](crate::Error::Export) for a mesh without upright sides,
/// [`Error::Io`](crate::Error::Io) if a file cannot be written.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let graph = &model.graph;
    let outline = Outline::new(graph, &model.mesh.nodes, NEEDS)?;
    let [n, m, layers] = model.grid.unwrap_or_else(|| usual(model, &outline));
    let pillars = Pillars::new(&outline, [n, m], graph);
    let walk = Walk::new(&model.mesh, graph);
    let layers = Layers::new(model, &walk, &pillars, layers);
    let columns: Vec<Vec<Sum>> = (0..m)
        .into_par_iter()
        .flat_map_iter(|j| {
            let mut from = 0;
            let sums = |i| sums(model, &walk, &pillars, &layers, j * n + i, &mut from);
            (0..n).map(sums).collect::<Vec<_>>()
        })
        .collect();
    let cells = n * m * layers.count;
    let cell = |at: usize| &columns[at % (n * m)][at / (n * m)];
    let mean = |at: usize, sum: f64| match cell(at).weight {
        0.0 => 0.0,
        weight => sum / weight,
    };

    batch.write(path, |out| {
        let faults = if pillars.ends.iter().any(|[top, bottom]| top != bottom) {
            "inclined along features"
        } else {
            "upright"
        };
        let how = if layers.by_region {
            "between regions"
        } else {
            "of equal thickness"
        };
        writeln!(
            out,
            "-- atomesh {}: {} cells of a mesh on {n} x {m} columns; pillars {faults}, layers {how}",
            env!("CARGO_PKG_VERSION"),
            model.len()
        )?;
        writeln!(out, "SPECGRID\n {n} {m} {} 1 F /\n", layers.count)?;
        writeln!(out, "COORD")?;
        write_items(out, pillars.ends.len(), |text, p| {
            for (end, z) in pillars.ends[p].iter().zip(pillars.z) {
                text.point([end[0], end[1], -z]);
            }
            text.end();
        })?;
        writeln!(out, "/\n\nZCORN")?;
        // Layer after layer its top and its bottom; of each, row after row of corners.
        let rows = 2 * m;
        write_items(out, 2 * layers.count * rows, |text, item| {
            let (level, row) = (item / rows, item % rows);
            let k = level.div_ceil(2);
            for i in 0..2 * n {
                let corner = i % 2 + 2 * (row % 2);
                text.and_real(-layers.corner(row / 2 * n + i / 2, corner)[k]);
            }
            text.end();
        })?;
        writeln!(out, "/\n\nACTNUM")?;
        whole_numbers(out, cells, |at| i64::from(cell(at).weight > 0.0))?;
        if model.porosity.is_some() {
            writeln!(out, "PORO")?;
            write_numbers(out, cells, |at| mean(at, cell(at).porosity))?;
            writeln!(out, "/\n")?;
        }
        if model.permeability.is_some() {
            for (k, name) in ["PERMX", "PERMY", "PERMZ"].into_iter().enumerate() {
                writeln!(out, "{name}")?;
                write_numbers(out, cells, |at| match cell(at).weight {
                    0.0 => 0.0,
                    weight => (cell(at).permeability[k] / weight).exp() / MILLIDARCY,
                })?;
                writeln!(out, "/\n")?;
            }
        }
        multipliers(out, model, &walk, &pillars, &layers)
    })?;
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    let regions = path.with_file_name(format!("{stem}-regions.{ending}"));
    let least = graph.region.iter().min().copied().unwrap_or(0);
    batch.write(&regions, |out| {
        writeln!(out, "FIPNUM")?;
        whole_numbers(out, cells, |at| {
            // The region with most of the cell.
            let regions = cell(at).regions.iter();
            let most = regions.max_by(|a, b| a.1.total_cmp(&b.1));
            most.map_or(1, |(region, _)| i64::from(*region) - i64::from(least) + 1)
        })
    })
}

type Out<'a> = &'a mut std::io::BufWriter<std::fs::File>;
type Done = std::io::Result<()>;

/// Whole numbers, many a line, and the slash at their end.
fn whole_numbers(out: Out, count: usize, value: impl Fn(usize) -> i64 + Sync) -> Done {
    const IN_LINE: usize = 30;
    write_items(out, count, |text: &mut Text, i| {
        text.and_int(value(i));
        if i % IN_LINE == IN_LINE - 1 || i + 1 == count {
            text.end();
        }
    })?;
    writeln!(out, "/\n")
}

/// As many cells as the mesh has, shaped as those are on average.
fn usual(model: &Model, outline: &Outline) -> [usize; 3] {
    let lengths = outline.lengths();
    let axes = [0, 1].map(|k| outline.edges[k].map(|e| e / lengths[k]));
    let along = |p: [f64; 3]| {
        let [i, j] = axes.map(|a| a[0] * p[0] + a[1] * p[1]);
        [i, j, p[2]]
    };
    // Mean distance between the sites of neighbours, along each axis.
    let mut apart = [0.0; 3];
    for c in &model.graph.connections {
        let [a, b] = c.cells.map(|cell| along(model.graph.site[cell as usize]));
        (0..3).for_each(|k| apart[k] += (a[k] - b[k]).abs());
    }
    // Along an axis on which no two cells are apart (a mesh of the plane is one layer) there is one.
    let most = apart.iter().copied().fold(0.0, f64::max);
    let shares: [f64; 3] = std::array::from_fn(|k| match apart[k] > 1e-9 * most {
        true => lengths[k] / apart[k],
        false => 1.0,
    });
    let axes = apart.iter().filter(|&&a| a > 1e-9 * most).count();
    let scale = model.len() as f64 / shares.iter().product::<f64>();
    let scale = match axes {
        3 => scale.cbrt(),
        2 => scale.sqrt(),
        _ => scale,
    };
    std::array::from_fn(|k| match apart[k] > 1e-9 * most {
        true => ((shares[k] * scale).round() as usize).max(1),
        false => 1,
    })
}

/// What is in the cells of a column.
fn sums(
    model: &Model,
    walk: &Walk,
    pillars: &Pillars,
    layers: &Layers,
    column: usize,
    from: &mut u32,
) -> Vec<Sum> {
    let mut sums = vec![Sum::default(); layers.count];
    let at = |k: usize| (k as f64 + 0.5) / LINES as f64;
    let places: Vec<[f64; 2]> = (0..LINES * LINES)
        .map(|k| [at(k % LINES), at(k / LINES)])
        .collect();
    let lines = lines_of(walk, pillars, column, &places, from);
    for (line, [u, v]) in lines.iter().zip(places) {
        let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
        let tops: Vec<f64> = (0..=layers.count)
            .map(|k| {
                (0..4)
                    .map(|c| weights[c] * layers.corner(column, c)[k])
                    .sum()
            })
            .collect();
        let mut k = 0;
        for piece in &line.pieces {
            let (top, bottom) = (line.z(piece.start), line.z(piece.end));
            while k > 0 && tops[k] < top {
                k -= 1;
            }
            loop {
                let length = top.min(tops[k]) - bottom.max(tops[k + 1]);
                if length > 0.0 {
                    sums[k].add(model, pillars, piece.cell, length);
                }
                if k + 1 < layers.count && tops[k + 1] > bottom {
                    k += 1;
                } else {
                    break;
                }
            }
        }
    }
    sums
}

impl Sum {
    fn add(&mut self, model: &Model, pillars: &Pillars, cell: u32, weight: f64) {
        let at = cell as usize;
        self.weight += weight;
        if let Some(porosity) = &model.porosity {
            self.porosity += weight * porosity[at];
        }
        if let Some(permeability) = &model.permeability {
            let k = permeability.rock.mobility(at);
            let [i, j] = pillars.axes.map(|[x, y]| k.along([x, y, 0.0]));
            for (sum, k) in self.permeability.iter_mut().zip([i, j, k.0[2]]) {
                *sum += weight * k.ln();
            }
        }
        let region = model.graph.region[at];
        match self.regions.iter_mut().find(|known| known.0 == region) {
            Some(known) => known.1 += weight,
            None => self.regions.push((region, weight)),
        }
    }
}

/// How faults lower transmissibilities, between the centres of cells that are neighbours: MULTX,
/// MULTY and MULTZ; nothing if they do not.
fn multipliers(out: Out, model: &Model, walk: &Walk, pillars: &Pillars, layers: &Layers) -> Done {
    let Some(permeability) = &model.permeability else {
        return Ok(());
    };
    let open = |i: usize| {
        let c = &model.graph.connections[i];
        let along = c
            .cells
            .map(|cell| permeability.rock.mobility(cell as usize).along(c.normal));
        c.area / (c.distance[0] / along[0] + c.distance[1] / along[1])
    };
    let count = model.graph.connections.len();
    let factor: Vec<f64> = (0..count)
        .into_par_iter()
        .map(|i| match model.graph.connections[i].on_feature {
            true => (permeability.transmissibility[i] / open(i)).min(1.0),
            false => 1.0,
        })
        .collect();
    if factor.iter().all(|&f| f > 1.0 - 1e-9) {
        return Ok(());
    }
    let [n, m] = pillars.columns;
    let centre = |[i, j, k]: [usize; 3]| {
        let column = j * n + i;
        let z: f64 = (0..4)
            .map(|c| layers.corner(column, c)[k..=k + 1].iter().sum::<f64>())
            .sum();
        let [top, bottom] = pillars.within(column, [0.5, 0.5]);
        let share = (z / 8.0 - top[2]) / (bottom[2] - top[2]);
        let along = |k: usize| top[k] + share * (bottom[k] - top[k]);
        std::array::from_fn::<f64, 3, _>(along)
    };
    let dims = [n, m, layers.count];
    for (axis, name) in ["MULTX", "MULTY", "MULTZ"].into_iter().enumerate() {
        let row = |row: usize| {
            let mut from = 0;
            let of = |i: usize| {
                let cell = [i, row % m, row / m];
                let mut next = cell;
                next[axis] += 1;
                if next[axis] == dims[axis] {
                    return 1.0;
                }
                let [p, q] = [cell, next].map(centre);
                from = walk.cell_at(p, from);
                let line = walk.line(p, std::array::from_fn(|k| q[k] - p[k]), from);
                let between = line.iter().filter(|piece| (0.0..1.0).contains(&piece.end));
                let crossed = between.filter_map(|piece| piece.leaves_by);
                // A rough face is crossed more than once.
                crossed.map(|c| factor[c as usize]).fold(1.0, f64::min)
            };
            (0..n).map(of).collect::<Vec<f64>>()
        };
        let all: Vec<f64> = (0..m * layers.count)
            .into_par_iter()
            .flat_map_iter(row)
            .collect();
        writeln!(out, "{name}")?;
        write_numbers(out, all.len(), |at| all[at])?;
        writeln!(out, "/\n")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::PolyMesh;
    use crate::mesh::{TriMesh, voronoi};

    /// The numbers of columns and layers in a grid of a mesh of the plane, one unit thick.
    fn grid_of(mesh: &PolyMesh<2>) -> [usize; 3] {
        let model = Model::new(mesh.extruded(1.0), None);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("A.GRDECL");
        let mut batch = Batch::default();
        write(&model, &mut batch, &path).unwrap();
        batch.commit().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let after = text.split("SPECGRID\n").nth(1).unwrap();
        let mut numbers = after.split_whitespace().map(|word| word.parse().unwrap());
        std::array::from_fn(|_| numbers.next().unwrap())
    }

    #[test]
    fn a_mesh_of_the_plane_is_one_layer() {
        let row = |n: u32| (0..n).map(|i| 0.5 + f64::from(i));
        let atoms: Vec<[f64; 2]> = row(4).flat_map(|y| row(6).map(move |x| [x, y])).collect();
        let cells = voronoi::voronoi_plane_welded(&atoms, [6.0, 4.0], 1e-9).unwrap();
        assert_eq!(grid_of(&cells), [6, 4, 1]);

        let square = TriMesh {
            nodes: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let mut cells = PolyMesh::from_simplices(&square, &[], &[]).unwrap();
        cells.assign_sides([0.0; 2], [1.0; 2]);
        assert_eq!(grid_of(&cells)[2], 1);
    }
}
