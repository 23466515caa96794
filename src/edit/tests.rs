use crate::job::spec::{DistanceSource, MeshSpec, NominalDistance};
use std::collections::BTreeSet;

use super::*;
use crate::feature;
use crate::geometry::distance2;
use crate::image::Geometry;
use crate::job::output::simplex_mesh_file;
use crate::job::{self, BOX_TOLERANCE, FixedAtom, MeshImage};
use crate::lattice::AtomKind;
use crate::lattice::optimise::NoProgress;
use crate::mesh::check::check;
use crate::mesh::{Space, TriMesh};
use crate::report::{Reference, fidelity, quality};
use crate::store::StoredMesh;

/// Returns an image of a bright curved surface, with a geometry that is not the identity.
pub(super) fn image<const D: usize>(dims: [usize; D]) -> Image<D> {
    let mut image = Image::from_fn(dims, Geometry::default(), |x| {
        let distance = x[0] - 20.0 - 0.2 * x[1] + 2.0 * (0.1 * x[D - 1]).sin();
        (-0.5 * (distance / 1.5).powi(2)).exp()
    });
    // Left-handed, as is usual with depth downwards.
    let mut spacing = [2.0; D];
    spacing[D - 1] = -2.0;
    image.geometry = Geometry::with_spacing([100.0; D], spacing);
    image
}

pub(super) fn world_position<const D: usize>(sample: [f64; D]) -> [f64; D] {
    std::array::from_fn(|k| 100.0 + if k + 1 == D { -2.0 } else { 2.0 } * sample[k])
}

pub(super) fn params<const D: usize>(d: f64) -> Params<D> {
    Params::new(MeshSpec {
        distance: NominalDistance::Constant(d),
        feature: feature::FeatureKind::Ridges,
        ..MeshSpec::default()
    })
    .unwrap()
}

fn make_mesh<const D: usize, M: Simplices<D>>(image: &Image<D>, params: &Params<D>) -> MeshFile<M>
where
    Space<D>: MeshImage<D, Mesh = M>,
{
    let outcome = job::run(image, params, &mut NoProgress).unwrap();
    simplex_mesh_file(&outcome, outcome.simplices().unwrap())
}

pub(super) fn named_edits<const D: usize>(changes: &[AtomChange<D>]) -> Vec<Edit<D>> {
    let edit = |(n, &change)| Edit {
        name: format!("edit {n}"),
        change,
    };
    changes.iter().enumerate().map(edit).collect()
}

fn edit_mesh<const D: usize, M: Reshape<D>>(
    file: &MeshFile<M>,
    image: &Image<D>,
    params: &Params<D>,
    changes: &[AtomChange<D>],
) -> Result<EditedMesh<M>> {
    let edits = named_edits(changes);
    edit_simplices(
        file.clone(),
        "mesh",
        EditImage::new(image, params),
        &edits,
        false,
        &mut NoProgress,
    )
}

#[test]
fn an_invalid_mesh_is_refused() {
    let (image, params) = (image([40, 36]), params(6.0));
    let good: MeshFile<TriMesh> = make_mesh(&image, &params);
    let change = AtomChange::Remove(9);
    let refusal = |spoil: fn(&mut TriMesh)| {
        let mut file = good.clone();
        spoil(&mut file.mesh);
        let error = edit_mesh(&file, &image, &params, &[change]).unwrap_err();
        error.to_string()
    };
    let inverted = refusal(|mesh| mesh.triangles[3].swap(0, 1));
    assert!(inverted.contains("flat or inverted"), "{inverted}");
    let holed = refusal(|mesh| mesh.triangles.truncate(50));
    assert!(holed.starts_with("mesh: is not valid"), "{holed}");
}

/// Returns the node nearest to a position in samples.
fn nearest_node<const D: usize, M: Simplices<D>>(file: &MeshFile<M>, sample: [f64; D]) -> u32 {
    let x = world_position(sample);
    let distance2_to = |n: usize| distance2(&file.mesh.nodes()[n], &x);
    let nodes = 0..file.mesh.nodes().len();
    nodes
        .min_by(|&a, &b| distance2_to(a).total_cmp(&distance2_to(b)))
        .unwrap() as u32
}

