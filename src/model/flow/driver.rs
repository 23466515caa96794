//! Flow through a mesh that a file holds: boundary conditions by the sides of its box, barriers by
//! its surfaces, results as arrays of a file.

use crate::Result;
use crate::files::vtk::DataArray;
use crate::geometry::to_3d;
use crate::job::{MeshSpace, Meshing};
use crate::mesh::Simplices;
use crate::mesh::graph::{Graph, Locator};
use crate::mesh::poly::PolyMesh;
use crate::model::flow::anisotropy::AxisRatios;
use crate::model::flow::report::{Exchange, FaultReport, FaultStats, FlowReport, ValueRange};
use crate::model::flow::system::check_cancelled;
use crate::model::flow::{
    Barriers, CellFlow, CellReconstruction, ElementFlow, FaultLaw, PointWell, Rock, Solution,
    Streamlines,
};
use crate::model::surface::SurfaceKind;
use crate::model::surface::facet_selection;
use crate::model::surface::names::{NO_MATCH_PROBLEM, NO_MATCH_REMEDY, Selector, SurfaceNames};
use crate::model::surface::stored_surfaces::{find_interfaces, numbered_surfaces};
use crate::progress::CancelToken;
use crate::store::{FieldValue, MeshFile, Storable, StoredMesh};

/// How near a side, in parts of the box, its nodes lie.
const SIDE_TOLERANCE: f64 = 1e-7;

/// Angle in degrees from which on two-point fluxes are called rough.
pub const ROUGH_ANGLE_DEGREES: f64 = 1.0;

/// The sides of the box, in the order of their numbers.
pub const SIDE_NAMES: [&str; 6] = ["xmin", "xmax", "ymin", "ymax", "zmin", "zmax"];

/// Where fluid enters and leaves.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BoundaryConditions<const D: usize> {
    /// Sources and sinks.
    pub wells: Vec<PointWell<D>>,
    /// Sides of the box with their pressures, Pa. Where two meet, the first holds.
    pub sides: Vec<(u8, f64)>,
}

/// Which surfaces are barriers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum BarrierSelection {
    /// Those that are neither horizons nor part labels.
    #[default]
    Faults,
    /// Horizons only.
    Horizons,
    /// All.
    All,
    /// Those that one of these picks.
    Selected(Vec<Selector>),
}

impl BarrierSelection {
    fn includes(&self, surfaces: &SurfaceNames, at: usize) -> bool {
        match self {
            Self::Faults => surfaces.kinds[at] == SurfaceKind::Fault,
            Self::Horizons => surfaces.kinds[at] == SurfaceKind::Horizon,
            Self::All => true,
            Self::Selected(selectors) => selectors.iter().any(|s| s.selects(surfaces, at)),
        }
    }
}

/// How the surfaces of a mesh resist flow.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultLaws {
    /// Which of them resist.
    pub selection: BarrierSelection,
    /// How they do.
    pub law: FaultLaw,
    /// Surfaces with a law of their own, whether they are in `standing` or not. Of several that pick a
    /// surface, the last holds.
    pub overrides: Vec<(Selector, FaultLaw)>,
    /// Whether it is an error if `law` is for faults, but no surface of a mesh of labels is one.
    pub must_apply: bool,
}

impl From<FaultLaw> for FaultLaws {
    /// The same for all faults; horizons are open.
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
    /// Whether any law is neither open nor closed.
    pub fn has_partial_law(&self) -> bool {
        let own = self.overrides.iter().map(|own| own.1);
        own.chain([self.law])
            .any(|law| law.multiplier() > 0.0 && !law.is_open())
    }

    /// Whether a pattern picks a name.
    pub fn selects_name(&self, name: &str) -> bool {
        let standing = match &self.selection {
            BarrierSelection::Selected(selectors) => selectors.as_slice(),
            _ => &[],
        };
        let own = self.overrides.iter().map(|own| &own.0);
        own.chain(standing).any(|selector| selector.matches(name))
    }

    /// Whether `law`, which is for faults, resists in a mesh of labels in which nothing is a fault.
    pub fn has_no_effect(&self, surfaces: &SurfaceNames) -> bool {
        let of_labels = surfaces.kinds.contains(&SurfaceKind::Interface);
        let none = of_labels && !surfaces.kinds.contains(&SurfaceKind::Fault);
        self.selection == BarrierSelection::Faults
            && none
            && !self.law.is_open()
            && self.overrides.is_empty()
    }

