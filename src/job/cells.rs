//! Atoms at rest become Voronoi cells (a PEBI grid): they are alongside features, so that the faces
//! between them follow the features.

use rayon::prelude::*;

use super::measure::measured;
use super::frame::Frame;
use super::{BOX_TOLERANCE, Made, Meshing, Params, Scene, Space, Stages, place, simplices};
use crate::Result;
use crate::feature::Features;
use crate::geometry::buckets::Buckets;
use crate::geometry::{add_scaled, distance2, dot, norm, normal, sub};
use crate::image::{Geometry, Image};
use crate::improve::{SliverMethod, Target};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::energy::{Beta, Pairwise};
use crate::lattice::optimize::{self, Stop};
use crate::lattice::seeding::{self, Alignment, Atoms, Seeding};
use crate::mesh::voronoi::conform::{Conforming, Surface, conform};
use crate::mesh::check::{Known, check_while};
use crate::mesh::graph::Graph;
use crate::mesh::poly::PolyMesh;
use crate::observer::{Patience, Stage};
use crate::report::{self, Reference, Report};

/// Evaluations in which atoms come to rest.
const EVALUATIONS: usize = 15;

/// The distance between the nodes of surfaces, in units of that between cells.
const COARSER: f64 = 1.5;

/// Voronoi cells, their figures, the distance between atoms and what the optimiser did.
type Cells<const D: usize> = (Made<D>, Report, Distance<D>, Option<optimize::Rest>);

fn env(name: &str, or: f64) -> f64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(or)
}

/// Cuts Voronoi cells that conform to features, and measures them.
pub(super) fn made<const D: usize>(
    image: &Image<D>,
    params: &Params<D>,
    features: &Features<D>,
    frame: &Frame<D>,
    stages: &mut Stages<'_>,
) -> Result<Cells<D>>
where
    Space<D>: Meshing<D>,
{
    let extent = frame.extent;
    let weld = params.weld;
    stages.begin_unless_stopped(Stage::Placing)?;
    let distance = place::apart(image, params, features, frame, stages)?;
    let mut surface = surface(params, &distance, features, frame, stages)?;
    let conforming = conform(&mut surface, extent);

    let mut fixed = place::fixed(&distance, Alignment::Alongside, frame)?;
    let given = fixed.len();
    fixed.extend(&conforming.sites);
    let how = if env("GROWN", 0.0) > 0.0 { Seeding::Grown } else { params.seeding };
    let mut atoms = stages.unless_stopped(Stage::Placing, |patience| {
        seeding::seed(
            how, extent, &distance, &fixed, Alignment::Alongside, Some(&features.potential), patience,
        )
    })?;
    let _ = given;
    keep_out(&mut atoms, &conforming);
    stages.begin(Stage::Pairing);
    let options = optimize::Effort {
        seed: params.seed,
        max_rounds: 1,
        max_evaluations: env("EVALS", EVALUATIONS as f64) as usize,
        ..optimize::Effort::default()
    };
    let energy = Pairwise::new(extent, &distance, None, Beta::Constant(0.0))?;
    let mut energy = energy.aligned(Alignment::Alongside);
    let moved = optimize::optimize(
        &mut atoms,
        &mut energy,
        &distance,
        extent,
        &options,
        stages.observer,
    )?;
    if moved.stop == Stop::Interrupted {
        stages.stopped();
    }
    let before = atoms.len();
    keep_out(&mut atoms, &conforming);
    eprintln!("atoms {} sites {} lost at the end {}", atoms.len(), conforming.sites.len(), before - atoms.len());
    stages.begin(Stage::Cutting);
    let start = std::time::Instant::now();
    let mut mesh = Space::<D>::cells(&atoms.positions, extent, 0.0)?;
    eprintln!("cut {:?}", start.elapsed());
    let rounds = env("EVEN", 3.0) as usize;
    for round in 0..rounds {
        even(&mut atoms, &mesh, &conforming, &distance, extent, round + 1 == rounds);
        mesh = Space::<D>::cells(&atoms.positions, extent, if round + 1 == rounds { weld } else { 0.0 })?;
    }
    eprintln!("evened {:?}", start.elapsed());
    let scene = Scene {
        extent,
        features,
        distance: &distance,
    };
    let first = atoms.len() - conforming.sites.len();
    mesh.on_feature = crossed(&mesh, &surface, &conforming, first as u32);
    check_pairs(&mesh, &surface, &conforming, first as u32);

    stages.begin(Stage::Measuring);
    let report = stages.patiently(|patience| measure(&mesh, weld, &scene, image, patience));
    Ok((Made::Voronoi { mesh, weld }, report, distance, Some(moved)))
}

