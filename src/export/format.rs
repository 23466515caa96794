//! The formats that `atomesh export` writes: one table, one file of code each.

use std::path::{Path, PathBuf};

use super::twin::add_twin;
use crate::error::cause;
use crate::export::corner_point::grdecl;
use crate::export::meshers::{cgns, exodus, inp, medit, msh, stl, tetgen, vtkhdf, xdmf};
use crate::export::simulators::{darts, disv, geos, mrst, openfoam, opm, pflotran, resqml, tough};
use crate::files::{Batch, check_target};
use crate::model::reservoir::Model;
use crate::{Error, Result};

/// What a model may say besides its cells, and not every format can hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Content {
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
    BareFaults,
    /// Wells.
    Wells,
    /// What fills the pores.
    Fluid,
    /// The pressure at first.
    Pressure,
    /// Fluids without weight.
    Gravity,
    /// The time that a simulation covers.
    Duration,
    /// The number of cells along each axis of a grid that the model is resampled on.
    Grid,
    /// The names of faces: sides, surfaces, interfaces of regions.
    Names,
    /// Nodes doubled along surfaces.
    Split,
    /// Elements with nodes in the middle of their edges.
    Quadratic,
}

impl Content {
    /// Whether it is of a simulation, not of the rock.
    pub fn is_of_a_case(self) -> bool {
        use Content::{Duration, Fluid, Gravity, Pressure, Wells};
        matches!(self, Wells | Fluid | Pressure | Gravity | Duration)
    }
}

impl std::fmt::Display for Content {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Porosity => "porosity",
            Self::Permeability => "permeability",
            Self::Regions => "regions of cells",
            Self::Properties => "properties of cells",
            Self::Faults => "fault multipliers",
            Self::ClosedFaults => "closed faults",
            Self::BareFaults => "faults without permeability",
            Self::Wells => "wells",
            Self::Fluid => "fluids",
            Self::Pressure => "pressure",
            Self::Gravity => "fluids without weight",
            Self::Duration => "simulation time",
            Self::Grid => "grid of a chosen size",
            Self::Names => "names of faces",
            Self::Split => "meshes split along surfaces",
            Self::Quadratic => "quadratic elements",
        })
    }
}

/// A format for simulators or other meshers.
#[derive(Debug)]
pub struct Format {
    /// What `--to` calls it.
    pub name: &'static str,
    /// What it is, for people.
    pub what: &'static str,
    /// The endings of its files, or their whole names, the usual one first; none if it is a folder.
    pub endings: &'static [&'static str],
    /// Whether the cells' shapes are not in it, so that a VTU twin with cells in the same order is
    /// written beside it.
    pub twin: bool,
    /// Whether it holds cells of any shape, not only tetrahedra.
    pub any_cells: bool,
    /// Whether depth has a meaning in it.
    pub depth: bool,
    /// What else than cells and named faces it holds, itself or in its twin.
    pub holds: &'static [Content],
    write: fn(&Model, &mut Batch, &Path) -> Result<()>,
}

/// What formats hold that keep names and values, and elements of any order.
const NAMES_AND_ROCK: &[Content] = &[
    Content::Names,
    Content::Regions,
    Content::Porosity,
    Content::Permeability,
    Content::Properties,
    Content::Split,
    Content::Quadratic,
];