    /// The law of each surface; `option` is the one that says which surfaces resist.
    ///
    /// # Errors
    /// [`Error::Flow`](crate::Error::Flow) with the names of the surfaces if what is to resist does not
    /// exist.
    pub fn surface_laws(&self, surfaces: &SurfaceNames, option: &str) -> Result<Vec<FaultLaw>> {
        for (selector, _) in &self.overrides {
            surfaces.check("--fault-multiplier", selector)?;
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
                "--faults",
                "is for faults, but no surface is one",
                "say by --barriers which surfaces resist, or omit it",
            ));
        }
        let law = |at: usize| {
            let own = self.overrides.iter().rev();
            let mut own = own.filter(|own| own.0.selects(surfaces, at));
            match own.next() {
                Some(&(_, law)) => law,
                None if self.selection.includes(surfaces, at) => self.law,
                None => FaultLaw::OPEN,
            }
        };
        Ok((0..surfaces.kinds.len()).map(law).collect())
    }
}

/// The barriers on the faces of a mesh where its file has it, its surfaces [`numbered_surfaces`]; and whether
/// surfaces are there but none that `laws` are for.
///
/// # Errors
/// [`Error::Flow`](crate::Error::Flow) with the names of the surfaces if what is to resist does not exist.
pub fn barriers<const D: usize, M: Storable<D>>(
    stored: &mut StoredMesh<D, M>,
    marks: &[bool],
    laws: &FaultLaws,
) -> Result<(Barriers, bool)> {
    let mut surfaces = numbered_surfaces(stored, marks);
    if let Some(region) = stored.regions() {
        surfaces.add_interfaces(find_interfaces(stored, &region), |name| {
            laws.selects_name(name)
        });
    }
    let names = surfaces.all_names();
    let idle = laws.has_no_effect(&names);
    let laws = laws.surface_laws(&names, "--barriers")?;
    let label =
        stored.with_world_mesh(|mesh| facet_selection::labels_of_faces(mesh, &surfaces.facets));
    Ok((Barriers::new(label, laws)?.with_names(names.names), idle))
}

/// A flow that was computed: the file to write, and what is said of it.
#[derive(Debug, Clone)]
pub struct FlowOutcome<const D: usize, M> {
    /// The mesh, torn along its faults, with pressure and velocity.
    pub file: MeshFile<M>,
    /// Its figures.
    pub report: FlowReport,
    /// Paths of fluid, if they were asked for.
    pub streamlines: Option<Streamlines<D>>,
}

/// Flow through triangles or tetrahedra, and `lines` streamlines.
///
/// # Errors
/// Those of [`ElementFlow`]; [`Error::Interrupted`](crate::Error::Interrupted) once `patience` is over.
pub fn flow_through_elements<const D: usize, M: Simplices<D>>(
    stored: StoredMesh<D, M>,
    rock: Rock,
    barriers: &Barriers,
    conditions: &BoundaryConditions<D>,
    lines: Option<usize>,
    patience: &CancelToken<'_>,
) -> Result<FlowOutcome<D, M>> {
    let on_sides = side_nodes(&stored, &conditions.sides);
    let (mesh, arrays) = stored.into_file().into_parts();
    let flow = ElementFlow::new(&mesh, barriers, rock)?;
    drop(mesh);
    let located = flow.locate(&conditions.wells)?;
    let (fixed, sides) = fixed_nodes(&flow, &on_sides);
    let found = flow.solve_cancellable(&flow.rates(&located), &fixed, patience)?;

    let p = &found.pressure;
    let mut side_rates = [0.0; 6];
    for (&(node, _), &side) in fixed.iter().zip(&sides) {
        side_rates[usize::from(side)] += found.inflow[node as usize];
    }
    let nodes = flow.split_mesh.original_node.iter().zip(0u32..);
    let doubled = nodes.filter(|(from, node)| *from != node).count();
    let torn = flow.split_mesh.faces.iter().zip(flow.fault_rates(p));
    let crossings = torn.map(|(face, rate)| {
        let [here, there] = face.nodes;
        let jumps = here.iter().zip(there);
        let jump = jumps.fold(0.0, |jump: f64, (&a, b)| {
            jump.max((p[a as usize] - p[b as usize]).abs())
        });
        (face.label, rate, jump)
    });
    let mut report = flow_report(&found, p, conditions, &side_rates, barriers, crossings);
    report.faults.doubled_nodes = doubled;

    let mut streamlines = None;
    if let Some(count) = lines {
        let rates = flow.face_rates(p, &located, &fixed, patience)?;
        let positions: Vec<[f64; D]> = conditions.wells.iter().map(|well| well.position).collect();
        let mesh = &flow.split_mesh.mesh;
        streamlines = Some(Streamlines::trace(
            mesh, &rates, &located, &positions, count, patience,
        ));
    }
    check_cancelled(patience)?;
    let file = split_mesh_file(flow, found, arrays, &report);
    Ok(FlowOutcome {
        file,
        report,
        streamlines,
    })
}