pub(super) fn coordinate_bits<const D: usize>(x: [f64; D]) -> [u64; D] {
    x.map(f64::to_bits)
}

/// Nodes farther than a radius (physical units) from all positions, and cells that have only such
/// nodes with the values of their arrays, as bits.
type FarParts<const D: usize> = (BTreeSet<[u64; D]>, BTreeSet<(Vec<[u64; D]>, Vec<u64>)>);

fn far_parts<const D: usize, M: Simplices<D>>(
    file: &MeshFile<M>,
    positions: &[[f64; D]],
    radius: f64,
) -> FarParts<D> {
    let nodes = file.mesh.nodes();
    let is_far = |x: [f64; D]| positions.iter().all(|y| distance2(&x, y) > radius * radius);
    let data: Vec<Vec<f64>> = file.cell_data.iter().map(|a| a.values.to_f64()).collect();
    let cells = (0..file.mesh.len()).filter_map(|c| {
        let corners: Vec<[f64; D]> = (file.mesh.cell(c).iter())
            .map(|&n| nodes[n as usize])
            .collect();
        let stored = data.iter().map(|a| a[c].to_bits()).collect();
        let is_all_far = corners.iter().all(|&x| is_far(x));
        is_all_far.then(|| (corners.into_iter().map(coordinate_bits).collect(), stored))
    });
    let cells = cells.collect();
    let nodes = nodes
        .iter()
        .copied()
        .filter(|&x| is_far(x))
        .map(coordinate_bits);
    (nodes.collect(), cells)
}

/// Checks that the second mesh, made from the first one, is valid, that all its angles are in range,
/// and that it covers the feature as before.
fn assert_good_mesh<const D: usize, M: Simplices<D>>(
    meshes: [MeshFile<M>; 2],
    image: &Image<D>,
    params: &Params<D>,
) where
    Space<D>: MeshImage<D, Mesh = M>,
{
    let stored = meshes.map(|file| StoredMesh::new(file, "mesh").unwrap());
    let validity = check(
        &stored[1].lattice,
        [0.0; D],
        stored[1].space.extent,
        BOX_TOLERANCE,
    );
    assert!(validity.passed(), "{:?}", validity.problems);
    let features = feature::detect(image, &params.feature_options([1.0; D])).unwrap();
    let reference = Reference::from_features(&features);
    let [old, new] = stored.map(|stored| {
        let tagged = stored.feature_faces.as_deref();
        let fidelity = fidelity(&stored.lattice, &reference, tagged).unwrap();
        (quality(&stored.lattice), fidelity.tagged_faces.unwrap())
    });
    println!(
        "{D}-D angles {:.1} to {:.1}, before {:.1} to {:.1}; coverage {:.4}, {:.4}; precision {:.4}, {:.4}",
        new.0.smallest_angle.worst,
        new.0.largest_angle.worst,
        old.0.smallest_angle.worst,
        old.0.largest_angle.worst,
        new.1.coverage_one,
        old.1.coverage_one,
        new.1.precision,
        old.1.precision,
    );
    // Measured: smallest angles of 30.7 and 30.0 degrees; largest angles of 113.0 after 112.3, and
    // 147.4 after 142.2. Dihedral angles of tetrahedra from 30 to 150 degrees are accepted.
    let [smallest, largest] = [new.0.smallest_angle, new.0.largest_angle];
    assert!(smallest.worst > 29.5, "{smallest:?}");
    let before = old.0.largest_angle.worst;
    let max_angle = if D == 3 { 150.5 } else { before + 2.0 };
    assert!(largest.worst < max_angle, "{largest:?} after {before}");
    assert!(new.1.coverage_one > old.1.coverage_one - 0.01);
    assert!(new.1.precision > old.1.precision - 0.01);
}

