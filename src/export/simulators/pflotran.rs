//! Writes PFLOTRAN's explicit unstructured grid: `CELLS` at their sites, and `CONNECTIONS` at the
//! points where the lines between sites meet the faces. Beside it, a file `NAME-xmin.ex` for each
//! side of the box has the faces of that side, for boundary conditions. If there are several
//! regions, `NAME-region1.txt` has the cells of region 1, and so on.
//!
//! Porosity and permeability of each cell are in `NAME-rock.h5`, as `DATASET`s that are indexed by
//! cell.
//!
//! PFLOTRAN has no multipliers. A fault therefore reduces the area of its faces, and a closed fault
//! removes the connection.

use std::io::Write;
use std::path::Path;

use super::CONNECTION_LIST;
use crate::Result;
use crate::export::containers::binary::LazyArray;
use crate::export::containers::hdf5::{self, Hdf5Node};
use crate::export::format::ExportFormat;
use crate::export::meshers::groups::sorted_regions;
use crate::export::names::{ExportNames, FormatNames, Naming};
use crate::files::Batch;
use crate::files::text::write_items;
use crate::mesh::graph::BoundaryFace;
use crate::mesh::poly::SIDE_NAMES;
use crate::model::reservoir::Model;
use crate::names::NameRules;

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "pflotran",
    description: "PFLOTRAN explicit unstructured grid, with a file for each side",
    extensions: &["uge"],
    has_companion: true,
    holds_any_cells: true,
    uses_depth: true,
    supported_content: CONNECTION_LIST,
    deck_path: None,
    names: FormatNames {
        // Regions are files of their own.
        regions: Naming::Names(NameRules::FILE),
        ..FormatNames::NONE
    },
    write,
};

/// Writes the grid. Cell numbers begin with 1.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if a file cannot be written.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let graph = &model.graph;
    batch.write(path, |out| {
        writeln!(out, "CELLS {}", model.len())?;
        write_items(out, model.len(), |text, c| {
            let text = text.int(c + 1).point(graph.site[c]);
            text.spaced_real(graph.volume[c]).end_line();
        })?;
        let open = model.open_connections();
        writeln!(out, "CONNECTIONS {}", open.len())?;
        write_items(out, open.len(), |text, i| {
            let (i, factor) = open[i];
            let c = &graph.connections[i as usize];
            let text = text.int(c.cells[0] + 1).spaced_int(c.cells[1] + 1);
            text.point(c.point).spaced_real(factor * c.area).end_line();
        })
    })?;
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    for (side, name) in SIDE_NAMES.iter().enumerate() {
        let is_on_side = |face: &&BoundaryFace<3>| face.side == Some(side as u8);
        let faces: Vec<_> = graph.boundary.iter().filter(is_on_side).collect();
        if faces.is_empty() {
            continue;
        }
        batch.write(&path.with_file_name(format!("{stem}-{name}.ex")), |out| {
            writeln!(out, "CONNECTIONS {}", faces.len())?;
            write_items(out, faces.len(), |text, i| {
                let face = faces[i];
                let text = text.int(face.cell + 1).point(face.point);
                text.spaced_real(face.area).end_line();
            })
        })?;
    }
    write_rock(
        model,
        batch,
        &path.with_file_name(format!("{stem}-rock.h5")),
    )?;
    let regions = sorted_regions(model);
    if regions.len() > 1 {
        for region in regions {
            let is_in_region = |c: &usize| graph.region[*c] == region;
            let region_cells: Vec<usize> = (0..model.len()).filter(is_in_region).collect();
            let file = format!("{stem}-{}.txt", names.region(region));
            batch.write(&path.with_file_name(file), |out| {
                write_items(out, region_cells.len(), |text, i| {
                    text.int(region_cells[i] + 1).end_line()
                })
            })?;
        }
    }
    Ok(())
}

/// Writes the porosity and permeability of each cell.
fn write_rock(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let cells = model.len();
    let data = |name: &str, numbers| {
        (
            name.to_string(),
            Hdf5Node::Dataset(vec![cells as u64], numbers),
        )
    };
    let ids = LazyArray::from_fn(cells, |c| c as i32 + 1);
    let mut nodes = vec![data("Cell Ids", ids)];
    if let Some(porosity) = &model.porosity {
        nodes.push(data("Porosity", LazyArray::from_slice(porosity)));
    }
    if let Some(permeability) = &model.permeability {
        for (k, axis) in ["X", "Y", "Z"].into_iter().enumerate() {
            let value = move |c: usize| permeability.rock.mobility(c).0[k];
            let name = format!("Permeability{axis}");
            nodes.push(data(&name, LazyArray::from_fn(cells, value)));
        }
    }
    if nodes.len() == 1 {
        return Ok(());
    }
    batch.write(path, |out| hdf5::write(out, &Hdf5Node::Group(nodes)))
}
