//! Exodus II in NetCDF's classic format: an element block for each region; a side set and a node set for each
//! side of the box, each surface, and what parts two regions; values of cells at one time, 0.
//!
//! - `simplices`: tetrahedra or triangles, also torn or quadratic
//! - `cells`: cells of any shape, which are lists of faces (`NFACED`), which are lists of nodes (`NSIDED`)
//!
//! Elements are numbered block by block; `elem_num_map` has the cells' own numbers, from 1 on. Sets have the
//! numbers of Gmsh's physical groups; the block of a region has the region's number, from 1 on.
//!
//! Layout: "EXODUS: A Finite Element Data Model" (Sandia National Laboratories), chapter 5 and appendix A; of
//! cells of any shape "Polyhedral Element Support" in the library's documentation.

mod cells;
mod simplices;

use std::ops::Range;
use std::path::Path;

use super::groups::{region_name, region_shift, sorted_regions};
use super::simplices::SimplexMesh;
use crate::error::cause;
use crate::export::containers::binary::LazyArray;
use crate::export::containers::netcdf::{
    self, MAX_VARIABLE_BYTES, NetcdfAttribute, NetcdfFile, NetcdfVariable,
};
use crate::export::values::scalar_columns;
use crate::files::Batch;
use crate::model::reservoir::Model;
use crate::{Error, Result};

/// Bytes of a name, with the 0 at its end.
const NAME_BYTES: usize = 129;
/// Types of cells that are lists of faces, and of faces that are lists of nodes.
const NFACED: &str = "NFACED";
const NSIDED: &str = "NSIDED";

/// A mesh as Exodus has it.
struct ExodusMesh {
    dim: usize,
    points: Vec<[f64; 3]>,
    /// The cells in the order of elements.
    cell_order: Vec<u32>,
    /// The elements.
    blocks: Vec<Block>,
    /// The faces of cells of any shape.
    faces: Option<Block>,
    sets: Vec<SideSet>,
}

/// Elements, or faces, of one type.
struct Block {
    name: String,
    number: i32,
    element_type: &'static str,
    /// The nodes, or faces, of each, one after the other, from 1 on.
    connectivity: Vec<i32>,
    /// How many each has.
    part_counts: PartCounts,
    /// Whether its elements are cells of the model, which have values.
    has_cell_values: bool,
}

/// How many parts the elements of a block have.
enum PartCounts {
    Uniform(usize),
    PerElement(Vec<i32>),
}

/// Sides that have a name.
struct SideSet {
    name: String,
    number: usize,
    /// The element of each, and the number of the side there, both from 1 on.
    elements: Vec<i32>,
    sides: Vec<i32>,
    /// The nodes of all, from 1 on.
    nodes: Vec<i32>,
}

impl SideSet {
    /// Without sides yet.
    fn new(name: &str, number: usize) -> Self {
        Self {
            name: name.into(),
            number,
            elements: Vec::new(),
            sides: Vec::new(),
            nodes: Vec::new(),
        }
    }

    /// Adds a side of an element, and its nodes, all from 1 on.
    fn add(&mut self, element: i32, side: i32, nodes: impl IntoIterator<Item = i32>) {
        self.elements.push(element);
        self.sides.push(side);
        self.nodes.extend(nodes);
    }

    /// With each node once.
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
/// [`Error::Export`] if the cells are too many for the format.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let grid = match model.tets.is_some() || model.triangles.is_some() {
        true => simplices::exodus_mesh(model, &SimplexMesh::new(model, "Exodus II")?),
        false => cells::exodus_mesh(model),
    };
    let most = grid.blocks.iter().chain(&grid.faces);
    let most = most.map(|block| 4 * block.connectivity.len() as u64);
    if most.chain([8 * grid.points.len() as u64]).max() > Some(MAX_VARIABLE_BYTES) {
        return Err(Error::Export(cause(
            path.display(),
            "has more cells than Exodus II in NetCDF's classic format holds",
            "export to vtkhdf",
        )));
    }
    let columns = scalar_columns(model);
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
    for (k, axis) in ["coordx", "coordy", "coordz"][..*dim].iter().enumerate() {
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
        add_blocks(&mut file, "fa", "num_fa_blk", std::slice::from_ref(faces));
    }
    add_blocks(&mut file, "eb", "num_el_blk", blocks);
    add_sets(&mut file, &grid.sets);
    add_values(&mut file, &columns, blocks, order);
    batch.write(path, |out| netcdf::write(out, &file))
}

/// A region: its name, its number, and where its cells are among those in order.
struct RegionCells {
    name: String,
    number: i32,
    cells: Range<usize>,
}

/// The cells in the order of their regions, and these.
fn order_by_region(model: &Model) -> (Vec<u32>, Vec<RegionCells>) {
    let region = &model.mesh.region;
    let mut order: Vec<u32> = (0..region.len() as u32).collect();
    order.sort_by_key(|&cell| region[cell as usize]);
    let shift = region_shift(model);
    let parts = sorted_regions(model).into_iter().map(|own| {
        let start = order.partition_point(|&c| region[c as usize] < own);
        let end = order.partition_point(|&c| region[c as usize] <= own);
        RegionCells {
            name: region_name(model, own),
            number: (i64::from(own) + shift) as i32,
            cells: start..end,
        }
    });
    let parts = parts.collect();
    (order, parts)
}

/// The number of each cell among the elements, from 1 on.
fn element_numbers(order: &[u32]) -> Vec<i32> {
    let mut places = vec![0; order.len()];
    for (number, &cell) in (1..).zip(order) {
        places[cell as usize] = number;
    }
    places
}

/// Dimensions and words that every file has.
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

