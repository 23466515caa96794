//! The formats that `atomesh export` writes: one table, one file of code each.

use std::path::{Path, PathBuf};

use super::companion::add_companion;
use crate::error::cause;
use crate::export::corner_point::grdecl;
use crate::export::meshers::{cgns, exodus, inp, medit, msh, stl, tetgen, vtkhdf, xdmf};
use crate::export::simulators::{darts, disv, geos, mrst, openfoam, opm, pflotran, resqml, tough};
use crate::files::{Batch, check_target};
use crate::model::reservoir::Model;
use crate::{Error, Result};

/// What a model may say besides its cells, and not every format can hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExportContent {
    /// The share of pores in each cell.
    Porosity,
    /// The permeability of each cell.
    Permeability,
    /// The region of each cell.
    Regions,
    /// Other values of each cell.
    Properties,
    /// How faults resist flow: transmissibilities.
    Faults,
    /// Faults that nothing crosses.
    ClosedFaults,
    /// How faults resist flow, also where no permeability is known.
    FaultsWithoutRock,
    /// Wells.
    Wells,
    /// What fills the pores.
    Fluid,
    /// The pressure at first.
    InitialPressure,
    /// Fluids without weight.
    Gravity,
    /// The time that a simulation covers.
    Duration,
    /// The number of cells along each axis of a grid that the model is resampled on.
    Grid,
    /// The names of faces: sides, surfaces, interfaces of regions.
    Names,
    /// Nodes doubled along surfaces.
    SplitNodes,
    /// Elements with nodes in the middle of their edges.
    Quadratic,
}

impl ExportContent {
    /// Whether it is of a simulation, not of the rock.
    pub fn is_simulation_input(self) -> bool {
        use ExportContent::{Duration, Fluid, Gravity, InitialPressure, Wells};
        matches!(self, Wells | Fluid | InitialPressure | Gravity | Duration)
    }
}

impl std::fmt::Display for ExportContent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Porosity => "porosity",
            Self::Permeability => "permeability",
            Self::Regions => "regions of cells",
            Self::Properties => "properties of cells",
            Self::Faults => "fault multipliers",
            Self::ClosedFaults => "closed faults",
            Self::FaultsWithoutRock => "faults without permeability",
            Self::Wells => "wells",
            Self::Fluid => "fluids",
            Self::InitialPressure => "pressure",
            Self::Gravity => "fluids without weight",
            Self::Duration => "simulation time",
            Self::Grid => "grid of a chosen size",
            Self::Names => "names of faces",
            Self::SplitNodes => "meshes split along surfaces",
            Self::Quadratic => "quadratic elements",
        })
    }
}

/// A format for simulators or other meshers.
#[derive(Debug)]
pub struct ExportFormat {
    /// What `--to` calls it.
    pub name: &'static str,
    /// What it is, for people.
    pub description: &'static str,
    /// The endings of its files, or their whole names, the usual one first; none if it is a folder.
    pub extensions: &'static [&'static str],
    /// Whether the cells' shapes are not in it, so that a VTU twin with cells in the same order is
    /// written beside it.
    pub has_companion: bool,
    /// Whether it holds cells of any shape, not only tetrahedra.
    pub holds_any_cells: bool,
    /// Whether depth has a meaning in it.
    pub uses_depth: bool,
    /// What else than cells and named faces it holds, itself or in its twin.
    pub supported_content: &'static [ExportContent],
    write: fn(&Model, &mut Batch, &Path) -> Result<()>,
}

/// What formats hold that keep names and values, and elements of any order.
const NAMES_AND_ROCK: &[ExportContent] = &[
    ExportContent::Names,
    ExportContent::Regions,
    ExportContent::Porosity,
    ExportContent::Permeability,
    ExportContent::Properties,
    ExportContent::SplitNodes,
    ExportContent::Quadratic,
];

