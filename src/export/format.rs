//! List of the formats that `atomesh export` writes.
//!
//! To add a format, write a source file in [`simulators`], [`corner_point`] or [`meshers`] with its
//! `write` function and its entry, a constant `FORMAT`. Declare the module and add `&NAME::FORMAT`
//! to `FORMATS` in the `mod.rs` of that folder. No other file changes.

use std::path::{Path, PathBuf};

use super::companion::add_companion;
use super::names::{ExportNames, FormatNames};
use super::{corner_point, meshers, simulators};
use crate::error::cause;
use crate::files::output::same_file;
use crate::files::{Batch, check_target};
use crate::model::reservoir::Model;
use crate::{Error, Result};

/// Content of a model, besides its cells, that not every format can hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExportContent {
    /// Porosity of each cell.
    Porosity,
    /// Permeability of each cell.
    Permeability,
    /// Region of each cell.
    Regions,
    /// Other properties of each cell.
    Properties,
    /// Net-to-gross ratio of each cell.
    NetToGross,
    /// Numbers of the tables and reports of a deck.
    DeckRegions,
    /// Cells that take no part because a value is below a cut-off.
    CutOffs,
    /// Fault multipliers, which change transmissibilities.
    Faults,
    /// Closed faults, which nothing flows across.
    ClosedFaults,
    /// Fault multipliers of a model without permeability.
    FaultsWithoutRock,
    /// Wells.
    Wells,
    /// Fluids in the pores.
    Fluid,
    /// Contacts between three fluids, schedules and aquifers.
    Study,
    /// Initial pressure.
    InitialPressure,
    /// Simulation without gravity.
    Gravity,
    /// Duration of the simulation.
    Duration,
    /// Number of cells along each axis of a grid on which the model is resampled.
    Grid,
    /// Names of faces: sides of the box, surfaces, interfaces of regions.
    Names,
    /// Nodes that are doubled along surfaces.
    SplitNodes,
    /// Quadratic elements, with nodes in the middle of their edges.
    Quadratic,
    /// Pairs of nodes on opposite sides of a periodic mesh.
    PeriodicPairs,
}

impl ExportContent {
    /// Returns `true` if this content belongs to a simulation, not to the rock.
    pub fn is_simulation_input(self) -> bool {
        use ExportContent::{Duration, Fluid, Gravity, InitialPressure, Study, Wells};
        matches!(
            self,
            Wells | Fluid | Study | InitialPressure | Gravity | Duration
        )
    }
}

impl std::fmt::Display for ExportContent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Porosity => "porosity",
            Self::Permeability => "permeability",
            Self::Regions => "regions of cells",
            Self::Properties => "properties of cells",
            Self::NetToGross => "net-to-gross ratio",
            Self::DeckRegions => "numbers of tables",
            Self::CutOffs => "cells that are cut off",
            Self::Faults => "fault multipliers",
            Self::ClosedFaults => "closed faults",
            Self::FaultsWithoutRock => "faults without permeability",
            Self::Wells => "wells",
            Self::Fluid => "fluids",
            Self::Study => "contacts of fluids, schedules of wells or aquifers",
            Self::InitialPressure => "pressure",
            Self::Gravity => "simulations without gravity",
            Self::Duration => "simulation time",
            Self::Grid => "grid of a chosen size",
            Self::Names => "names of faces",
            Self::SplitNodes => "meshes split along surfaces",
            Self::Quadratic => "quadratic elements",
            Self::PeriodicPairs => "pairs of nodes on opposite sides",
        })
    }
}

/// File format of a simulator or a mesher.
#[derive(Debug)]
pub struct ExportFormat {
    /// Name of the format for `--to`.
    pub name: &'static str,
    /// Description for users.
    pub description: &'static str,
    /// File extensions, or whole file names, the usual one first. The list is empty if the format
    /// is a folder.
    pub extensions: &'static [&'static str],
    /// `true` if the format does not hold the shapes of cells. A companion VTU with the same cells
    /// in the same order is then written beside the file.
    pub has_companion: bool,
    /// `true` if the format holds cells of any shape, not only tetrahedra.
    pub holds_any_cells: bool,
    /// `true` if the format uses depth.
    pub uses_depth: bool,
    /// Content that the format or its companion holds, besides cells and named faces.
    pub supported_content: &'static [ExportContent],
    /// Path of the deck that is written beside a grid, if porosity and permeability are known.
    /// `None` for formats without such a deck.
    pub(super) deck_path: Option<fn(&Path) -> PathBuf>,
    /// Rules for names.
    pub(crate) names: FormatNames,
    /// Writes a model to a file or a folder.
    pub(super) write: fn(&Model, &ExportNames, &mut Batch, &Path) -> Result<()>,
}