/// Makes cells more alike: atoms come where there is room, go where there is none, move to the middle of
/// their cells and away from where their cells touch in tiny faces.
fn even<const D: usize>(
    atoms: &mut Atoms<D>,
    mesh: &PolyMesh<D>,
    conforming: &Conforming<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    last: bool,
) {
    let shapes = mesh.cell_shapes();
    let free = |i: usize| atoms.kinds[i] != AtomKind::Fixed;
    let largest = conforming.squares.iter().fold(1e-300f64, |m, &w| m.max(w)).sqrt();
    let balls = Buckets::new(&conforming.centres, largest);
    let outside = |x: &[f64; D]| {
        let mut out = true;
        if !conforming.centres.is_empty() {
            balls.visit_within(*x, largest, |j| {
                out &= distance2(x, &conforming.centres[j]) >= conforming.squares[j];
            });
        }
        out
    };
    let inside = |x: &[f64; D], d: f64| (0..D).all(|k| x[k] > 0.25 * d && x[k] < extent[k] - 0.25 * d);
    let inner = mesh.inner_faces();
    let mut moved = atoms.positions.clone();
    if !last {
        let by = env("LLOYD", 0.8);
        for i in (0..atoms.len()).filter(|&i| free(i)) {
            let x = add_scaled(atoms.positions[i], by, sub(shapes[i].1, atoms.positions[i]));
            if outside(&x) { moved[i] = x; }
        }
    } else {
        let areas: Vec<f64> = (0..inner).map(|f| mesh.face_shape(f).area()).collect();
        let mean = areas.iter().sum::<f64>() / inner.max(1) as f64;
        let by = env("OPEN", 0.02);
        let mut shift = vec![[0.0; D]; atoms.len()];
        for f in 0..inner {
            if areas[f] > 1.5e-3 * mean { continue; }
            let [a, b] = mesh.face_cells[f].map(|c| c as usize);
            let sign = if mesh.faces.get(f).len() > 3 { 1.0 } else { -env("TRI", 1.0) };
            let line = sub(atoms.positions[b], atoms.positions[a]);
            shift[a] = add_scaled(shift[a], by * sign, line);
            shift[b] = add_scaled(shift[b], -by * sign, line);
        }
        for i in (0..atoms.len()).filter(|&i| free(i)) {
            let x = add_scaled(atoms.positions[i], 1.0, shift[i]);
            if outside(&x) { moved[i] = x; }
        }
    }
    let mut gone = vec![false; atoms.len()];
    let mut fresh: Vec<[f64; D]> = Vec::new();
    if !last {
        let most = env("RATIO", 4.0);
        for f in 0..inner {
            let [a, b] = mesh.face_cells[f].map(|c| c as usize);
            let (small, large) = if shapes[a].0 < shapes[b].0 { (a, b) } else { (b, a) };
            if shapes[large].0 > most * shapes[small].0 && free(small) {
                gone[small] = true;
            }
            let d = distance.at(atoms.positions[a]);
            let near = distance2(&atoms.positions[a], &atoms.positions[b]) < (0.5 * d).powi(2);
            if near && !gone[a] && !gone[b] {
                if free(a) { gone[a] = true; } else if free(b) { gone[b] = true; }
            }
        }
        let mut site_of = vec![u32::MAX; mesh.nodes.len()];
        for (f, cells) in mesh.face_cells.iter().enumerate() {
            for &n in mesh.faces.get(f) { site_of[n as usize] = site_of[n as usize].min(cells[0]); }
        }
        let room = env("ROOM", 0.85);
        let mut far: Vec<(f64, usize)> = (0..mesh.nodes.len()).filter_map(|n| {
            let x = mesh.nodes[n];
            let d = distance.at(x);
            let r = distance2(&x, &mesh.sites[site_of[n] as usize]).sqrt() / d;
            (r > room && inside(&x, d) && outside(&x)).then_some((r, n))
        }).collect();
        far.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut placed = crate::geometry::scatter::Scatter::new([0.0; D], extent, 1.6 * distance.min());
        for (_, n) in far {
            let x = mesh.nodes[n];
            if placed.is_free(&x, 0.8 * distance.at(x)) { placed.add(x); fresh.push(x); }
        }
    }
    eprintln!("even: gone {}, fresh {}", gone.iter().filter(|g| **g).count(), fresh.len());
    let mut kept = Atoms { positions: Vec::new(), kinds: Vec::new() };
    for i in 0..atoms.len() {
        if !free(i) && kept.positions.len() < usize::MAX && !fresh.is_empty() {
            // Fixed atoms stay last.
            kept.positions.append(&mut fresh);
            kept.kinds.resize(kept.positions.len(), AtomKind::Interior);
        }
        if !gone[i] { kept.positions.push(moved[i]); kept.kinds.push(atoms.kinds[i]); }
    }
    kept.positions.append(&mut fresh);
    kept.kinds.resize(kept.positions.len(), AtomKind::Interior);
    *atoms = kept;
}

