//! Writes a VTU for GEOS. `attribute` is the region of each cell (1 or more). The rock arrays have
//! the names of GEOS' own examples, so that `fieldsToImport` and `fieldNamesInGEOS` are equal.
//! Names of faces become sets of nodes: arrays of 0 and 1 for `nodesetNames` (64-bit, as GEOS
//! ignores other types). The named faces are also written as triangles or polygons, whose
//! `attribute` is the number of the name. GEOS makes a node set with that number from their nodes.
//! GEOS does not read sets of faces. It gives each node set a face set of the same name: the faces
//! all of whose nodes are in the set.
//!
//! If the mesh is split along surfaces, `NAME.vtm` has the mesh as its block `main`, and a block
//! for each surface (`faceBlocks`). In these, `collocated_nodes` lists for each node the nodes of
//! the mesh at the same position.
//!
//! GEOS reads tetrahedra and prisms, but of other polyhedra only those that have a name in GEOS.

use std::io::Write;
use std::path::Path;

use crate::Result;
use crate::export::format::{ExportContent, ExportFormat};
use crate::export::meshers::groups::NamedSides;
use crate::export::meshers::simplices::{SimplexMesh, TornSurface};
use crate::export::names::{ExportNames, FormatNames, Naming};
use crate::files::Batch;
use crate::files::vtk::DataArray;
use crate::files::vtk::xml::escape;
use crate::geometry::sorted_distinct;
use crate::mesh::poly::PolyMesh;
use crate::mesh::{Mesh, TetMesh, TriMesh};
use crate::mesh_file::vtu::{MixedCells, add_mixed_vtu};
use crate::model::flow::SplitMesh;
use crate::model::reservoir::Model;
use crate::names::{LetterCase, NameRules};

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "geos",
    description: "VTU for GEOS: attribute, rock, sets of nodes and faces",
    extensions: &["vtu"],
    has_companion: false,
    holds_any_cells: true,
    uses_depth: false,
    supported_content: &[
        ExportContent::Names,
        ExportContent::Regions,
        ExportContent::Porosity,
        ExportContent::Permeability,
        ExportContent::Properties,
        ExportContent::SplitNodes,
    ],
    deck_path: None,
    names: FormatNames {
        regions: Naming::Numbers,
        max_region_number: Some(i32::MAX),
        // Fractures are files.
        faces: Naming::Names(NameRules::FILE),
        properties: Some(NameRules {
            case: LetterCase::Sensitive,
            reserved: &[
                "attribute",
                "rockPorosity_referencePorosity",
                "rockPerm_permeability",
            ],
            ..NameRules::FILE
        }),
        ..FormatNames::NONE
    },
    write,
};

/// Array names of porosity and permeability.
const ROCK_ARRAY_NAMES: [&str; 2] = ["rockPorosity_referencePorosity", "rockPerm_permeability"];
/// VTK cell types.
const TRIANGLE_TYPE: u8 = TriMesh::VTK_CELL;
const TETRAHEDRON_TYPE: u8 = TetMesh::VTK_CELL;
const POLYGON_TYPE: u8 = PolyMesh::<2>::VTK_CELL;
const ERROR_PLACE: &str = "a mesh for GEOS";

/// Writes the mesh.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if a file cannot be written.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let regions = model.mesh.region.iter();
    let attribute: Vec<i32> = regions.map(|&r| names.region_number(r)).collect();
    let mut arrays = vec![DataArray::scalars("attribute", attribute)];
    if let Some(porosity) = &model.porosity {
        arrays.push(DataArray::scalars(ROCK_ARRAY_NAMES[0], porosity.clone()));
    }
    if let Some(permeability) = &model.permeability {
        let diagonal = |cell: usize| permeability.rock.mobility(cell).0.into_iter().take(3);
        arrays.push(DataArray {
            name: ROCK_ARRAY_NAMES[1].into(),
            components: 3,
            values: (0..model.len())
                .flat_map(diagonal)
                .collect::<Vec<f64>>()
                .into(),
        });
    }
    for (property, name) in model.properties.iter().zip(&names.properties) {
        arrays.push(DataArray {
            name: name.clone(),
            ..property.clone()
        });
    }
    if model.tets.is_none() {
        let cells = MixedCells::polyhedra(&model.mesh);
        let named_sides = NamedSides::from_model(model, &names.faces);
        return cells_with_faces(batch, path, &model.mesh.nodes, cells, &named_sides, arrays);
    }
    let mesh = &SimplexMesh::new(model, names, ERROR_PLACE)?;
    let mut cells = MixedCells::default();
    (0..mesh.len()).for_each(|t| cells.push(TETRAHEDRON_TYPE, mesh.get(t).iter().copied()));
    cells_with_faces(batch, path, mesh.nodes, cells, &mesh.named_sides, arrays)?;
    match &model.split_mesh {
        Some(split) => write_fractures(mesh, split, batch, path),
        None => Ok(()),
    }
}