/// The words and numbers of `count` blocks or sets: their status, numbers and names.
fn add_list<'a>(file: &mut NetcdfFile<'a>, prefix: &str, count: &str, named: Vec<(i32, String)>) {
    file.dimensions.push((count.into(), named.len()));
    let (numbers, names): (Vec<i32>, Vec<String>) = named.into_iter().unzip();
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

/// How a file calls the numbers of a block's parts, those of how many each has, the dimensions of both, and
/// what parts are of what.
struct BlockNames {
    list: &'static str,
    counts: &'static str,
    len: &'static str,
    size: &'static str,
    types: [&'static str; 2],
}

const ELEMENTS: BlockNames = BlockNames {
    list: "connect",
    counts: "ebepecnt",
    len: "num_el_in_blk",
    size: "num_nod_per_el",
    types: ["NODE", "ELEM"],
};
const ELEMENTS_OF_FACES: BlockNames = BlockNames {
    list: "facconn",
    size: "num_fac_per_el",
    types: ["FACE", "ELEM"],
    ..ELEMENTS
};
const FACES: BlockNames = BlockNames {
    list: "fbconn",
    counts: "fbepecnt",
    len: "num_fa_in_blk",
    size: "num_nod_per_fa",
    types: ["NODE", "FACE"],
};

/// Blocks of elements (`eb`) or of faces (`fa`).
fn add_blocks<'a>(file: &mut NetcdfFile<'a>, prefix: &str, count: &str, blocks: &'a [Block]) {
    let named = blocks
        .iter()
        .map(|block| (block.number, block.name.clone()));
    add_list(file, prefix, count, named.collect());
    for (k, block) in (1..).zip(blocks) {
        let words = match block.element_type {
            NFACED => ELEMENTS_OF_FACES,
            NSIDED => FACES,
            _ => ELEMENTS,
        };
        let [len, size] = [words.len, words.size].map(|word| format!("{word}{k}"));
        let of_each = [len.as_str(), &size];
        let (on, width) = match block.part_counts {
            PartCounts::Uniform(width) => (&of_each[..], width),
            PartCounts::PerElement(_) => (&of_each[1..], block.connectivity.len()),
        };
        let name = format!("{}{k}", words.list);
        let mut parts = NetcdfVariable::new(name, on, LazyArray::from_slice(&block.connectivity));
        let kind = NetcdfAttribute::Text(block.element_type.into());
        parts.attributes.push(("elem_type".into(), kind));
        file.variables.push(parts);
        if let PartCounts::PerElement(counts) = &block.part_counts {
            let name = format!("{}{k}", words.counts);
            let mut each = NetcdfVariable::new(name, &of_each[..1], LazyArray::from_slice(counts));
            for (name, kind) in ["entity_type1", "entity_type2"]
                .into_iter()
                .zip(words.types)
            {
                each.attributes
                    .push((name.into(), NetcdfAttribute::Text(kind.into())));
            }
            file.variables.push(each);
        }
        file.dimensions.push((len, block.len()));
        file.dimensions.push((size, width));
    }
}

fn add_sets<'a>(file: &mut NetcdfFile<'a>, sets: &'a [SideSet]) {
    if sets.is_empty() {
        return;
    }
    let named = || sets.iter().map(|set| (set.number as i32, set.name.clone()));
    add_list(file, "ss", "num_side_sets", named().collect());
    add_list(file, "ns", "num_node_sets", named().collect());
    for (k, set) in (1..).zip(sets) {
        let [sides, points] = [format!("num_side_ss{k}"), format!("num_nod_ns{k}")];
        file.dimensions.push((sides.clone(), set.elements.len()));
        file.dimensions.push((points.clone(), set.nodes.len()));
        for (name, on, values) in [
            (format!("elem_ss{k}"), &sides, &set.elements),
            (format!("side_ss{k}"), &sides, &set.sides),
            (format!("node_ns{k}"), &points, &set.nodes),
        ] {
            file.variables.push(NetcdfVariable::new(
                name,
                &[on],
                LazyArray::from_slice(values),
            ));
        }
    }
}

/// The values of cells, which other elements do not have.
fn add_values<'a>(
    file: &mut NetcdfFile<'a>,
    columns: &'a [(String, Vec<f64>)],
    blocks: &[Block],
    order: &'a [u32],
) {
    let (count, width) = (blocks.len(), columns.len());
    file.dimensions.push(("num_elem_var".into(), width));
    let known: Vec<i32> = blocks
        .iter()
        .map(|block| i32::from(block.has_cell_values))
        .collect();
    let table = LazyArray::from_fn(count * width, move |i| known[i / width]);
    let on = ["num_el_blk", "num_elem_var"];
    file.variables
        .push(NetcdfVariable::new("elem_var_tab", &on, table));
    let names: Vec<String> = columns.iter().map(|(name, _)| name.clone()).collect();
    let on = ["num_elem_var", "len_name"];
    file.variables.push(NetcdfVariable::from_texts(
        "name_elem_var",
        &on,
        NAME_BYTES,
        &names,
    ));
    let now = LazyArray::from_fn(1, |_| 0.0f64);
    file.variables
        .push(NetcdfVariable::new("time_whole", &["time_step"], now));
    for (number, (_, values)) in (1..).zip(columns) {
        let mut start = 0;
        for (k, block) in (1..).zip(blocks).filter(|(_, block)| block.has_cell_values) {
            let own = &order[start..][..block.len()];
            start += block.len();
            let name = format!("vals_elem_var{number}eb{k}");
            let on = ["time_step", &format!("num_el_in_blk{k}")];
            let numbers = LazyArray::from_fn(own.len(), |i| values[own[i] as usize]);
            file.variables.push(NetcdfVariable::new(name, &on, numbers));
        }
    }
}
