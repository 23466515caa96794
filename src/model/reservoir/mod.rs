//! From a mesh to a reservoir model: metres with z upwards, porosity and permeability in every cell,
//! transmissibilities, wells. Everything that a simulator is given is here; how it is written is the
//! business of the house `export`.
//!
//! - `frame`: from a mesh's coordinates to metres and depth
//! - `sample`: averages of an image over cells
//! - `check`: what is looked at before anything is written
//! - `closed`: wells that closed faults part, and those that run through one
//! - `trajectory`: wells through cells
//! - `completion`: well indices
//! - `sides`: the two sides of surfaces, and meshes torn along them

pub(crate) mod averaging;
pub(crate) mod check;
pub(crate) mod closed_faults;
pub(crate) mod completion;
pub(crate) mod frame;
pub(crate) mod prepared_model;
pub(crate) mod surface_sides;
pub(crate) mod trajectory;

pub use prepared_model::{MeshPlacement, PreparedModel};

use crate::parallel::prelude::*;

use crate::error::cause;
use crate::files::vtk::DataArray;
use crate::geometry::dot;
use crate::mesh::TetMesh;
use crate::mesh::graph::{Connection, Graph};
use crate::mesh::poly::{PolyMesh, SIDE_NAMES};
use crate::model::flow::driver::FaultLaws;
use crate::model::flow::{Barriers, CellFlow, Rock, SplitMesh};
use crate::model::surface::SurfaceKind;
use crate::model::surface::names::{SurfaceNames, add_names, interface_name};
use crate::model::surface::stored_surfaces::region_label;
use crate::store::LabelledRegion;
use crate::{Error, Result};

pub use averaging::{MeanKind, SamplePositions};
pub use check::ModelChecks;
pub use completion::Completion;
pub use frame::{DepthAxis, ModelFrame};
pub use trajectory::{Trajectory, WellTracer};

/// One millidarcy in m^2.
pub const MILLIDARCY: f64 = 9.869_232_667_160_13e-16;
/// One bar in Pa.
pub const BAR: f64 = 1e5;
/// One day in seconds.
pub const DAY: f64 = 86_400.0;
/// Densities in kg/m^3.
pub const WATER_DENSITY: f64 = 1000.0;
/// Likewise, of oil.
pub const OIL_DENSITY: f64 = 850.0;
/// Acceleration of gravity in m/s^2.
pub const GRAVITY: f64 = 9.806_65;

/// A mesh with everything that a simulator needs to know, in SI units. Cells have the order of the
/// mesh throughout.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Model {
    /// The cells, in metres, z upwards: what is at depth d is at z = -d. Faces on the box say on
    /// which side (of the image's axes).
    pub mesh: PolyMesh<3>,
    /// The same cells as tetrahedra, if that is what they are.
    pub tets: Option<TetMesh>,
    /// Whether simplices shall have nodes in the middle of their edges.
    pub is_quadratic: bool,
    /// The tetrahedra torn along surfaces, if they shall be.
    pub split_mesh: Option<SplitMesh>,
    /// Of a layer of prisms on triangles, those: of the first half of the mesh's nodes.
    pub triangles: Option<Vec<[u32; 3]>>,
    /// Cells and connections.
    pub graph: Graph<3>,
    /// The regions that are labels of an image, if they are: what parts them has the names of both.
    pub labels: Vec<LabelledRegion>,
    /// The surfaces that the faces on features form.
    pub surfaces: FaceSurfaces,
    /// How they resist flow.
    pub barriers: Barriers,
    /// For each cell whether its porosity or permeability is zero, so that it takes no part; empty if all
    /// do.
    pub inactive: Vec<bool>,
    /// Share of pores in each cell's volume.
    pub porosity: Option<Vec<f64>>,
    /// Permeability in m^2, with what follows from it.
    pub permeability: Option<Permeability>,
    /// Whatever else is known of each cell.
    pub properties: Vec<DataArray>,
    /// What happens in the model.
    pub case: SimulationCase,
    /// Columns along two axes, and layers, of a grid that the model is resampled on; as fine as the
    /// cells if not given.
    pub grid: Option<[usize; 3]>,
}

