//! Writes Exodus II in NetCDF's classic format: an element block for each region; a side set and a
//! node set for each side of the box, each surface, and each interface of two regions; and the
//! values of cells at the time 0.
//!
//! - `simplices`: tetrahedra or triangles, also split or quadratic
//! - `cells`: cells of any shape, which are lists of faces (`NFACED`), which are lists of nodes
//!   (`NSIDED`)
//!
//! Elements are numbered block by block. `elem_num_map` has the cell numbers of the mesh, from 1.
//! Sets have the numbers of Gmsh's physical groups. The block of a region has the number of the
//! region, if all regions have numbers above 0.
//!
//! Source: "EXODUS: A Finite Element Data Model" (Sandia National Laboratories), chapter 5 and
//! appendix A; for cells of any shape "Polyhedral Element Support" in the documentation of the
//! library.

mod cells;
mod simplices;

use std::ops::Range;
use std::path::Path;

use super::NAMES_AND_ROCK;
use super::groups::sorted_regions;
use super::simplices::SimplexMesh;
use crate::error::cause;
use crate::export::containers::binary::LazyArray;
use crate::export::containers::netcdf::{
    self, MAX_VARIABLE_BYTES, NetcdfAttribute, NetcdfFile, NetcdfVariable,
};
use crate::export::format::ExportFormat;
use crate::export::names::{ExportNames, FormatNames, TablePlace};
use crate::export::values::scalar_columns;
use crate::files::Batch;
use crate::mesh_file::formats::exodus::{
    COORDINATES, ELEMENT_BLOCKS, ELEMENT_TYPE, ELEMENT_VALUE_NAMES, ELEMENTS, ELEMENTS_OF_FACES,
    FACE_BLOCKS, FACES, NFACED, NODE_SET_ARRAY, NODE_SETS, NSIDED, ObjectKind, SIDE_SET_ARRAYS,
    SIDE_SETS,
};
use crate::model::reservoir::Model;
use crate::names::NameRules;
use crate::{Error, Result};

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "exodus",
    description: "Exodus II: element blocks, side sets and node sets, values of cells",
    extensions: &["exo", "e", "ex2"],
    has_companion: false,
    holds_any_cells: true,
    uses_depth: false,
    supported_content: NAMES_AND_ROCK,
    deck_path: None,
    names: FormatNames {
        properties: Some(ENTITY_NAMES),
        has_columns: true,
        faces_overlap: true,
        node_set_prefix: Some(""),
        max_region_number: Some(MAX_REGION_NUMBER),
        ..FormatNames::one_namespace(ENTITY_NAMES, TablePlace::Companion)
    },
    write,
};

/// Largest number of the block of a region. The blocks between the sides of split surfaces follow.
const MAX_REGION_NUMBER: i32 = i32::MAX - (1 << 20);
/// Rules of Exodus for the names of blocks, sets and variables. Readers that keep the library's
/// default length see the first 32 bytes.
const ENTITY_NAMES: NameRules = NameRules {
    max_bytes: NAME_BYTES - 1,
    distinct_bytes: 32,
    ..NameRules::TEXT
};
/// Size of a name in bytes, with the final zero.
const NAME_BYTES: usize = 129;

/// Mesh in the form of Exodus.
struct ExodusMesh {
    dim: usize,
    points: Vec<[f64; 3]>,
    /// Cells in the order of the elements.
    cell_order: Vec<u32>,
    /// Blocks of elements.
    blocks: Vec<Block>,
    /// Faces of cells of any shape.
    faces: Option<Block>,
    sets: Vec<SideSet>,
    /// Sets of nodes besides those of sides: the name, and the nodes from 1.
    node_sets: Vec<(String, Vec<i32>)>,
}

/// Elements, or faces, of one type.
struct Block {
    name: String,
    number: i32,
    element_type: &'static str,
    /// Nodes, or faces, of each element, one after the other, from 1.
    connectivity: Vec<i32>,
    /// Number of nodes, or faces, of each element.
    part_counts: PartCounts,
    /// `true` if the elements are cells of the model, which have values.
    has_cell_values: bool,
}

/// Number of nodes, or faces, of the elements of a block.
enum PartCounts {
    Uniform(usize),
    PerElement(Vec<i32>),
}

