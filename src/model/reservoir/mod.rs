//! Builds a reservoir model from a mesh: metres with z upwards, porosity and permeability of every
//! cell, transmissibilities, and wells. The model has all the data that a simulator needs; the
//! module `export` writes it.
//!
//! - `model_sets`: named sets of cells, faces and nodes
//! - `periodic_pairs`: nodes that are images of one another on opposite sides
//! - `prepared_model`: models from mesh files
//! - `region_shares`: regions from an image that the mesh was not made of
//! - `rock_options`: options for the rock in the cells
//! - `space_options`: options that place a model in space
//! - `case_options`: options for the wells and fluids of a simulation
//! - `well_options`: wells as options name them, and their places
//! - `model_frame`: from a mesh's coordinates to metres and depth
//! - `aquifer`: aquifers beyond a side
//! - `averaging`: averages of an image over cells
//! - `check`: checks of a model before it is written
//! - `equilibrium`: contacts and pressures at the start
//! - `schedule`: rates and limits of wells by date
//! - `closed_faults`: notes on wells at closed faults
//! - `trajectory`: the segments of wells in cells
//! - `completion`: well indices
//! - `gouge`: fault rock from clay and throw
//! - `gouge_profile`: the clay of the two walls of a fault
//! - `fault_throws`: throws of faults, face by face
//! - `extended_faults`: faults continued beyond their edges
//! - `seal_check`: the flow that passes closed faults
//! - `surface_sides`: the two sides of surfaces, and meshes split along them

pub(crate) mod aquifer;
pub(crate) mod averaging;
pub(crate) mod case_options;
pub(crate) mod check;
pub(crate) mod closed_faults;
pub(crate) mod completion;
pub(crate) mod equilibrium;
mod extended_faults;
pub(crate) mod fault_throws;
pub(crate) mod gouge;
mod gouge_profile;
pub(crate) mod model_frame;
mod model_sets;
pub(crate) mod periodic_pairs;
pub(crate) mod prepared_model;
pub(crate) mod region_shares;
pub(crate) mod rock_options;
pub(crate) mod schedule;
pub(crate) mod seal_check;
pub(crate) mod space_options;
pub(crate) mod surface_sides;
pub(crate) mod trajectory;
pub(crate) mod well_options;

pub use model_sets::ModelSets;
pub use periodic_pairs::{PeriodicImages, PeriodicPair};
pub use prepared_model::{MeshPlacement, PreparedModel};

use crate::parallel::prelude::*;

use crate::error::cause;
use crate::files::vtk::DataArray;
use crate::geometry::{dot, sorted_distinct, sub};
use crate::image::LabelValue;
use crate::mesh::TetMesh;
use crate::mesh::graph::{Connection, Graph};
use crate::mesh::poly::{PolyMesh, SIDE_NAMES};
use crate::model::flow::driver::FaultLaws;
use crate::model::flow::{Barriers, CellFlow, Rock, SplitMesh, Tensor};
use crate::model::surface::SurfaceKind;
use crate::model::surface::names::{SurfaceNames, interface_name};
use crate::model::surface::stored_surfaces::region_label;
use crate::names::append_distinct;
use crate::store::{LabelledRegion, NamedRegion};
use crate::{Error, Result};

pub use crate::model::surface::fault_extension::ExtendedFault;
pub use crate::units::values::MILLIDARCY;
pub use aquifer::{Aquifer, AquiferModel, AquiferOption};
pub use averaging::{CellMeans, MeanKind, SamplePositions};
pub use case_options::{CaseOptions, FluidChoice};
pub use check::ModelChecks;
pub use completion::Completion;
pub use equilibrium::{CapillaryOption, ContactOption, DatumOption, Equilibrium};
pub use gouge::{FaultRock, FaultRockLaw, FaultThrow, GougeOptions};
pub use model_frame::{DepthAxis, ModelFrame};
pub use rock_options::{
    CellPermeability, CellProperty, CellValue, CutOff, PermeabilityUnit, RockOptions,
};
pub use schedule::{Date, Schedule};
pub use seal_check::SealCheck;
pub use space_options::SpaceOptions;
pub use trajectory::{Trajectory, WellTracer};
pub use well_options::{ScheduledWell, WellOption, WellPlace};

