//! Sites of a surface make Voronoi cells whose faces are its facets.

use atomesh::mesh::poly::PolyMesh;
use atomesh::mesh::voronoi::conform::{ConformingSites, FacetSurface};
use atomesh::mesh::voronoi::{voronoi, voronoi_plane};

const BOX: [f64; 3] = [8.0, 8.0, 8.0];

/// Numbers in [-0.5, 0.5), the same for the same seed.
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

/// Nearly equilateral triangles between rows of nodes: `columns` steps of `u`, `rows` of `v`; nodes that are
/// not on the outline are off by up to half of `off`.
fn patch(
    surface: &mut FacetSurface<3>,
    origin: [f64; 3],
    [u, v]: [[f64; 3]; 2],
    [columns, rows]: [usize; 2],
    off: f64,
) {
    let mut random = Random(rows as u64 + (1e6 * off) as u64);
    let mut below: Vec<(f64, u32)> = Vec::new();
    for j in 0..=rows {
        // Every second row begins half a step later, but for its ends.
        let mut places: Vec<f64> = (0..=columns).map(|i| i as f64).collect();
        if j % 2 == 1 {
            places = (0..columns).map(|i| i as f64 + 0.5).collect();
            places.insert(0, 0.0);
            places.push(columns as f64);
        }
        let last = places.len() - 1;
        let row: Vec<(f64, u32)> = (places.iter().enumerate())
            .map(|(i, &place)| {
                let outline = i == 0 || i == last || j == 0 || j == rows;
                let [a, b] =
                    [random.draw(), random.draw()].map(|r| if outline { 0.0 } else { off * r });
                let (s, t) = (place + a, j as f64 + b);
                let x = std::array::from_fn(|k| origin[k] + s * u[k] + t * v[k]);
                surface.nodes.push(x);
                (place, surface.nodes.len() as u32 - 1)
            })
            .collect();
        let (mut i, mut k) = (0, 0);
        while j > 0 && (i + 1 < below.len() || k + 1 < row.len()) {
            let next =
                |row: &[(f64, u32)], at: usize| row.get(at + 1).map_or(f64::INFINITY, |n| n.0);
            if next(&below, i) <= next(&row, k) {
                surface.facets.push([below[i].1, below[i + 1].1, row[k].1]);
                i += 1;
            } else {
                surface.facets.push([below[i].1, row[k + 1].1, row[k].1]);
                k += 1;
            }
        }
        below = row;
    }
}

/// The same with one node for those at one place.
fn joined(surface: &FacetSurface<3>) -> FacetSurface<3> {
    let mut nodes: Vec<[f64; 3]> = Vec::new();
    let mut number = Vec::new();
    for x in &surface.nodes {
        let same = nodes.iter().position(|y| distance(x, y) < 1e-9);
        number.push(same.unwrap_or(nodes.len()) as u32);
        if same.is_none() {
            nodes.push(*x);
        }
    }
    let renumbered = |facet: &[u32; 3]| facet.map(|n| number[n as usize]);
    let facets = surface.facets.iter().map(renumbered).collect();
    FacetSurface { nodes, facets }
}

/// Cells of sites, and of atoms around them that are about as far apart; and the first cell of a site.
fn cells(sites: &ConformingSites<3>) -> (PolyMesh<3>, usize) {
    let mut random = Random(5);
    let grid = (0..1000).map(|i| [i % 10, i / 10 % 10, i / 100]);
    let atoms = grid.map(|place| place.map(|c| 0.8 * (f64::from(c) + 0.5) + 0.2 * random.draw()));
    let mut atoms: Vec<[f64; 3]> = atoms.filter(|&x| sites.is_free(x)).collect();
    let first = atoms.len();
    atoms.extend(sites.sites());
    (voronoi(&atoms, BOX).unwrap(), first)
}

/// The face between the two sites of the i-th facet that has sites.
fn face<const D: usize>(mesh: &PolyMesh<D>, first: usize, i: usize) -> usize {
    let cells = [first + 2 * i, first + 2 * i + 1].map(|c| c as u32);
    let inner = &mesh.face_cells[..mesh.inner_face_count()];
    inner
        .binary_search(&cells)
        .expect("a face between the two sites")
}

/// Each facet, all of whose neighbours have sites as it has, is a face, corner for corner. Gives how many
/// these are.
fn exact(sites: &ConformingSites<3>, mesh: &PolyMesh<3>, first: usize) -> usize {
    let surface = sites.surface();
    let on_surface = sites.faces_on_surface(mesh, first);
    let lacking =
        (0..surface.facets.len() as u32).filter(|f| sites.facets().binary_search(f).is_err());
    let lacking: Vec<u32> = lacking.flat_map(|f| surface.facets[f as usize]).collect();
    let mut found = 0;
    for (i, &f) in sites.facets().iter().enumerate() {
        if surface.facets[f as usize]
            .iter()
            .any(|n| lacking.contains(n))
        {
            continue;
        }
        let face = face(mesh, first, i);
        assert!(on_surface[face]);
        let corners = surface.corners(f as usize);
        let off = mesh.face_shape(face).area() / area(corners) - 1.0;
        assert!(off.abs() < 1e-7, "facet {f}: {off}");
        for x in &corners {
            let mut nodes = mesh.faces.get(face).iter();
            assert!(
                nodes.any(|&n| distance(&mesh.nodes[n as usize], x) < 1e-7),
                "facet {f}: {x:?}"
            );
        }
        found += 1;
    }
    found
}