fn check_pairs<const D: usize>(mesh: &PolyMesh<D>, surface: &Surface<D>, c: &Conforming<D>, first: u32) {
    use crate::mesh::poly::Beyond;
    let mut of = std::collections::HashMap::new();
    for f in 0..mesh.inner_faces() { if let Beyond::Cell(_) = mesh.beyond(f) { of.insert(mesh.face_cells[f], f); } }
    let (mut exact, mut off, mut missing) = (0, 0, 0);
    for (facet, pair) in &c.pairs {
        let pair = pair.map(|p| p + first);
        let key = [pair[0].min(pair[1]), pair[0].max(pair[1])];
        match of.get(&key) {
            None => missing += 1,
            Some(&f) => {
                let area = mesh.face_shape(f).area();
                let n = crate::geometry::normal(&surface.corners(*facet as usize));
                if (area - norm(n)).abs() < 1e-6 * area { exact += 1 } else { off += 1 }
            }
        }
    }
    eprintln!("pairs: exact {exact}, not {off}, without face {missing}");
    let shapes = mesh.cell_shapes();
    let mut ratios: Vec<(f64, usize)> = (0..mesh.inner_faces()).map(|f| {
        let [a, b] = mesh.face_cells[f].map(|c| shapes[c as usize].0);
        (a.max(b) / a.min(b), f)
    }).collect();
    ratios.sort_by(|a, b| b.0.total_cmp(&a.0));
    let q = |p: f64| ratios[(p * ratios.len() as f64) as usize].0;
    let areas: Vec<f64> = (0..mesh.inner_faces()).map(|f| mesh.face_shape(f).area()).collect();
    let mean = areas.iter().sum::<f64>() / areas.len() as f64;
    let mut classes = [[0usize; 3]; 3];
    for f in 0..mesh.inner_faces() {
        let k = mesh.face_cells[f].iter().filter(|&&c| c >= first).count();
        classes[k][0] += 1;
        if areas[f] < 1e-3 * mean { classes[k][1] += 1; }
        if mesh.faces.get(f).len() == 3 && areas[f] < 1e-3 * mean { classes[k][2] += 1; }
    }
    eprintln!("faces (all, tiny, tiny triangles): atom-atom {:?} atom-site {:?} site-site {:?}", classes[0], classes[1], classes[2]);
    {
        let mut facets_of: std::collections::HashMap<u32, Vec<(u32, usize)>> = Default::default();
        for (facet, pair) in &c.pairs { for s in 0..2 { facets_of.entry(pair[s] + first).or_default().push((*facet, s)); } }
        let mut kinds = std::collections::BTreeMap::new();
        for f in 0..mesh.inner_faces() {
            if areas[f] >= 1e-3 * mean || mesh.face_cells[f].iter().any(|&c| c < first) { continue; }
            let [x, y] = mesh.face_cells[f];
            let (Some(x), Some(y)) = (facets_of.get(&x), facets_of.get(&y)) else { *kinds.entry("rim site".to_string()).or_insert(0) += 1; continue; };
            let (t, u) = (surface.facets[x[0].0 as usize], surface.facets[y[0].0 as usize]);
            let shared = t.iter().filter(|n| u.contains(n)).count();
            let nodes = mesh.faces.get(f);
            let on_node = nodes.iter().filter(|&&n| t.iter().any(|&p| distance2(&mesh.nodes[n as usize], &surface.nodes[p as usize]) < 1e-12)).count();
            let key = format!("share {shared}, feature {}, corners at nodes {on_node}, area {}", mesh.on_feature[f], if areas[f] < 1e-9 * mean {"<1e-9"} else if areas[f] < 1e-6 * mean {"<1e-6"} else {"-"});
            *kinds.entry(key).or_insert(0) += 1;
        }
        for k in kinds { eprintln!("   tiny {k:?}"); }
    }
    let conn = |f: usize| { let [a, b] = mesh.face_cells[f].map(|c| mesh.sites[c as usize]); norm(sub(a, b)) };
    let mut lens: Vec<f64> = (0..mesh.inner_faces()).map(conn).collect();
    lens.sort_by(f64::total_cmp);
    eprintln!("volume ratios: worst {:.2} .1% {:.2} 1% {:.2} 10% {:.2}; connections shortest {:.3} .1% {:.3} 1% {:.3} median {:.3}", q(0.0), q(0.001), q(0.01), q(0.1), lens[0], lens[lens.len() / 1000], lens[lens.len() / 100], lens[lens.len() / 2]);
    let mut kinds = std::collections::BTreeMap::new();
    for &(r, f) in ratios.iter().take_while(|r| r.0 > 6.0) {
        let [mut a, mut b] = mesh.face_cells[f];
        if shapes[a as usize].0 > shapes[b as usize].0 { std::mem::swap(&mut a, &mut b); }
        let faces = mesh.faces_of_cells();
        let nearest = faces.get(a as usize).iter().filter(|&&f| (f as usize) < mesh.inner_faces()).map(|&f| conn(f as usize)).fold(f64::INFINITY, f64::min);
        let own = shapes[a as usize].0.cbrt();
        let key = format!("small {} large {} small has near {}", if a >= first {"site"} else {"atom"}, if b >= first {"site"} else {"atom"}, if nearest < 0.5 * own {"<.5"} else if nearest < 0.8 * own { "<.8"} else {">"});
        let _ = r;
        *kinds.entry(key).or_insert(0) += 1;
    }
    for k in kinds { eprintln!("   >6: {k:?}"); }
    for &(r, f) in ratios.iter().take(3) {
        let [a, b] = mesh.face_cells[f];
        eprintln!("  ratio {r:.1} sites {} {} volumes {:.1} {:.1} area {:.3} conn {:.2}", a >= first, b >= first, shapes[a as usize].0, shapes[b as usize].0, mesh.face_shape(f).area(), conn(f));
    }
}

