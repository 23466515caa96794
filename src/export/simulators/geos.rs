//! A VTU for GEOS: `attribute` says the region of each cell (1 or more), and rock has the names that
//! GEOS' own examples give it, so that `fieldsToImport` and `fieldNamesInGEOS` are the same. Names of faces
//! are sets of nodes, arrays of 0 and 1 for `nodesetNames` (64-bit, or GEOS does not see them); beside the
//! cells also triangles or polygons, whose `attribute` is the number of the name: GEOS makes a set of that
//! number of their nodes. Of faces it reads no sets: it gives each set of nodes one of the same name, the
//! faces all of whose nodes are in it.
//!
//! Of a mesh that is torn along surfaces, `NAME.vtm` has the mesh as its block `main` and a block for each
//! surface (`faceBlocks`), which says by `collocated_nodes` which nodes of the mesh are at each of its own.
//!
//! GEOS itself takes tetrahedra, and prisms; of other polyhedra, only those that it can name.

use std::io::Write;
use std::path::Path;

use crate::Result;
use crate::export::meshers::groups::{NamedSides, region_shift};
use crate::export::meshers::simplices::{SimplexMesh, TornSurface};
use crate::files::Batch;
use crate::files::vtk::DataArray;
use crate::files::vtk::xml::escape;
use crate::mesh::poly::PolyMesh;
use crate::mesh::{Mesh, TetMesh, TriMesh};
use crate::model::flow::SplitMesh;
use crate::model::reservoir::Model;
use crate::store::vtu::{MixedCells, add_mixed_vtu};

/// The names of porosity and permeability.
const ROCK_ARRAY_NAMES: [&str; 2] = ["rockPorosity_referencePorosity", "rockPerm_permeability"];
/// VTK's numbers of cells.
const TRIANGLE_TYPE: u8 = TriMesh::VTK_CELL;
const TETRAHEDRON_TYPE: u8 = TetMesh::VTK_CELL;
const POLYGON_TYPE: u8 = PolyMesh::<2>::VTK_CELL;
const ERROR_PLACE: &str = "a mesh for GEOS";

/// Writes the mesh.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if it cannot be written.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let shift = region_shift(model);
    let own = model.mesh.region.iter();
    let attribute: Vec<i32> = own.map(|&r| (i64::from(r) + shift) as i32).collect();
    let mut arrays = vec![DataArray::scalars("attribute", attribute)];
    if let Some(porosity) = &model.porosity {
        arrays.push(DataArray::scalars(ROCK_ARRAY_NAMES[0], porosity.clone()));
    }
    if let Some(permeability) = &model.permeability {
        let of = |cell: usize| permeability.rock.mobility(cell).0.into_iter().take(3);
        arrays.push(DataArray {
            name: ROCK_ARRAY_NAMES[1].into(),
            components: 3,
            values: (0..model.len()).flat_map(of).collect::<Vec<f64>>().into(),
        });
    }
    arrays.extend(model.properties.iter().cloned());
    if model.tets.is_none() {
        let cells = MixedCells::polyhedra(&model.mesh);
        let named = NamedSides::from_model(model);
        return cells_with_faces(batch, path, (&model.mesh.nodes, cells), &named, arrays);
    }
    let mesh = &SimplexMesh::new(model, ERROR_PLACE)?;
    let mut cells = MixedCells::default();
    (0..mesh.len()).for_each(|t| cells.push(TETRAHEDRON_TYPE, mesh.get(t).iter().copied()));
    cells_with_faces(batch, path, (mesh.nodes, cells), &mesh.named_sides, arrays)?;
    match &model.split_mesh {
        Some(split) => write_fractures(mesh, split, batch, path),
        None => Ok(()),
    }
}

/// A set of nodes: 1 where they are in it.
fn node_set(name: &str, count: usize, nodes: &[u32]) -> DataArray {
    let mut within = vec![0i64; count];
    nodes.iter().for_each(|&n| within[n as usize] = 1);
    DataArray::scalars(name, within)
}