/// A plane from side to side of the box, of 153 triangles.
fn plane(off: f64) -> FacetSurface<3> {
    let mut surface = FacetSurface::default();
    let ways = [[0.0, 1.0, 0.0], [8.0 / 9.0, 0.0, 0.25]];
    patch(&mut surface, [0.0, 0.0, 3.0], ways, [8, 9], off);
    surface
}

#[test]
fn facets_are_faces() {
    for seed in 0..20 {
        let mut surface = plane(0.3 + 0.01 * f64::from(seed));
        surface.regularise(BOX);
        let sites = ConformingSites::new(surface, BOX, &[]);
        let (mesh, first) = cells(&sites);
        let found = exact(&sites, &mesh, first);
        let share = sites.covered_share(&mesh, first);
        println!("seed {seed}: {found} of 153 exact, {share:.4}");
        assert!(
            found >= 90 && share > 0.98,
            "seed {seed}: {found} exact, {share}"
        );
    }
}

#[test]
fn surfaces_that_cross_are_followed_up_to_their_line() {
    // Degrees between the two.
    for angle in [90.0f64, 60.0, 45.0] {
        let (sin, cos) = angle.to_radians().sin_cos();
        let mut surface = FacetSurface::default();
        for [x, z] in [[1.0, 0.0], [-1.0, 0.0], [cos, sin], [-cos, -sin]] {
            let ways = [[0.0, 1.0, 0.0], [0.9 * x, 0.0, 0.9 * z]];
            patch(&mut surface, [4.0, 0.0, 4.0], ways, [8, 3], 0.0);
        }
        let mut surface = joined(&surface);
        surface.regularise(BOX);
        let sites = ConformingSites::new(surface, BOX, &[]);
        let (mesh, first) = cells(&sites);
        let (found, share) = (
            exact(&sites, &mesh, first),
            sites.covered_share(&mesh, first),
        );
        println!("{angle} degrees: {found} of 204 exact, {share:.4}");
        assert!(
            found >= 45 && share > 0.85,
            "{angle}: {found} exact, {share}"
        );
    }
}

#[test]
fn faces_end_where_a_surface_does() {
    let mut surface = FacetSurface::default();
    let ways = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]];
    patch(&mut surface, [2.0, 2.0, 4.0], ways, [4, 4], 0.0);
    let sites = ConformingSites::new(surface, BOX, &[]);
    let (mesh, first) = cells(&sites);
    let on_surface = sites.faces_on_surface(&mesh, first);
    let (mut total, mut farthest) = (0.0, 0.0f64);
    for f in (0..on_surface.len()).filter(|&f| on_surface[f]) {
        total += mesh.face_shape(f).area();
        for &n in mesh.faces.get(f) {
            let [x, y, _] = mesh.nodes[n as usize];
            let over = [2.0 - x, x - 6.0, 2.0 - y, y - 6.0];
            farthest = over.into_iter().fold(farthest, f64::max);
        }
    }
    println!("area {total:.4} of 16, over the rim by {farthest:.4}");
    assert!(
        farthest < 0.25 && (total / 16.0 - 1.0).abs() < 0.05,
        "{farthest} {total}"
    );
}

#[test]
fn sites_keep_off_given_atoms() {
    let free = ConformingSites::new(plane(0.2), BOX, &[]);
    let given = free.sites()[40];
    let sites = ConformingSites::new(plane(0.2), BOX, &[given]);
    assert!(sites.facets().len() < free.facets().len());
    for x in sites.sites() {
        assert!(distance(&x, &given) > 0.2, "{x:?}");
    }
}

#[test]
fn edges_are_faces_in_the_plane() {
    let extent = [9.0, 7.0];
    let bend = |i: usize| [i as f64, 3.0 + 0.8 * (0.7 * i as f64).sin()];
    let surface = FacetSurface::<2> {
        nodes: (0..9).map(bend).collect(),
        facets: (0..8).map(|i| [i, i + 1]).collect(),
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
        let nodes = mesh.faces.get(face(&mesh, first, i)).iter();
        for x in sites.surface().corners(i) {
            let mut ends = nodes
                .clone()
                .map(|&n| distance(&mesh.nodes[n as usize], &x));
            // The last one is a tip, where the site ahead ends the face.
            assert!(ends.any(|off| off < 1e-9), "edge {i}");
        }
    }
}