/// Flow through Voronoi cells, or any polyhedra or polygons, by two-point fluxes, with `lines`
/// streamlines; and if two-point fluxes are rough, what to say of that: by how many degrees the lines
/// between cells are off square to the permeability times their faces' normals, on average, and what becomes
/// of the flow along each axis.
///
/// # Errors
/// Those of [`CellFlow`]; [`Error::Interrupted`](crate::Error::Interrupted) once `patience` is over.
pub fn flow_through_cells<const D: usize>(
    stored: StoredMesh<D, PolyMesh<D>>,
    rock: &Rock,
    barriers: &Barriers,
    conditions: &BoundaryConditions<D>,
    lines: Option<usize>,
    patience: &CancelToken<'_>,
) -> Result<(FlowOutcome<D, PolyMesh<D>>, Vec<String>)>
where
    MeshSpace<D>: Meshing<D>,
{
    let space = stored.space.clone();
    let mut file = stored.into_file();
    let graph = Graph::from_poly(&file.mesh);
    let flow = CellFlow::with_barriers(&graph, rock, barriers)?;
    let cells = graph.volume.len();
    let sides = &conditions.sides;
    let found = flow.solve_cancellable(&flow.well_rates(&conditions.wells)?, sides, patience)?;
    let (p, of_sides) = found.pressure.split_at(cells);
    let rates = flow.rates(p, sides);
    let mut side_rates = [0.0; 6];
    for (&(side, _), at) in sides.iter().zip(cells..cells + of_sides.len()) {
        side_rates[usize::from(side)] = found.inflow[at];
    }
    let connections = graph.connections.iter().zip(&rates.connections);
    let crossings = connections.filter_map(|(c, &rate)| {
        let [a, b] = c.cells.map(|c| p[c as usize]);
        Some((barriers.label(c.face as usize)?, rate, a - b))
    });
    let report = flow_report(&found, p, conditions, &side_rates, barriers, crossings);
    let velocity = flow.velocity(&rates);
    let mut streamlines = None;
    if let Some(count) = lines {
        let mesh = &file.mesh;
        let inside: CellReconstruction<D, <MeshSpace<D> as Meshing<D>>::Mesh> =
            CellReconstruction::new(mesh, &graph, &rates, &velocity);
        let wells = conditions.wells.iter();
        let positions: Vec<[f64; D]> = wells.clone().map(|well| well.position).collect();
        let locator = Locator::new(&graph);
        let wells: Vec<(u32, f64)> = wells
            .filter_map(|well| Some((locator.cell_at(well.position)? as u32, well.rate)))
            .collect();
        streamlines = Some(Streamlines::trace_polyhedra(
            &inside, &wells, &positions, count, patience,
        ));
    }
    check_cancelled(patience)?;
    let velocity = pad_to_3d(&velocity);
    let pressure = DataArray::scalars("pressure", p.to_vec());
    file.cell_data
        .extend([pressure, vectors("velocity", velocity)]);
    file.field_data.push(report_field(&report));
    let outcome = FlowOutcome {
        file,
        report,
        streamlines,
    };
    let mut notes = Vec::new();
    if flow.angle_error > ROUGH_ANGLE_DEGREES {
        notes.push(format!(
            "the lines between cells deviate by {:.0} degrees from the permeability times their faces' normals, on average: two-point fluxes are rough",
            flow.angle_error
        ));
        let axes = &space.geometry.axes;
        let ratios = AxisRatios::new(&graph, rock, axes, space.step, patience)?;
        notes.extend(ratios.note());
    }
    Ok((outcome, notes))
}

