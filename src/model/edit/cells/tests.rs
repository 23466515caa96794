use std::collections::{BTreeMap, BTreeSet};

use super::*;
use crate::feature::FeatureKind;
use crate::geometry::distance2;
use crate::job::{self, BOX_TOLERANCE, CellKind, Spacing};
use crate::mesh::Mesh;
use crate::mesh::check::check;
use crate::mesh::graph::Graph;
use crate::model::edit::tests::{coordinate_bits, image, named_edits, refusal, world_position};
use crate::progress::NoProgress;
use crate::report::squared_distance_to_face;
use crate::store::{StoredMesh, cell_output::cell_mesh_file};

fn params<const D: usize>(d: f64) -> Params<D> {
    Params {
        spacing: Spacing::Constant(d),
        feature: FeatureKind::Ridges,
        cells: CellKind::Voronoi,
        ..Params::default()
    }
}

fn make_mesh<const D: usize>(image: &Image<D>, params: &Params<D>) -> MeshFile<PolyMesh<D>>
where
    MeshSpace<D>: Meshing<D>,
{
    let outcome = job::run(image, params, &mut NoProgress).unwrap();
    let job::MeshResult::Voronoi { mesh, weld } = &outcome.mesh else {
        panic!("no Voronoi cells");
    };
    cell_mesh_file(&outcome, mesh, *weld)
}

fn edit_mesh<const D: usize>(
    file: &MeshFile<PolyMesh<D>>,
    image: &Image<D>,
    params: &Params<D>,
    changes: &[AtomChange<D>],
) -> Result<EditedMesh<PolyMesh<D>>>
where
    MeshSpace<D>: Meshing<D>,
{
    let edits = named_edits(changes);
    let observer = &mut NoProgress;
    edit_cells(file.clone(), "mesh", image, params, &edits, false, observer)
}

/// The cell whose site is nearest to a position in samples.
fn nearest_cell<const D: usize>(file: &MeshFile<PolyMesh<D>>, sample: [f64; D]) -> u32 {
    let x = world_position(sample);
    let gap = |&c: &usize| distance2(&file.mesh.sites[c], &x);
    let cells = 0..file.mesh.sites.len();
    cells.min_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap() as u32
}

/// Nodes farther than `radius` (world units) from all positions; and by their sites the cells all of whose
/// nodes are, with their faces and whether these lie on features, and with what is stored for the cell. All
/// as bits.
type FarParts<const D: usize> = (
    BTreeSet<[u64; D]>,
    BTreeMap<[u64; D], (Vec<(Vec<[u64; D]>, bool)>, Vec<u64>)>,
);

fn far_parts<const D: usize>(
    file: &MeshFile<PolyMesh<D>>,
    from: &[[f64; D]],
    radius: f64,
) -> FarParts<D> {
    let mesh = &file.mesh;
    let is_far = |x: &[f64; D]| from.iter().all(|y| distance2(x, y) > radius * radius);
    let lists = mesh.faces_of_cells();
    // `atom_kind` is what an edit adds.
    let stored: Vec<Vec<f64>> = (file.cell_data.iter())
        .filter(|array| array.name != editable_cells::ATOM_KIND)
        .map(|array| array.values.to_f64())
        .collect();
    let mut cells = BTreeMap::new();
    for (c, &site) in mesh.sites.iter().enumerate() {
        let ring = |&f: &u32| {
            let ring = mesh.faces.get(f as usize).iter();
            let mut ring: Vec<[u64; D]> = ring
                .map(|&n| coordinate_bits(mesh.nodes[n as usize]))
                .collect();
            ring.sort_unstable();
            (ring, mesh.on_feature[f as usize])
        };
        let mut faces: Vec<(Vec<[u64; D]>, bool)> = lists.get(c).iter().map(ring).collect();
        faces.sort_unstable();
        let nodes = lists
            .get(c)
            .iter()
            .flat_map(|&f| mesh.faces.get(f as usize));
        if nodes.copied().all(|n| is_far(&mesh.nodes[n as usize])) {
            let mut values: Vec<u64> = stored.iter().map(|a| a[c].to_bits()).collect();
            values.push(mesh.region[c] as u64);
            cells.insert(coordinate_bits(site), (faces, values));
        }
    }
    let nodes = mesh
        .nodes
        .iter()
        .copied()
        .filter(|x| is_far(x))
        .map(coordinate_bits);
    (nodes.collect(), cells)
}

