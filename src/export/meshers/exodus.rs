//! Exodus II in NetCDF's classic format: an element block for each region; a side set and a node set for each
//! side of the box, each surface, and what parts two regions; values of cells at one time, 0. Between the two
//! sides of a surface along which the mesh is torn, wedges of no thickness, in a block that has its name.
//!
//! Elements are numbered block by block; `elem_num_map` has the cells' own numbers, from 1 on. Sets have the
//! numbers of Gmsh's physical groups; the block of a region has the region's number, from 1 on.
//!
//! Layout: "EXODUS: A Finite Element Data Model" (Sandia National Laboratories), chapter 5 and appendix A.

use std::path::Path;

use super::groups::{Named, region_name, regions, shift_of_regions};
use super::simplices::Simplices;
use crate::error::cause;
use crate::export::containers::binary::Numbers;
use crate::export::containers::netcdf::{self, Attribute, File, MOST_BYTES, Variable};
use crate::export::values::columns;
use crate::files::Batch;
use crate::model::reservoir::Model;
use crate::{Error, Result};

/// The side of an element opposite its corner k, in space and in the plane.
const SIDE_OPPOSITE: [[i32; 4]; 2] = [[2, 3, 1, 4], [2, 3, 1, 0]];
/// A triangle that is not in the plane z = 0 is a shell, whose first two sides are its faces.
const FACES_OF_SHELL: i32 = 2;
/// Bytes of a name, with the 0 at its end.
const NAME: usize = 129;

/// Elements of one type.
struct Block {
    name: String,
    number: i32,
    kind: &'static str,
    /// The nodes of each, `size` of them.
    nodes: Vec<i32>,
    size: usize,
}

impl Block {
    fn len(&self) -> usize {
        self.nodes.len() / self.size
    }
}

/// Writes the mesh.
///
/// # Errors
/// [`Error::Export`] if the cells are neither tetrahedra nor triangles, or too many for the format.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &Simplices::new(model, "Exodus II")?;
    let mut order: Vec<u32> = (0..mesh.len() as u32).collect();
    order.sort_by_key(|&cell| mesh.region[cell as usize]);
    let (blocks, columns) = (blocks(model, mesh, &order), columns(model));
    let most = blocks.iter().map(|block| 4 * block.nodes.len() as u64);
    if most.chain([8 * mesh.node_count() as u64]).max() > Some(MOST_BYTES) {
        return Err(Error::Export(cause(
            path.display(),
            "has more cells than Exodus II in NetCDF's classic format holds",
            "export to vtkhdf",
        )));
    }
    let wedges: usize = mesh.torn.iter().map(|torn| torn.pairs.len()).sum();
    let flat = mesh.nodes.iter().all(|p| p[2] == mesh.nodes[0][2]);
    let dim = if mesh.size == 3 && flat { 2 } else { 3 };
    let mut file = head(mesh.node_count(), order.len() + wedges, dim);
    let count = order.len() + wedges;
    let map = Numbers::computed(count, |i| {
        order.get(i).map_or(i, |&c| c as usize) as i32 + 1
    });
    file.variables
        .push(Variable::new("elem_num_map", &["num_elem"], map));
    for (k, axis) in ["coordx", "coordy", "coordz"][..dim].iter().enumerate() {
        let numbers = Numbers::computed(mesh.node_count(), move |i| mesh.point(i)[k]);
        file.variables
            .push(Variable::new(*axis, &["num_nodes"], numbers));
    }
    let axes: Vec<String> = ["x", "y", "z"][..dim].iter().map(|&a| a.into()).collect();
    file.variables.push(Variable::texts(
        "coor_names",
        &["num_dim", "len_name"],
        NAME,
        &axes,
    ));
    put_blocks(&mut file, &blocks);
    let mut place = vec![0; order.len()];
    for (number, &cell) in (1..).zip(&order) {
        place[cell as usize] = number;
    }
    put_sets(&mut file, mesh, &place, dim);
    put_values(&mut file, &columns, &blocks, &order);
    batch.write(path, |out| netcdf::write(out, &file))
}