/// One bar in Pa.
pub(crate) const BAR: f64 = 1e5;
/// One day in seconds.
pub(crate) const DAY: f64 = 86_400.0;
/// Pressure of the air in Pa, which is that at depth 0.
pub(crate) const SURFACE_PRESSURE: f64 = 1.013_25 * BAR;
/// Density of water in kg/m^3.
pub(crate) const WATER_DENSITY: f64 = 1000.0;
/// Density of oil in kg/m^3.
pub(crate) const OIL_DENSITY: f64 = 850.0;
/// Density of gas at the surface in kg/m^3.
pub(crate) const GAS_DENSITY: f64 = 0.8;
/// Acceleration of gravity in m/s^2.
pub(crate) const GRAVITY: f64 = 9.806_65;

/// A mesh with all the data that a simulator needs, in SI units. All arrays by cell have the order
/// of the mesh's cells.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Model {
    /// The cells, in metres with z upwards: a point at depth d has z = -d. Faces on the box have
    /// the number of its side (along the image's axes).
    pub mesh: PolyMesh<3>,
    /// Cells of `mesh` as tetrahedra, if they are tetrahedra.
    pub tets: Option<TetMesh>,
    /// `true` if simplices have nodes at the midpoints of their edges.
    pub is_quadratic: bool,
    /// The tetrahedra split along surfaces, if requested.
    pub split_mesh: Option<SplitMesh>,
    /// The base triangles, if the mesh is a layer of prisms on triangles. Their nodes are in the
    /// first half of the mesh's nodes.
    pub triangles: Option<Vec<[u32; 3]>>,
    /// Cells and connections.
    pub graph: Graph<3>,
    /// The regions that are labels of an image. Interfaces between them are named after both.
    pub labels: Vec<LabelledRegion>,
    /// Names of other regions, such as those beyond the image.
    pub named_regions: Vec<NamedRegion>,
    /// The surfaces that the faces on features form.
    pub surfaces: FaceSurfaces,
    /// Sets of cells, faces and nodes that have names in the file of the mesh.
    pub sets: ModelSets,
    /// Nodes that are images of one another on opposite sides of a periodic mesh.
    pub periodic: PeriodicImages,
    /// The fault laws of the surfaces.
    pub barriers: Barriers,
    /// `true` for each cell whose porosity or permeability is zero, so that it takes no part. Empty
    /// if all cells are active.
    pub inactive: Vec<bool>,
    /// The share of each cell that holds data; empty if all cells are full of data. The porosity is
    /// already reduced by it.
    pub live: Vec<f64>,
    /// Porosity: the pore fraction of each cell's volume.
    pub porosity: Option<Vec<f64>>,
    /// Net-to-gross ratio: the part of each cell's height that is reservoir rock. The porosity is
    /// that of this part; `permeability` is that of the whole cell.
    pub net_to_gross: Option<Vec<f64>>,
    /// Permeability in m^2, and the transmissibilities.
    pub permeability: Option<Permeability>,
    /// Numbers of the tables and reports of a deck that apply to each cell.
    pub deck_regions: DeckRegions,
    /// Other properties of the cells.
    pub properties: Vec<DataArray>,
    /// Fluids, wells and duration of the simulation.
    pub case: SimulationCase,
    /// Size of the grid on which the model is resampled: columns along two axes, and layers. If
    /// `None`, it is as fine as the cells.
    pub grid: Option<[usize; 3]>,
}

/// Numbers, from 1, of the tables and reports of a deck that apply to each cell, as far as they are
/// given.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct DeckRegions {
    /// Tables of relative permeability and capillary pressure (SATNUM).
    pub saturation: Option<Vec<u32>>,
    /// Tables of pressure and volume (PVTNUM).
    pub pressure_volume: Option<Vec<u32>>,
    /// Regions in which fluids are in equilibrium at the start (EQLNUM).
    pub equilibration: Option<Vec<u32>>,
    /// Regions for which fluids in place are reported (FIPNUM).
    pub fluid_in_place: Option<Vec<u32>>,
}