/// Cells closed and disjoint, their volumes that of the box, faces square to their connections.
fn check_cells<const D: usize>(file: &MeshFile<PolyMesh<D>>) {
    let stored = StoredMesh::new(file.clone(), "mesh").unwrap();
    let found = check(
        &stored.lattice,
        [0.0; D],
        stored.space.extent,
        BOX_TOLERANCE,
    );
    assert!(found.passed(), "{:?}", found.problems);
    assert!(found.volume_error < 1e-12, "{}", found.volume_error);
    let graph = Graph::from_poly(&stored.lattice);
    let mean =
        graph.connections.iter().map(|c| c.area).sum::<f64>() / graph.connections.len() as f64;
    for connection in graph.connections.iter().filter(|c| c.area > 1e-6 * mean) {
        let off = connection.angle_error(&graph.site);
        assert!(off < 1e-6, "a face {off} degrees off");
        let [a, b] = connection.distance;
        assert!((a - b).abs() < 1e-9, "not halfway: {a}, {b}");
    }
}

/// Adds, moves (a little and far) and removes atoms, also at a feature.
fn edits_stay_local<const D: usize>(dims: [usize; D], d: f64)
where
    MeshSpace<D>: Meshing<D>,
{
    let (image, params) = (image(dims), params(d));
    let before = make_mesh(&image, &params);
    let sample =
        |x: [f64; 3]| -> [f64; D] { std::array::from_fn(|k| x[if k + 1 == D { 2 } else { k }]) };
    let (added, far_to) = (sample([14.3, 12.2, 11.7]), sample([9.1, 21.4, 18.0]));
    let moved_far = nearest_cell(&before, sample([18.0, 6.0, 6.0]));
    let nudged = nearest_cell(&before, sample([12.0, 12.0, 22.0]));
    let beside_feature = (0..before.mesh.inner_face_count()).filter(|&f| before.mesh.on_feature[f]);
    let beside_feature = beside_feature.map(|f| before.mesh.face_cells[f][0]);
    let x = world_position(sample([22.0, 14.0, 10.0]));
    let gap = |c: &u32| distance2(&before.mesh.sites[*c as usize], &x);
    let removed = beside_feature
        .min_by(|a, b| gap(a).total_cmp(&gap(b)))
        .unwrap();
    let old = |c: u32| before.mesh.sites[c as usize];
    let mut nudge = old(nudged);
    nudge[0] += 0.6 * d;
    nudge[1] -= 0.5 * d;
    let changes = [
        AtomChange::Add(world_position(added)),
        AtomChange::Move(moved_far, world_position(far_to)),
        AtomChange::Move(nudged, nudge),
        AtomChange::Remove(removed),
    ];
    let EditedMesh { file, summary } = edit_mesh(&before, &image, &params, &changes).unwrap();
    check_cells(&file);
    // How features were found is on record.
    assert!(summary.notes.is_empty(), "{:?}", summary.notes);

    // Atoms are where they were put, to the bit.
    let at = |n: usize| file.mesh.sites[summary.atoms[n].unwrap() as usize];
    assert_eq!(
        [at(0), at(1), at(2)],
        [world_position(added), world_position(far_to), nudge]
    );
    assert_eq!(summary.atoms[1..], [Some(moved_far), Some(nudged), None]);
    for gone in [moved_far, nudged, removed] {
        assert!(!file.mesh.sites.contains(&old(gone)));
    }

    // Far away nothing has changed by a bit; there is something far away; near by, much has changed.
    let places = [
        world_position(added),
        world_position(far_to),
        nudge,
        old(nudged),
        old(moved_far),
        old(removed),
    ];
    let (nodes, cells) = far_parts(&before, &places, 2.0 * 5.0 * d);
    let (same_nodes, same_cells) = far_parts(&file, &places, 2.0 * 5.0 * d);
    assert!(nodes == same_nodes && cells == same_cells);
    let all = before.mesh.sites.len();
    assert!(5 * cells.len() > all, "{} of {all}", cells.len());
    let sites = |file: &MeshFile<PolyMesh<D>>| -> BTreeSet<[u64; D]> {
        file.mesh
            .sites
            .iter()
            .copied()
            .map(coordinate_bits)
            .collect()
    };
    let (was, is) = (sites(&before), sites(&file));
    assert!(was.difference(&is).count() > 20);

    // What the atoms do is known to the next edit: the one that was added stays.
    let next = AtomChange::Remove(nearest_cell(&file, sample([26.0, 20.0, 22.0])));
    let again = edit_mesh(&file, &image, &params, &[next]).unwrap();
    check_cells(&again.file);
    assert!(again.file.mesh.sites.contains(&world_position(added)));
    assert!(again.summary.notes.is_empty(), "{:?}", again.summary.notes);
}

