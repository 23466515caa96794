//! Tests Voronoi cells that conform to a surface: sites on both sides of its facets make faces of
//! its facets.

use atomesh::MeshSpec;
use atomesh::feature::FeatureKind;
use atomesh::image::{Geometry, Image};
use atomesh::job::CellKind;
use atomesh::mesh::poly::PolyMesh;
use atomesh::mesh::voronoi::conform::{ConformingSites, FacetSurface};
use atomesh::mesh::voronoi::{voronoi, voronoi_plane};
use atomesh::progress::NoProgress;

const BOX: [f64; 3] = [8.0, 8.0, 8.0];

/// Pseudo-random numbers in [-0.5, 0.5) that depend on the seed only.
struct Random(u64);

impl Random {
    fn draw(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    }
}

fn distance<const D: usize>(a: &[f64; D], b: &[f64; D]) -> f64 {
    (0..D).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

fn area(x: [[f64; 3]; 3]) -> f64 {
    let [u, v]: [[f64; 3]; 2] = [1, 2].map(|i| std::array::from_fn(|k| x[i][k] - x[0][k]));
    let square: f64 = (0..3)
        .map(|k| {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            (u[i] * v[j] - u[j] * v[i]).powi(2)
        })
        .sum();
    0.5 * square.sqrt()
}

/// Adds nearly equilateral triangles between rows of nodes: `columns` steps of `u` and `rows` steps
/// of `v`. Nodes that are not on the outline are displaced by up to half of `off` steps.
fn patch(
    surface: &mut FacetSurface<3>,
    origin: [f64; 3],
    [u, v]: [[f64; 3]; 2],
    [columns, rows]: [usize; 2],
    displacement: f64,
) {
    let mut random = Random(rows as u64 + (1e6 * displacement) as u64);
    let mut previous_row: Vec<(f64, u32)> = Vec::new();
    for j in 0..=rows {
        // Every second row begins half a step later, except at its ends.
        let mut positions: Vec<f64> = (0..=columns).map(|i| i as f64).collect();
        if j % 2 == 1 {
            positions = (0..columns).map(|i| i as f64 + 0.5).collect();
            positions.insert(0, 0.0);
            positions.push(columns as f64);
        }
        let last = positions.len() - 1;
        let row: Vec<(f64, u32)> = (positions.iter().enumerate())
            .map(|(i, &position)| {
                let outline = i == 0 || i == last || j == 0 || j == rows;
                let [a, b] = [random.draw(), random.draw()]
                    .map(|r| if outline { 0.0 } else { displacement * r });
                let (s, t) = (position + a, j as f64 + b);
                let x = std::array::from_fn(|k| origin[k] + s * u[k] + t * v[k]);
                surface.nodes.push(x);
                (position, surface.nodes.len() as u32 - 1)
            })
            .collect();
        let (mut i, mut k) = (0, 0);
        while j > 0 && (i + 1 < previous_row.len() || k + 1 < row.len()) {
            let next = |row: &[(f64, u32)], index: usize| {
                row.get(index + 1).map_or(f64::INFINITY, |n| n.0)
            };
            if next(&previous_row, i) <= next(&row, k) {
                surface
                    .facets
                    .push([previous_row[i].1, previous_row[i + 1].1, row[k].1]);
                i += 1;
            } else {
                surface
                    .facets
                    .push([previous_row[i].1, row[k + 1].1, row[k].1]);
                k += 1;
            }
        }
        previous_row = row;
    }
}

/// Returns the surface with one node in place of those that coincide.
fn merge_nodes(surface: &FacetSurface<3>) -> FacetSurface<3> {
    let mut nodes: Vec<[f64; 3]> = Vec::new();
    let mut new_index = Vec::new();
    for x in &surface.nodes {
        let existing = nodes.iter().position(|y| distance(x, y) < 1e-9);
        new_index.push(existing.unwrap_or(nodes.len()) as u32);
        if existing.is_none() {
            nodes.push(*x);
        }
    }
    let renumbered = |facet: &[u32; 3]| facet.map(|n| new_index[n as usize]);
    let facets = surface.facets.iter().map(renumbered).collect();
    FacetSurface {
        nodes,
        facets,
        names: Vec::new(),
    }
}

/// Returns the Voronoi cells of the sites and of atoms around them at a similar distance, and the
/// first cell that belongs to a site.
fn cells(sites: &ConformingSites<3>) -> (PolyMesh<3>, usize) {
    let mut random = Random(5);
    let grid = (0..1000).map(|i| [i % 10, i / 10 % 10, i / 100]);
    let atoms = grid.map(|index| index.map(|c| 0.8 * (f64::from(c) + 0.5) + 0.2 * random.draw()));
    let mut atoms: Vec<[f64; 3]> = atoms.filter(|&x| sites.is_free(x)).collect();
    let first = atoms.len();
    atoms.extend(sites.sites());
    (voronoi(&atoms, BOX).unwrap(), first)
}

/// Returns the face between the two sites of the `i`-th facet that has sites.
fn face<const D: usize>(
    sites: &ConformingSites<D>,
    mesh: &PolyMesh<D>,
    first: usize,
    i: usize,
) -> usize {
    let cells = sites.site_pairs()[i].map(|site| first as u32 + site);
    let inner = &mesh.face_cells[..mesh.inner_face_count()];
    inner
        .binary_search(&cells)
        .expect("a face between the two sites")
}

/// Asserts that a facet is a face, corner for corner, if the facet and all its neighbours have
/// sites. Returns the number of these facets.
fn count_exact_faces(sites: &ConformingSites<3>, mesh: &PolyMesh<3>, first: usize) -> usize {
    let surface = sites.surface();
    let on_surface = sites.faces_on_surface(mesh, first);
    let nodes_without_sites =
        (0..surface.facets.len() as u32).filter(|f| sites.facets().binary_search(f).is_err());
    let nodes_without_sites: Vec<u32> = nodes_without_sites
        .flat_map(|f| surface.facets[f as usize])
        .collect();
    let mut count = 0;
    for (i, &f) in sites.facets().iter().enumerate() {
        if surface.facets[f as usize]
            .iter()
            .any(|n| nodes_without_sites.contains(n))
        {
            continue;
        }
        let face = face(sites, mesh, first, i);
        assert!(on_surface[face]);
        let corners = surface.corners(f as usize);
        let error = mesh.face_shape(face).area() / area(corners) - 1.0;
        assert!(error.abs() < 1e-7, "facet {f}: {error}");
        for x in &corners {
            let mut nodes = mesh.faces.get(face).iter();
            assert!(
                nodes.any(|&n| distance(&mesh.nodes[n as usize], x) < 1e-7),
                "facet {f}: {x:?}"
            );
        }
        count += 1;
    }
    count
}

/// Returns a plane of 153 triangles that crosses the whole box.
fn plane(displacement: f64) -> FacetSurface<3> {
    let mut surface = FacetSurface::default();
    let steps = [[0.0, 1.0, 0.0], [8.0 / 9.0, 0.0, 0.25]];
    patch(&mut surface, [0.0, 0.0, 3.0], steps, [8, 9], displacement);
    surface
}

#[test]
fn facets_are_faces() {
    for seed in 0..20 {
        let mut surface = plane(0.3 + 0.01 * f64::from(seed));
        surface.regularise(BOX);
        let sites = ConformingSites::new(surface, BOX, &[]);
        let (mesh, first) = cells(&sites);
        let exact = count_exact_faces(&sites, &mesh, first);
        let share = sites.covered_share(&mesh, first);
        println!("seed {seed}: {exact} of 153 exact, {share:.4}");
        assert!(
            exact >= 90 && share > 0.98,
            "seed {seed}: {exact} exact, {share}"
        );
    }
}

#[test]
fn cells_follow_crossing_surfaces_up_to_their_intersection() {
    // The angle between the surfaces is in degrees.
    for angle in [90.0f64, 60.0, 45.0] {
        let (sin, cos) = angle.to_radians().sin_cos();
        let mut surface = FacetSurface::default();
        for [x, z] in [[1.0, 0.0], [-1.0, 0.0], [cos, sin], [-cos, -sin]] {
            let steps = [[0.0, 1.0, 0.0], [0.9 * x, 0.0, 0.9 * z]];
            patch(&mut surface, [4.0, 0.0, 4.0], steps, [8, 3], 0.0);
        }
        let mut surface = merge_nodes(&surface);
        surface.regularise(BOX);
        let sites = ConformingSites::new(surface, BOX, &[]);
        let (mesh, first) = cells(&sites);
        let (exact, share) = (
            count_exact_faces(&sites, &mesh, first),
            sites.covered_share(&mesh, first),
        );
        println!("{angle} degrees: {exact} of 204 exact, {share:.4}");
        assert!(
            exact >= 120 && share > 0.998,
            "{angle}: {exact} exact, {share}"
        );
    }
}

#[test]
fn cells_of_an_image_of_two_planes_that_cross_cover_both() {
    for angle in [90.0f64, 60.0] {
        let (sin, cos) = (0.5 * angle).to_radians().sin_cos();
        // The planes cross in a line that is oblique to the axes.
        let distance_to_planes = |x: [f64; 3]| {
            let along = 0.4 * (x[2] - 30.3);
            let (u, v) = (x[0] - 30.2 - along, x[1] - 29.6 + 0.5 * along);
            (cos * u + sin * v).abs().min((cos * u - sin * v).abs())
        };
        let value = |i: usize| {
            let x = [i % 61, i / 61 % 61, i / 61 / 61].map(|c| c as f64);
            (-0.5 * (distance_to_planes(x) / 1.5).powi(2)).exp() as f32
        };
        let samples = (0..61usize.pow(3)).map(value).collect();
        let image = Image::new([61; 3], samples, Geometry::default());
        let spec = MeshSpec {
            feature: FeatureKind::Ridges,
            distance: "7".parse().unwrap(),
            cells: Some(CellKind::Voronoi),
            ..MeshSpec::default()
        };
        let report = atomesh::mesh(&image, &spec, &mut NoProgress)
            .unwrap()
            .report;
        let voronoi = report.voronoi.unwrap();
        let covered = report.fidelity.unwrap().tagged_faces.unwrap().coverage_half;
        println!("{angle} degrees: {covered:.4} {:?}", voronoi.tiny_faces);
        assert!(covered > 0.995, "{angle}: {covered}");
        assert!(voronoi.volume_ratio[0] < 6.0, "{angle}");
    }
}

#[test]
fn cells_of_atoms_on_spheres_of_nodes_reach_the_nodes() {
    let sites = ConformingSites::new(plane(0.2), BOX, &[]);
    let (mesh, _) = cells(&sites);
    let mut count = 0;
    let is_corner = |node: &&[f64; 3]| mesh.nodes.iter().any(|x| distance(x, node) < 1e-9);
    for node in sites.surface().nodes.iter().filter(is_corner) {
        let above = [node[0], node[1], node[2] + 1.0];
        let Some(x) = sites.sphere_point(*node, above) else {
            continue;
        };
        assert!(x[2] > node[2] && sites.is_free(x));
        // No other atom is nearer to the node: it lies on the side of the cell of x.
        let radius = distance(&x, node);
        let others = mesh.sites.iter().map(|site| distance(site, node));
        let nearest = others.fold(f64::INFINITY, f64::min);
        assert!(nearest > radius - 1e-9, "{node:?}: {nearest} {radius}");
        count += 1;
    }
    assert!(count > 20, "{count}");
    assert_eq!(sites.sphere_point([4.0, 4.0, 7.5], [4.0, 4.0, 8.0]), None);
}

#[test]
fn faces_end_at_the_rim_of_a_surface() {
    let mut surface = FacetSurface::default();
    let steps = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]];
    patch(&mut surface, [2.0, 2.0, 4.0], steps, [4, 4], 0.0);
    let sites = ConformingSites::new(surface, BOX, &[]);
    let (mesh, first) = cells(&sites);
    let on_surface = sites.faces_on_surface(&mesh, first);
    let (mut total, mut farthest) = (0.0, 0.0f64);
    for f in (0..on_surface.len()).filter(|&f| on_surface[f]) {
        total += mesh.face_shape(f).area();
        for &n in mesh.faces.get(f) {
            let [x, y, _] = mesh.nodes[n as usize];
            let beyond = [2.0 - x, x - 6.0, 2.0 - y, y - 6.0];
            farthest = beyond.into_iter().fold(farthest, f64::max);
        }
    }
    println!("area {total:.4} of 16, over the rim by {farthest:.4}");
    assert!(
        farthest < 0.25 && (total / 16.0 - 1.0).abs() < 0.05,
        "{farthest} {total}"
    );
}