/// Named sides of elements.
struct SideSet {
    name: String,
    number: usize,
    /// Element of each side, and the number of the side in it, both from 1.
    elements: Vec<i32>,
    sides: Vec<i32>,
    /// Nodes of all sides, from 1.
    nodes: Vec<i32>,
}

impl SideSet {
    /// Creates a set without sides.
    fn new(name: &str, number: usize) -> Self {
        Self {
            name: name.into(),
            number,
            elements: Vec::new(),
            sides: Vec::new(),
            nodes: Vec::new(),
        }
    }

    /// Adds a side of an element, and its nodes, all from 1.
    fn add(&mut self, element: i32, side: i32, nodes: impl IntoIterator<Item = i32>) {
        self.elements.push(element);
        self.sides.push(side);
        self.nodes.extend(nodes);
    }

    /// Sorts the nodes and removes duplicates.
    fn with_unique_nodes(mut self) -> Self {
        self.nodes.sort_unstable();
        self.nodes.dedup();
        self
    }
}

impl Block {
    fn len(&self) -> usize {
        match &self.part_counts {
            PartCounts::Uniform(size) => self.connectivity.len() / size,
            PartCounts::PerElement(counts) => counts.len(),
        }
    }
}

/// Writes the mesh.
///
/// # Errors
/// Returns [`Error::Export`] if there are too many cells for the format.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let grid = if model.tets.is_some() || model.triangles.is_some() {
        simplices::exodus_mesh(model, names, &SimplexMesh::new(model, names, "Exodus II")?)
    } else {
        cells::exodus_mesh(model, names)
    };
    let sizes = grid.blocks.iter().chain(&grid.faces);
    let sizes = sizes.map(|block| 4 * block.connectivity.len() as u64);
    if sizes.chain([8 * grid.points.len() as u64]).max() > Some(MAX_VARIABLE_BYTES) {
        return Err(Error::Export(cause(
            path.display(),
            "has more cells than Exodus II in NetCDF's classic format holds",
            "export to vtkhdf",
        )));
    }
    let columns = scalar_columns(model, &names.properties);
    let ExodusMesh {
        dim,
        points,
        cell_order: order,
        blocks,
        ..
    } = &grid;
    let count = blocks.iter().map(Block::len).sum();
    let mut file = new_file(points.len(), count, *dim);
    let map = LazyArray::from_fn(count, |i| {
        order.get(i).map_or(i, |&c| c as usize) as i32 + 1
    });
    file.variables
        .push(NetcdfVariable::new("elem_num_map", &["num_elem"], map));
    for (k, axis) in COORDINATES[..*dim].iter().enumerate() {
        let numbers = LazyArray::from_fn(points.len(), move |i| points[i][k]);
        file.variables
            .push(NetcdfVariable::new(*axis, &["num_nodes"], numbers));
    }
    let axes: Vec<String> = ["x", "y", "z"][..*dim].iter().map(|&a| a.into()).collect();
    file.variables.push(NetcdfVariable::from_texts(
        "coor_names",
        &["num_dim", "len_name"],
        NAME_BYTES,
        &axes,
    ));
    if let Some(faces) = &grid.faces {
        file.dimensions.push(("num_face".into(), faces.len()));
        add_blocks(&mut file, &FACE_BLOCKS, std::slice::from_ref(faces));
    }
    add_blocks(&mut file, &ELEMENT_BLOCKS, blocks);
    add_sets(&mut file, &grid.sets);
    add_node_sets(&mut file, &grid);
    add_values(&mut file, &columns, blocks, order);
    batch.write(path, |out| netcdf::write(out, &file))
}

/// Region: its name, its number, and the range of its cells in the order of elements.
struct RegionCells {
    name: String,
    number: i32,
    cells: Range<usize>,
}

/// Returns the cells ordered by region, and the regions.
fn order_by_region(model: &Model, names: &ExportNames) -> (Vec<u32>, Vec<RegionCells>) {
    let region = &model.mesh.region;
    let mut order: Vec<u32> = (0..region.len() as u32).collect();
    order.sort_by_key(|&cell| region[cell as usize]);
    let regions = sorted_regions(model).into_iter().map(|value| {
        let start = order.partition_point(|&c| region[c as usize] < value);
        let end = order.partition_point(|&c| region[c as usize] <= value);
        RegionCells {
            name: names.region(value).to_string(),
            number: names.region_number(value),
            cells: start..end,
        }
    });
    let regions = regions.collect();
    (order, regions)
}