#[test]
fn edits_of_polygons_stay_local() {
    edits_stay_local([120, 110], 5.0);
}

#[test]
#[cfg(feature = "tetgen")]
fn edits_of_polyhedra_stay_local() {
    edits_stay_local([56, 48, 60], 4.0);
}

/// The image of a curved sheet, and with a disc across x besides, if `at` is given.
fn image_with_disc<const D: usize>(dims: [usize; D], at: Option<f64>, radius: f64) -> Image<D> {
    let mut image = image(dims);
    let Some(at) = at else { return image };
    let samples: Vec<f32> = (image.as_slice().iter().enumerate())
        .map(|(i, &value)| {
            let mut rest = i;
            let x: [f64; D] = std::array::from_fn(|k| {
                let x = rest % dims[k];
                rest /= dims[k];
                x as f64
            });
            let off = disc_distance(&x, dims, at, radius);
            value.max((-0.5 * (off / 1.5).powi(2)).exp() as f32)
        })
        .collect();
    image = Image::new(dims, samples, image.geometry.clone());
    image
}

/// How far a sample is from the disc.
fn disc_distance<const D: usize>(x: &[f64; D], dims: [usize; D], at: f64, radius: f64) -> f64 {
    let rest: f64 = (1..D).map(|k| (x[k] - dims[k] as f64 / 2.0).powi(2)).sum();
    let beyond = (rest.sqrt() - radius).max(0.0);
    (x[0] - at).hypot(beyond)
}

/// The share of the disc but for its rim that faces on features cover within a sample, and the number of
/// faces on features nearer to it than d.
fn disc_coverage<const D: usize>(
    file: &MeshFile<PolyMesh<D>>,
    dims: [usize; D],
    (at, radius): (f64, f64),
    d: f64,
) -> (f64, usize) {
    let stored = StoredMesh::new(file.clone(), "mesh").unwrap();
    let mesh = &stored.lattice;
    let (mut facets, mut near) = (Vec::new(), 0);
    for f in (0..mesh.inner_face_count()).filter(|&f| mesh.on_feature[f]) {
        mesh.facets(f, |facet| {
            facets.push(facet.map(|n| mesh.nodes[n as usize]))
        });
        near += usize::from(disc_distance(&mesh.face_shape(f).centroid, dims, at, radius) < d);
    }
    let (mut all, mut within) = (0, 0);
    let steps = 24;
    for i in 0..steps * steps {
        let mut x = [at; D];
        let share = |n: usize| (n as f64 + 0.5) / steps as f64 * 2.0 - 1.0;
        x[1] = dims[1] as f64 / 2.0 + share(i % steps) * radius;
        if D == 3 {
            x[2] = dims[2] as f64 / 2.0 + share(i / steps) * radius;
        }
        if disc_distance(&x, dims, at, radius - 1.0) > 1e-9 {
            continue;
        }
        all += 1;
        within += usize::from(
            facets
                .iter()
                .any(|facet| squared_distance_to_face(x, facet) <= 1.0),
        );
    }
    (f64::from(within as u32) / f64::from(all), near)
}

/// A disc comes into the image, moves, and goes, and an edit near by follows it.
fn faults_come_and_go<const D: usize>(dims: [usize; D], d: f64, radius: f64)
where
    MeshSpace<D>: Meshing<D>,
{
    let params = params(d);
    let at = dims[0] as f64 - 4.5 * d;
    let [none, one, other] =
        [None, Some(at), Some(at - 3.0)].map(|at| image_with_disc(dims, at, radius));
    let without = make_mesh(&none, &params);
    let centre = |x: f64| -> [f64; D] {
        std::array::from_fn(|k| {
            if k == 0 {
                x
            } else {
                dims[k] as f64 / 2.0 + 0.3
            }
        })
    };
    let beside = AtomChange::Add(world_position(centre(at + 1.3 * d)));
    let follow = |file: &MeshFile<PolyMesh<D>>, image: &Image<D>, change: AtomChange<D>| {
        let edited = edit_mesh(file, image, &params, &[change]).unwrap();
        check_cells(&edited.file);
        edited.file
    };
    let before = disc_coverage(&without, dims, (at, radius), d);
    let edited_in = follow(&without, &one, beside);
    let [by_edit, anew] = [&edited_in, &make_mesh(&one, &params)]
        .map(|file| disc_coverage(file, dims, (at, radius), d));
    let remove =
        |file: &MeshFile<PolyMesh<D>>| AtomChange::Remove(nearest_cell(file, centre(at + 2.0 * d)));
    let moved = follow(&edited_in, &other, remove(&edited_in));
    let there = disc_coverage(&moved, dims, (at - 3.0, radius), d);
    let here = disc_coverage(&moved, dims, (at, radius), d);
    let taken_out = follow(&edited_in, &none, remove(&edited_in));
    let after = disc_coverage(&taken_out, dims, (at, radius), d);
    let figures = format!(
        "{D}-D before {before:?}, edited in {by_edit:?}, anew {anew:?}, moved: there {there:?}, here \
         {here:?}, taken out {after:?}"
    );
    println!("{figures}");
    assert!(before.1 == 0 && by_edit.1 > 0, "{figures}");
    assert!(by_edit.0 > anew.0 - 0.01, "{figures}");
    assert!(there.0 > anew.0 - 0.03 && here.0 < 0.1, "{figures}");
    assert!(after.1 == 0, "{figures}");
}