/// Adds, moves (by a small and by a large distance) and removes atoms, near each other and far
/// apart.
fn edits_stay_local<const D: usize, M: Reshape<D>>(dims: [usize; D], d: f64)
where
    Space<D>: MeshImage<D, Mesh = M>,
{
    let (image, params) = (image(dims), params(d));
    let before = make_mesh(&image, &params);
    let sample =
        |x: [f64; 3]| -> [f64; D] { std::array::from_fn(|k| x[if k + 1 == D { 2 } else { k }]) };
    let (added, far_to, near_from) = (
        sample([14.3, 12.2, 11.7]),
        sample([9.1, 21.4, 18.0]),
        sample([20.0, 12.0, 22.0]),
    );
    let moved_far = nearest_node(&before, sample([18.0, 6.0, 6.0]));
    let nudged = nearest_node(&before, near_from);
    let removed = nearest_node(&before, sample([10.0, 18.0, 8.0]));
    let on_side = nearest_node(&before, sample([0.0, 12.0, 12.0]));
    let mut nudge = before.mesh.nodes()[nudged as usize];
    nudge[0] += 0.6 * d;
    nudge[1] -= 0.5 * d;
    let changes = [
        AtomChange::Add(world_position(added)),
        AtomChange::Move(moved_far, world_position(far_to)),
        AtomChange::Move(nudged, nudge),
        AtomChange::Remove(removed),
        AtomChange::Remove(on_side),
    ];
    let after = edit_mesh(&before, &image, &params, &changes).unwrap();
    let EditedMesh { file, summary } = &after;

    // Atoms are exactly where the edits put them, and fixed.
    let position = |n: usize| file.mesh.nodes()[summary.atoms[n].unwrap() as usize];
    assert_eq!(position(0), world_position(added));
    assert_eq!(position(1), world_position(far_to));
    assert_eq!(position(2), nudge);
    assert_eq!(summary.atoms[1..3], [Some(moved_far), Some(nudged)]);
    assert_eq!(summary.atoms[3..], [None, None]);
    let kinds = file.point_data[0].values.to_f64();
    for n in 0..3 {
        let n = summary.atoms[n].unwrap() as usize;
        assert_eq!(kinds[n], f64::from(AtomKind::Fixed as u8));
    }
    let old = |n: u32| before.mesh.nodes()[n as usize];
    for removed_atom in [removed, on_side, moved_far] {
        assert!(!file.mesh.nodes().contains(&old(removed_atom)));
    }

    // Far from the edits no bit has changed. Some cells are far away, and many nodes near the edits
    // have changed.
    let places = [
        world_position(added),
        world_position(far_to),
        nudge,
        old(nudged),
        old(moved_far),
        old(removed),
        old(on_side),
    ];
    let (nodes, cells) = far_parts(&before, &places, 2.0 * 5.0 * d);
    let (same_nodes, same_cells) = far_parts(file, &places, 2.0 * 5.0 * d);
    assert!(nodes == same_nodes && cells == same_cells);
    assert!(
        5 * cells.len() > before.mesh.len(),
        "{} of {}",
        cells.len(),
        before.mesh.len()
    );
    let unchanged_count = |radius: f64| {
        far_parts(&before, &places, radius)
            .0
            .intersection(&far_parts(file, &places, radius).0)
            .count()
    };
    let unchanged_near = unchanged_count(0.0) - unchanged_count(2.0 * 4.0 * d);
    assert!(
        unchanged_near * 10 < before.mesh.nodes().len(),
        "{unchanged_near}"
    );

    assert_good_mesh([before, after.file], &image, &params);
}

#[test]
fn edits_in_space_stay_local() {
    edits_stay_local([64, 60, 72], 4.0);
}

#[test]
fn edits_in_the_plane_stay_local() {
    edits_stay_local([120, 110], 5.0);
}