/// Returns the element number of each cell, from 1.
fn element_numbers(order: &[u32]) -> Vec<i32> {
    let mut elements = vec![0; order.len()];
    for (number, &cell) in (1..).zip(order) {
        elements[cell as usize] = number;
    }
    elements
}

/// Creates a file with the dimensions and attributes that every file has.
fn new_file<'a>(nodes: usize, elements: usize, dim: usize) -> NetcdfFile<'a> {
    let mut file = NetcdfFile::default();
    for (name, length) in [
        ("len_string", 33),
        ("len_line", 81),
        ("four", 4),
        ("len_name", NAME_BYTES),
        ("time_step", 0),
        ("num_dim", dim),
        ("num_nodes", nodes),
        ("num_elem", elements),
    ] {
        file.dimensions.push((name.into(), length));
    }
    let version = concat!("atomesh ", env!("CARGO_PKG_VERSION"));
    for (name, value) in [
        ("api_version", NetcdfAttribute::Float(8.11)),
        ("version", NetcdfAttribute::Float(8.11)),
        ("floating_point_word_size", NetcdfAttribute::Int(8)),
        ("file_size", NetcdfAttribute::Int(1)),
        (
            "maximum_name_length",
            NetcdfAttribute::Int(NAME_BYTES as i32 - 1),
        ),
        ("title", NetcdfAttribute::Text(version.into())),
    ] {
        file.attributes.push((name.into(), value));
    }
    file
}

/// Adds the status, the numbers and the names of blocks or sets.
fn add_list(file: &mut NetcdfFile<'_>, kind: &ObjectKind, entries: Vec<(i32, String)>) {
    let ObjectKind { prefix, count } = *kind;
    file.dimensions.push((count.into(), entries.len()));
    let (numbers, names): (Vec<i32>, Vec<String>) = entries.into_iter().unzip();
    let status = LazyArray::from_fn(numbers.len(), |_| 1i32);
    let property = LazyArray::from_fn(numbers.len(), move |i| numbers[i]);
    file.variables.push(NetcdfVariable::new(
        format!("{prefix}_status"),
        &[count],
        status,
    ));
    let mut ids = NetcdfVariable::new(format!("{prefix}_prop1"), &[count], property);
    ids.attributes
        .push(("name".into(), NetcdfAttribute::Text("ID".into())));
    file.variables.push(ids);
    let names = NetcdfVariable::from_texts(
        format!("{prefix}_names"),
        &[count, "len_name"],
        NAME_BYTES,
        &names,
    );
    file.variables.push(names);
}

/// Adds blocks of elements or of faces.
fn add_blocks<'a>(file: &mut NetcdfFile<'a>, kind: &ObjectKind, blocks: &'a [Block]) {
    let entries = blocks
        .iter()
        .map(|block| (block.number, block.name.clone()));
    add_list(file, kind, entries.collect());
    for (k, block) in (1..).zip(blocks) {
        let block_names = match block.element_type {
            NFACED => ELEMENTS_OF_FACES,
            NSIDED => FACES,
            _ => ELEMENTS,
        };
        let [len, size] = [block_names.len, block_names.size].map(|word| format!("{word}{k}"));
        let dims = [len.as_str(), &size];
        let (used_dims, width) = match block.part_counts {
            PartCounts::Uniform(width) => (&dims[..], width),
            PartCounts::PerElement(_) => (&dims[1..], block.connectivity.len()),
        };
        let name = format!("{}{k}", block_names.list);
        let mut parts =
            NetcdfVariable::new(name, used_dims, LazyArray::from_slice(&block.connectivity));
        let element_type = NetcdfAttribute::Text(block.element_type.into());
        parts.attributes.push((ELEMENT_TYPE.into(), element_type));
        file.variables.push(parts);
        if let PartCounts::PerElement(counts) = &block.part_counts {
            let name = format!("{}{k}", block_names.counts);
            let mut counts_variable =
                NetcdfVariable::new(name, &dims[..1], LazyArray::from_slice(counts));
            for (name, kind) in ["entity_type1", "entity_type2"]
                .into_iter()
                .zip(block_names.types)
            {
                counts_variable
                    .attributes
                    .push((name.into(), NetcdfAttribute::Text(kind.into())));
            }
            file.variables.push(counts_variable);
        }
        file.dimensions.push((len, block.len()));
        file.dimensions.push((size, width));
    }
}

