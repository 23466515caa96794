use crate::geometry::grid_index::index_at;
use crate::image::Image;
use crate::job::spec::{DistanceSource, MeshSpec, NominalDistance};
use std::collections::{BTreeMap, BTreeSet};

use super::*;
use crate::edit::tests::{coordinate_bits, image, named_edits, refusal, world_position};
use crate::feature::FeatureKind;
use crate::geometry::distance2;
use crate::geometry::squared_distance_to_face;
use crate::job::output::cells::cell_mesh_file;
use crate::job::{self, BOX_TOLERANCE, CellKind, MeshImage, Params};
use crate::mesh::Mesh;
use crate::mesh::check::check;
use crate::mesh::graph::Graph;
use crate::progress::NoProgress;
use crate::store::StoredMesh;

fn params<const D: usize>(d: f64) -> Params<D> {
    Params::new(MeshSpec {
        distance: NominalDistance::Constant(d),
        feature: FeatureKind::Ridges,
        cells: Some(CellKind::Voronoi),
        ..MeshSpec::default()
    })
    .unwrap()
}

fn make_mesh<const D: usize>(image: &Image<D>, params: &Params<D>) -> MeshFile<PolyMesh<D>>
where
    Space<D>: MeshImage<D>,
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
    Space<D>: Dimension<D, Mesh: JoinAtoms<D>>,
{
    let edits = named_edits(changes);
    let progress = &mut NoProgress;
    let input = EditImage::new(image, params);
    edit_cells(file.clone(), "mesh", input, &edits, false, progress)
}

/// Returns the cell whose site is nearest to a position in samples.
fn nearest_cell<const D: usize>(file: &MeshFile<PolyMesh<D>>, sample: [f64; D]) -> u32 {
    let x = world_position(sample);
    let distance2_to = |&c: &usize| distance2(&file.mesh.sites[c], &x);
    let cells = 0..file.mesh.sites.len();
    cells
        .min_by(|a, b| distance2_to(a).total_cmp(&distance2_to(b)))
        .unwrap() as u32
}

/// The parts of a mesh that are far from some positions, as bits: nodes, and by their sites the
/// cells that have only such nodes. Each cell has its faces, whether these lie on features, and the
/// values of the cell arrays.
type FarParts<const D: usize> = (
    BTreeSet<[u64; D]>,
    BTreeMap<[u64; D], (Vec<(Vec<[u64; D]>, bool)>, Vec<u64>)>,
);