#[test]
fn sites_keep_away_from_fixed_atoms() {
    let free = ConformingSites::new(plane(0.2), BOX, &[]);
    let fixed = free.sites()[40];
    let sites = ConformingSites::new(plane(0.2), BOX, &[fixed]);
    assert!(sites.facets().len() < free.facets().len());
    for x in sites.sites() {
        assert!(distance(&x, &fixed) > 0.2, "{x:?}");
    }
}

#[test]
fn edges_are_faces_in_the_plane() {
    let extent = [9.0, 7.0];
    let node = |i: usize| [i as f64, 3.0 + 0.8 * (0.7 * i as f64).sin()];
    let surface = FacetSurface::<2> {
        nodes: (0..9).map(node).collect(),
        facets: (0..8).map(|i| [i, i + 1]).collect(),
        names: Vec::new(),
    };
    let sites = ConformingSites::new(surface, extent, &[]);
    assert_eq!(sites.facets().len(), 8);
    let grid = (0..80).map(|i| {
        [
            0.9 * f64::from(i % 10) + 0.45,
            0.85 * f64::from(i / 10) + 0.4,
        ]
    });
    let mut atoms: Vec<[f64; 2]> = grid.filter(|&x| sites.is_free(x)).collect();
    let first = atoms.len();
    atoms.extend(sites.sites());
    let mesh = voronoi_plane(&atoms, extent).unwrap();
    let on_surface = sites.faces_on_surface(&mesh, first);
    assert_eq!(on_surface.iter().filter(|on| **on).count(), 8);
    for i in 0..8 {
        let nodes = mesh.faces.get(face(&sites, &mesh, first, i)).iter();
        for x in sites.surface().corners(i) {
            let mut ends = nodes
                .clone()
                .map(|&n| distance(&mesh.nodes[n as usize], &x));
            // The last node is a tip, where the site beyond it ends the face.
            assert!(ends.any(|distance| distance < 1e-9), "edge {i}");
        }
    }
}