fn add_sets<'a>(file: &mut NetcdfFile<'a>, sets: &'a [SideSet]) {
    if sets.is_empty() {
        return;
    }
    let entries = || sets.iter().map(|set| (set.number as i32, set.name.clone()));
    add_list(file, &SIDE_SETS, entries().collect());
    for (k, set) in (1..).zip(sets) {
        let sides = format!("num_side_ss{k}");
        file.dimensions.push((sides.clone(), set.elements.len()));
        for (array, values) in SIDE_SET_ARRAYS.iter().zip([&set.elements, &set.sides]) {
            let (name, values) = (format!("{array}{k}"), LazyArray::from_slice(values));
            file.variables
                .push(NetcdfVariable::new(name, &[&sides], values));
        }
    }
}

/// Adds a node set for the nodes of each side set, and then the other node sets.
fn add_node_sets<'a>(file: &mut NetcdfFile<'a>, grid: &'a ExodusMesh) {
    let of_sides = grid.sets.iter();
    let mut sets: Vec<(i32, &str, &[i32])> = of_sides
        .map(|set| (set.number as i32, set.name.as_str(), set.nodes.as_slice()))
        .collect();
    let last = sets.iter().map(|set| set.0).max().unwrap_or(0);
    for (number, (name, nodes)) in (last + 1..).zip(&grid.node_sets) {
        sets.push((number, name, nodes));
    }
    if sets.is_empty() {
        return;
    }
    let entries = sets
        .iter()
        .map(|(number, name, _)| (*number, name.to_string()));
    add_list(file, &NODE_SETS, entries.collect());
    for (k, (_, _, nodes)) in (1..).zip(sets) {
        let points = format!("num_nod_ns{k}");
        file.dimensions.push((points.clone(), nodes.len()));
        let values = LazyArray::from_slice(nodes);
        file.variables.push(NetcdfVariable::new(
            format!("{NODE_SET_ARRAY}{k}"),
            &[&points],
            values,
        ));
    }
}

/// Adds the values of the cells. Other elements have none.
fn add_values<'a>(
    file: &mut NetcdfFile<'a>,
    columns: &'a [(String, Vec<f64>)],
    blocks: &[Block],
    order: &'a [u32],
) {
    let (count, width) = (blocks.len(), columns.len());
    file.dimensions.push(("num_elem_var".into(), width));
    let has_values: Vec<i32> = blocks
        .iter()
        .map(|block| i32::from(block.has_cell_values))
        .collect();
    let table = LazyArray::from_fn(count * width, move |i| has_values[i / width]);
    let dims = [ELEMENT_BLOCKS.count, "num_elem_var"];
    file.variables
        .push(NetcdfVariable::new("elem_var_tab", &dims, table));
    let names: Vec<String> = columns.iter().map(|(name, _)| name.clone()).collect();
    let dims = ["num_elem_var", "len_name"];
    file.variables.push(NetcdfVariable::from_texts(
        ELEMENT_VALUE_NAMES,
        &dims,
        NAME_BYTES,
        &names,
    ));
    let time = LazyArray::from_fn(1, |_| 0.0f64);
    file.variables
        .push(NetcdfVariable::new("time_whole", &["time_step"], time));
    for (number, (_, values)) in (1..).zip(columns) {
        let mut start = 0;
        for (k, block) in (1..).zip(blocks).filter(|(_, block)| block.has_cell_values) {
            let block_cells = &order[start..][..block.len()];
            start += block.len();
            let name = format!("vals_elem_var{number}eb{k}");
            let dims = ["time_step", &format!("{}{k}", ELEMENTS.len)];
            let numbers =
                LazyArray::from_fn(block_cells.len(), |i| values[block_cells[i] as usize]);
            file.variables
                .push(NetcdfVariable::new(name, &dims, numbers));
        }
    }
}