impl DeckRegions {
    /// Returns the keyword of each kind of numbers, and the numbers.
    pub fn keywords(&self) -> [(&'static str, Option<&[u32]>); 4] {
        [
            ("SATNUM", self.saturation.as_deref()),
            ("PVTNUM", self.pressure_volume.as_deref()),
            ("EQLNUM", self.equilibration.as_deref()),
            ("FIPNUM", self.fluid_in_place.as_deref()),
        ]
    }

    /// Returns the largest number of each kind, in the order of [`keywords`](Self::keywords): 1 if
    /// there are none.
    pub fn counts(&self) -> [usize; 4] {
        let largest = |numbers: Option<&[u32]>| numbers.and_then(|n| n.iter().max().copied());
        self.keywords()
            .map(|(_, numbers)| largest(numbers).unwrap_or(1) as usize)
    }
}

/// The surfaces of a mesh, and the surface on which each connection lies.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FaceSurfaces {
    /// The kinds of surfaces 1, 2 ... Their numbers are those of `atomesh surface`.
    pub kinds: Vec<SurfaceKind>,
    /// The names of the first surfaces, if the mesh's file has names.
    pub names: Vec<String>,
    /// Number of surfaces, from the first, that are large enough to have names. The others are
    /// fragments, called `scraps`.
    pub kept_count: usize,
    /// The number of the surface of each connection; 0 for none.
    pub connection_surfaces: Vec<u32>,
    /// The numbers of the surfaces that extend a fault, each with that of the fault.
    pub extensions: Vec<(u32, u32)>,
}

/// Returns the names that no surface may have: those of the box sides, of the rest of the boundary,
/// and of the fragments.
pub(crate) fn reserved_names() -> Vec<String> {
    let names = SIDE_NAMES.into_iter().chain(["boundary", "scraps"]);
    names.map(String::from).collect()
}

impl FaceSurfaces {
    /// Returns one fault that consists of all connections on features.
    fn single_fault(graph: &Graph<3>) -> Self {
        let flags = graph.connections.iter().map(|c| u32::from(c.on_feature));
        let connection_surfaces: Vec<u32> = flags.collect();
        let has_fault = connection_surfaces.contains(&1);
        Self {
            kinds: if has_fault {
                vec![SurfaceKind::Fault]
            } else {
                Vec::new()
            },
            names: Vec::new(),
            kept_count: usize::from(has_fault),
            connection_surfaces,
            extensions: Vec::new(),
        }
    }

    /// Returns the names of all surfaces, as all formats use them.
    pub fn all_names(&self) -> SurfaceNames {
        SurfaceNames::new(&self.kinds, self.kept_count, &self.names, &reserved_names())
    }

    /// Returns the number of the surface of each connection; 0 for none. The extension of a fault has the
    /// number of the fault.
    fn merged_labels(&self) -> Vec<u32> {
        let merged = self.merged_numbers();
        let labels = self.connection_surfaces.iter();
        labels.map(|&label| merged[label as usize]).collect()
    }

    /// Returns for each number of a surface, from 0 for none, the number that counts: that of the fault for the
    /// extension of a fault.
    pub(crate) fn merged_numbers(&self) -> Vec<u32> {
        let mut merged: Vec<u32> = (0..=self.kinds.len() as u32).collect();
        for &(extension, fault) in &self.extensions {
            merged[extension as usize] = fault;
        }
        merged
    }

    /// Adds surfaces of one kind on connections that lie on no other surface. `name_index` returns the
    /// index in `names` of the name of a connection's new surface.
    fn add_surfaces(
        &mut self,
        names: Vec<String>,
        kind: SurfaceKind,
        name_index: impl Fn(usize) -> Option<usize>,
    ) {
        let (kept_count, added_count) = (self.kept_count, names.len());
        for (connection, surface) in self.connection_surfaces.iter_mut().enumerate() {
            match *surface as usize {
                0 => {
                    *surface =
                        name_index(connection).map_or(0, |index| (kept_count + 1 + index) as u32)
                }
                scrap if scrap > kept_count => *surface += added_count as u32,
                _ => {}
            }
        }
        self.names = self.all_names().names;
        self.names.extend(names);
        let added = std::iter::repeat_n(kind, added_count);
        self.kinds.splice(kept_count..kept_count, added);
        self.kept_count += added_count;
    }
}

/// Permeability of all cells, and transmissibilities.
#[derive(Debug, Clone, PartialEq)]
pub struct Permeability {
    /// Permeability of each cell in m^2.
    pub rock: Rock,
    /// Transmissibility of each connection in m^3: rate times viscosity over pressure difference,
    /// with the resistance of faults.
    pub transmissibility: Vec<f64>,
}

/// The fluids in the pores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Fluid {
    /// Water only.
    #[default]
    Water,
    /// Oil, and water that wells inject.
    OilWater,
    /// Gas above oil above water.
    OilWaterGas,
}

impl Fluid {
    /// Returns the density in kg/m^3 of the initial fluid.
    pub fn density(self) -> f64 {
        match self {
            Self::Water => WATER_DENSITY,
            Self::OilWater | Self::OilWaterGas => OIL_DENSITY,
        }
    }
}