/// The surfaces of a mesh, and which of them each connection lies on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FaceSurfaces {
    /// The kind of surface 1, 2 ...: they have the numbers that `atomesh surface` gives them.
    pub kinds: Vec<SurfaceKind>,
    /// The names of the first, as far as the mesh's file has names.
    pub names: Vec<String>,
    /// How many of them, the first, are more than scraps.
    pub kept_count: usize,
    /// For each connection the number of its surface; 0 for none.
    pub connection_surfaces: Vec<u32>,
}

/// Names that no surface has: those of the sides of the box, and of what else has no name of its own.
pub(crate) fn reserved_names() -> Vec<String> {
    let all = SIDE_NAMES.into_iter().chain(["boundary", "scraps"]);
    all.map(String::from).collect()
}

impl FaceSurfaces {
    /// One fault of all connections on features.
    fn single_fault(graph: &Graph<3>) -> Self {
        let on = graph.connections.iter().map(|c| u32::from(c.on_feature));
        let connection_surfaces: Vec<u32> = on.collect();
        let any = connection_surfaces.contains(&1);
        Self {
            kinds: if any {
                vec![SurfaceKind::Fault]
            } else {
                Vec::new()
            },
            names: Vec::new(),
            kept_count: usize::from(any),
            connection_surfaces,
        }
    }

    /// The names of all surfaces, as every format has them.
    pub fn all_names(&self) -> SurfaceNames {
        SurfaceNames::new(&self.kinds, self.kept_count, &self.names, &reserved_names())
    }

    /// Makes surfaces of what parts regions, where it is on no other: `number` is the place of each
    /// connection's name among `names`.
    fn add_interfaces(&mut self, names: Vec<String>, number: impl Fn(usize) -> Option<usize>) {
        let (kept, added) = (self.kept_count, names.len());
        for (at, surface) in self.connection_surfaces.iter_mut().enumerate() {
            match *surface as usize {
                0 => *surface = number(at).map_or(0, |place| (kept + 1 + place) as u32),
                scrap if scrap > kept => *surface += added as u32,
                _ => {}
            }
        }
        self.names = self.all_names().names;
        self.names.extend(names);
        let interfaces = std::iter::repeat_n(SurfaceKind::Interface, added);
        self.kinds.splice(kept..kept, interfaces);
        self.kept_count += added;
    }
}

/// Permeability and what follows from it.
#[derive(Debug, Clone, PartialEq)]
pub struct Permeability {
    /// Of each cell, in m^2.
    pub rock: Rock,
    /// Of each connection, in m^3: rate times viscosity over difference of pressure, with the faults'
    /// resistance.
    pub transmissibility: Vec<f64>,
}

/// What fills the pores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Fluid {
    /// Water only.
    #[default]
    Water,
    /// Oil, and water that is injected.
    OilWater,
}

impl Fluid {
    /// Density in kg/m^3 of what fills the pores at first.
    pub fn density(self) -> f64 {
        match self {
            Self::Water => WATER_DENSITY,
            Self::OilWater => OIL_DENSITY,
        }
    }
}

/// Fluids, wells, and the time that a simulation covers.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationCase {
    /// What the model is called.
    pub title: String,
    /// What fills the pores at first.
    pub fluid: Fluid,
    /// Whether fluids have weight; without it, all cells are taken to be at one depth.
    pub has_gravity: bool,
    /// Pressure in Pa at the top of the model at first.
    pub top_pressure: f64,
    /// Wells.
    pub wells: Vec<Well>,
    /// Length of the simulation in seconds.
    pub duration: f64,
}

impl Default for SimulationCase {
    fn default() -> Self {
        Self {
            title: "atomesh".into(),
            fluid: Fluid::Water,
            has_gravity: true,
            top_pressure: 100.0 * BAR,
            wells: Vec::new(),
            duration: 3650.0 * DAY,
        }
    }
}