/// All of them.
pub const FORMATS: &[Format] = &[
    Format {
        name: "opm",
        what: "OPM Flow and Eclipse deck: cells and connections, a complete case",
        endings: &["DATA", "data"],
        twin: true,
        any_cells: true,
        depth: true,
        holds: &[
            Content::Regions,
            Content::Porosity,
            Content::Permeability,
            Content::Properties,
            Content::Faults,
            Content::ClosedFaults,
            Content::Wells,
            Content::Fluid,
            Content::Pressure,
            Content::Gravity,
            Content::Duration,
        ],
        write: opm::write,
    },
    Format {
        name: "openfoam",
        what: "OpenFOAM case with constant/polyMesh",
        endings: &[],
        twin: false,
        any_cells: true,
        depth: false,
        holds: &[
            Content::Names,
            Content::Regions,
            Content::Porosity,
            Content::Permeability,
            Content::Properties,
            Content::ClosedFaults,
            Content::BareFaults,
        ],
        write: openfoam::write,
    },
    Format {
        name: "pflotran",
        what: "PFLOTRAN explicit unstructured grid, with a file for each side",
        endings: &["uge"],
        twin: true,
        any_cells: true,
        depth: true,
        holds: &[
            Content::Regions,
            Content::Porosity,
            Content::Permeability,
            Content::Properties,
            Content::Faults,
            Content::ClosedFaults,
            Content::BareFaults,
        ],
        write: pflotran::write,
    },
    Format {
        name: "tough2",
        what: "TOUGH2 mesh: elements and connections",
        endings: &["MESH"],
        twin: true,
        any_cells: true,
        depth: true,
        holds: &[
            Content::Regions,
            Content::Porosity,
            Content::Permeability,
            Content::Properties,
            Content::Faults,
            Content::ClosedFaults,
            Content::BareFaults,
        ],
        write: tough::write,
    },
    Format {
        name: "disv",
        what: "MODFLOW 6 simulation of columns (DISV), in a folder",
        endings: &[],
        twin: true,
        any_cells: true,
        depth: true,
        holds: &[
            Content::Regions,
            Content::Porosity,
            Content::Permeability,
            Content::Properties,
            Content::Faults,
            Content::ClosedFaults,
            Content::Wells,
            Content::Pressure,
            Content::Gravity,
            Content::Duration,
        ],
        write: disv::write,
    },
    Format {
        name: "mrst",
        what: "MRST grid as a MAT-file: G, rock, T",
        endings: &["mat"],
        twin: false,
        any_cells: true,
        depth: true,
        holds: &[
            Content::Names,
            Content::Regions,
            Content::Porosity,
            Content::Permeability,
            Content::Properties,
            Content::Faults,
            Content::ClosedFaults,
            Content::Wells,
        ],
        write: mrst::write,
    },
    Format {
        name: "geos",
        what: "VTU for GEOS: attribute, rock, sets of nodes and faces",
        endings: &["vtu"],
        twin: false,
        any_cells: true,
        depth: false,
        holds: &[
            Content::Names,
            Content::Regions,
            Content::Porosity,
            Content::Permeability,
            Content::Properties,
            Content::Split,
        ],
        write: geos::write,
    },
    Format {
        name: "grdecl",
        what: "corner-point grid, resampled, for Eclipse and similar simulators without NNC",
        endings: &["GRDECL", "grdecl"],
        twin: false,
        any_cells: true,
        depth: true,
        holds: &[
            Content::Names,
            Content::Regions,
            Content::Porosity,
            Content::Permeability,
            Content::Faults,
            Content::ClosedFaults,
            Content::Grid,
            Content::Wells,
            Content::Fluid,
            Content::Pressure,
            Content::Duration,
        ],
        write: grdecl::write,
    },
    Format {
        name: "resqml",
        what: "RESQML 2.0.1: an unstructured grid with its rock properties, EPC and HDF5",
        endings: &["epc"],
        twin: false,
        any_cells: true,
        depth: true,
        holds: &[
            Content::Names,
            Content::Regions,
            Content::Porosity,
            Content::Permeability,
            Content::Properties,
        ],
        write: resqml::write,
    },
    Format {
        name: "darts",
        what: "open-DARTS connection list, and its cells",
        endings: &["conn"],
        twin: true,
        any_cells: true,
        depth: true,
        holds: &[
            Content::Regions,
            Content::Porosity,
            Content::Permeability,
            Content::Properties,
            Content::Faults,
            Content::ClosedFaults,
            Content::Wells,
        ],
        write: darts::write,
    },
    Format {
        name: "msh",
        what: "Gmsh mesh, version 4.1: tetrahedra, regions and surfaces",
        endings: &["msh"],
        twin: false,
        any_cells: false,
        depth: false,
        holds: &[
            Content::Names,
            Content::Regions,
            Content::Split,
            Content::Quadratic,
        ],
        write: msh::write_4,
    },
    Format {
        name: "msh2",
        what: "Gmsh mesh, version 2.2",
        endings: &["msh"],
        twin: false,
        any_cells: false,
        depth: false,
        holds: &[
            Content::Names,
            Content::Regions,
            Content::Split,
            Content::Quadratic,
        ],
        write: msh::write_2,
    },
    Format {
        name: "inp",
        what: "Abaqus and CalculiX elements, sets and surfaces",
        endings: &["inp"],
        twin: false,
        any_cells: false,
        depth: false,
        holds: &[
            Content::Names,
            Content::Regions,
            Content::Split,
            Content::Quadratic,
        ],
        write: inp::write,
    },
    Format {
        name: "medit",
        what: "Medit mesh of tetrahedra and triangles",
        endings: &["mesh"],
        twin: false,
        any_cells: false,
        depth: false,
        holds: &[Content::Names, Content::Regions],
        write: medit::write,
    },
    Format {
        name: "tetgen",
        what: "TetGen's .node, .ele and .face",
        endings: &["node"],
        twin: false,
        any_cells: false,
        depth: false,
        holds: &[Content::Names, Content::Regions],
        write: tetgen::write,
    },
    Format {
        name: "exodus",
        what: "Exodus II: element blocks, side sets and node sets, values of cells",
        endings: &["exo", "e", "ex2"],
        twin: false,
        any_cells: true,
        depth: false,
        holds: NAMES_AND_ROCK,
        write: exodus::write,
    },
    Format {
        name: "vtkhdf",
        what: "VTKHDF: any cells with their values and sets of nodes",
        endings: &["vtkhdf"],
        twin: false,
        any_cells: true,
        depth: false,
        holds: NAMES_AND_ROCK,
        write: vtkhdf::write,
    },
    Format {
        name: "xdmf",
        what: "XDMF with HDF5: cells with their values, sets of faces and nodes",
        endings: &["xdmf", "xmf"],
        twin: false,
        any_cells: false,
        depth: false,
        holds: NAMES_AND_ROCK,
        write: xdmf::write,
    },
    Format {
        name: "cgns",
        what: "CGNS: any cells with their values, boundary conditions by name",
        endings: &["cgns"],
        twin: false,
        any_cells: true,
        depth: false,
        holds: &[
            Content::Names,
            Content::Regions,
            Content::Porosity,
            Content::Permeability,
            Content::Properties,
            Content::Quadratic,
        ],
        write: cgns::write,
    },
    Format {
        name: "stl",
        what: "the sides of the box and the faces on features as triangles, in text",
        endings: &["stl"],
        twin: false,
        any_cells: true,
        depth: false,
        holds: &[Content::Names],
        write: stl::write,
    },
    Format {
        name: "obj",
        what: "the same as Wavefront OBJ",
        endings: &["obj"],
        twin: false,
        any_cells: true,
        depth: false,
        holds: &[Content::Names],
        write: stl::write_obj,
    },
];