/// Fluids, wells and duration of a simulation.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationCase {
    /// The name of the model.
    pub title: String,
    /// The initial fluid.
    pub fluid: Fluid,
    /// `true` if gravity acts. Without gravity, all cells are treated as if at one depth.
    pub has_gravity: bool,
    /// Initial pressure in Pa at the top of the model.
    pub top_pressure: f64,
    /// The equilibrium of fluids in each region; empty if one fluid fills the pores at the start.
    pub equilibria: Vec<Equilibrium>,
    /// Curves of capillary pressure.
    pub capillary_pressures: Vec<CapillaryOption>,
    /// Aquifers.
    pub aquifers: Vec<Aquifer>,
    /// Wells.
    pub wells: Vec<Well>,
    /// The first day of the simulation.
    pub start: Date,
    /// Rates and limits of wells by date.
    pub schedule: Option<Schedule>,
    /// Duration of the simulation in seconds.
    pub duration: f64,
}

impl Default for SimulationCase {
    fn default() -> Self {
        Self {
            title: "atomesh".into(),
            fluid: Fluid::Water,
            has_gravity: true,
            top_pressure: 100.0 * BAR,
            equilibria: Vec::new(),
            capillary_pressures: Vec::new(),
            aquifers: Vec::new(),
            wells: Vec::new(),
            start: Date::default(),
            schedule: None,
            duration: 3650.0 * DAY,
        }
    }
}

/// A well and the cells to which it is open.
#[derive(Debug, Clone, PartialEq)]
pub struct Well {
    /// The name of the well: at most eight letters and digits.
    pub name: String,
    /// The cells, with the well index of each in m^3: rate times viscosity over the difference
    /// between the pressures of cell and well.
    pub cells: Vec<(u32, f64)>,
    /// Permeability times length times the angle in which fluid flows to the well, in m^3 for each
    /// of these cells.
    pub strengths: Vec<f64>,
    /// Length of the well in each of these cells, in metres.
    pub lengths: Vec<f64>,
    /// Radius in metres.
    pub radius: f64,
    /// The path of the well, in the model's metres. It is a single point if the well is vertical
    /// and open to one cell.
    pub path: Vec<[f64; 3]>,
    /// The rate or pressure that controls the well.
    pub control: Control,
}

/// The rate or pressure that controls a well.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Control {
    /// Injects water at this rate, in m^3/s.
    Inject(f64),
    /// Produces at this pressure in the well, in Pa.
    Pressure(f64),
    /// Does what the schedule says.
    Scheduled,
}

impl Model {
    /// Makes a model from cells in metres with z upwards. It has only their geometry. All faces on
    /// features form one fault, which is open.
    pub fn new(mesh: PolyMesh<3>, tets: Option<TetMesh>) -> Self {
        let graph = Graph::from_poly(&mesh);
        Self {
            surfaces: FaceSurfaces::single_fault(&graph),
            graph,
            mesh,
            tets,
            ..Self::default()
        }
    }

    /// Returns the name of a region, if it has one.
    pub fn region_name(&self, region: i32) -> Option<&str> {
        let label = self.labels.iter().find(|label| label.region == region);
        let named = || {
            self.named_regions
                .iter()
                .find(|named| named.region == region)
        };
        label
            .and_then(|label| label.name.as_deref())
            .or_else(|| Some(&*named()?.name))
    }

    /// Returns the value of a region's label, if it is not the number of the region, as with labels
    /// beyond 32 bits or with a fraction.
    pub fn label_beyond_region(&self, region: i32) -> Option<LabelValue> {
        let label = self.labels.iter().find(|label| label.region == region)?;
        (label.label.as_i32() != Some(region)).then_some(label.label)
    }

    /// Returns the name of a region, or its number.
    pub fn region_label(&self, region: i32) -> String {
        self.region_name(region)
            .map_or_else(|| region_label(&self.labels, region), String::from)
    }

    /// Returns `true` if a deck reports by other numbers than those of the regions.
    pub fn has_own_reports(&self) -> bool {
        self.deck_regions.fluid_in_place.is_some()
    }

    /// Returns the number of cells.
    pub fn len(&self) -> usize {
        self.graph.volume.len()
    }

    /// Returns `true` if there are no cells.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns `true` if neither the porosity nor the permeability of a cell is zero.
    pub fn is_active(&self, cell: usize) -> bool {
        !self.inactive.get(cell).copied().unwrap_or(false)
    }

