//! Computes the flow through a mesh from a file: takes boundary conditions on the sides of the box
//! and barriers on surfaces, and returns the results as arrays of a mesh file.

use crate::Result;
use crate::error::cause;
use crate::files::vtk::DataArray;
use crate::geometry::to_3d;
use crate::mesh::check::nodes_on_bent_side;
use crate::mesh::graph::{Graph, Locator};
use crate::mesh::poly::PolyMesh;
use crate::mesh::{Dimension, Simplices, Space};
use crate::model::flow::anisotropy::AxisRatios;
use crate::model::flow::report::{Exchange, FaultReport, FaultStats, FlowReport, ValueRange};
use crate::model::flow::system::check_cancelled;
use crate::model::flow::{
    Barriers, CellFlow, CellReconstruction, ElementFlow, FaultLaw, PointWell, Rock, Solution,
    Streamlines,
};
use crate::model::surface::SurfaceKind;
use crate::model::surface::facet_selection;
use crate::model::surface::fault_extension::ExtendedFault;
use crate::model::surface::names::{NO_MATCH_PROBLEM, NO_MATCH_REMEDY, Selector, SurfaceNames};
use crate::model::surface::stored_surfaces::{find_interfaces, numbered_surfaces};
use crate::progress::CancelToken;
use crate::store::{FieldValue, MeshFile, Storable, StoredMesh};

/// Largest distance of a node from its side, as a fraction of the box.
const SIDE_TOLERANCE: f64 = 1e-7;

/// Smallest mean angle error, in degrees, at which two-point fluxes are called rough.
pub const ROUGH_ANGLE_DEGREES: f64 = 1.0;

/// The names of the sides of the box, in the order of their numbers.
pub const SIDE_NAMES: [&str; 6] = ["xmin", "xmax", "ymin", "ymax", "zmin", "zmax"];

/// Wells and sides where fluid enters and leaves.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BoundaryConditions<const D: usize> {
    /// Sources and sinks.
    pub wells: Vec<PointWell<D>>,
    /// Sides of the box with their pressures in Pa. On an edge where two sides meet, the first one
    /// applies.
    pub sides: Vec<(u8, f64)>,
}

/// The surfaces that are barriers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum BarrierSelection {
    /// Surfaces that are neither horizons nor interfaces between labels.
    #[default]
    Faults,
    /// Horizons only.
    Horizons,
    /// All surfaces.
    All,
    /// Surfaces that at least one of these selectors selects.
    Selected(Vec<Selector>),
}

impl BarrierSelection {
    fn includes(&self, surfaces: &SurfaceNames, surface: usize) -> bool {
        match self {
            Self::Faults => surfaces.kinds[surface] == SurfaceKind::Fault,
            Self::Horizons => surfaces.kinds[surface] == SurfaceKind::Horizon,
            Self::All => true,
            Self::Selected(selectors) => selectors.iter().any(|s| s.selects(surfaces, surface)),
        }
    }
}

/// The fault laws of the surfaces of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultLaws {
    /// The surfaces to which `law` applies.
    pub selection: BarrierSelection,
    /// The law of these surfaces.
    pub law: FaultLaw,
    /// Surfaces with their own law, whether `selection` includes them or not. If several selectors
    /// select the same surface, the last one applies.
    pub overrides: Vec<(Selector, FaultLaw)>,
    /// If `true`, it is an error if `law` is for faults but the mesh has interfaces between labels
    /// and no faults.
    pub must_apply: bool,
}

impl From<FaultLaw> for FaultLaws {
    /// Applies one law to all faults; horizons are open.
    fn from(law: FaultLaw) -> Self {
        Self {
            selection: BarrierSelection::Faults,
            law,
            overrides: Vec::new(),
            must_apply: false,
        }
    }
}

impl FaultLaws {
    /// Returns `true` if any law is neither open nor closed.
    pub fn has_partial_law(&self) -> bool {
        let laws = self.overrides.iter().map(|entry| entry.1);
        laws.chain([self.law])
            .any(|law| law.multiplier() > 0.0 && !law.is_open())
    }