/// Dimensions and words that every file has.
fn head<'a>(nodes: usize, elements: usize, dim: usize) -> File<'a> {
    let mut file = File::default();
    for (name, length) in [
        ("len_string", 33),
        ("len_line", 81),
        ("four", 4),
        ("len_name", NAME),
        ("time_step", 0),
        ("num_dim", dim),
        ("num_nodes", nodes),
        ("num_elem", elements),
    ] {
        file.dimensions.push((name.into(), length));
    }
    let version = concat!("atomesh ", env!("CARGO_PKG_VERSION"));
    for (name, value) in [
        ("api_version", Attribute::Float(8.11)),
        ("version", Attribute::Float(8.11)),
        ("floating_point_word_size", Attribute::Int(8)),
        ("file_size", Attribute::Int(1)),
        ("maximum_name_length", Attribute::Int(NAME as i32 - 1)),
        ("title", Attribute::Text(version.into())),
    ] {
        file.attributes.push((name.into(), value));
    }
    file
}

/// The elements of each region, in this order, and those between torn faces.
fn blocks(model: &Model, mesh: &Simplices, order: &[u32]) -> Vec<Block> {
    let kind = match (mesh.size, mesh.is_quadratic()) {
        (4, false) => "TETRA",
        (4, true) => "TETRA10",
        (_, false) => "TRI3",
        (_, true) => "TRI6",
    };
    let corners = mesh.size;
    let edges = corners * (corners - 1) / 2;
    let size = corners + if mesh.is_quadratic() { edges } else { 0 };
    let shift = shift_of_regions(model);
    let of_regions = regions(model).into_iter().map(|region| {
        let start = order.partition_point(|&c| mesh.region[c as usize] < region);
        let end = order.partition_point(|&c| mesh.region[c as usize] <= region);
        let mut nodes = Vec::with_capacity((end - start) * size);
        for &cell in &order[start..end] {
            mesh.visit(mesh.get(cell as usize), |n| nodes.push(n as i32 + 1));
        }
        Block {
            name: region_name(model, region),
            number: (i64::from(region) + shift) as i32,
            kind,
            nodes,
            size,
        }
    });
    let mut blocks: Vec<Block> = of_regions.collect();
    let last = blocks.iter().map(|block| block.number).max().unwrap_or(0);
    for (number, torn) in (last + 1..).zip(&mesh.torn) {
        let nodes = torn.pairs.iter().flat_map(|pair| pair.as_flattened());
        blocks.push(Block {
            name: torn.name.clone(),
            number,
            kind: "WEDGE",
            nodes: nodes.map(|&n| n as i32 + 1).collect(),
            size: 6,
        });
    }
    blocks
}

/// The words and numbers of `count` blocks or sets: their status, numbers and names.
fn list<'a>(file: &mut File<'a>, prefix: &str, count: &str, named: Vec<(i32, String)>) {
    file.dimensions.push((count.into(), named.len()));
    let (numbers, names): (Vec<i32>, Vec<String>) = named.into_iter().unzip();
    let status = Numbers::computed(numbers.len(), |_| 1i32);
    let property = Numbers::computed(numbers.len(), move |i| numbers[i]);
    file.variables
        .push(Variable::new(format!("{prefix}_status"), &[count], status));
    let mut ids = Variable::new(format!("{prefix}_prop1"), &[count], property);
    ids.attributes
        .push(("name".into(), Attribute::Text("ID".into())));
    file.variables.push(ids);
    let names = Variable::texts(
        format!("{prefix}_names"),
        &[count, "len_name"],
        NAME,
        &names,
    );
    file.variables.push(names);
}