    /// Finds the inactive cells, whose porosity, net-to-gross ratio or permeability is zero, or
    /// which `is_cut_off`, and returns their number. Call this before
    /// [`set_permeability`](Self::set_permeability).
    ///
    /// # Errors
    /// Returns [`Error::Export`] if all cells are inactive.
    pub fn find_inactive(&mut self, rock: Option<&Rock>, is_cut_off: &[bool]) -> Result<usize> {
        let is_inactive = |cell: usize| {
            let value = |values: &Option<Vec<f64>>| values.as_ref().map(|values| values[cell]);
            let conducts = rock.is_none_or(|rock| rock.mobility(cell).0 != [0.0; 6]);
            value(&self.porosity) == Some(0.0)
                || value(&self.net_to_gross) == Some(0.0)
                || !conducts
                || is_cut_off.get(cell).copied().unwrap_or(false)
        };
        let inactive: Vec<bool> = (0..self.len()).map(is_inactive).collect();
        let count = inactive.iter().filter(|inactive| **inactive).count();
        if count == inactive.len() {
            return Err(Error::Export(cause(
                "porosity or permeability",
                "is zero or below a cut-off in every cell, so that nothing is left to simulate",
                "give values above 0 where fluid is to flow",
            )));
        }
        self.inactive = if count > 0 { inactive } else { Vec::new() };
        Ok(count)
    }

    /// Takes ground without data out of the rock: multiplies the porosity by the share of each cell
    /// that holds data. Returns which cells hold none.
    pub(crate) fn take_live(&mut self, live: Vec<f64>) -> Vec<bool> {
        if let Some(porosity) = &mut self.porosity {
            porosity
                .iter_mut()
                .zip(&live)
                .for_each(|(p, share)| *p *= share);
        }
        self.live = live;
        self.live.iter().map(|share| *share == 0.0).collect()
    }

    /// Returns the volume in m^3 of the ground that holds data, if that is not all ground.
    pub fn live_volume(&self) -> Option<f64> {
        let volumes = self.graph.volume.iter().zip(&self.live);
        (!self.live.is_empty()).then(|| volumes.map(|(volume, share)| volume * share).sum())
    }

    /// Returns the depth of a cell's site in metres.
    pub fn depth(&self, cell: usize) -> f64 {
        -self.graph.site[cell][2]
    }

    /// Sets the fault laws of the surfaces. An interface between two regions becomes a surface if
    /// `laws` selects it by name. Call this after the regions are set, and before
    /// [`set_permeability`](Self::set_permeability), which uses the laws.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] if a law is for a surface that does not exist.
    pub fn set_faults(&mut self, laws: &FaultLaws) -> Result<()> {
        self.add_picked_interfaces(laws);
        let names = self.surfaces.all_names();
        let mut surface_laws = laws.surface_laws(&names, "barriers")?;
        for &(extension, fault) in &self.surfaces.extensions {
            let [extension, fault] = [extension, fault].map(|number| number as usize - 1);
            let has_own_law = laws
                .overrides
                .iter()
                .any(|(s, _)| s.selects(&names, extension));
            if !has_own_law {
                surface_laws[extension] = surface_laws[fault];
            }
        }
        self.barriers = Barriers::new(self.surfaces.connection_surfaces.clone(), surface_laws)?;
        Ok(())
    }

    fn add_picked_interfaces(&mut self, laws: &FaultLaws) {
        let region = &self.graph.region;
        let region_pair = |c: &Connection<3>| {
            let [a, b] = c.cells.map(|cell| region[cell as usize]);
            (a != b).then_some([a.min(b), a.max(b)])
        };
        let connections = self.graph.connections.iter();
        let pairs = sorted_distinct(
            (connections.zip(&self.surfaces.connection_surfaces))
                .filter(|(_, surface)| **surface == 0)
                .filter_map(|(c, _)| region_pair(c)),
        );
        let mut names = [reserved_names(), self.surfaces.all_names().names].concat();
        let known_count = names.len();
        let interfaces = pairs.iter().map(|pair| {
            let [a, b] = pair.map(|region| self.region_label(region));
            interface_name([&a, &b])
        });
        append_distinct(&mut names, interfaces);
        let named_pairs = pairs.into_iter().zip(names.split_off(known_count));
        let (pairs, names): (Vec<_>, Vec<_>) = named_pairs
            .filter(|(_, name)| laws.selects_name(name))
            .unzip();
        if !names.is_empty() {
            let connections = &self.graph.connections;
            let name_index = |connection: usize| {
                pairs
                    .binary_search(&region_pair(&connections[connection])?)
                    .ok()
            };
            let kind = SurfaceKind::Interface;
            self.surfaces.add_surfaces(names, kind, name_index);
        }
    }