    /// Checks that no fault conducts better than the rock, which only transmissibilities from cell
    /// to cell can represent.
    ///
    /// # Errors
    /// Returns [`Error::Flow`](crate::Error::Flow) if a multiplier is above 1.
    pub fn check_resistance(&self) -> Result<()> {
        let laws = self.overrides.iter().map(|entry| entry.1);
        match laws.chain([self.law]).find(FaultLaw::is_conduit) {
            None => Ok(()),
            Some(law) => Err(crate::Error::Flow(cause(
                format!("fault multiplier {}", law.multiplier()),
                "is not from 0 to 1",
                "0 is closed, 1 is open; only an export can have faults that conduct better than the rock",
            ))),
        }
    }

    /// Returns `true` if a selector matches this name.
    pub fn selects_name(&self, name: &str) -> bool {
        let selected = match &self.selection {
            BarrierSelection::Selected(selectors) => selectors.as_slice(),
            _ => &[],
        };
        let overrides = self.overrides.iter().map(|entry| &entry.0);
        overrides
            .chain(selected)
            .any(|selector| selector.matches(name))
    }

    /// Returns `true` if `law` is for faults and resists flow, but the mesh has interfaces between
    /// labels and no faults.
    pub fn has_no_effect(&self, surfaces: &SurfaceNames) -> bool {
        let has_interfaces = surfaces.kinds.contains(&SurfaceKind::Interface);
        let no_faults = has_interfaces && !surfaces.kinds.contains(&SurfaceKind::Fault);
        self.selection == BarrierSelection::Faults
            && no_faults
            && !self.law.is_open()
            && self.overrides.is_empty()
    }

    /// Returns the law of each surface. `option` is the option that selects barriers, for error
    /// messages.
    ///
    /// # Errors
    /// Returns [`Error::Flow`](crate::Error::Flow) with the names of all surfaces if a selected
    /// surface does not exist.
    pub fn surface_laws(&self, surfaces: &SurfaceNames, option: &str) -> Result<Vec<FaultLaw>> {
        for (selector, _) in &self.overrides {
            surfaces.check("fault-multiplier", selector)?;
        }
        match &self.selection {
            BarrierSelection::Selected(selectors) => {
                let mut all = selectors.iter();
                all.try_for_each(|selector| surfaces.check(option, selector))?;
            }
            BarrierSelection::Horizons if !surfaces.kinds.contains(&SurfaceKind::Horizon) => {
                let place = format!("{option} horizons");
                return Err(surfaces.no_match_error(place, NO_MATCH_PROBLEM, NO_MATCH_REMEDY));
            }
            _ => {}
        }
        if self.must_apply && self.has_no_effect(surfaces) {
            return Err(surfaces.no_match_error(
                "faults",
                "is for faults, but no surface is one",
                "select the surfaces that resist with --barriers, or omit it",
            ));
        }
        let law = |surface: usize| {
            let overrides = self.overrides.iter().rev();
            let mut matching = overrides.filter(|entry| entry.0.selects(surfaces, surface));
            match matching.next() {
                Some(&(_, law)) => law,
                None if self.selection.includes(surfaces, surface) => self.law,
                None => FaultLaw::OPEN,
            }
        };
        Ok((0..surfaces.kinds.len()).map(law).collect())
    }
}

/// The barriers of a mesh.
pub(super) struct MeshBarriers {
    /// The barriers on the faces of the mesh.
    pub barriers: Barriers,
    /// `true` if the mesh has surfaces but none to which the laws apply.
    pub is_idle: bool,
    /// The faults that were extended.
    pub extended: Vec<ExtendedFault>,
}

/// Returns the barriers on the faces of a mesh in world coordinates, one label for each of its
/// [`numbered_surfaces`]. Faults are extended by up to a distance if it is given with the cells of the
/// mesh in world coordinates; an extension has the law of its fault.
///
/// # Errors
/// Returns [`Error::Flow`](crate::Error::Flow) with the names of all surfaces if a selected surface
/// does not exist.
pub(super) fn barriers<const D: usize, M: Storable<D>>(
    stored: &mut StoredMesh<D, M>,
    marks: &[bool],
    laws: &FaultLaws,
    extend: Option<(f64, &PolyMesh<D>)>,
) -> Result<MeshBarriers> {
    let mut surfaces = numbered_surfaces(stored, marks);
    if let Some(region) = stored.regions() {
        surfaces.add_interfaces(find_interfaces(stored, &region), |name| {
            laws.selects_name(name)
        });
    }
    let names = surfaces.all_names();
    let is_idle = laws.has_no_effect(&names);
    let mut laws = laws.surface_laws(&names, "barriers")?;
    let mut extended = Vec::new();
    if let Some((distance, cells)) = extend {
        let kept_count = surfaces.kept_count;
        let found = surfaces.extend_faults(cells, distance);
        let new_laws: Vec<FaultLaw> = found.iter().map(|f| laws[f.0 as usize - 1]).collect();
        laws.splice(kept_count..kept_count, new_laws);
        extended = found.into_iter().map(|found| found.1).collect();
    }
    let label =
        stored.with_world_mesh(|mesh| facet_selection::labels_of_faces(mesh, &surfaces.facets));
    Ok(MeshBarriers {
        barriers: Barriers::new(label, laws)?.with_names(surfaces.all_names().names),
        is_idle,
        extended,
    })
}