/// The surfaces that features have in an aligned mesh somewhat coarser than the cells.
fn surface<const D: usize>(
    params: &Params<D>,
    distance: &Distance<D>,
    features: &Features<D>,
    frame: &Frame<D>,
    stages: &mut Stages<'_>,
) -> Result<Surface<D>>
where
    Space<D>: Meshing<D>,
{
    if features.points.is_empty() {
        return Ok(Surface::default());
    }
    let shortest = frame.extent.iter().copied().fold(f64::INFINITY, f64::min);
    let coarser = env("COARSER", COARSER).min(0.5 * shortest / distance.max());
    let distance = match distance {
        Distance::Field(field) if env("NEARER", 1.0) > 0.0 => {
            let (min, max) = (distance.min(), distance.max());
            let near = env("NEARER", 1.0);
            let samples = field.samples.iter().map(|&d| {
                let d = f64::from(d);
                let share = if max > min { (d - min) / (max - min) } else { 1.0 };
                (d * (near + share * (coarser - near))) as f32
            });
            Distance::Field(crate::image::Field { samples: samples.collect(), ..field.clone() })
        }
        _ => distance.times(coarser),
    };
    let placed = place::lattice(params, distance, &[], features, frame, stages)?;
    let scene = Scene {
        extent: frame.extent,
        features,
        distance: &placed.distance,
    };
    let target = Target {
        min_dihedral: 30.0,
        method: SliverMethod::Joe,
    };
    let joined = Space::<D>::join(placed.atoms, &scene, None, Some(&target), stages)?;
    let (joined, neighbors) = simplices::sealed(joined, &scene, stages)?;
    let mut surface =
        Surface::of_marked(&joined.made.mesh, &neighbors, &joined.made.feature_faces);
    if env("FLIP", 1.0) > 0.0 { surface.tidy(frame.extent); }
    Ok(surface)
}

/// Takes out the atoms inside the balls, but for fixed ones.
fn keep_out<const D: usize>(atoms: &mut Atoms<D>, conforming: &Conforming<D>) {
    let largest = conforming.squares.iter().fold(0.0f64, |m, &w| m.max(w)).sqrt();
    if conforming.centres.is_empty() {
        return;
    }
    let grid = Buckets::new(&conforming.centres, largest);
    let out = |i: usize| {
        let x = atoms.positions[i];
        let mut out = atoms.kinds[i] == AtomKind::Fixed;
        if !out {
            out = true;
            grid.visit_within(x, largest, |j| {
                out &= distance2(&x, &conforming.centres[j]) >= conforming.squares[j];
            });
        }
        out
    };
    let keep: Vec<bool> = (0..atoms.len()).into_par_iter().map(out).collect();
    let mut kept = keep.iter();
    atoms.positions.retain(|_| kept.next().is_some_and(|k| *k));
    let mut kept = keep.iter();
    atoms.kinds.retain(|_| kept.next().is_some_and(|k| *k));
}