fn put_blocks<'a>(file: &mut File<'a>, blocks: &'a [Block]) {
    let named = blocks
        .iter()
        .map(|block| (block.number, block.name.clone()));
    list(file, "eb", "num_el_blk", named.collect());
    for (k, block) in (1..).zip(blocks) {
        let [len, size] = [format!("num_el_in_blk{k}"), format!("num_nod_per_el{k}")];
        let nodes = Numbers::slice(&block.nodes);
        let mut connect = Variable::new(format!("connect{k}"), &[&len, &size], nodes);
        let kind = Attribute::Text(block.kind.into());
        connect.attributes.push(("elem_type".into(), kind));
        file.variables.push(connect);
        file.dimensions.push((len, block.len()));
        file.dimensions.push((size, block.size));
    }
}

/// `place` has each cell's number among the elements.
fn put_sets<'a>(file: &mut File<'a>, mesh: &Simplices, place: &[i32], dim: usize) {
    if mesh.named.is_empty() {
        return;
    }
    let opposite = SIDE_OPPOSITE[usize::from(mesh.size == 3)];
    let shell = if mesh.size == 3 && dim == 3 {
        FACES_OF_SHELL
    } else {
        0
    };
    let named = || {
        mesh.named
            .iter()
            .map(|named| (named.number as i32, named.name.clone()))
    };
    list(file, "ss", "num_side_sets", named().collect());
    list(file, "ns", "num_node_sets", named().collect());
    for (k, Named { sides, cells, .. }) in (1..).zip(&mesh.named) {
        let (mut elements, mut numbers) = (Vec::new(), Vec::new());
        let mut nodes: Vec<i32> = Vec::new();
        for (i, &cell) in cells.iter().enumerate() {
            let side = sides.get(i);
            let corner = mesh
                .get(cell as usize)
                .iter()
                .position(|n| !side.contains(n));
            elements.push(place[cell as usize]);
            numbers.push(opposite[corner.unwrap_or(0)] + shell);
            mesh.visit(side, |n| nodes.push(n as i32 + 1));
        }
        nodes.sort_unstable();
        nodes.dedup();
        let [sides, points] = [format!("num_side_ss{k}"), format!("num_nod_ns{k}")];
        file.dimensions.push((sides.clone(), elements.len()));
        file.dimensions.push((points.clone(), nodes.len()));
        for (name, on, values) in [
            (format!("elem_ss{k}"), &sides, elements),
            (format!("side_ss{k}"), &sides, numbers),
            (format!("node_ns{k}"), &points, nodes),
        ] {
            let values = Numbers::computed(values.len(), move |i| values[i]);
            file.variables.push(Variable::new(name, &[on], values));
        }
    }
}

/// The values of cells, which wedges do not have.
fn put_values<'a>(
    file: &mut File<'a>,
    columns: &'a [(String, Vec<f64>)],
    blocks: &[Block],
    order: &'a [u32],
) {
    let wedge = |block: &Block| block.kind == "WEDGE";
    let (count, width) = (blocks.len(), columns.len());
    file.dimensions.push(("num_elem_var".into(), width));
    let known: Vec<i32> = blocks
        .iter()
        .map(|block| i32::from(!wedge(block)))
        .collect();
    let table = Numbers::computed(count * width, move |i| known[i / width]);
    let on = ["num_el_blk", "num_elem_var"];
    file.variables
        .push(Variable::new("elem_var_tab", &on, table));
    let names: Vec<String> = columns.iter().map(|(name, _)| name.clone()).collect();
    let on = ["num_elem_var", "len_name"];
    file.variables
        .push(Variable::texts("name_elem_var", &on, NAME, &names));
    let now = Numbers::computed(1, |_| 0.0f64);
    file.variables
        .push(Variable::new("time_whole", &["time_step"], now));
    for (number, (_, values)) in (1..).zip(columns) {
        let mut start = 0;
        for (k, block) in (1..).zip(blocks).filter(|(_, block)| !wedge(block)) {
            let own = &order[start..][..block.len()];
            start += block.len();
            let name = format!("vals_elem_var{number}eb{k}");
            let on = ["time_step", &format!("num_el_in_blk{k}")];
            let numbers = Numbers::computed(own.len(), |i| values[own[i] as usize]);
            file.variables.push(Variable::new(name, &on, numbers));
        }
    }
}
