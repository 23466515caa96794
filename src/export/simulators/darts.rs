//! Writes connections and cells for open-DARTS' `conn_mesh`, in columns that `numpy.loadtxt` reads:
//! `NAME.conn` with block_m, block_p, tran, tranD, and `NAME.cells`. If there are wells,
//! `NAME.wells` has a line for each block to which a well is connected.
//!
//! Blocks are numbered from 0. tran and the well indices are in cP m3/day/bar, as in DARTS. tranD
//! is area over distance (m).

use std::io::Write;
use std::path::Path;

use super::opm::TRANSMISSIBILITY_UNIT;
use crate::Result;
use crate::export::format::{ExportContent, ExportFormat};
use crate::export::names::{ExportNames, FormatNames, Naming, TablePlace};
use crate::files::Batch;
use crate::files::text::write_items;
use crate::model::reservoir::{BAR, Control, DAY, MILLIDARCY, Model};
use crate::names::NameRules;

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "darts",
    description: "open-DARTS connection list, and its cells",
    extensions: &["conn"],
    has_companion: true,
    holds_any_cells: true,
    uses_depth: true,
    supported_content: &[
        ExportContent::Regions,
        ExportContent::Porosity,
        ExportContent::Permeability,
        ExportContent::Properties,
        ExportContent::CutOffs,
        ExportContent::Faults,
        ExportContent::ClosedFaults,
        ExportContent::Wells,
    ],
    deck_path: None,
    names: FormatNames {
        regions: Naming::Numbers,
        wells: Some(NameRules::FILE),
        table: TablePlace::Comments("# "),
        ..FormatNames::NONE
    },
    write,
};

const ERROR_PLACE: &str = "a DARTS connection list";

/// Writes the files. `path` is the `.conn` file.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if porosity or permeability is missing.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let porosity = model.need_porosity(ERROR_PLACE)?;
    let permeability = model.need_permeability(ERROR_PLACE)?;
    let (graph, t) = (&model.graph, &permeability.transmissibility);
    batch.write(path, |out| {
        writeln!(out, "# block_m block_p tran tranD")?;
        write_items(out, t.len(), |text, i| {
            let c = &graph.connections[i];
            let text = text.int(c.cells[0]).spaced_int(c.cells[1]);
            let text = text.spaced_real(TRANSMISSIBILITY_UNIT * t[i]);
            text.spaced_real(c.unit_transmissibility()).end_line();
        })
    })?;
    batch.write(&path.with_extension("cells"), |out| {
        write!(out, "{}", names.comments())?;
        writeln!(out, "# volume poro depth permx permy permz region x y z")?;
        write_items(out, model.len(), |text, c| {
            let text = text.real(graph.volume[c]).spaced_real(porosity[c]);
            text.spaced_real(model.depth(c));
            for k in &permeability.rock.mobility(c).0[..3] {
                text.spaced_real(k / MILLIDARCY);
            }
            text.spaced_int(graph.region[c])
                .point(graph.site[c])
                .end_line();
        })
    })?;
    if model.case.wells.is_empty() {
        return Ok(());
    }
    batch.write(&path.with_extension("wells"), |out| {
        writeln!(out, "# name block index radius control value (m3/day, bar)")?;
        write!(out, "{}", names.comments())?;
        for (well, name) in model.case.wells.iter().zip(&names.wells) {
            let (control, value) = match well.control {
                Control::Inject(rate) => ("inject", rate * DAY),
                // Formats without schedules have no such wells.
                Control::Scheduled => ("inject", 0.0),
                Control::Pressure(pressure) => ("pressure", pressure / BAR),
            };
            let radius = well.radius;
            for (block, index) in &well.cells {
                let index = TRANSMISSIBILITY_UNIT * index;
                writeln!(out, "{name} {block} {index:e} {radius} {control} {value}")?;
            }
        }
        Ok(())
    })
}