#[test]
fn faults_among_polygons_are_edited_in_moved_and_taken_out() {
    faults_come_and_go([100, 90], 5.0, 12.0);
}

#[test]
#[cfg(feature = "tetgen")]
fn faults_among_polyhedra_are_edited_in_moved_and_taken_out() {
    faults_come_and_go([56, 44, 44], 4.0, 9.0);
}

#[test]
fn variable_distances_wells_and_welded_cells_are_edited() {
    let image = image([110, 100]);
    let well = world_position([80.3, 50.4]);
    let fixed = job::FixedAtom {
        name: "well".into(),
        position: well,
    };
    let params = Params {
        spacing: Spacing::FromFeatures { min: 3.0, max: 9.0 },
        fixed_atoms: vec![fixed],
        weld_ratio: 0.01,
        ..params(3.0)
    };
    let file = make_mesh(&image, &params);
    let changes = [
        AtomChange::Add(world_position([70.1, 60.2])),
        AtomChange::Remove(nearest_cell(&file, [20.0, 40.0])),
    ];
    let after = edit_mesh(&file, &image, &params, &changes).unwrap();
    let stored = StoredMesh::new(after.file.clone(), "mesh").unwrap();
    assert_eq!(stored.weld, 0.01);
    let known = crate::mesh::check::CheckHints {
        weld: 0.01,
        ..Default::default()
    };
    let (low, extent) = ([0.0; 2], stored.space.extent);
    let found =
        crate::mesh::check::check_with_hints(&stored.lattice, known, low, extent, BOX_TOLERANCE);
    assert!(found.passed(), "{:?}", found.problems);
    // The well has not moved by a bit, and neither has the new atom.
    for x in [well, world_position([70.1, 60.2])] {
        let gaps = after.file.mesh.sites.iter().map(|site| distance2(site, &x));
        assert!(gaps.fold(f64::INFINITY, f64::min) < 1e-18, "{x:?}");
    }
}

#[test]
fn regions_go_with_the_cells() {
    let (image, params) = (image([90, 80]), params(5.0));
    let mut file = make_mesh(&image, &params);
    let side = |site: &[f64; 2]| i32::from(site[1] > 20.0);
    file.mesh.region = file.mesh.sites.iter().map(side).collect();
    let after = edit_mesh(
        &file,
        &image,
        &params,
        &[AtomChange::Add(world_position([40.2, 40.3]))],
    )
    .unwrap();
    let cells = after.file.mesh.sites.iter().zip(&after.file.mesh.region);
    let wrong = cells
        .filter(|(site, region)| side(site) != **region)
        .count();
    assert!(wrong < 10, "{wrong} of {}", after.file.mesh.sites.len());
}

#[test]
fn impossible_edits_of_cells_are_refused() {
    let (image, params) = (image([60, 50]), params(5.0));
    let file = make_mesh(&image, &params);
    let refused = |changes: &[AtomChange<2>]| refusal(edit_mesh(&file, &image, &params, changes));
    assert!(refused(&[AtomChange::Remove(100_000)]).contains("a cell of the mesh"));
    assert!(refused(&[AtomChange::Add(world_position([61.0, 20.0]))]).contains("outside"));
    assert!(refused(&[AtomChange::Add(world_position([0.0, 20.0]))]).contains("where cells end"));
    let other = super::tests::image([61, 50]);
    let edits = named_edits(&[AtomChange::Add(world_position([30.0, 20.0]))]);
    let error = edit_cells(
        file,
        "mesh",
        &other,
        &params,
        &edits,
        false,
        &mut NoProgress,
    );
    assert!(error.unwrap_err().to_string().contains("61"));
}
