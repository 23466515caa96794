//! A grid for MRST (MATLAB or Octave) as a MAT-file: `G` with its geometry, `rock`, and `T`, the
//! transmissibility of every face.
//!
//! As MRST has it: z is depth; numbers begin with 1, and 0 is outside; normals are as long as the
//! face's area and point from the first neighbour to the second. `G.faces.tagNames` has the name for each
//! `G.faces.tag`, and `G.nodes.sets` the nodes of each name. `G.cells.sites` are the points that
//! `T` is for: `computeTrans` takes centroids instead, which on Voronoi cells is wrong. `W` are the wells, if
//! there are any, with the fields that `addWell` makes.
//! Source: K.-A. Lie, "An Introduction to Reservoir Simulation Using MATLAB/GNU Octave", section 3.4.

use std::path::Path;

use crate::Result;
use crate::export::containers::binary::Numbers;
use crate::export::containers::mat::{self, Fields, Value};
use crate::export::meshers::groups::{Group, Names, nodes_of};
use crate::files::Batch;
use crate::files::vtk::Scalar;
use crate::mesh::poly::SIDE_0;
use crate::model::reservoir::{Control, Model, Permeability, Well};

/// A point in metres with z downwards.
fn downwards([x, y, z]: [f64; 3]) -> [f64; 3] {
    [x, y, -z]
}

/// A matrix with a point a row.
fn points<'a>(count: usize, point: impl Fn(usize) -> [f64; 3] + Sync + 'a) -> Value<'a> {
    let value = move |i: usize| point(i % count)[i / count];
    Value::Matrix(count, 3, Numbers::computed(3 * count, value))
}

/// Numbers that begin with 0 as ones that begin with 1.
fn from_one(numbers: &[u32]) -> Value<'_> {
    Value::column(Numbers::computed(numbers.len(), |i| numbers[i] + 1))
}

/// Writes the grid.
///
/// # Errors
/// [`Error::Export`](crate::Error::Export) for a model that no such file can hold,
/// [`Error::Io`](crate::Error::Io) if it cannot be written.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let (mesh, graph) = (&model.mesh, &model.graph);
    let (cells, faces, inner) = (model.len(), mesh.face_cells.len(), mesh.inner_faces());
    let of_cells = mesh.faces_of_cells();
    let names = Names::new(model);
    let words = names.names.iter().map(|name| Value::Text(name));
    let groups = names.groups();
    let set = |group: &'_ Group| {
        let nodes = nodes_of(model, &group.faces);
        Value::column(Numbers::computed(nodes.len(), move |i| nodes[i] + 1))
    };
    let sets = groups.iter().filter(|group| mat::is_name(&group.name));
    let sets = sets.map(|group| (group.name.as_str(), set(group)));
    let area = |f: usize| match f.checked_sub(inner) {
        None => (graph.connections[f].area, graph.connections[f].normal),
        Some(outer) => (graph.boundary[outer].area, graph.boundary[outer].normal),
    };
    // Mirrored, faces turn the other way.
    let offsets = &mesh.faces.offsets;
    let nodes = |range: std::ops::Range<usize>, bytes: &mut Vec<u8>| {
        let mut face = offsets.partition_point(|&o| o as usize <= range.start) - 1;
        for i in range {
            while offsets[face + 1] as usize <= i {
                face += 1;
            }
            let mirrored = (offsets[face] + offsets[face + 1]) as usize - 1 - i;
            (mesh.faces.items[mirrored] + 1).put(bytes);
        }
    };
    let neighbour = |i: usize| match mesh.face_cells[i % faces][i / faces] {
        outside if outside >= SIDE_0 => 0,
        cell => cell + 1,
    };

    let of_cell = Value::Struct(vec![
        ("num", Value::number(cells as f64)),
        ("facePos", from_one(&of_cells.offsets)),
        ("faces", from_one(&of_cells.items)),
        (
            "indexMap",
            Value::column(Numbers::computed(cells, |c| c as u32 + 1)),
        ),
        ("volumes", Value::column(Numbers::slice(&graph.volume))),
        ("centroids", points(cells, |c| downwards(graph.centroid[c]))),
        ("sites", points(cells, |c| downwards(graph.site[c]))),
        ("region", Value::column(Numbers::slice(&graph.region))),
    ]);
    let of_face = Value::Struct(vec![
        ("num", Value::number(faces as f64)),
        ("nodePos", from_one(offsets)),
        (
            "nodes",
            Value::column(Numbers::filled::<u32>(mesh.faces.items.len(), nodes)),
        ),
        (
            "neighbors",
            Value::Matrix(faces, 2, Numbers::computed(2 * faces, neighbour)),
        ),
        ("tag", Value::column(Numbers::slice(&names.of_face))),
        ("tagNames", Value::Cells(words.collect())),
        (
            "areas",
            Value::column(Numbers::computed(faces, |f| area(f).0)),
        ),
        (
            "normals",
            points(faces, |f| {
                let (area, normal) = area(f);
                downwards(normal.map(|n| area * n))
            }),
        ),
        (
            "centroids",
            points(faces, |f| downwards(mesh.face_shape(f).centroid)),
        ),
    ]);
    let of_node = Value::Struct(vec![
        ("num", Value::number(mesh.nodes.len() as f64)),
        (
            "coords",
            points(mesh.nodes.len(), |n| downwards(mesh.nodes[n])),
        ),
        ("sets", Value::Struct(sets.collect())),
    ]);
    let grid = Value::Struct(vec![
        ("cells", of_cell),
        ("faces", of_face),
        ("nodes", of_node),
        ("griddim", Value::number(3.0)),
        (
            "type",
            Value::Cells(vec![Value::Text("atomesh"), Value::Text("computeGeometry")]),
        ),
    ]);
    let mut variables = vec![("G", grid)];
    let mut rock = Vec::new();
    if let Some(porosity) = &model.porosity {
        rock.push(("poro", Value::column(Numbers::slice(porosity))));
    }
    if let Some(permeability) = &model.permeability {
        rock.push(("perm", permeabilities(permeability, cells)));
        let transmissibility = |f: usize| match f.checked_sub(inner) {
            None => permeability.transmissibility[f],
            Some(outer) => {
                let face = &graph.boundary[outer];
                let along = permeability
                    .rock
                    .mobility(face.cell as usize)
                    .along(face.normal);
                face.area * along / face.distance
            }
        };
        let numbers = Numbers::computed(faces, transmissibility);
        variables.push(("T", Value::column(numbers)));
    }
    if !rock.is_empty() {
        variables.push(("rock", Value::Struct(rock)));
    }
    if !model.case.wells.is_empty() {
        let wells = model.case.wells.iter().map(|w| well(model, w));
        variables.push(("W", Value::Structs(wells.collect())));
    }
    let columns: Vec<_> = model
        .properties
        .iter()
        .filter(|p| mat::is_name(&p.name))
        .collect();
    if !columns.is_empty() {
        let field = |p: &&'_ crate::files::vtk::DataArray| {
            let (values, width) = (p.values.to_f64(), p.components);
            let value = move |i: usize| values[i % cells * width + i / cells];
            Value::Matrix(cells, width, Numbers::computed(cells * width, value))
        };
        let fields = columns
            .iter()
            .map(|p| (p.name.as_str(), field(p)))
            .collect();
        variables.push(("properties", Value::Struct(fields)));
    }
    mat::check(path, &variables)?;
    batch.write(path, |out| mat::write(out, &variables))
}