    /// Returns the factor by which its fault multiplies the transmissibility of a connection: 1 if
    /// there is no fault or an open one, 0 for a closed fault. Without permeability, the rock
    /// counts as uniform.
    pub fn fault_factor(&self, connection: usize) -> f64 {
        let Some(label) = self.barriers.label(connection) else {
            return 1.0;
        };
        let c = &self.graph.connections[connection];
        let mobility = c.cells.map(|cell| match &self.permeability {
            Some(permeability) => permeability
                .rock
                .mobility(cell as usize)
                .normal_component(c.normal),
            None => 1.0,
        });
        let open_resistance = c.distance[0] / mobility[0] + c.distance[1] / mobility[1];
        if !open_resistance.is_finite() {
            // A neighbouring cell has zero permeability.
            return self.barriers.law(label).multiplier();
        }
        let fault_conductance = self.barriers.law(label).conductance(c.distance, mobility);
        open_resistance / (open_resistance + 1.0 / fault_conductance)
    }

    /// Returns the connections between active cells that are not closed, each with its
    /// [`fault_factor`](Self::fault_factor).
    pub fn open_connections(&self) -> Vec<(u32, f64)> {
        let factors = (0..self.graph.connections.len()).map(|i| (i as u32, self.fault_factor(i)));
        let open = factors.filter(|(_, factor)| *factor > 0.0);
        open.filter(|(i, _)| self.joins_active_cells(*i as usize))
            .collect()
    }

    /// Returns `true` if both cells of a connection are active.
    fn joins_active_cells(&self, connection: usize) -> bool {
        let cells = self.graph.connections[connection].cells;
        cells.iter().all(|&cell| self.is_active(cell as usize))
    }

    /// Sets the permeability of the reservoir rock, in m^2, and computes all transmissibilities: as
    /// [`CellFlow`] does, for a viscosity of 1. The net-to-gross ratio reduces the permeability
    /// along the layers, as in reservoir simulators.
    ///
    /// # Errors
    /// Returns [`Error::Flow`] with the cells of a connection that would have a negative
    /// transmissibility.
    pub fn set_permeability(&mut self, mut rock: Rock) -> Result<()> {
        if let Some(net_to_gross) = &self.net_to_gross {
            let net = |(cell, ratio): (usize, &f64)| {
                // Rock that conducts nothing is inactive; its value only has to be valid.
                let root = if *ratio > 0.0 { ratio.sqrt() } else { 1.0 };
                let [xx, yy, zz, xy, yz, xz] = rock.mobility(cell).0;
                let [xy, yz, xz] = [xy * root * root, yz * root, xz * root];
                Tensor([xx * root * root, yy * root * root, zz, xy, yz, xz])
            };
            rock = Rock {
                mobilities: net_to_gross.iter().enumerate().map(net).collect(),
                cell_mobility: (0..net_to_gross.len() as u32).collect(),
            };
        }
        let flow = CellFlow::with_barriers(&self.graph, &rock, &self.barriers)?;
        let mut transmissibility = flow.transmissibility;
        for (connection, t) in transmissibility.iter_mut().enumerate() {
            if !self.joins_active_cells(connection) {
                *t = 0.0;
            }
        }
        self.permeability = Some(Permeability {
            rock,
            transmissibility,
        });
        Ok(())
    }

    /// Returns the depth of the shallowest site in metres.
    pub fn top_depth(&self) -> f64 {
        (0..self.len())
            .map(|cell| self.depth(cell))
            .fold(f64::INFINITY, f64::min)
    }

    /// Returns the initial pressure in Pa at a depth; `top` is [`top_depth`](Self::top_depth).
    pub fn initial_pressure(&self, depth: f64, top: f64) -> f64 {
        let case = &self.case;
        if case.has_gravity {
            case.top_pressure + case.fluid.density() * GRAVITY * (depth - top)
        } else {
            case.top_pressure
        }
    }

    /// Returns a note for each producer whose pressure is not below the initial pressure of the
    /// rock, so that no fluid flows into it.
    pub fn idle_producers(&self) -> Vec<String> {
        let top = self.top_depth();
        let note = |well: &Well| {
            let Control::Pressure(well_pressure) = well.control else {
                return None;
            };
            // The pressure of a well applies at its first cell.
            let depth = self.depth(well.cells.first()?.0 as usize);
            let rock_pressure = self.initial_pressure(depth, top);
            (well_pressure >= rock_pressure).then(|| {
                format!(
                    "producer {}: its pressure of {} bar is not below the initial pressure of the rock there, {:.2} bar: nothing flows into it until an injector raises that pressure",
                    well.name,
                    well_pressure / BAR,
                    rock_pressure / BAR
                )
            })
        };
        self.case.wells.iter().filter_map(note).collect()
    }