/// A computed flow: the file to write and the report.
#[derive(Debug, Clone)]
pub(super) struct ComputedFlow<const D: usize, M> {
    /// The mesh, split along its faults, with pressure and velocity.
    pub file: MeshFile<M>,
    /// The report.
    pub report: FlowReport,
    /// Streamlines, if requested.
    pub streamlines: Option<Streamlines<D>>,
}

/// Computes the flow through triangles or tetrahedra, and `streamline_count` streamlines if it is
/// not `None`.
///
/// # Errors
/// Returns the errors of [`ElementFlow`], and [`Error::Interrupted`](crate::Error::Interrupted)
/// once `cancel` is cancelled.
pub(super) fn flow_through_elements<const D: usize, M: Simplices<D>>(
    stored: StoredMesh<D, M>,
    rock: Rock,
    barriers: &Barriers,
    conditions: &BoundaryConditions<D>,
    streamline_count: Option<usize>,
    cancel: &CancelToken<'_>,
) -> Result<ComputedFlow<D, M>> {
    let nodes_on_sides = side_nodes(&stored, &conditions.sides);
    let (mesh, arrays) = stored.into_file().into_parts();
    let flow = ElementFlow::new(&mesh, barriers, rock)?;
    drop(mesh);
    let located = flow.locate(&conditions.wells)?;
    let (fixed, sides) = fixed_nodes(&flow, &nodes_on_sides);
    let solution = flow.solve_cancellable(&flow.rates(&located), &fixed, cancel)?;

    let p = &solution.pressure;
    let mut side_rates = [0.0; 6];
    for (&(node, _), &side) in fixed.iter().zip(&sides) {
        side_rates[usize::from(side)] += solution.inflow[node as usize];
    }
    let nodes = flow.split_mesh.original_node.iter().zip(0u32..);
    let doubled = nodes.filter(|(original, node)| *original != node).count();
    let faces_and_rates = flow.split_mesh.faces.iter().zip(flow.fault_rates(p));
    let crossings = faces_and_rates.map(|(face, rate)| {
        let [side_a, side_b] = face.nodes;
        let node_pairs = side_a.iter().zip(side_b);
        let jump = node_pairs.fold(0.0, |max_jump: f64, (&a, b)| {
            max_jump.max((p[a as usize] - p[b as usize]).abs())
        });
        (face.label, rate, jump)
    });
    let mut report = flow_report(&solution, p, conditions, &side_rates, barriers, crossings);
    report.faults.doubled_nodes = doubled;

    let mut streamlines = None;
    if let Some(count) = streamline_count {
        let rates = flow.face_rates(p, &located, &fixed, cancel)?;
        let positions: Vec<[f64; D]> = conditions.wells.iter().map(|well| well.position).collect();
        let mesh = &flow.split_mesh.mesh;
        streamlines = Some(Streamlines::trace(
            mesh, &rates, &located, &positions, count, cancel,
        ));
    }
    check_cancelled(cancel)?;
    let file = split_mesh_file(flow, solution, arrays, &report);
    Ok(ComputedFlow {
        file,
        report,
        streamlines,
    })
}