/// A well as `addWell` makes it, in SI units: rates are positive where it injects. Pressures are those at the depth
/// of its first cell.
fn well<'a>(model: &'a Model, well: &'a Well) -> Fields<'a> {
    let (kind, value) = match well.control {
        Control::Inject(rate) => ("rate", rate),
        Control::Produce(rate) => ("rate", -rate),
        Control::Pressure(pressure) => ("bhp", pressure),
    };
    let sign = if matches!(well.control, Control::Inject(_)) {
        1.0
    } else {
        -1.0
    };
    let count = well.cells.len();
    let depth = |i: usize| model.depth(well.cells[i].0 as usize);
    let reference = if count > 0 { depth(0) } else { 0.0 };
    let of_cells = |value: fn(&(u32, f64)) -> f64| {
        Value::column(Numbers::computed(count, move |i| value(&well.cells[i])))
    };
    vec![
        ("name", Value::Text(&well.name)),
        ("cells", of_cells(|c| f64::from(c.0 + 1))),
        ("type", Value::Text(kind)),
        ("val", Value::number(value)),
        ("sign", Value::number(sign)),
        ("WI", of_cells(|c| c.1)),
        (
            "dZ",
            Value::column(Numbers::computed(count, move |i| depth(i) - reference)),
        ),
        ("r", Value::number(well.radius)),
        ("refDepth", Value::number(reference)),
        ("compi", Value::number(1.0)),
        ("status", Value::number(1.0)),
    ]
}

/// A column if the rock is isotropic, three for kx, ky, kz, or all six: xx, xy, xz, yy, yz, zz.
fn permeabilities(permeability: &Permeability, cells: usize) -> Value<'_> {
    let rock = &permeability.rock;
    let all = |test: fn(&[f64; 6]) -> bool| rock.kinds.iter().all(|k| test(&k.0));
    let columns: &'static [(usize, f64)] =
        if all(|k| k[0] == k[1] && k[0] == k[2] && k[3..] == [0.0; 3]) {
            &[(0, 1.0)]
        } else if all(|k| k[3..] == [0.0; 3]) {
            &[(0, 1.0), (1, 1.0), (2, 1.0)]
        } else {
            // z turns round.
            &[(0, 1.0), (3, 1.0), (5, -1.0), (1, 1.0), (4, -1.0), (2, 1.0)]
        };
    let value = move |i: usize| {
        let (component, sign) = columns[i / cells];
        sign * rock.mobility(i % cells).0[component]
    };
    let count = columns.len();
    Value::Matrix(cells, count, Numbers::computed(cells * count, value))
}