/// Cells with what has a name; `arrays` are those of the cells, `attribute` the first.
fn cells_with_faces(
    batch: &mut Batch,
    path: &Path,
    (nodes, mut cells): (&[[f64; 3]], MixedCells),
    named: &[NamedSides],
    arrays: Vec<DataArray>,
) -> Result<()> {
    // Faces have what the cells have that they are seen from.
    let count = cells.kinds.len();
    let mut rows: Vec<u32> = (0..count as u32).collect();
    let mut numbers = Vec::new();
    for own in named {
        for (i, &cell) in own.cells.iter().enumerate() {
            let side = own.sides.get(i);
            let kind = if side.len() == 3 {
                TRIANGLE_TYPE
            } else {
                POLYGON_TYPE
            };
            cells.push(kind, side.iter().copied());
            rows.push(cell);
            numbers.push(own.number as i32);
        }
    }
    let mut arrays: Vec<DataArray> = (arrays.into_iter())
        .map(|array| DataArray {
            values: array.values.select_tuples(&rows, array.components),
            ..array
        })
        .collect();
    let of_cells = arrays[0].values.to_i64().into_iter().take(count);
    let attribute: Vec<i32> = of_cells.map(|a| a as i32).chain(numbers).collect();
    arrays[0].values = attribute.into();
    let sets: Vec<DataArray> = (named.iter())
        .map(|own| node_set(&own.name, nodes.len(), &own.sides.items))
        .collect();
    add_mixed_vtu(batch, path, nodes, &cells, &sets, &arrays)
}

/// The surfaces along which a mesh is torn, each in a file, and the one that lists all.
fn write_fractures(
    mesh: &SimplexMesh,
    split: &SplitMesh,
    batch: &mut Batch,
    path: &Path,
) -> Result<()> {
    // All nodes at the place of each, it among them.
    let mut places: Vec<(u32, u32)> = split.original_node.iter().copied().zip(0..).collect();
    places.sort_unstable();
    let at = |n: u32| {
        let place = split.original_node[n as usize];
        let first = places.partition_point(|p| p.0 < place);
        places[first..].iter().take_while(move |p| p.0 == place)
    };
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let mut blocks = vec![("main".to_string(), format!("{stem}.vtu"))];
    for TornSurface {
        name,
        number,
        face_pairs: pairs,
        ..
    } in &mesh.torn_surfaces
    {
        // A face of whose nodes none is doubled parts nothing.
        let parts = |pair: &&[[u32; 3]; 2]| pair[0] != pair[1];
        let faces: Vec<[u32; 3]> = pairs.iter().filter(parts).map(|pair| pair[0]).collect();
        let place = |n: &u32| split.original_node[*n as usize];
        let mut own: Vec<u32> = faces.as_flattened().iter().map(place).collect();
        own.sort_unstable();
        own.dedup();
        let most = own.iter().map(|&n| at(n).count()).max().unwrap_or(0);
        let mut collocated = Vec::with_capacity(most * own.len());
        for &n in &own {
            let here = collocated.len();
            collocated.extend(at(n).map(|p| i64::from(p.1)));
            collocated.resize(here + most, -1);
        }
        let mut cells = MixedCells::default();
        for face in &faces {
            let local = |n: u32| own.partition_point(|&m| m < place(&n)) as u32;
            cells.push(TRIANGLE_TYPE, face.map(local));
        }
        let nodes: Vec<[f64; 3]> = own.iter().map(|&n| mesh.nodes[n as usize]).collect();
        let collocated = DataArray {
            name: "collocated_nodes".into(),
            components: most,
            values: collocated.into(),
        };
        let attribute = DataArray::scalars("attribute", vec![*number as i32; faces.len()]);
        let file = format!("{stem}-{name}.vtu");
        let own_path = path.with_file_name(&file);
        add_mixed_vtu(
            batch,
            &own_path,
            &nodes,
            &cells,
            &[collocated],
            &[attribute],
        )?;
        blocks.push((name.clone(), file));
    }
    mesh.write_face_pairs(batch, path, 0)?;
    batch.write(&path.with_extension("vtm"), |out| {
        writeln!(
            out,
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"vtkMultiBlockDataSet\" version=\"1.0\">\n  \
             <vtkMultiBlockDataSet>"
        )?;
        for (i, (name, file)) in blocks.iter().enumerate() {
            let file = escape(file);
            writeln!(
                out,
                "    <DataSet index=\"{i}\" name=\"{name}\" file=\"{file}\"/>"
            )?;
        }
        writeln!(out, "  </vtkMultiBlockDataSet>\n</VTKFile>")
    })
}