impl Format {
    /// The format of that name.
    ///
    /// # Errors
    /// [`Error::Export`] with the names that there are.
    pub fn named(name: &str) -> Result<&'static Self> {
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
        if self.endings.is_empty() {
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
            .endings
            .iter()
            .any(|known| *known == ending || *known == name)
        {
            return Err(Error::Export(cause(
                path.display(),
                format!("does not end in {}", self.endings.join(" or ")),
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
    pub fn check_holds(&self, content: Content, place: &str) -> Result<()> {
        if self.holds.contains(&content) {
            return Ok(());
        }
        let able = FORMATS.iter().filter(|f| f.holds.contains(&content));
        let able: Vec<&str> = able.map(|f| f.name).collect();
        Err(Error::Export(cause(
            place,
            format!("the format {} holds no {content}", self.name),
            format!("omit it, or export to {}", able.join(", ")),
        )))
    }

    /// Returns whether simulators of flow read it, so that depth and fluxes matter.
    pub fn is_of_flow(&self) -> bool {
        self.depth || self.holds.contains(&Content::Permeability)
    }

    /// Whether it is complete without rock, but has no place then for what happens in a simulation.
    pub fn case_needs_rock(&self) -> bool {
        self.name == "grdecl"
    }

    /// The twin of a file.
    pub fn twin_of(&self, path: &Path) -> Option<PathBuf> {
        self.twin.then(|| path.with_extension("vtu"))
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
        if let Some(twin) = self.twin_of(path) {
            add_twin(&mut batch, &twin, model)?;
        }
        batch.commit()
    }
}
