//! Tests of the check of seals on small networks, and on random models whose leaks are known.

use super::*;
use crate::geometry::random::Random;
use crate::geometry::{dot, norm, sub};
use crate::mesh::boxes::jittered_box;
use crate::mesh::poly::PolyMesh;
use crate::mesh::poly::samples::two_cells;
use crate::mesh::{TetMesh, voronoi};
use crate::model::flow::FaultLaw;
use crate::model::surface::SurfaceKind;

fn check(model: &Model) -> SealCheck {
    SealCheck::new(model, &ModelFrame::default(), &CancelToken::never()).unwrap()
}

#[test]
fn a_closed_fault_that_divides_the_mesh_passes_nothing() {
    let mut mesh = two_cells::<3>(0.75);
    mesh.assign_sides([0.0; 3], [2.0, 1.0, 1.0]);
    let mut model = Model::new(mesh, None);
    assert!(check(&model).faults.is_empty());
    model.set_faults(&FaultLaw::CLOSED.into()).unwrap();
    let seals = check(&model);
    let [fault] = &seals.faults[..] else {
        panic!("{seals:?}")
    };
    assert_eq!((fault.verdict, fault.area), (SealVerdict::Sealed, 1.0));
    assert_eq!(fault.covered_share, 1.0);
    assert_eq!((fault.through, fault.around), (0.0, 0.0));
    assert_eq!(seals.compartments.len(), 2);
    assert!(seals.table().contains("sealed; nothing flows around it"));
    assert_eq!(seals.csv().lines().count(), 2);
    // A partial multiplier is no closed fault.
    let partial = FaultLaw::new(0.5, None).unwrap();
    model.set_faults(&partial.into()).unwrap();
    let seals = check(&model);
    assert!(seals.faults.is_empty() && seals.compartments.len() == 1);
}

#[test]
fn shares_are_those_of_the_network() {
    // A ring of 2 x 1 x 2 cells, in which the fault closes one of the two ways.
    let atoms = [
        [0.5, 0.5, 0.5],
        [1.5, 0.5, 0.5],
        [0.5, 0.5, 1.5],
        [1.5, 0.5, 1.5],
    ];
    let mesh = voronoi::voronoi(&atoms, [2.0, 1.0, 2.0]).unwrap();
    let mut model = Model::new(mesh, None);
    let on_fault: Vec<u32> = (model.graph.connections.iter())
        .map(|c| u32::from(c.normal[0].abs() > 0.9 && c.point[2] < 1.0))
        .collect();
    assert_eq!(on_fault.iter().sum::<u32>(), 1);
    model.surfaces.kinds = vec![SurfaceKind::Fault];
    model.surfaces.kept_count = 1;
    model.surfaces.connection_surfaces = on_fault;
    model.set_faults(&FaultLaw::CLOSED.into()).unwrap();
    let seals = check(&model);
    let fault = &seals.faults[0];
    // Half of the fluid of each side enters each of its two cells. Open, the two cells are alike and
    // two connections of conductance 1 lead across: 2. Closed, half of the fluid comes from the other
    // cell: the mean difference of pressures is 1 + 2 / 4, so that the conductance is 2 / 3.
    let passing = fault.through + fault.around;
    assert!((passing - 1.0 / 3.0).abs() < 1e-9, "{fault:?}");
    assert_eq!(fault.covered_share, 0.5);
}

/// Extent of the random models, in cells.
const EXTENT: [f64; 3] = [22.0, 14.0, 10.0];

#[derive(Debug, Clone, Copy, PartialEq)]
enum Cells {
    Tetrahedra,
    Voronoi,
    CornerPoints,
}

/// Where faces of the fault are missing. Widths are in cells.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Defect {
    None,
    FreeTip,
    Hole(f64),
    GapToSide(usize, f64),
    GapToFault(f64),
}

/// A model with a closed fault, and the faces that are missing from it.
struct RandomModel {
    model: Model,
    /// The connections through which the fault leaks.
    missing: Vec<usize>,
    centre: [f64; 3],
}