/// Returns a node set as an array: 1 for the nodes in it, 0 for the others.
fn node_set(name: &str, count: usize, nodes: &[u32]) -> DataArray {
    let mut membership = vec![0i64; count];
    nodes.iter().for_each(|&n| membership[n as usize] = 1);
    DataArray::scalars(name, membership)
}

/// Writes cells with their named faces. `arrays` are the arrays of the cells, `attribute` first.
fn cells_with_faces(
    batch: &mut Batch,
    path: &Path,
    nodes: &[[f64; 3]],
    mut cells: MixedCells,
    named_sides: &[NamedSides],
    arrays: Vec<DataArray>,
) -> Result<()> {
    // A face has the values of the cell on whose side it is.
    let count = cells.kinds.len();
    let mut rows: Vec<u32> = (0..count as u32).collect();
    let mut numbers = Vec::new();
    for group in named_sides {
        for (i, &cell) in group.cells.iter().enumerate() {
            let side = group.sides.get(i);
            let kind = if side.len() == 3 {
                TRIANGLE_TYPE
            } else {
                POLYGON_TYPE
            };
            cells.push(kind, side.iter().copied());
            rows.push(cell);
            numbers.push(group.number as i32);
        }
    }
    let mut arrays: Vec<DataArray> = (arrays.into_iter())
        .map(|array| DataArray {
            values: array.values.select_tuples(&rows, array.components),
            ..array
        })
        .collect();
    let cell_attribute = arrays[0].values.to_i64().into_iter().take(count);
    let attribute: Vec<i32> = cell_attribute.map(|a| a as i32).chain(numbers).collect();
    arrays[0].values = attribute.into();
    let sets: Vec<DataArray> = (named_sides.iter())
        .map(|group| node_set(&group.name, nodes.len(), &group.sides.items))
        .collect();
    add_mixed_vtu(batch, path, nodes, &cells, &sets, &arrays)
}

/// Writes a file for each surface along which the mesh is split, and the file that lists all files.
fn write_fractures(
    mesh: &SimplexMesh,
    split: &SplitMesh,
    batch: &mut Batch,
    path: &Path,
) -> Result<()> {
    // Pairs of original node and node, sorted: all nodes at one position are neighbours.
    let mut nodes_by_origin: Vec<(u32, u32)> =
        split.original_node.iter().copied().zip(0..).collect();
    nodes_by_origin.sort_unstable();
    let duplicates = |n: u32| {
        let origin = split.original_node[n as usize];
        let first = nodes_by_origin.partition_point(|p| p.0 < origin);
        nodes_by_origin[first..]
            .iter()
            .take_while(move |p| p.0 == origin)
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
        // A face does not separate anything if none of its nodes is doubled.
        let is_split = |pair: &&[[u32; 3]; 2]| pair[0] != pair[1];
        let faces: Vec<[u32; 3]> = pairs.iter().filter(is_split).map(|pair| pair[0]).collect();
        let origin = |n: &u32| split.original_node[*n as usize];
        let origins = sorted_distinct(faces.as_flattened().iter().map(origin));
        let max_count = origins
            .iter()
            .map(|&n| duplicates(n).count())
            .max()
            .unwrap_or(0);
        let mut collocated = Vec::with_capacity(max_count * origins.len());
        for &n in &origins {
            let start = collocated.len();
            collocated.extend(duplicates(n).map(|p| i64::from(p.1)));
            collocated.resize(start + max_count, -1);
        }
        let mut cells = MixedCells::default();
        for face in &faces {
            let local = |n: u32| origins.partition_point(|&m| m < origin(&n)) as u32;
            cells.push(TRIANGLE_TYPE, face.map(local));
        }
        let nodes: Vec<[f64; 3]> = origins.iter().map(|&n| mesh.nodes[n as usize]).collect();
        let collocated = DataArray {
            name: "collocated_nodes".into(),
            components: max_count,
            values: collocated.into(),
        };
        let attribute = DataArray::scalars("attribute", vec![*number as i32; faces.len()]);
        let file = format!("{stem}-{name}.vtu");
        let surface_path = path.with_file_name(&file);
        add_mixed_vtu(
            batch,
            &surface_path,
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