/// A well in the cells that it is open to.
#[derive(Debug, Clone, PartialEq)]
pub struct Well {
    /// Its name: at most eight letters and digits.
    pub name: String,
    /// The cells, with the well index of each in m^3: rate times viscosity over the difference between
    /// the pressures of cell and well.
    pub cells: Vec<(u32, f64)>,
    /// Its length in each of them, in metres.
    pub lengths: Vec<f64>,
    /// Radius in metres.
    pub radius: f64,
    /// Its way, in the model's metres; a single point if it is upright and open to one cell.
    pub path: Vec<[f64; 3]>,
    /// What it does.
    pub control: Control,
}

/// What a well does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Control {
    /// Injects water at this rate, in m^3/s.
    Inject(f64),
    /// Produces at this rate, in m^3/s.
    Produce(f64),
    /// Produces at this pressure in the well, in Pa.
    Pressure(f64),
}

impl Model {
    /// A model of cells in metres, z upwards; nothing is known yet but their shapes. All faces on
    /// features are one fault, which is open.
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

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.graph.volume.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether a cell takes part: neither its porosity nor its permeability is zero.
    pub fn is_active(&self, cell: usize) -> bool {
        !self.inactive.get(cell).copied().unwrap_or(false)
    }

    /// Finds the cells that take no part, whose porosity or permeability is zero, and gives their number.
    /// Before [`set_permeability`](Self::set_permeability).
    ///
    /// # Errors
    /// [`Error::Export`] if no cell takes part.
    pub fn find_inactive(&mut self, rock: Option<&Rock>) -> Result<usize> {
        let is_zero = |cell: usize| {
            let porosity = self.porosity.as_ref().map(|porosity| porosity[cell]);
            let conducts = rock.is_none_or(|rock| rock.mobility(cell).0 != [0.0; 6]);
            porosity == Some(0.0) || !conducts
        };
        let inactive: Vec<bool> = (0..self.len()).map(is_zero).collect();
        let count = inactive.iter().filter(|inactive| **inactive).count();
        if count == inactive.len() {
            return Err(Error::Export(cause(
                "porosity or permeability",
                "is zero in every cell, so that nothing is left to simulate",
                "give values above 0 where fluid is to flow",
            )));
        }
        self.inactive = if count > 0 { inactive } else { Vec::new() };
        Ok(count)
    }

    /// Depth of a cell's site in metres.
    pub fn depth(&self, cell: usize) -> f64 {
        -self.graph.site[cell][2]
    }

    /// Says how surfaces resist flow. What parts two regions is a surface if `laws` pick it by name. After
    /// regions are set, and before [`set_permeability`](Self::set_permeability), which looks
    /// at it.
    ///
    /// # Errors
    /// [`Error::Flow`] if a law is for a surface that does not exist.
    pub fn set_faults(&mut self, laws: &FaultLaws) -> Result<()> {
        self.add_picked_interfaces(laws);
        let of_surfaces = laws.surface_laws(&self.surfaces.all_names(), "--barriers")?;
        self.barriers = Barriers::new(self.surfaces.connection_surfaces.clone(), of_surfaces)?;
        Ok(())
    }

    fn add_picked_interfaces(&mut self, laws: &FaultLaws) {
        let region = &self.graph.region;
        let pair = |c: &Connection<3>| {
            let [a, b] = c.cells.map(|cell| region[cell as usize]);
            (a != b).then_some([a.min(b), a.max(b)])
        };
        let connections = self.graph.connections.iter();
        let mut pairs: Vec<[i32; 2]> = (connections.zip(&self.surfaces.connection_surfaces))
            .filter(|(_, surface)| **surface == 0)
            .filter_map(|(c, _)| pair(c))
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        let mut names = [reserved_names(), self.surfaces.all_names().names].concat();
        let before = names.len();
        let interfaces = pairs.iter().map(|pair| {
            let [a, b] = pair.map(|region| region_label(&self.labels, region));
            interface_name([&a, &b])
        });
        add_names(&mut names, interfaces);
        let named = pairs.into_iter().zip(names.split_off(before));
        let (pairs, names): (Vec<_>, Vec<_>) =
            named.filter(|(_, name)| laws.selects_name(name)).unzip();
        if !names.is_empty() {
            let connections = &self.graph.connections;
            let number = |at: usize| pairs.binary_search(&pair(&connections[at])?).ok();
            self.surfaces.add_interfaces(names, number);
        }
    }