fn far_parts<const D: usize>(
    file: &MeshFile<PolyMesh<D>>,
    positions: &[[f64; D]],
    radius: f64,
) -> FarParts<D> {
    let mesh = &file.mesh;
    let is_far = |x: &[f64; D]| positions.iter().all(|y| distance2(x, y) > radius * radius);
    let lists = mesh.faces_of_cells();
    // An edit adds the array `atom_kind`.
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

/// Checks that cells are closed and disjoint, that they fill the box, and that faces are
/// perpendicular to the connections of their sites and halfway between them.
fn check_cells<const D: usize>(file: &MeshFile<PolyMesh<D>>) {
    let stored = StoredMesh::new(file.clone(), "mesh").unwrap();
    let validity = check(
        &stored.lattice,
        [0.0; D],
        stored.space.extent,
        BOX_TOLERANCE,
    );
    assert!(validity.passed(), "{:?}", validity.problems);
    assert!(validity.volume_error < 1e-12, "{}", validity.volume_error);
    let graph = Graph::from_poly(&stored.lattice);
    let mean =
        graph.connections.iter().map(|c| c.area).sum::<f64>() / graph.connections.len() as f64;
    for connection in graph.connections.iter().filter(|c| c.area > 1e-6 * mean) {
        let error = connection.angle_error(&graph.site);
        assert!(error < 1e-6, "a face {error} degrees off");
        let [a, b] = connection.distance;
        assert!((a - b).abs() < 1e-9, "not halfway: {a}, {b}");
    }
}

/// Adds, moves (by a small and by a large distance) and removes atoms, also next to a feature.
fn edits_stay_local<const D: usize>(dims: [usize; D], d: f64)
where
    Space<D>: MeshImage<D, Mesh: JoinAtoms<D>>,
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
    let distance2_to = |c: &u32| distance2(&before.mesh.sites[*c as usize], &x);
    let removed = beside_feature
        .min_by(|a, b| distance2_to(a).total_cmp(&distance2_to(b)))
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
    // The file records how features were found.
    assert!(summary.notes.is_empty(), "{:?}", summary.notes);

    // Atoms are exactly where the edits put them.
    let position = |n: usize| file.mesh.sites[summary.atoms[n].unwrap() as usize];
    assert_eq!(
        [position(0), position(1), position(2)],
        [world_position(added), world_position(far_to), nudge]
    );
    assert_eq!(summary.atoms[1..], [Some(moved_far), Some(nudged), None]);
    for removed_atom in [moved_far, nudged, removed] {
        assert!(!file.mesh.sites.contains(&old(removed_atom)));
    }

    // Far from the edits no bit has changed. Some cells are far away, and many cells near the edits
    // have changed.
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
    let total = before.mesh.sites.len();
    assert!(5 * cells.len() > total, "{} of {total}", cells.len());
    let sites = |file: &MeshFile<PolyMesh<D>>| -> BTreeSet<[u64; D]> {
        file.mesh
            .sites
            .iter()
            .copied()
            .map(coordinate_bits)
            .collect()
    };
    let (old_sites, new_sites) = (sites(&before), sites(&file));
    assert!(old_sites.difference(&new_sites).count() > 20);

    // The next edit knows which atoms are fixed: the added atom stays.
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
fn edits_of_polyhedra_stay_local() {
    edits_stay_local([56, 48, 60], 4.0);
}

/// The image of a curved surface, and of a disc across x at `disc_x`, if given.
fn image_with_disc<const D: usize>(dims: [usize; D], disc_x: Option<f64>, radius: f64) -> Image<D> {
    let mut image = image(dims);
    let Some(disc_x) = disc_x else { return image };
    let samples: Vec<f32> = (image.as_slice().iter().enumerate())
        .map(|(i, &value)| {
            let x = index_at(dims, i).map(|c| c as f64);
            let distance = disc_distance(&x, dims, disc_x, radius);
            value.max((-0.5 * (distance / 1.5).powi(2)).exp() as f32)
        })
        .collect();
    image = Image::new(dims, samples, image.geometry.clone());
    image
}

/// Returns the distance of a sample from the disc.
fn disc_distance<const D: usize>(x: &[f64; D], dims: [usize; D], disc_x: f64, radius: f64) -> f64 {
    let radial2: f64 = (1..D).map(|k| (x[k] - dims[k] as f64 / 2.0).powi(2)).sum();
    let beyond = (radial2.sqrt() - radius).max(0.0);
    (x[0] - disc_x).hypot(beyond)
}

/// Returns the fraction of the disc, without its rim, that faces on features cover within one
/// sample, and the number of faces on features nearer to it than d.
fn disc_coverage<const D: usize>(
    file: &MeshFile<PolyMesh<D>>,
    dims: [usize; D],
    disc_x: f64,
    radius: f64,
    d: f64,
) -> (f64, usize) {
    let stored = StoredMesh::new(file.clone(), "mesh").unwrap();
    let mesh = &stored.lattice;
    let (mut facets, mut near_count) = (Vec::new(), 0);
    for f in (0..mesh.inner_face_count()).filter(|&f| mesh.on_feature[f]) {
        mesh.facets(f, |facet| {
            facets.push(facet.map(|n| mesh.nodes[n as usize]))
        });
        near_count +=
            usize::from(disc_distance(&mesh.face_shape(f).centroid, dims, disc_x, radius) < d);
    }
    let (mut total, mut covered) = (0, 0);
    let steps = 24;
    for i in 0..steps * steps {
        let mut x = [disc_x; D];
        let offset = |n: usize| (n as f64 + 0.5) / steps as f64 * 2.0 - 1.0;
        x[1] = dims[1] as f64 / 2.0 + offset(i % steps) * radius;
        if D == 3 {
            x[2] = dims[2] as f64 / 2.0 + offset(i / steps) * radius;
        }
        if disc_distance(&x, dims, disc_x, radius - 1.0) > 1e-9 {
            continue;
        }
        total += 1;
        covered += usize::from(
            facets
                .iter()
                .any(|facet| squared_distance_to_face(x, facet) <= 1.0),
        );
    }
    (f64::from(covered as u32) / f64::from(total), near_count)
}

/// Adds a disc to the image, moves it and removes it, and checks that a nearby edit follows each
/// time.
fn faults_come_and_go<const D: usize>(dims: [usize; D], d: f64, radius: f64)
where
    Space<D>: MeshImage<D, Mesh: JoinAtoms<D>>,
{
    let params = params(d);
    let disc_x = dims[0] as f64 - 4.5 * d;
    let [no_disc, with_disc, moved_disc] = [None, Some(disc_x), Some(disc_x - 3.0)]
        .map(|disc_x| image_with_disc(dims, disc_x, radius));
    let file_without = make_mesh(&no_disc, &params);
    let centre = |x: f64| -> [f64; D] {
        std::array::from_fn(|k| {
            if k == 0 {
                x
            } else {
                dims[k] as f64 / 2.0 + 0.3
            }
        })
    };
    let addition = AtomChange::Add(world_position(centre(disc_x + 1.3 * d)));
    let edit_and_check = |file: &MeshFile<PolyMesh<D>>, image: &Image<D>, change: AtomChange<D>| {
        let edited = edit_mesh(file, image, &params, &[change]).unwrap();
        check_cells(&edited.file);
        edited.file
    };
    let before = disc_coverage(&file_without, dims, disc_x, radius, d);
    let edited_in = edit_and_check(&file_without, &with_disc, addition);
    let [by_edit, remeshed] = [&edited_in, &make_mesh(&with_disc, &params)]
        .map(|file| disc_coverage(file, dims, disc_x, radius, d));
    let remove = |file: &MeshFile<PolyMesh<D>>| {
        AtomChange::Remove(nearest_cell(file, centre(disc_x + 2.0 * d)))
    };
    let moved = edit_and_check(&edited_in, &moved_disc, remove(&edited_in));
    let at_new = disc_coverage(&moved, dims, disc_x - 3.0, radius, d);
    let at_old = disc_coverage(&moved, dims, disc_x, radius, d);
    let taken_out = edit_and_check(&edited_in, &no_disc, remove(&edited_in));
    let after = disc_coverage(&taken_out, dims, disc_x, radius, d);
    let figures = format!(
        "{D}-D before {before:?}, edited in {by_edit:?}, meshed again {remeshed:?}, moved: there {at_new:?}, here \
         {at_old:?}, taken out {after:?}"
    );
    println!("{figures}");
    assert!(before.1 == 0 && by_edit.1 > 0, "{figures}");
    assert!(by_edit.0 > remeshed.0 - 0.01, "{figures}");
    assert!(at_new.0 > remeshed.0 - 0.03 && at_old.0 < 0.1, "{figures}");
    assert!(after.1 == 0, "{figures}");
}

#[test]
fn faults_among_polygons_are_edited_in_moved_and_taken_out() {
    faults_come_and_go([100, 90], 5.0, 12.0);
}

#[test]
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
        fixed_atoms: vec![fixed],
        ..Params::new(MeshSpec {
            distance: NominalDistance::Range { min: 3.0, max: 9.0 },
            distance_from: DistanceSource::Features,
            weld: 0.01,
            ..params::<2>(3.0).spec
        })
        .unwrap()
    };
    let file = make_mesh(&image, &params);
    let changes = [
        AtomChange::Add(world_position([70.1, 60.2])),
        AtomChange::Remove(nearest_cell(&file, [20.0, 40.0])),
    ];
    let after = edit_mesh(&file, &image, &params, &changes).unwrap();
    let stored = StoredMesh::new(after.file.clone(), "mesh").unwrap();
    assert_eq!(stored.weld, 0.01);
    let hints = crate::mesh::check::CheckHints {
        weld: 0.01,
        ..Default::default()
    };
    let (low, extent) = ([0.0; 2], stored.space.extent);
    let validity =
        crate::mesh::check::check_with_hints(&stored.lattice, hints, low, extent, BOX_TOLERANCE);
    assert!(validity.passed(), "{:?}", validity.problems);
    // Neither the well nor the new atom has moved.
    for x in [well, world_position([70.1, 60.2])] {
        let distances2 = after.file.mesh.sites.iter().map(|site| distance2(site, &x));
        assert!(distances2.fold(f64::INFINITY, f64::min) < 1e-18, "{x:?}");
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
        EditImage::new(&other, &params),
        &edits,
        false,
        &mut NoProgress,
    );
    assert!(error.unwrap_err().to_string().contains("61"));
}