fn cells(kind: Cells, normal: [f64; 3], random: &mut Random) -> (PolyMesh<3>, Option<TetMesh>) {
    let n = EXTENT.map(|length| length as usize);
    if kind == Cells::Tetrahedra {
        let tets: TetMesh = jittered_box(n, EXTENT, 0.2, |_| true);
        let mut mesh = PolyMesh::from_simplices(&tets, &[], &[]).unwrap();
        mesh.assign_sides([0.0; 3], EXTENT);
        return (mesh, Some(tets));
    }
    let mut atoms = Vec::new();
    for i in 0..n.iter().product::<usize>() {
        let index = [i % n[0], i / n[0] % n[1], i / (n[0] * n[1])];
        let mut x = index.map(|c| c as f64 + 0.5);
        if kind == Cells::Voronoi {
            x = x.map(|c| c + 0.25 * (random.draw() - 0.5));
            // Some sites lean with the fault.
            x[0] -= (0.3 * normal[2] / normal[0] * (x[2] - 5.0)).clamp(-0.4, 0.4);
            x[0] = x[0].clamp(0.05, EXTENT[0] - 0.05);
        }
        atoms.push(x);
    }
    (voronoi::voronoi(&atoms, EXTENT).unwrap(), None)
}

/// Returns a model whose fault dips by `dip` degrees.
#[expect(
    clippy::too_many_lines,
    reason = "one model, from its planes to its sealed connections"
)]
fn random_model(kind: Cells, dip: f64, defect: Defect, random: &mut Random) -> RandomModel {
    let azimuth = 0.5 * (random.draw() - 0.5);
    let (sin, cos) = dip.to_radians().sin_cos();
    let normal = [sin * azimuth.cos(), sin * azimuth.sin(), cos];
    let (mesh, tets) = cells(kind, normal, random);
    let mut model = Model::new(mesh, tets);
    let middle = EXTENT.map(|length| 0.5 * length + 0.13);
    let offset = |x: [f64; 3]| dot(sub(x, middle), normal);
    let site = &model.graph.site;
    let crossing: Vec<usize> = (0..model.graph.connections.len())
        .filter(|index| {
            let cells = model.graph.connections[*index].cells;
            let [a, b] = cells.map(|cell| offset(site[cell as usize]));
            a * b < 0.0
        })
        .collect();
    let point = |index: usize| model.graph.connections[index].point;
    // The other fault, to which the first one goes.
    let wall = 10.0;
    let has_wall = matches!(defect, Defect::GapToFault(_));
    let is_on_wall = |index: usize| {
        let cells = model.graph.connections[index].cells;
        let [a, b] = cells.map(|cell| site[cell as usize][1] - wall);
        a * b < 0.0
    };
    let hole_centre = {
        let y = 4.0 + 6.0 * random.draw();
        let z = 3.5 + 3.0 * random.draw();
        let x = middle[0] - ((y - middle[1]) * normal[1] + (z - middle[2]) * normal[2]) / normal[0];
        [x, y, z]
    };
    let nearest = (crossing.iter().copied())
        .min_by(|a, b| {
            let distance = |index: usize| norm(sub(point(index), hole_centre));
            distance(*a).total_cmp(&distance(*b))
        })
        .unwrap();
    let is_missing = |index: usize| {
        let x = point(index);
        match defect {
            Defect::None => false,
            Defect::FreeTip => x[1] > 6.5,
            Defect::Hole(width) => index == nearest || norm(sub(x, point(nearest))) < 0.5 * width,
            Defect::GapToSide(side, width) => {
                let axis = side / 2;
                let from_side = if side % 2 == 1 {
                    EXTENT[axis] - x[axis]
                } else {
                    x[axis]
                };
                // Along the fault, the way to the bottom is longer than the height.
                let slope = if axis == 2 { sin } else { 1.0 };
                from_side < width * slope
            }
            Defect::GapToFault(width) => x[1] > wall - width,
        }
    };
    let is_beyond = |index: usize| has_wall && point(index)[1] > wall;
    let mut labels = vec![0; model.graph.connections.len()];
    let mut missing = Vec::new();
    for &index in &crossing {
        if is_missing(index) {
            missing.push(index);
        } else if !is_beyond(index) {
            labels[index] = 1;
        }
    }
    missing.retain(|index| !(is_beyond(*index) || has_wall && is_on_wall(*index)));
    for index in (0..labels.len()).filter(|index| has_wall && is_on_wall(*index)) {
        labels[index] = 2;
    }
    let count = 1 + usize::from(has_wall);
    let weights = missing.iter().map(|index| {
        let c = &model.graph.connections[*index];
        (c.area * dot(c.normal, normal).abs(), c.point)
    });
    let centre = SealNetwork::mean_position(weights);
    model.surfaces.kinds = vec![SurfaceKind::Fault; count];
    model.surfaces.kept_count = count;
    model.surfaces.connection_surfaces = labels;
    model.set_faults(&FaultLaw::CLOSED.into()).unwrap();
    RandomModel {
        model,
        missing,
        centre,
    }
}