/// Returns all formats, in the order in which they are listed.
pub fn formats() -> impl Iterator<Item = &'static ExportFormat> {
    let folders = [simulators::FORMATS, corner_point::FORMATS, meshers::FORMATS];
    folders.into_iter().flatten().copied()
}

/// Programs whose name stands for the format that they read.
const PROGRAMS: [(&str, &str); 5] = [
    ("abaqus", "inp"),
    ("calculix", "inp"),
    ("eclipse", "opm"),
    ("gmsh", "msh"),
    ("modflow", "disv"),
];

/// Formats that hold only the diagonal of the permeability's tensor, each with what follows from that.
const DIAGONAL_FORMATS: [(&str, &str); 8] = [
    (
        "opm",
        "PERMX, PERMY and PERMZ, which well indices come from, lack them; the connections hold them",
    ),
    (
        "grdecl",
        "PERMX, PERMY and PERMZ lack them, and so do the transmissibilities that a simulator computes",
    ),
    (
        "pflotran",
        "PermeabilityX, PermeabilityY and PermeabilityZ lack them, and so does the flow",
    ),
    (
        "tough2",
        "PMX is the permeability along x alone, for all directions",
    ),
    ("disv", "K, K22 and K33 lack them, and so does the flow"),
    (
        "darts",
        "the columns permx, permy and permz lack them; the connections hold them",
    ),
    ("resqml", "the properties I, J and K lack them"),
    (
        "geos",
        "rockPerm_permeability lacks them, and so does the flow",
    ),
];

