//! Flow through a mesh that a file holds: boundary conditions by the sides of its box, barriers by
//! its surfaces, results as arrays of a file.

use crate::Result;
use crate::files::vtk::DataArray;
use crate::geometry::in_space;
use crate::job::{Meshing, Space};
use crate::mesh::Simplices;
use crate::mesh::graph::{Graph, Locator};
use crate::mesh::poly::PolyMesh;
use crate::model::flow::anisotropy::AxisRatios;
use crate::model::flow::report::{Exchange, Fault, Faulted, FlowReport, Range};
use crate::model::flow::system::lasts;
use crate::model::flow::{
    Barriers, CellFlow, ElementFlow, Faults, Inside, Rock, Solution, Streamlines, Well,
};
use crate::model::surface::Kind;
use crate::model::surface::names::{NO_MATCH, Selector, SurfaceNames, USE_NAMES};
use crate::model::surface::select;
use crate::model::surface::stored::{interfaces_of, numbered};
use crate::observer::Patience;
use crate::store::{FieldValue, MeshFile, Stored, StoredMesh};

/// How near a side, in parts of the box, its nodes lie.
const ON_SIDE: f64 = 1e-7;

/// Angle in degrees from which on two-point fluxes are called rough.
pub const ROUGH: f64 = 1.0;

/// The sides of the box, in the order of their numbers.
pub const SIDES: [&str; 6] = ["xmin", "xmax", "ymin", "ymax", "zmin", "zmax"];

/// Where fluid enters and leaves.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Conditions<const D: usize> {
    /// Sources and sinks.
    pub wells: Vec<Well<D>>,
    /// Sides of the box with their pressures, Pa. Where two meet, the first holds.
    pub sides: Vec<(u8, f64)>,
}

/// Which surfaces are barriers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Standing {
    /// Those that are neither horizons nor part labels.
    #[default]
    Faults,
    /// Horizons only.
    Horizons,
    /// All.
    All,
    /// Those that one of these picks.
    Picked(Vec<Selector>),
}

impl Standing {
    fn holds(&self, surfaces: &SurfaceNames, at: usize) -> bool {
        match self {
            Self::Faults => surfaces.kinds[at] == Kind::Fault,
            Self::Horizons => surfaces.kinds[at] == Kind::Horizon,
            Self::All => true,
            Self::Picked(selectors) => selectors.iter().any(|s| s.picks(surfaces, at)),
        }
    }
}

/// How the surfaces of a mesh resist flow.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultLaws {
    /// Which of them resist.
    pub standing: Standing,
    /// How they do.
    pub law: Faults,
    /// Surfaces with a law of their own, whether they are in `standing` or not. Of several that pick a
    /// surface, the last holds.
    pub own: Vec<(Selector, Faults)>,
    /// Whether it is an error if `law` is for faults, but no surface of a mesh of labels is one.
    pub must_apply: bool,
}

impl From<Faults> for FaultLaws {
    /// The same for all faults; horizons are open.
    fn from(law: Faults) -> Self {
        Self {
            standing: Standing::Faults,
            law,
            own: Vec::new(),
            must_apply: false,
        }
    }
}

impl FaultLaws {
    /// Whether any law is neither open nor closed.
    pub fn any_between(&self) -> bool {
        let own = self.own.iter().map(|own| own.1);
        own.chain([self.law])
            .any(|law| law.multiplier() > 0.0 && !law.are_open())
    }

    /// Whether a pattern picks a name.
    pub fn pick(&self, name: &str) -> bool {
        let standing = match &self.standing {
            Standing::Picked(selectors) => selectors.as_slice(),
            _ => &[],
        };
        let own = self.own.iter().map(|own| &own.0);
        own.chain(standing).any(|selector| selector.matches(name))
    }

    /// Whether `law`, which is for faults, resists in a mesh of labels in which nothing is a fault.
    pub fn is_idle(&self, surfaces: &SurfaceNames) -> bool {
        let of_labels = surfaces.kinds.contains(&Kind::Interface);
        let none = of_labels && !surfaces.kinds.contains(&Kind::Fault);
        self.standing == Standing::Faults && none && !self.law.are_open() && self.own.is_empty()
    }

    /// The law of each surface; `option` is the one that says which surfaces resist.
    ///
    /// # Errors
    /// [`Error::Flow`](crate::Error::Flow) with the names of the surfaces if what is to resist does not
    /// exist.
    pub fn of_surfaces(&self, surfaces: &SurfaceNames, option: &str) -> Result<Vec<Faults>> {
        for (selector, _) in &self.own {
            surfaces.check("--fault-multiplier", selector)?;
        }
        match &self.standing {
            Standing::Picked(selectors) => {
                let mut all = selectors.iter();
                all.try_for_each(|selector| surfaces.check(option, selector))?;
            }
            Standing::Horizons if !surfaces.kinds.contains(&Kind::Horizon) => {
                let place = format!("{option} horizons");
                return Err(surfaces.none_picked(place, NO_MATCH, USE_NAMES));
            }
            _ => {}
        }
        if self.must_apply && self.is_idle(surfaces) {
            return Err(surfaces.none_picked(
                "--faults",
                "is for faults, but no surface is one",
                "say by --barriers which surfaces resist, or omit it",
            ));
        }
        let law = |at: usize| {
            let own = self.own.iter().rev();
            let mut own = own.filter(|own| own.0.picks(surfaces, at));
            match own.next() {
                Some(&(_, law)) => law,
                None if self.standing.holds(surfaces, at) => self.law,
                None => Faults::OPEN,
            }
        };
        Ok((0..surfaces.kinds.len()).map(law).collect())
    }
}