/// Returns what is wrong with the check of a model, if anything is.
fn fault_of_check(kind: Cells, dip: f64, defect: Defect, random: &mut Random) -> Option<String> {
    let RandomModel {
        mut model,
        missing,
        centre,
    } = random_model(kind, dip, defect, random);
    let seals = check(&model);
    let is_leaky = !matches!(defect, Defect::None | Defect::FreeTip);
    let fault = &seals.faults[0];
    let problem = |text: &str| Some(format!("{kind:?} {dip:.0} {defect:?}: {text}: {fault:?}"));
    if (fault.verdict == SealVerdict::Leaks) != is_leaky {
        return problem("verdict");
    }
    if seals.faults[1..]
        .iter()
        .any(|f| f.verdict != SealVerdict::Sealed)
    {
        return problem("verdict of the other fault");
    }
    let goes_round = matches!(defect, Defect::FreeTip | Defect::GapToFault(_));
    if goes_round != (fault.around > 0.02) {
        return problem("flow around it");
    }
    if !is_leaky {
        return None;
    }
    let cause = &fault.leaks[0].cause;
    let expected = match defect {
        Defect::Hole(_) => "hole in its faces".to_string(),
        Defect::GapToSide(side, _) => {
            format!("gap to side {}", crate::mesh::poly::SIDE_NAMES[side])
        }
        _ => "gap to fault2".into(),
    };
    if fault.leaks.len() != 1 || *cause != expected {
        return problem("leaks");
    }
    let at = fault.leaks[0].at;
    let distance = norm(sub(at, centre));
    let nearest = missing
        .iter()
        .map(|index| norm(sub(model.graph.connections[*index].point, at)));
    let nearest = nearest.fold(f64::INFINITY, f64::min);
    if distance > 1.0 || nearest > 1.0 {
        return problem(&format!(
            "place, {distance:.2} from {centre:?}, {nearest:.2}"
        ));
    }
    let remedy = fault.leaks[0]
        .remedy
        .strip_prefix("--extend-faults ")
        .unwrap();
    model.extend_faults(remedy.parse().unwrap());
    model.set_faults(&FaultLaw::CLOSED.into()).unwrap();
    let extended = check(&model);
    if extended
        .faults
        .iter()
        .any(|f| f.verdict != SealVerdict::Sealed)
    {
        return problem(&format!("remedy, {:?}", extended.faults));
    }
    None
}

/// Returns what is wrong with the checks of 48 random models.
fn problems(seed: u64) -> Vec<String> {
    let mut random = Random::new(seed);
    let mut problems = Vec::new();
    for number in 0..48 {
        let kind = [Cells::Tetrahedra, Cells::Voronoi, Cells::CornerPoints][number % 3];
        let width = 1.0 + (number / 6 % 3) as f64;
        let dip = 40.0 + 50.0 * random.draw();
        let defect = if number % 2 == 0 {
            [Defect::None, Defect::FreeTip][number / 6 % 2]
        } else {
            match number / 6 % 4 {
                0 => Defect::Hole(width),
                1 => Defect::GapToSide([3, 2][number / 24], width),
                2 => Defect::GapToFault(width),
                _ => Defect::GapToSide([4, 5][number / 24], width),
            }
        };
        let problem = fault_of_check(kind, dip, defect, &mut random);
        problems.extend(problem.map(|problem| format!("seed {seed}, model {number}: {problem}")));
    }
    problems
}

#[test]
fn the_verdict_and_the_place_of_leaks_are_right_in_48_random_models() {
    let problems = problems(5);
    assert!(
        problems.is_empty(),
        "{} wrong\n{}",
        problems.len(),
        problems.join("\n")
    );
}

#[test]
#[ignore = "slow: make test-all"]
fn leaks_are_found_in_models_of_other_seeds() {
    let problems: Vec<String> = (101..109).flat_map(problems).collect();
    assert!(
        problems.is_empty(),
        "{} of 384 wrong\n{}",
        problems.len(),
        problems.join("\n")
    );
}