/// Computes the flow through Voronoi cells, or any polyhedra or polygons, by two-point fluxes, and
/// `streamline_count` streamlines if it is not `None`. If two-point fluxes are rough, the second
/// value holds notes: the mean angle between the lines from site to site and the permeability times
/// the faces' normals, and the error of the flow along each axis.
///
/// # Errors
/// Returns the errors of [`CellFlow`], and [`Error::Interrupted`](crate::Error::Interrupted) once
/// `cancel` is cancelled.
pub(super) fn flow_through_cells<const D: usize>(
    stored: StoredMesh<D, PolyMesh<D>>,
    rock: &Rock,
    barriers: &Barriers,
    conditions: &BoundaryConditions<D>,
    streamline_count: Option<usize>,
    cancel: &CancelToken<'_>,
) -> Result<(ComputedFlow<D, PolyMesh<D>>, Vec<String>)>
where
    Space<D>: Dimension<D>,
{
    let space = stored.space.clone();
    let mut file = stored.into_file();
    let graph = Graph::from_poly(&file.mesh);
    let flow = CellFlow::with_barriers(&graph, rock, barriers)?;
    let cells = graph.volume.len();
    let sides = &conditions.sides;
    let solution = flow.solve_cancellable(&flow.well_rates(&conditions.wells)?, sides, cancel)?;
    let (p, side_pressures) = solution.pressure.split_at(cells);
    let rates = flow.rates(p, sides);
    let mut side_rates = [0.0; 6];
    for (&(side, _), unknown) in sides.iter().zip(cells..cells + side_pressures.len()) {
        side_rates[usize::from(side)] = solution.inflow[unknown];
    }
    let connections = graph.connections.iter().zip(&rates.connections);
    let crossings = connections.filter_map(|(c, &rate)| {
        let [a, b] = c.cells.map(|c| p[c as usize]);
        Some((barriers.label(c.face as usize)?, rate, a - b))
    });
    let report = flow_report(&solution, p, conditions, &side_rates, barriers, crossings);
    let velocity = flow.velocity(&rates);
    let mut streamlines = None;
    if let Some(count) = streamline_count {
        let mesh = &file.mesh;
        let reconstruction: CellReconstruction<D, <Space<D> as Dimension<D>>::Mesh> =
            CellReconstruction::new(mesh, &graph, &rates, &velocity);
        let wells = conditions.wells.iter();
        let positions: Vec<[f64; D]> = wells.clone().map(|well| well.position).collect();
        let locator = Locator::new(&graph);
        let wells: Vec<(u32, f64)> = wells
            .filter_map(|well| Some((locator.cell_at(well.position)? as u32, well.rate)))
            .collect();
        streamlines = Some(Streamlines::trace_polyhedra(
            &reconstruction,
            &wells,
            &positions,
            count,
            cancel,
        ));
    }
    check_cancelled(cancel)?;
    let velocity = pad_to_3d(&velocity);
    let pressure = DataArray::scalars("pressure", p.to_vec());
    file.cell_data
        .extend([pressure, vectors("velocity", velocity)]);
    file.field_data.push(report_field(&report));
    let outcome = ComputedFlow {
        file,
        report,
        streamlines,
    };
    let mut notes = Vec::new();
    if flow.angle_error > ROUGH_ANGLE_DEGREES {
        notes.push(format!(
            "flow between cells is rough: the lines between their sites deviate by {:.0} degrees on average from the direction in which the rock conducts across their faces (two-point fluxes)",
            flow.angle_error
        ));
        let axes = &space.geometry.axes;
        let ratios = AxisRatios::new(&graph, rock, axes, space.step, cancel)?;
        notes.extend(ratios.note());
    }
    Ok((outcome, notes))
}

/// A side, its pressure, and for each node of a mesh whether it lies on the side.
type SideNodes = (u8, f64, Vec<bool>);

/// Finds the nodes that lie on the sides with given pressures.
fn side_nodes<const D: usize, M: Simplices<D>>(
    stored: &StoredMesh<D, M>,
    sides: &[(u8, f64)],
) -> Vec<SideNodes> {
    let nodes = stored.lattice.nodes();
    let nodes_on_sides = sides.iter().map(|&(side, pressure)| {
        let axis = usize::from(side / 2);
        let extent = stored.space.extent[axis];
        let plane = if side % 2 == 0 { 0.0 } else { extent };
        let is_on = |x: &[f64; D]| (x[axis] - plane).abs() <= SIDE_TOLERANCE * extent;
        let is_on_side = match stored.space.bent_side {
            Some(bent) if bent == usize::from(side) => {
                nodes_on_bent_side(&stored.lattice, stored.space.extent, bent)
            }
            _ => nodes.iter().map(is_on).collect(),
        };
        (side, pressure, is_on_side)
    });
    nodes_on_sides.collect()
}