/// Compares a mesh with edited atoms and a new mesh with the same atoms.
fn compare_with_remeshing<const D: usize, M: Reshape<D>>(dims: [usize; D], d: f64)
where
    Space<D>: MeshImage<D, Mesh = M>,
{
    let image = image(dims);
    let plain = params(d);
    let wells: Vec<[f64; D]> = (0..4)
        .map(|n| {
            world_position(std::array::from_fn(|k| {
                8.3 + 9.7 * f64::from(n) + 3.1 * k as f64
            }))
        })
        .collect();
    let changes: Vec<AtomChange<D>> = wells.iter().map(|&x| AtomChange::Add(x)).collect();
    let by_edit = edit_mesh(&make_mesh(&image, &plain), &image, &plain, &changes)
        .unwrap()
        .file;
    let fixed = |(n, &position): (usize, &[f64; D])| FixedAtom {
        name: n.to_string(),
        position,
    };
    let with_wells = Params {
        fixed_atoms: wells.iter().enumerate().map(fixed).collect(),
        ..plain
    };
    let remeshed = make_mesh(&image, &with_wells);
    let features = feature::detect(&image, &with_wells.feature_options([1.0; D])).unwrap();
    let reference = Reference::from_features(&features);
    let [(q, f), (r, g)] = [by_edit, remeshed].map(|file| {
        let stored = StoredMesh::new(file, "mesh").unwrap();
        let tagged = stored.feature_faces.as_deref();
        let fidelity = fidelity(&stored.lattice, &reference, tagged).unwrap();
        (quality(&stored.lattice), fidelity.tagged_faces.unwrap())
    });
    let figures = format!(
        "{D}-D edited: angles {:.2} to {:.2}, mean ratio {:.4}, coverage {:.4}; meshed again: {:.2} to {:.2}, {:.4}, {:.4}",
        q.smallest_angle.worst,
        q.largest_angle.worst,
        q.mean_ratio_mean,
        f.coverage_half,
        r.smallest_angle.worst,
        r.largest_angle.worst,
        r.mean_ratio_mean,
        g.coverage_half,
    );
    println!("{figures}");
    // Measured: mean ratios 0.0015 above those of the new mesh; both cover all features. The
    // improvement stops as soon as every angle is in range, so margins inside the range are not
    // compared.
    let (min_angle, max_angle): (f64, f64) = if D == 2 { (30.0, 120.0) } else { (30.0, 150.0) };
    assert!(
        q.smallest_angle.worst > min_angle.min(r.smallest_angle.worst - 2.0),
        "{figures}"
    );
    assert!(
        q.largest_angle.worst < max_angle.max(r.largest_angle.worst + 2.0),
        "{figures}"
    );
    assert!(q.mean_ratio_mean > r.mean_ratio_mean - 0.002, "{figures}");
    assert!(f.coverage_half > g.coverage_half - 0.002, "{figures}");
}

#[test]
fn edits_in_space_are_as_good_as_remeshing() {
    compare_with_remeshing([56, 52, 60], 5.0);
}

#[test]
fn edits_in_the_plane_are_as_good_as_remeshing() {
    compare_with_remeshing([90, 80], 5.0);
}

/// Makes a mesh of an image of these dimensions, adds one atom, and returns the summary of the
/// edit.
fn edit_work<const D: usize, M: Reshape<D>>(dims: [usize; D], params: &Params<D>) -> Summary
where
    Space<D>: MeshImage<D, Mesh = M>,
{
    let image = image(dims);
    let file = make_mesh(&image, params);
    let change = AtomChange::Add(world_position([6.1; D]));
    edit_mesh(&file, &image, params, &[change]).unwrap().summary
}

fn check_equal_work(small: &Summary, large: &Summary) {
    assert_eq!(small.samples, large.samples);
    let ratio = small.cells[1] as f64 / large.cells[1] as f64;
    assert!(
        (0.75..1.33).contains(&ratio),
        "{:?} {:?}",
        small.cells,
        large.cells
    );
}

#[test]
fn work_does_not_grow_with_the_image() {
    let work = |dims: [usize; 2]| edit_work(dims, &params(5.0));
    check_equal_work(&work([100, 100]), &work([300, 400]));
}

#[test]
fn work_does_not_grow_with_the_volume() {
    let work = |dims: [usize; 3]| edit_work(dims, &params(5.0));
    check_equal_work(&work([60; 3]), &work([80, 100, 90]));
}