    /// The factor of a connection's transmissibility that its fault is: 1 where there is none or it is
    /// open, 0 if it is closed. Without permeability, that of a rock which is the same everywhere.
    pub fn fault_factor(&self, connection: usize) -> f64 {
        let Some(label) = self.barriers.label(connection) else {
            return 1.0;
        };
        let c = &self.graph.connections[connection];
        let mobility = c.cells.map(|cell| match &self.permeability {
            Some(known) => known
                .rock
                .mobility(cell as usize)
                .normal_component(c.normal),
            None => 1.0,
        });
        let open = c.distance[0] / mobility[0] + c.distance[1] / mobility[1];
        if !open.is_finite() {
            // Next to rock that conducts nothing.
            return self.barriers.law(label).multiplier();
        }
        let fault = self.barriers.law(label).conductance(c.distance, mobility);
        open / (open + 1.0 / fault)
    }

    /// The connections between active cells that are not closed, each with its
    /// [`fault_factor`](Self::fault_factor).
    pub fn open_connections(&self) -> Vec<(u32, f64)> {
        let factors = (0..self.graph.connections.len()).map(|i| (i as u32, self.fault_factor(i)));
        let open = factors.filter(|(_, factor)| *factor > 0.0);
        open.filter(|(i, _)| self.joins_active_cells(*i as usize))
            .collect()
    }

    /// Whether both cells of a connection take part.
    fn joins_active_cells(&self, connection: usize) -> bool {
        let cells = self.graph.connections[connection].cells;
        cells.iter().all(|&cell| self.is_active(cell as usize))
    }

    /// Gives the rock its permeability, in m^2, and finds all transmissibilities: as
    /// [`CellFlow`] does, for a viscosity of 1.
    ///
    /// # Errors
    /// [`Error::Flow`] names a connection that would have a negative transmissibility.
    pub fn set_permeability(&mut self, rock: Rock) -> Result<()> {
        let flow = CellFlow::with_barriers(&self.graph, &rock, &self.barriers)?;
        let mut transmissibility = flow.transmissibility;
        for (at, t) in transmissibility.iter_mut().enumerate() {
            if !self.joins_active_cells(at) {
                *t = 0.0;
            }
        }
        self.permeability = Some(Permeability {
            rock,
            transmissibility,
        });
        Ok(())
    }

    /// Depth of the shallowest site in metres.
    pub fn top_depth(&self) -> f64 {
        (0..self.len())
            .map(|cell| self.depth(cell))
            .fold(f64::INFINITY, f64::min)
    }

    /// The pressure in Pa at a depth at first; `top` is [`top`](Self::top_depth).
    pub fn initial_pressure(&self, depth: f64, top: f64) -> f64 {
        let case = &self.case;
        match case.has_gravity {
            true => case.top_pressure + case.fluid.density() * GRAVITY * (depth - top),
            false => case.top_pressure,
        }
    }

    /// A line for each producer whose pressure is not below that of the rock at first: it has nothing to
    /// draw fluid with.
    pub fn idle_producers(&self) -> Vec<String> {
        let top = self.top_depth();
        let idle = |well: &Well| {
            let Control::Pressure(own) = well.control else {
                return None;
            };
            // The pressure of a well is that at its first cell.
            let depth = self.depth(well.cells.first()?.0 as usize);
            let around = self.initial_pressure(depth, top);
            (own >= around).then(|| {
                format!(
                    "producer {}: its pressure of {} bar is not below the {:.2} bar that the rock has there at first: nothing flows into it until an injector raises that",
                    well.name,
                    own / BAR,
                    around / BAR
                )
            })
        };
        self.case.wells.iter().filter_map(idle).collect()
    }