/// All of them.
pub const FORMATS: &[ExportFormat] = &[
    ExportFormat {
        name: "opm",
        description: "OPM Flow and Eclipse deck: cells and connections, a complete case",
        extensions: &["DATA", "data"],
        has_companion: true,
        holds_any_cells: true,
        uses_depth: true,
        supported_content: &[
            ExportContent::Regions,
            ExportContent::Porosity,
            ExportContent::Permeability,
            ExportContent::Properties,
            ExportContent::Faults,
            ExportContent::ClosedFaults,
            ExportContent::Wells,
            ExportContent::Fluid,
            ExportContent::InitialPressure,
            ExportContent::Gravity,
            ExportContent::Duration,
        ],
        write: opm::write,
    },
    ExportFormat {
        name: "openfoam",
        description: "OpenFOAM case with constant/polyMesh",
        extensions: &[],
        has_companion: false,
        holds_any_cells: true,
        uses_depth: false,
        supported_content: &[
            ExportContent::Names,
            ExportContent::Regions,
            ExportContent::Porosity,
            ExportContent::Permeability,
            ExportContent::Properties,
            ExportContent::ClosedFaults,
            ExportContent::FaultsWithoutRock,
        ],
        write: openfoam::write,
    },
    ExportFormat {
        name: "pflotran",
        description: "PFLOTRAN explicit unstructured grid, with a file for each side",
        extensions: &["uge"],
        has_companion: true,
        holds_any_cells: true,
        uses_depth: true,
        supported_content: &[
            ExportContent::Regions,
            ExportContent::Porosity,
            ExportContent::Permeability,
            ExportContent::Properties,
            ExportContent::Faults,
            ExportContent::ClosedFaults,
            ExportContent::FaultsWithoutRock,
        ],
        write: pflotran::write,
    },
    ExportFormat {
        name: "tough2",
        description: "TOUGH2 mesh: elements and connections",
        extensions: &["MESH"],
        has_companion: true,
        holds_any_cells: true,
        uses_depth: true,
        supported_content: &[
            ExportContent::Regions,
            ExportContent::Porosity,
            ExportContent::Permeability,
            ExportContent::Properties,
            ExportContent::Faults,
            ExportContent::ClosedFaults,
            ExportContent::FaultsWithoutRock,
        ],
        write: tough::write,
    },
    ExportFormat {
        name: "disv",
        description: "MODFLOW 6 simulation of columns (DISV), in a folder",
        extensions: &[],
        has_companion: true,
        holds_any_cells: true,
        uses_depth: true,
        supported_content: &[
            ExportContent::Regions,
            ExportContent::Porosity,
            ExportContent::Permeability,
            ExportContent::Properties,
            ExportContent::Faults,
            ExportContent::ClosedFaults,
            ExportContent::Wells,
            ExportContent::InitialPressure,
            ExportContent::Gravity,
            ExportContent::Duration,
        ],
        write: disv::write,
    },
    ExportFormat {
        name: "mrst",
        description: "MRST grid as a MAT-file: G, rock, T",
        extensions: &["mat"],
        has_companion: false,
        holds_any_cells: true,
        uses_depth: true,
        supported_content: &[
            ExportContent::Names,
            ExportContent::Regions,
            ExportContent::Porosity,
            ExportContent::Permeability,
            ExportContent::Properties,
            ExportContent::Faults,
            ExportContent::ClosedFaults,
            ExportContent::Wells,
        ],
        write: mrst::write,
    },
    ExportFormat {
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
        write: geos::write,
    },
    ExportFormat {
        name: "grdecl",
        description: "corner-point grid, resampled, for Eclipse and similar simulators without NNC",
        extensions: &["GRDECL", "grdecl"],
        has_companion: false,
        holds_any_cells: true,
        uses_depth: true,
        supported_content: &[
            ExportContent::Names,
            ExportContent::Regions,
            ExportContent::Porosity,
            ExportContent::Permeability,
            ExportContent::Faults,
            ExportContent::ClosedFaults,
            ExportContent::Grid,
            ExportContent::Wells,
            ExportContent::Fluid,
            ExportContent::InitialPressure,
            ExportContent::Duration,
        ],
        write: grdecl::write,
    },
    ExportFormat {
        name: "resqml",
        description: "RESQML 2.0.1: an unstructured grid with its rock properties, EPC and HDF5",
        extensions: &["epc"],
        has_companion: false,
        holds_any_cells: true,
        uses_depth: true,
        supported_content: &[
            ExportContent::Names,
            ExportContent::Regions,
            ExportContent::Porosity,
            ExportContent::Permeability,
            ExportContent::Properties,
        ],
        write: resqml::write,
    },
    ExportFormat {
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
            ExportContent::Faults,
            ExportContent::ClosedFaults,
            ExportContent::Wells,
        ],
        write: darts::write,
    },
    ExportFormat {
        name: "msh",
        description: "Gmsh mesh, version 4.1: tetrahedra, regions and surfaces",
        extensions: &["msh"],
        has_companion: false,
        holds_any_cells: false,
        uses_depth: false,
        supported_content: &[
            ExportContent::Names,
            ExportContent::Regions,
            ExportContent::SplitNodes,
            ExportContent::Quadratic,
        ],
        write: msh::write_v4,
    },
    ExportFormat {
        name: "msh2",
        description: "Gmsh mesh, version 2.2",
        extensions: &["msh"],
        has_companion: false,
        holds_any_cells: false,
        uses_depth: false,
        supported_content: &[
            ExportContent::Names,
            ExportContent::Regions,
            ExportContent::SplitNodes,
            ExportContent::Quadratic,
        ],
        write: msh::write_v2,
    },
    ExportFormat {
        name: "inp",
        description: "Abaqus and CalculiX elements, sets and surfaces",
        extensions: &["inp"],
        has_companion: false,
        holds_any_cells: false,
        uses_depth: false,
        supported_content: &[
            ExportContent::Names,
            ExportContent::Regions,
            ExportContent::SplitNodes,
            ExportContent::Quadratic,
        ],
        write: inp::write,
    },
    ExportFormat {
        name: "medit",
        description: "Medit mesh of tetrahedra and triangles",
        extensions: &["mesh"],
        has_companion: false,
        holds_any_cells: false,
        uses_depth: false,
        supported_content: &[ExportContent::Names, ExportContent::Regions],
        write: medit::write,
    },
    ExportFormat {
        name: "tetgen",
        description: "TetGen's .node, .ele and .face",
        extensions: &["node"],
        has_companion: false,
        holds_any_cells: false,
        uses_depth: false,
        supported_content: &[ExportContent::Names, ExportContent::Regions],
        write: tetgen::write,
    },
    ExportFormat {
        name: "exodus",
        description: "Exodus II: element blocks, side sets and node sets, values of cells",
        extensions: &["exo", "e", "ex2"],
        has_companion: false,
        holds_any_cells: true,
        uses_depth: false,
        supported_content: NAMES_AND_ROCK,
        write: exodus::write,
    },
    ExportFormat {
        name: "vtkhdf",
        description: "VTKHDF: any cells with their values and sets of nodes",
        extensions: &["vtkhdf"],
        has_companion: false,
        holds_any_cells: true,
        uses_depth: false,
        supported_content: NAMES_AND_ROCK,
        write: vtkhdf::write,
    },
    ExportFormat {
        name: "xdmf",
        description: "XDMF with HDF5: cells with their values, sets of faces and nodes",
        extensions: &["xdmf", "xmf"],
        has_companion: false,
        holds_any_cells: false,
        uses_depth: false,
        supported_content: NAMES_AND_ROCK,
        write: xdmf::write,
    },
    ExportFormat {
        name: "cgns",
        description: "CGNS: any cells with their values, boundary conditions by name",
        extensions: &["cgns"],
        has_companion: false,
        holds_any_cells: true,
        uses_depth: false,
        supported_content: &[
            ExportContent::Names,
            ExportContent::Regions,
            ExportContent::Porosity,
            ExportContent::Permeability,
            ExportContent::Properties,
            ExportContent::Quadratic,
        ],
        write: cgns::write,
    },
    ExportFormat {
        name: "stl",
        description: "the sides of the box and the faces on features as triangles, in text",
        extensions: &["stl"],
        has_companion: false,
        holds_any_cells: true,
        uses_depth: false,
        supported_content: &[ExportContent::Names],
        write: stl::write,
    },
    ExportFormat {
        name: "obj",
        description: "the same as Wavefront OBJ",
        extensions: &["obj"],
        has_companion: false,
        holds_any_cells: true,
        uses_depth: false,
        supported_content: &[ExportContent::Names],
        write: stl::write_obj,
    },
];