impl ExportFormat {
    /// Returns what follows from it that the format holds only the diagonal of the permeability's
    /// tensor, or `None` if it holds all of the tensor or none.
    pub(super) fn diagonal_only(&self) -> Option<&'static str> {
        let entry = DIAGONAL_FORMATS.iter().find(|(name, _)| *name == self.name);
        entry.map(|(_, effect)| *effect)
    }

    /// Returns which readers the file needs, if not every common version reads it.
    pub(super) fn needed_reader(&self, has_polyhedra: bool) -> Option<&'static str> {
        match (self.name, has_polyhedra) {
            ("vtkhdf", true) => Some(super::meshers::vtkhdf::READERS_OF_POLYHEDRA),
            ("vtkhdf", false) => Some(super::meshers::vtkhdf::READERS_OF_SIMPLICES),
            _ => None,
        }
    }

    /// Returns the programs whose name stands for the format.
    pub fn programs(&self) -> impl Iterator<Item = &'static str> {
        let programs = PROGRAMS.iter().filter(|(_, format)| *format == self.name);
        programs.map(|(program, _)| *program)
    }

    /// Returns the format with the given name, or that a program with this name reads.
    ///
    /// # Errors
    /// Returns [`Error::Export`] with the list of known names if there is no such format.
    pub fn from_name(name: &str) -> Result<&'static Self> {
        let named = |f: &&ExportFormat| f.name == name || f.programs().any(|p| p == name);
        formats().find(named).ok_or_else(|| {
            let names: Vec<&str> = formats().map(|f| f.name).collect();
            Error::Export(cause(
                format!("format {name}"),
                "is not a format that can be written",
                format!("give one of {}", names.join(", ")),
            ))
        })
    }

    /// Checks that a model of the mesh in the file `mesh` can be written to `path` without replacing
    /// the mesh.
    ///
    /// # Errors
    /// Returns [`Error::Io`], [`Error::Export`] or [`Error::Job`] that names the path.
    pub fn check_files(&self, mesh: &Path, path: &Path) -> Result<()> {
        self.check_target(path)?;
        let companion = self.companion_path(path);
        if same_file(path, mesh) || companion.is_some_and(|path| same_file(&path, mesh)) {
            return Err(Error::Job(cause(
                path.display(),
                "would overwrite the mesh, directly or with its companion VTU",
                "name another file",
            )));
        }
        Ok(())
    }

    /// Checks that a model can be written to `path`, before the long work begins.
    ///
    /// # Errors
    /// Returns [`Error::Export`] if the file has another extension, and [`Error::Io`] if its folder
    /// does not exist.
    pub fn check_target(&self, path: &Path) -> Result<()> {
        if self.is_folder() {
            if path.is_file() {
                let problem = format!("is a file, but {} needs a folder", self.name);
                return Err(Error::Io(cause(path.display(), problem, "name a folder")));
            }
            return Ok(());
        }
        check_target(path)?;
        let ending = path.extension().unwrap_or_default().to_string_lossy();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if !self
            .extensions
            .iter()
            .any(|known| *known == ending || *known == name)
        {
            return Err(Error::Export(cause(
                path.display(),
                format!("does not end in {}", self.extensions.join(" or ")),
                format!(
                    "give it that ending, which programs that read {} expect",
                    self.name
                ),
            )));
        }
        Ok(())
    }

    /// Checks that the format can hold the given content. `place` begins the error message.
    ///
    /// # Errors
    /// Returns [`Error::Export`] with the list of formats that can hold it.
    pub fn check_content(&self, content: ExportContent, place: &str) -> Result<()> {
        if self.supported_content.contains(&content) {
            return Ok(());
        }
        let supporting = formats().filter(|f| f.supported_content.contains(&content));
        let names: Vec<&str> = supporting.map(|f| f.name).collect();
        Err(Error::Export(cause(
            place,
            format!("the format {} holds no {content}", self.name),
            format!("omit it, or export to {}", names.join(", ")),
        )))
    }

    /// Returns `true` if an export is for flow, so that depth and fluxes matter: in formats of
    /// simulators, and in formats of meshers that hold rock if rock is given.
    pub fn is_for_flow(&self, has_rock: bool) -> bool {
        let holds_rock = self
            .supported_content
            .contains(&ExportContent::Permeability);
        let is_mesher = meshers::FORMATS.iter().any(|f| f.name == self.name);
        self.uses_depth || holds_rock && (has_rock || !is_mesher)
    }

    /// Returns `true` if a simulation case needs porosity and permeability in this format, although
    /// its grid is complete without them.
    pub fn case_needs_rock(&self) -> bool {
        self.deck_path.is_some()
    }

    /// Returns the path of the deck beside a grid, if the format has one. The deck is written if
    /// porosity and permeability are known.
    pub fn deck_path(&self, path: &Path) -> Option<PathBuf> {
        self.deck_path.map(|deck_path| deck_path(path))
    }

    /// Returns the path of the companion VTU of a file, if the format needs one.
    pub fn companion_path(&self, path: &Path) -> Option<PathBuf> {
        self.has_companion.then(|| path.with_extension("vtu"))
    }

    /// Writes a model and its companion file. Either all files appear or none.
    ///
    /// # Errors
    /// Returns [`Error::Export`] if the model lacks what the format needs, and [`Error::Io`] if a
    /// file cannot be written.
    pub fn write(&self, model: &Model, path: &Path) -> Result<()> {
        self.write_with_names(model, &ExportNames::new(model, &self.names), path)
    }

    /// Returns `true` if the format is a folder.
    pub(super) fn is_folder(&self) -> bool {
        self.extensions.is_empty()
    }

    /// Writes a model, as [`write`](Self::write) does, with names that are decided already.
    pub(super) fn write_with_names(
        &self,
        model: &Model,
        names: &ExportNames,
        path: &Path,
    ) -> Result<()> {
        self.check_target(path)?;
        let mut batch = Batch::default();
        (self.write)(model, names, &mut batch, path)?;
        names.add_table(&mut batch, path, self.is_folder())?;
        if let Some(companion) = self.companion_path(path) {
            add_companion(&mut batch, &companion, model)?;
        }
        batch.commit()
    }
}