/// The barriers on the faces of a mesh where its file has it, its surfaces [`numbered`]; and whether
/// surfaces are there but none that `laws` are for.
///
/// # Errors
/// [`Error::Flow`](crate::Error::Flow) with the names of the surfaces if what is to resist does not exist.
pub fn barriers<const D: usize, M: Stored<D>>(
    stored: &mut StoredMesh<D, M>,
    marks: &[bool],
    laws: &FaultLaws,
) -> Result<(Barriers, bool)> {
    let mut surfaces = numbered(stored, marks);
    if let Some(region) = stored.regions() {
        surfaces.add_interfaces(interfaces_of(stored, &region), |name| laws.pick(name));
    }
    let names = surfaces.all_names();
    let idle = laws.is_idle(&names);
    let laws = laws.of_surfaces(&names, "--barriers")?;
    let label = stored.in_world(|mesh| select::labels_of_faces(mesh, &surfaces.facets));
    Ok((Barriers::new(label, laws)?.named(names.names), idle))
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
    conditions: &Conditions<D>,
    lines: Option<usize>,
    patience: &Patience<'_>,
) -> Result<FlowOutcome<D, M>> {
    let on_sides = on_sides(&stored, &conditions.sides);
    let (mesh, arrays) = stored.into_file().split();
    let flow = ElementFlow::new(&mesh, barriers, rock)?;
    drop(mesh);
    let located = flow.locate(&conditions.wells)?;
    let (fixed, sides) = fixed(&flow, &on_sides);
    let found = flow.solve_while(&flow.rates(&located), &fixed, patience)?;

    let p = &found.pressure;
    let mut side_rates = [0.0; 6];
    for (&(node, _), &side) in fixed.iter().zip(&sides) {
        side_rates[usize::from(side)] += found.inflow[node as usize];
    }
    let nodes = flow.split.original.iter().zip(0u32..);
    let doubled = nodes.filter(|(from, node)| *from != node).count();
    let torn = flow.split.faces.iter().zip(flow.fault_rates(p));
    let crossings = torn.map(|(face, rate)| {
        let [here, there] = face.nodes;
        let jumps = here.iter().zip(there);
        let jump = jumps.fold(0.0, |jump: f64, (&a, b)| {
            jump.max((p[a as usize] - p[b as usize]).abs())
        });
        (face.label, rate, jump)
    });
    let mut report = report(&found, p, conditions, &side_rates, barriers, crossings);
    report.faults.nodes_doubled = doubled;

    let mut streamlines = None;
    if let Some(count) = lines {
        let rates = flow.face_rates(p, &located, &fixed, patience)?;
        let positions: Vec<[f64; D]> = conditions.wells.iter().map(|well| well.position).collect();
        let mesh = &flow.split.mesh;
        streamlines = Some(Streamlines::trace(
            mesh, &rates, &located, &positions, count, patience,
        ));
    }
    lasts(patience)?;
    let file = torn_file(flow, found, arrays, &report);
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
    conditions: &Conditions<D>,
    lines: Option<usize>,
    patience: &Patience<'_>,
) -> Result<(FlowOutcome<D, PolyMesh<D>>, Vec<String>)>
where
    Space<D>: Meshing<D>,
{
    let space = stored.space.clone();
    let mut file = stored.into_file();
    let graph = Graph::from_poly(&file.mesh);
    let flow = CellFlow::with_barriers(&graph, rock, barriers)?;
    let cells = graph.volume.len();
    let sides = &conditions.sides;
    let found = flow.solve_while(&flow.well_rates(&conditions.wells)?, sides, patience)?;
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
    let report = report(&found, p, conditions, &side_rates, barriers, crossings);
    let velocity = flow.velocity(&rates);
    let mut streamlines = None;
    if let Some(count) = lines {
        let mesh = &file.mesh;
        let inside: Inside<D, <Space<D> as Meshing<D>>::Mesh> =
            Inside::new(mesh, &graph, &rates, &velocity);
        let wells = conditions.wells.iter();
        let positions: Vec<[f64; D]> = wells.clone().map(|well| well.position).collect();
        let locator = Locator::new(&graph);
        let wells: Vec<(u32, f64)> = wells
            .filter_map(|well| Some((locator.cell_at(well.position)? as u32, well.rate)))
            .collect();
        streamlines = Some(Streamlines::through(
            &inside, &wells, &positions, count, patience,
        ));
    }
    lasts(patience)?;
    let velocity = components(&velocity);
    let pressure = DataArray::scalars("pressure", p.to_vec());
    file.cell_data
        .extend([pressure, vectors("velocity", velocity)]);
    file.field_data.push(said(&report));
    let outcome = FlowOutcome {
        file,
        report,
        streamlines,
    };
    let mut notes = Vec::new();
    if flow.angle_error > ROUGH {
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
type OnSide = (u8, f64, Vec<bool>);

/// Which nodes lie on the sides whose pressures are given.
fn on_sides<const D: usize, M: Simplices<D>>(
    stored: &StoredMesh<D, M>,
    given: &[(u8, f64)],
) -> Vec<OnSide> {
    let nodes = stored.lattice.nodes();
    let found = given.iter().map(|&(side, pressure)| {
        let axis = usize::from(side / 2);
        let extent = stored.space.extent[axis];
        let plane = if side % 2 == 0 { 0.0 } else { extent };
        let is_on = |x: &[f64; D]| (x[axis] - plane).abs() <= ON_SIDE * extent;
        (side, pressure, nodes.iter().map(is_on).collect())
    });
    found.collect()
}

/// Nodes with given pressure, and for each of them the side that gives it.
fn fixed<const D: usize, M: Simplices<D>>(
    flow: &ElementFlow<D, M>,
    given: &[OnSide],
) -> (Vec<(u32, f64)>, Vec<u8>) {
    let mut taken = vec![false; flow.split.original.len()];
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
fn report<const D: usize>(
    found: &Solution,
    pressure: &[f64],
    conditions: &Conditions<D>,
    side_rates: &[f64; 6],
    barriers: &Barriers,
    crossings: impl Iterator<Item = (u32, f64, f64)>,
) -> FlowReport {
    let mut faults = Faulted::default();
    let mut by_fault: Vec<Faulted> = Vec::new();
    for (label, rate, jump) in crossings {
        let label = label as usize;
        by_fault.resize(by_fault.len().max(label), Faulted::default());
        by_fault[label - 1].add(rate, jump);
        faults.add(rate, jump);
    }
    let wells = conditions.wells.iter().map(|well| Exchange {
        name: well.name.trim_start_matches('-').to_string(),
        rate: well.rate,
    });
    let sides = conditions.sides.iter().map(|&(side, pressure)| Exchange {
        name: format!("{} at {pressure} Pa", SIDES[usize::from(side)]),
        rate: side_rates[usize::from(side)],
    });
    let numbered = (1..).zip(by_fault).filter(|(_, fault)| fault.faces > 0);
    FlowReport {
        figures: found.figures,
        pressure: Range::of(pressure),
        faults,
        by_fault: numbered
            .map(|(surface, faulted)| Fault {
                surface,
                name: barriers.name(surface),
                multiplier: barriers.law(surface).multiplier(),
                faulted,
            })
            .collect(),
        exchange: wells.chain(sides).collect(),
    }
}

/// The torn mesh with pressure, velocity, and what crosses faults.
fn torn_file<const D: usize, M: Simplices<D>>(
    flow: ElementFlow<D, M>,
    found: Solution,
    arrays: MeshFile<()>,
    report: &FlowReport,
) -> MeshFile<M> {
    let velocity = components(&flow.velocity(&found.pressure));
    let mut across = vec![0.0; flow.split.mesh.connectivity().len()];
    let rates = flow.fault_rates(&found.pressure);
    for (face, rate) in flow.split.faces.iter().zip(rates) {
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            let first = face.cells[side] as usize * (D + 1);
            across[first + usize::from(face.face[side])] = sign * rate;
        }
    }
    let split = flow.split;
    let torn = |array: DataArray| DataArray {
        values: array.values.tuples(&split.original, array.components),
        ..array
    };
    let mut point_data: Vec<DataArray> = arrays.point_data.into_iter().map(torn).collect();
    point_data.push(DataArray::scalars("node", split.original.clone()));
    point_data.push(DataArray::scalars("pressure", found.pressure));
    let mut cell_data = arrays.cell_data;
    cell_data.push(vectors("velocity", velocity));
    cell_data.push(DataArray {
        name: "fault_rate".into(),
        components: D + 1,
        values: across.into(),
    });
    let mut field_data = arrays.field_data;
    field_data.push(said(report));
    MeshFile {
        mesh: split.mesh,
        point_data,
        cell_data,
        field_data,
    }
}

/// Vectors as VTK wants them, with three components.
fn components<const D: usize>(vectors: &[[f64; D]]) -> Vec<f64> {
    vectors.iter().flat_map(|&v| in_space(v)).collect()
}

fn vectors(name: &str, values: Vec<f64>) -> DataArray {
    DataArray {
        name: name.into(),
        components: 3,
        values: values.into(),
    }
}

fn said(report: &FlowReport) -> (String, FieldValue) {
    let json = serde_json::to_string(report).unwrap_or_default();
    ("flow".into(), FieldValue::Text(json))
}