impl ExportFormat {
    /// The format of that name.
    ///
    /// # Errors
    /// [`Error::Export`] with the names that there are.
    pub fn from_name(name: &str) -> Result<&'static Self> {
        FORMATS.iter().find(|f| f.name == name).ok_or_else(|| {
            let names: Vec<&str> = FORMATS.iter().map(|f| f.name).collect();
            Error::Export(cause(
                format!("format {name}"),
                "is not a format that can be written",
                format!("give one of {}", names.join(", ")),
            ))
        })
    }

    /// Checks that a model can be written to `path`, before the long work.
    ///
    /// # Errors
    /// [`Error::Export`] for a file with another ending, [`Error::Io`] for a folder that is not there.
    pub fn check_target(&self, path: &Path) -> Result<()> {
        if self.extensions.is_empty() {
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
                    "give it that ending, by which readers of {} know it",
                    self.name
                ),
            )));
        }
        Ok(())
    }

    /// Checks that the format can hold what a model shall say.
    ///
    /// # Errors
    /// [`Error::Export`] with the formats that can.
    pub fn check_content(&self, content: ExportContent, place: &str) -> Result<()> {
        if self.supported_content.contains(&content) {
            return Ok(());
        }
        let able = FORMATS
            .iter()
            .filter(|f| f.supported_content.contains(&content));
        let able: Vec<&str> = able.map(|f| f.name).collect();
        Err(Error::Export(cause(
            place,
            format!("the format {} holds no {content}", self.name),
            format!("omit it, or export to {}", able.join(", ")),
        )))
    }

    /// Returns whether simulators of flow read it, so that depth and fluxes matter.
    pub fn is_flow_format(&self) -> bool {
        self.uses_depth
            || self
                .supported_content
                .contains(&ExportContent::Permeability)
    }

    /// Whether it is complete without rock, but has no place then for what happens in a simulation.
    pub fn case_needs_rock(&self) -> bool {
        self.name == "grdecl"
    }

    /// The twin of a file.
    pub fn companion_path(&self, path: &Path) -> Option<PathBuf> {
        self.has_companion.then(|| path.with_extension("vtu"))
    }

    /// Writes a model, and its twin; all files appear, or none.
    ///
    /// # Errors
    /// [`Error::Export`] if the model lacks what the format needs, [`Error::Io`] if a file cannot be
    /// written.
    pub fn write(&self, model: &Model, path: &Path) -> Result<()> {
        self.check_target(path)?;
        let mut batch = Batch::default();
        (self.write)(model, &mut batch, path)?;
        if let Some(twin) = self.companion_path(path) {
            add_companion(&mut batch, &twin, model)?;
        }
        batch.commit()
    }
}