    /// Returns the permeability of the reservoir rock along x, y and z in m^2: that of the whole
    /// cell without the effect of the net-to-gross ratio.
    pub fn net_permeability(&self, permeability: &Permeability, cell: usize) -> [f64; 3] {
        let [x, y, z, ..] = permeability.rock.mobility(cell).0;
        match self.net_to_gross.as_ref().map(|ratios| ratios[cell]) {
            Some(ratio) if ratio > 0.0 => [x / ratio, y / ratio, z],
            _ => [x, y, z],
        }
    }

    /// Returns the largest off-diagonal term of the permeability along three directions, over the
    /// geometric mean of the diagonal terms beside it; 0 without permeability. The directions are
    /// unit vectors.
    pub fn off_diagonal_share(&self, axes: &[[f64; 3]; 3]) -> f64 {
        let Some(permeability) = &self.permeability else {
            return 0.0;
        };
        let share = |tensor: &Tensor| {
            let flux = axes.map(|axis| tensor.times(axis));
            let term = |i: usize, j: usize| dot(axes[i], flux[j]);
            let shares = [[0, 1], [1, 2], [0, 2]].map(|[i, j]| {
                let mean = (term(i, i) * term(j, j)).sqrt();
                if mean > 0.0 {
                    term(i, j).abs() / mean
                } else {
                    0.0
                }
            });
            shares.into_iter().fold(0.0, f64::max)
        };
        let tensors = permeability.rock.mobilities.iter();
        tensors.map(share).fold(0.0, f64::max)
    }

    /// Returns the pore volume of a cell in m^3, if the porosity is known.
    pub fn pore_volume(&self, cell: usize) -> Option<f64> {
        let net = self
            .net_to_gross
            .as_ref()
            .map_or(1.0, |ratios| ratios[cell]);
        let porosity = self.porosity.as_ref()?[cell];
        Some(porosity * net * self.graph.volume[cell])
    }

    /// Returns the porosity.
    ///
    /// # Errors
    /// Returns [`Error::Export`] if there is none; `place` is the format or step that needs it.
    pub fn need_porosity(&self, place: &str) -> Result<&[f64]> {
        let missing = || {
            let remedy = "give a number, a file by region, or an image";
            Error::Export(
                cause(place, "needs the porosity of every cell", remedy).with_parameter("porosity"),
            )
        };
        self.porosity.as_deref().ok_or_else(missing)
    }

    /// Returns the permeability.
    ///
    /// # Errors
    /// Returns [`Error::Export`] if there is none; `place` is the format or step that needs it.
    pub fn need_permeability(&self, place: &str) -> Result<&Permeability> {
        let missing = || {
            let remedy = "give numbers, a file by region, or images";
            Error::Export(
                cause(place, "needs the permeability of every cell", remedy)
                    .with_parameter("permeability"),
            )
        };
        self.permeability.as_ref().ok_or_else(missing)
    }

    /// Returns the tetrahedra.
    ///
    /// # Errors
    /// Returns [`Error::Export`] if the cells are not tetrahedra; `place` is the format or step
    /// that needs them.
    pub fn need_tets(&self, place: &str) -> Result<&TetMesh> {
        let missing = || {
            let remedy = "mesh the image with tetrahedra as cells";
            Error::Export(cause(place, "holds tetrahedra only", remedy))
        };
        self.tets.as_ref().ok_or_else(missing)
    }