/// A side with its pressure, and which nodes of a mesh lie on it.
type SideNodes = (u8, f64, Vec<bool>);

/// Which nodes lie on the sides whose pressures are given.
fn side_nodes<const D: usize, M: Simplices<D>>(
    stored: &StoredMesh<D, M>,
    given: &[(u8, f64)],
) -> Vec<SideNodes> {
    let nodes = stored.lattice.nodes();
    let found = given.iter().map(|&(side, pressure)| {
        let axis = usize::from(side / 2);
        let extent = stored.space.extent[axis];
        let plane = if side % 2 == 0 { 0.0 } else { extent };
        let is_on = |x: &[f64; D]| (x[axis] - plane).abs() <= SIDE_TOLERANCE * extent;
        (side, pressure, nodes.iter().map(is_on).collect())
    });
    found.collect()
}

/// Nodes with given pressure, and for each of them the side that gives it.
fn fixed_nodes<const D: usize, M: Simplices<D>>(
    flow: &ElementFlow<D, M>,
    given: &[SideNodes],
) -> (Vec<(u32, f64)>, Vec<u8>) {
    let mut taken = vec![false; flow.split_mesh.original_node.len()];
    let (mut fixed, mut sides) = (Vec::new(), Vec::new());
    for (side, pressure, is_on) in given {
        for node in flow.nodes_where(|i| is_on[i]) {
            // Where two sides meet, the first holds.
            if !std::mem::replace(&mut taken[node as usize], true) {
                fixed.push((node, *pressure));
                sides.push(*side);
            }
        }
    }
    (fixed, sides)
}

/// What is said; `crossings` are label, rate and jump of pressure of each face on a barrier.
fn flow_report<const D: usize>(
    found: &Solution,
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
        name: well.name.trim_start_matches('-').to_string(),
        rate: well.rate,
    });
    let sides = conditions.sides.iter().map(|&(side, pressure)| Exchange {
        name: format!("{} at {pressure} Pa", SIDE_NAMES[usize::from(side)]),
        rate: side_rates[usize::from(side)],
    });
    let numbered = (1..).zip(by_fault).filter(|(_, fault)| fault.faces > 0);
    FlowReport {
        solver: found.stats,
        pressure: ValueRange::from_values(pressure),
        faults,
        by_fault: numbered
            .map(|(surface, faulted)| FaultReport {
                surface,
                name: barriers.name(surface),
                multiplier: barriers.law(surface).multiplier(),
                stats: faulted,
            })
            .collect(),
        exchange: wells.chain(sides).collect(),
    }
}

/// The torn mesh with pressure, velocity, and what crosses faults.
fn split_mesh_file<const D: usize, M: Simplices<D>>(
    flow: ElementFlow<D, M>,
    found: Solution,
    arrays: MeshFile<()>,
    report: &FlowReport,
) -> MeshFile<M> {
    let velocity = pad_to_3d(&flow.velocity(&found.pressure));
    let mut across = vec![0.0; flow.split_mesh.mesh.connectivity().len()];
    let rates = flow.fault_rates(&found.pressure);
    for (face, rate) in flow.split_mesh.faces.iter().zip(rates) {
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            let first = face.cells[side] as usize * (D + 1);
            across[first + usize::from(face.local_faces[side])] = sign * rate;
        }
    }
    let split = flow.split_mesh;
    let torn = |array: DataArray| DataArray {
        values: array
            .values
            .select_tuples(&split.original_node, array.components),
        ..array
    };
    let mut point_data: Vec<DataArray> = arrays.point_data.into_iter().map(torn).collect();
    point_data.push(DataArray::scalars("node", split.original_node.clone()));
    point_data.push(DataArray::scalars("pressure", found.pressure));
    let mut cell_data = arrays.cell_data;
    cell_data.push(vectors("velocity", velocity));
    cell_data.push(DataArray {
        name: "fault_rate".into(),
        components: D + 1,
        values: across.into(),
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

/// Vectors as VTK wants them, with three components.
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