/// Returns the nodes with given pressure, and for each of them the side that gives it.
fn fixed_nodes<const D: usize, M: Simplices<D>>(
    flow: &ElementFlow<D, M>,
    side_nodes: &[SideNodes],
) -> (Vec<(u32, f64)>, Vec<u8>) {
    let mut is_fixed = vec![false; flow.split_mesh.original_node.len()];
    let (mut fixed, mut sides) = (Vec::new(), Vec::new());
    for (side, pressure, is_on) in side_nodes {
        for node in flow.nodes_where(|i| is_on[i]) {
            // Where two sides meet, the first one applies.
            if !std::mem::replace(&mut is_fixed[node as usize], true) {
                fixed.push((node, *pressure));
                sides.push(*side);
            }
        }
    }
    (fixed, sides)
}

/// Builds the report. `crossings` holds label, rate and pressure jump of each face on a barrier.
fn flow_report<const D: usize>(
    solution: &Solution,
    pressure: &[f64],
    conditions: &BoundaryConditions<D>,
    side_rates: &[f64; 6],
    barriers: &Barriers,
    crossings: impl Iterator<Item = (u32, f64, f64)>,
) -> FlowReport {
    let mut faults = FaultStats::default();
    let mut by_fault: Vec<FaultStats> = Vec::new();
    for (label, rate, jump) in crossings {
        let label = label as usize;
        by_fault.resize(by_fault.len().max(label), FaultStats::default());
        by_fault[label - 1].add(rate, jump);
        faults.add(rate, jump);
    }
    let wells = conditions.wells.iter().map(|well| Exchange {
        name: well.name.clone(),
        rate: well.rate,
    });
    let sides = conditions.sides.iter().map(|&(side, pressure)| Exchange {
        name: format!("{} at {pressure} Pa", SIDE_NAMES[usize::from(side)]),
        rate: side_rates[usize::from(side)],
    });
    let numbered = (1..).zip(by_fault).filter(|(_, fault)| fault.faces > 0);
    FlowReport {
        solver: solution.stats,
        pressure: ValueRange::from_values(pressure),
        faults,
        by_fault: numbered
            .map(|(surface, stats)| FaultReport {
                surface,
                name: barriers.name(surface),
                multiplier: barriers.law(surface).multiplier(),
                stats,
            })
            .collect(),
        exchange: wells.chain(sides).collect(),
    }
}

/// Returns the split mesh with pressure, velocity, and the rates across fault faces.
fn split_mesh_file<const D: usize, M: Simplices<D>>(
    flow: ElementFlow<D, M>,
    solution: Solution,
    arrays: MeshFile<()>,
    report: &FlowReport,
) -> MeshFile<M> {
    let velocity = pad_to_3d(&flow.velocity(&solution.pressure));
    let mut fault_rates = vec![0.0; flow.split_mesh.mesh.connectivity().len()];
    let rates = flow.fault_rates(&solution.pressure);
    for (face, rate) in flow.split_mesh.faces.iter().zip(rates) {
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            let first_face = face.cells[side] as usize * (D + 1);
            fault_rates[first_face + usize::from(face.local_faces[side])] = sign * rate;
        }
    }
    let split = flow.split_mesh;
    let split_array = |array: DataArray| DataArray {
        values: array
            .values
            .select_tuples(&split.original_node, array.components),
        ..array
    };
    let mut point_data: Vec<DataArray> = arrays.point_data.into_iter().map(split_array).collect();
    point_data.push(DataArray::scalars("node", split.original_node.clone()));
    point_data.push(DataArray::scalars("pressure", solution.pressure));
    let mut cell_data = arrays.cell_data;
    cell_data.push(vectors("velocity", velocity));
    cell_data.push(DataArray {
        name: "fault_rate".into(),
        components: D + 1,
        values: fault_rates.into(),
    });
    let mut field_data = arrays.field_data;
    field_data.push(report_field(report));
    MeshFile {
        mesh: split.mesh,
        point_data,
        cell_data,
        field_data,
    }
}

/// Returns vectors with three components each, as VTK requires.
fn pad_to_3d<const D: usize>(vectors: &[[f64; D]]) -> Vec<f64> {
    vectors.iter().flat_map(|&v| to_3d(v)).collect()
}

fn vectors(name: &str, values: Vec<f64>) -> DataArray {
    DataArray {
        name: name.into(),
        components: 3,
        values: values.into(),
    }
}

fn report_field(report: &FlowReport) -> (String, FieldValue) {
    let json = serde_json::to_string(report).unwrap_or_default();
    ("flow".into(), FieldValue::Text(json))
}