#[test]
fn variable_distances_and_old_meshes() {
    let image = image([110, 100]);
    let params = Params::new(MeshSpec {
        distance: NominalDistance::Range { min: 3.0, max: 9.0 },
        distance_from: DistanceSource::Features,
        ..params::<2>(3.0).spec
    })
    .unwrap();
    let mut file = make_mesh(&image, &params);
    // Files of earlier versions do not record how features were found.
    file.field_data.retain(|(name, _)| name != "features");
    let changes = [
        AtomChange::Add(world_position([80.3, 50.4])),
        AtomChange::Remove(nearest_node(&file, [60.0, 70.0])),
    ];
    let after = edit_mesh(&file, &image, &params, &changes).unwrap();
    assert_eq!(after.summary.notes.len(), 1);
    assert!(resolved_options(&after.file).is_some());
    let stored = StoredMesh::new(after.file.clone(), "mesh").unwrap();
    let validity = check(
        &stored.lattice,
        [0.0; 2],
        stored.space.extent,
        BOX_TOLERANCE,
    );
    assert!(validity.passed(), "{:?}", validity.problems);
    let quality = quality(&stored.lattice);
    assert!(
        quality.smallest_angle.worst > 25.0,
        "{:?}",
        quality.smallest_angle
    );
    // The edited file records how features were found, and both edits.
    let again = edit_mesh(
        &after.file,
        &image,
        &params,
        &[AtomChange::Add(world_position([20.0, 90.0]))],
    )
    .unwrap();
    assert!(again.summary.notes.is_empty());
    let edits = again
        .file
        .field_data
        .iter()
        .find(|(name, _)| name == "edits");
    let Some((_, FieldValue::Text(text))) = edits else {
        panic!("no history")
    };
    assert_eq!(text.lines().count(), 3, "{text}");
}

#[test]
fn regions_go_with_the_cells() {
    let (image, params) = (image([90, 80]), params(5.0));
    let mut file = make_mesh(&image, &params);
    let side = |file: &MeshFile<crate::mesh::TriMesh>, c: usize| {
        let corners = file.mesh.corners(c);
        i32::from(corners.iter().map(|x| x[1]).sum::<f64>() / 3.0 > 20.0)
    };
    let regions: Vec<i32> = (0..file.mesh.triangles.len())
        .map(|c| side(&file, c))
        .collect();
    file.cell_data[0].values = regions.into();
    let after = edit_mesh(
        &file,
        &image,
        &params,
        &[AtomChange::Add(world_position([40.2, 40.3]))],
    )
    .unwrap();
    let regions = after.file.cell_data[0].values.to_f64();
    let wrong = (0..regions.len())
        .filter(|&c| regions[c] != f64::from(side(&after.file, c)))
        .count();
    assert!(wrong < 20, "{wrong} of {}", regions.len());
}

/// Returns the message of an error; checks that it is one line and has a remedy.
pub(super) fn refusal<T>(outcome: crate::Result<T>) -> String {
    let error = outcome.err().unwrap().to_string();
    assert!(!error.contains('\n') && error.contains("; "), "{error}");
    error
}

#[test]
fn impossible_edits_are_refused() {
    let (image, params) = (image([60, 50]), params(5.0));
    let file = make_mesh(&image, &params);
    let refused = |changes: &[AtomChange<2>]| refusal(edit_mesh(&file, &image, &params, changes));
    let well = world_position([30.0, 20.0]);
    let outside = refused(&[AtomChange::Add(world_position([61.0, 20.0]))]);
    assert!(
        outside.contains("edit 0") && outside.contains("outside"),
        "{outside}"
    );
    assert!(refused(&[AtomChange::Add([f64::NAN, 0.0])]).contains("outside"));
    assert!(refused(&[AtomChange::Add(well), AtomChange::Add(well)]).contains("same place"));
    assert!(refused(&[AtomChange::Remove(100_000)]).contains("has no atom 100000"));
    let corner = nearest_node(&file, [0.0, 0.0]);
    assert!(refused(&[AtomChange::Remove(corner)]).contains("corner"));
    assert!(refused(&[AtomChange::Move(corner, well)]).contains("corner"));
    assert!(refused(&[AtomChange::Add(world_position([0.0, 0.0]))]).contains("stays"));
    let inner = nearest_node(&file, [30.0, 20.0]);
    assert!(
        refused(&[AtomChange::Remove(inner), AtomChange::Move(inner, well)])
            .contains("also edited")
    );
    let other = super::tests::image([61, 50]);
    let edits = named_edits(&[AtomChange::Add(well)]);
    let error = edit_simplices(
        file,
        "mesh",
        EditImage::new(&other, &params),
        &edits,
        false,
        &mut NoProgress,
    );
    assert!(error.unwrap_err().to_string().contains("61"));
}