    /// The porosity.
    ///
    /// # Errors
    /// [`Error::Export`] if there is none; `needs` says who asks.
    pub fn need_porosity(&self, needs: &str) -> Result<&[f64]> {
        let missing = || {
            let remedy = "give a number, a file by region, or an image";
            Error::Export(
                cause(needs, "needs the porosity of every cell", remedy).with_parameter("porosity"),
            )
        };
        self.porosity.as_deref().ok_or_else(missing)
    }

    /// The permeability.
    ///
    /// # Errors
    /// [`Error::Export`] if there is none; `needs` says who asks.
    pub fn need_permeability(&self, needs: &str) -> Result<&Permeability> {
        let missing = || {
            let remedy = "give numbers, a file by region, or images";
            Error::Export(
                cause(needs, "needs the permeability of every cell", remedy)
                    .with_parameter("permeability"),
            )
        };
        self.permeability.as_ref().ok_or_else(missing)
    }

    /// The tetrahedra.
    ///
    /// # Errors
    /// [`Error::Export`] if the cells are others; `needs` says who asks.
    pub fn need_tets(&self, needs: &str) -> Result<&TetMesh> {
        let missing = || {
            let remedy = "mesh the image with tetrahedra as cells";
            Error::Export(cause(needs, "holds tetrahedra only", remedy))
        };
        self.tets.as_ref().ok_or_else(missing)
    }

    /// The angle in degrees, at each connection, between the line from site to site and the
    /// permeability times the face's normal, of the worse of its two cells: 0 where two-point fluxes
    /// are right. Without permeability, to the normal itself.
    pub fn two_point_angles(&self) -> Vec<f64> {
        let graph = &self.graph;
        let angle = |c: &crate::mesh::graph::Connection<3>| {
            let Some(permeability) = &self.permeability else {
                return c.angle_error(&graph.site);
            };
            let [a, b] = c.cells.map(|cell| graph.site[cell as usize]);
            let line: [f64; 3] = std::array::from_fn(|k| b[k] - a[k]);
            let of = |cell: u32| {
                let conormal = permeability.rock.mobility(cell as usize).times(c.normal);
                let across = crate::geometry::norm(crate::geometry::cross(line, conormal));
                across.atan2(dot(line, conormal)).to_degrees()
            };
            of(c.cells[0]).max(of(c.cells[1]))
        };
        graph.connections.par_iter().map(angle).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::poly::samples::two_cells;
    use crate::model::flow::{FaultLaw, Tensor};

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
    fn a_fault_is_a_factor_with_and_without_permeability() {
        let bare = Model::new(two_cells::<3>(0.75), None);
        for multiplier in [0.0, 0.25, 1.0] {
            let law = FaultLaw::new(multiplier, None).unwrap();
            let mut model = bare.clone();
            model.set_faults(&law.into()).unwrap();
            assert!((model.fault_factor(0) - multiplier).abs() < 1e-15);
            let rock = Rock::uniform(Tensor::isotropic(3.0), 1.0);
            model.set_permeability(rock).unwrap();
            assert!((model.fault_factor(0) - multiplier).abs() < 1e-15);
            let t = model.permeability.as_ref().unwrap().transmissibility[0];
            assert!((t - 3.0 * multiplier).abs() < 1e-15, "{t}");
        }
        // A horizon is no barrier, unless it is named.
        let mut model = bare;
        model.surfaces.kinds = vec![SurfaceKind::Horizon];
        let mut laws = FaultLaws::from(FaultLaw::CLOSED);
        model.set_faults(&laws).unwrap();
        assert_eq!(model.fault_factor(0), 1.0);
        laws.overrides = vec![(1.into(), FaultLaw::new(0.5, None).unwrap())];
        model.set_faults(&laws).unwrap();
        assert!((model.fault_factor(0) - 0.5).abs() < 1e-15);
        laws.overrides[0].0 = 2.into();
        let error = model.set_faults(&laws).unwrap_err().to_string();
        let want = "--fault-multiplier 2: matches no surface: the mesh has horizon1; ";
        assert!(error.starts_with(want), "{error}");
    }

    #[test]
    fn what_is_missing_is_named() {
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