    /// Returns for each connection the angle in degrees between the line from site to site and the
    /// permeability times the face's normal, the larger one of its two cells. It is 0 where
    /// two-point fluxes are correct. Without permeability, it is the angle to the normal.
    pub fn two_point_angles(&self) -> Vec<f64> {
        let graph = &self.graph;
        let angle = |c: &crate::mesh::graph::Connection<3>| {
            let Some(permeability) = &self.permeability else {
                return c.angle_error(&graph.site);
            };
            let [a, b] = c.cells.map(|cell| graph.site[cell as usize]);
            let line = sub(b, a);
            let cell_angle = |cell: u32| {
                let conormal = permeability.rock.mobility(cell as usize).times(c.normal);
                let across = crate::geometry::norm(crate::geometry::cross(line, conormal));
                across.atan2(dot(line, conormal)).to_degrees()
            };
            cell_angle(c.cells[0]).max(cell_angle(c.cells[1]))
        };
        graph.connections.par_iter().map(angle).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;
    use crate::model::flow::FaultLaw;

    fn model() -> Model {
        let mut model = Model::new(two_cells::<3>(0.75), None);
        let rock = Rock::uniform(Tensor::from_numbers(&[2.0, 8.0, 1.0]).unwrap(), 1.0);
        model.set_permeability(rock).unwrap();
        model
    }

    #[test]
    fn transmissibility_is_area_over_distance_times_permeability() {
        let model = model();
        let permeability = model.need_permeability("x").unwrap();
        assert_eq!(permeability.transmissibility, [2.0]);
        assert!(model.two_point_angles()[0] < 1e-12);
    }

    #[test]
    fn net_to_gross_reduces_pores_and_flow_along_layers() {
        let mut model = Model::new(two_cells::<3>(0.75), None);
        model.porosity = Some(vec![0.2; 2]);
        model.net_to_gross = Some(vec![0.5; 2]);
        let rock = Rock::uniform(Tensor::from_numbers(&[2.0, 8.0, 1.0]).unwrap(), 1.0);
        model.set_permeability(rock).unwrap();
        let permeability = model.permeability.as_ref().unwrap();
        assert!((permeability.transmissibility[0] - 1.0).abs() < 1e-12);
        assert_eq!(permeability.rock.mobility(1).0[2], 1.0);
        let net = model.net_permeability(permeability, 0);
        assert!((net[1] - 8.0).abs() < 1e-12 && net[2] == 1.0);
        assert!((model.pore_volume(0).unwrap() - 0.1 * model.graph.volume[0]).abs() < 1e-15);
    }

    #[test]
    fn cells_below_a_cut_off_are_inactive() {
        let mut model = Model::new(two_cells::<3>(0.75), None);
        assert_eq!(model.find_inactive(None, &[false, true]).unwrap(), 1);
        assert!(model.is_active(0) && !model.is_active(1));
        assert!(model.find_inactive(None, &[true, true]).is_err());
        model.net_to_gross = Some(vec![0.0, 0.4]);
        assert_eq!(model.find_inactive(None, &[]).unwrap(), 1);
        assert!(!model.is_active(0));
    }

    #[test]
    fn a_fault_is_a_factor_with_and_without_permeability() {
        let base = Model::new(two_cells::<3>(0.75), None);
        for multiplier in [0.0, 0.25, 1.0] {
            let law = FaultLaw::new(multiplier, None).unwrap();
            let mut model = base.clone();
            model.set_faults(&law.into()).unwrap();
            assert!((model.fault_factor(0) - multiplier).abs() < 1e-15);
            let rock = Rock::uniform(Tensor::isotropic(3.0), 1.0);
            model.set_permeability(rock).unwrap();
            assert!((model.fault_factor(0) - multiplier).abs() < 1e-15);
            let t = model.permeability.as_ref().unwrap().transmissibility[0];
            assert!((t - 3.0 * multiplier).abs() < 1e-15, "{t}");
        }
        // A horizon is no barrier unless a law selects it.
        let mut model = base;
        model.surfaces.kinds = vec![SurfaceKind::Horizon];
        let mut laws = FaultLaws::from(FaultLaw::CLOSED);
        model.set_faults(&laws).unwrap();
        assert_eq!(model.fault_factor(0), 1.0);
        laws.overrides = vec![(1.into(), FaultLaw::new(0.5, None).unwrap())];
        model.set_faults(&laws).unwrap();
        assert!((model.fault_factor(0) - 0.5).abs() < 1e-15);
        laws.overrides[0].0 = 2.into();
        let error = model.set_faults(&laws).unwrap_err().to_string();
        let expected = "fault-multiplier 2: matches no surface: the mesh has horizon1; ";
        assert!(error.starts_with(expected), "{error}");
    }

    #[test]
    fn errors_name_missing_properties() {
        let model = Model::new(two_cells::<3>(0.75), None);
        for error in [
            model.need_porosity("an OPM deck").unwrap_err(),
            model.need_permeability("an OPM deck").unwrap_err(),
            model.need_tets("an OPM deck").unwrap_err(),
        ] {
            assert!(error.to_string().starts_with("an OPM deck: "), "{error}");
        }
    }
}