/// Which faces lie on features: those between the two sites of a facet, and those whose connection
/// passes through the surface.
fn crossed<const D: usize>(
    mesh: &PolyMesh<D>,
    surface: &Surface<D>,
    conforming: &Conforming<D>,
    first: u32,
) -> Vec<bool> {
    let inner = mesh.inner_faces();
    let centroids: Vec<[f64; D]> = (0..surface.facets.len())
        .map(|f| {
            let x = surface.corners(f);
            std::array::from_fn(|k| x.iter().map(|x| x[k]).sum::<f64>() / D as f64)
        })
        .collect();
    let reach = |f: usize| {
        let x = surface.corners(f);
        x.iter().map(|x| distance2(x, &centroids[f])).fold(0.0, f64::max).sqrt()
    };
    let largest = (0..surface.facets.len()).map(reach).fold(0.0, f64::max);
    let mut pairs: Vec<[u32; 2]> = (conforming.pairs.iter())
        .map(|(_, [a, b])| [first + a.min(b), first + a.max(b)])
        .collect();
    pairs.sort_unstable();
    let grid = Buckets::new(&centroids, largest.max(1e-9));
    (0..mesh.face_cells.len())
        .into_par_iter()
        .map(|f| {
            if f >= inner || surface.facets.is_empty() {
                return false;
            }
            if pairs.binary_search(&mesh.face_cells[f]).is_ok() {
                return true;
            }
            let [a, b] = mesh.face_cells[f].map(|c| mesh.sites[c as usize]);
            let middle: [f64; D] = std::array::from_fn(|k| 0.5 * (a[k] + b[k]));
            let half = 0.5 * distance2(&a, &b).sqrt();
            let mut through = false;
            grid.visit_within(middle, half + largest, |t| {
                through = through || pierces(a, b, &surface.corners(t));
            });
            through
        })
        .collect()
}

/// Whether the line from a to b passes through a facet.
fn pierces<const D: usize>(a: [f64; D], b: [f64; D], facet: &[[f64; D]; D]) -> bool {
    let n = normal(facet);
    let [above, below] = [a, b].map(|x| dot(sub(x, facet[0]), n));
    if (above > 0.0) == (below > 0.0) {
        return false;
    }
    let at = add_scaled(a, above / (above - below), sub(b, a));
    (0..D).all(|k| {
        let mut part = *facet;
        part[k] = at;
        dot(normal(&part), n) >= 0.0
    })
}

/// The figures of cells, as far as `patience` lasts: what was not measured to its end is left out.
fn measure<const D: usize>(
    mesh: &PolyMesh<D>,
    weld: f64,
    scene: &Scene<'_, D>,
    image: &Image<D>,
    patience: &Patience<'_>,
) -> Report {
    let (features, distance) = (scene.features, scene.distance);
    let step = features.potential.step;
    let graph = Graph::from_poly(mesh);
    let known = Known {
        weld,
        ..Known::default()
    };
    let voronoi = measured(patience, || {
        let low = [0.0; D];
        let check = check_while(mesh, known, low, scene.extent, BOX_TOLERANCE, patience);
        let physical = Graph::from_poly(&to_world(mesh, step, &image.geometry));
        report::voronoi(check, &graph, &physical)
    });
    let fidelity = measured(patience, || {
        let reference = Reference::from_features(features);
        let any = !features.points.is_empty();
        any.then(|| fidelity(mesh, step, &reference, patience))
    });
    Report {
        voronoi,
        lattice: Some(report::lattice_of_graph(&graph, |x| distance.at(x))),
        fidelity: fidelity.flatten(),
        ..Report::default()
    }
}

/// Fidelity of cells in a lattice space where samples are `step` apart; of no use once `patience` is
/// over.
pub fn fidelity<const D: usize>(
    mesh: &PolyMesh<D>,
    step: [f64; D],
    reference: &Reference<'_, D>,
    patience: &Patience<'_>,
) -> report::Fidelity {
    let in_samples = mesh.mapped(|x| std::array::from_fn(|k| x[k] / step[k]), false);
    report::fidelity_of_cells_while(&in_samples, reference, patience)
}

/// Cells in lattice space as cells where the image lies in the world.
pub fn to_world<const D: usize>(
    mesh: &PolyMesh<D>,
    step: [f64; D],
    geometry: &Geometry<D>,
) -> PolyMesh<D> {
    mesh.mapped(
        |x| geometry.to_physical(std::array::from_fn(|k| x[k] / step[k])),
        geometry.determinant() < 0.0,
    )
}

