use super::*;
use crate::files::vtk::DataArray;
use crate::mesh::poly::Lists;
use crate::mesh::poly::{FIRST_SIDE, PolyMesh};
use crate::mesh::{TetMesh, TriMesh};
use crate::model::surface::SurfaceKind;
use crate::store::MeshFile;

/// The unit cube as six tetrahedra about its diagonal, scaled to side `size`.
pub(super) fn cube(size: f64) -> TetMesh {
    let nodes: Vec<[f64; 3]> = (0..8)
        .map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|c| size * f64::from(c)))
        .collect();
    let paths = [[1, 3], [5, 1], [3, 2], [2, 6], [4, 5], [6, 4]];
    let tets = paths.iter().map(|&[a, b]| [0, a, b, 7]).collect();
    TetMesh { nodes, tets }
}

pub(super) fn mesh_file<M>(mesh: M, name: &str, bits: Vec<u8>) -> MeshFile<M> {
    MeshFile {
        mesh,
        point_data: Vec::new(),
        cell_data: vec![DataArray::scalars(name, bits)],
        field_data: Vec::new(),
    }
}

fn overlay<const D: usize>(mesh: Skeleton<D>) -> Overlay<D> {
    Overlay {
        mesh,
        ..Overlay::default()
    }
}

/// The cells of a unit cube.
pub(super) fn unit_cube() -> DrawableFaces {
    let stored = StoredMesh::new(mesh_file(cube(1.0), "none", vec![0; 6]), "cube").unwrap();
    DrawableFaces::from_mesh(&stored, &[]).unwrap()
}

#[test]
fn a_section_lies_in_its_plane_and_closes() {
    let mesh = mesh_file(cube(2.0), "feature_faces", vec![1, 0, 0, 0, 0, 0]);
    let skeleton = Skeleton::new(&mesh, &Geometry::default()).unwrap();
    // 12 faces on the sides and 6 about the diagonal; one is marked.
    assert_eq!(skeleton.kinds.len(), 18);
    assert_eq!(skeleton.kinds.iter().flatten().count(), 1);
    for axis in 0..3 {
        for at in [0.3, 1.0, 1.7] {
            let found: Vec<_> = skeleton.section(axis, at).map(|(ends, _)| ends).collect();
            // The square's rim has a side of 2 and 8 half-sides or more; every end is shared.
            let mut around = 0.0;
            for [p, q] in &found {
                assert!((p[axis] - at).abs() < 1e-12 && (q[axis] - at).abs() < 1e-12);
                let on_rim =
                    |k: &usize| *k != axis && p[*k] == q[*k] && (p[*k] == 0.0 || p[*k] == 2.0);
                if (0..3).any(|k| on_rim(&k)) {
                    around += (0..3).map(|k| (p[k] - q[k]).abs()).sum::<f64>();
                }
                for end in [p, q] {
                    let near = |r: &[f64; 3]| (0..3).all(|k| (r[k] - end[k]).abs() < 1e-12);
                    let meet = found.iter().flatten().filter(|r| near(r)).count();
                    assert!(meet >= 2, "a loose end at {end:?}");
                }
            }
            assert!(
                (around - 8.0).abs() < 1e-12,
                "axis {axis} at {at}: {around}"
            );
        }
    }
    assert_eq!(skeleton.section(0, 2.5).count(), 0);
}

#[test]
fn polygons_are_cut_as_triangles_are() {
    // One square face, upright on the plane z = 0.5.
    let skeleton = Skeleton::<3> {
        nodes: vec![[0.0; 3], [4.0, 0.0, 0.0], [4.0, 0.0, 1.0], [0.0, 0.0, 1.0]],
        faces: Lists {
            offsets: vec![0, 4],
            items: vec![0, 1, 2, 3],
        },
        kinds: vec![Some(SurfaceKind::Fault)],
    };
    let found: Vec<_> = skeleton.section(2, 0.5).collect();
    assert_eq!(
        found,
        [([[4.0, 0.0, 0.5], [0.0, 0.0, 0.5]], Some(SurfaceKind::Fault))]
    );
}

#[test]
fn the_feature_edge_is_drawn_in_its_colour_where_it_is() {
    let samples: Vec<f32> = (0..21 * 21).map(|i| (i % 21) as f32).collect();
    let image = Image::new(
        [21, 21],
        samples,
        Geometry::with_spacing([100.0, 0.0], [5.0, 5.0]),
    );
    let nodes = vec![[100.0, 0.0], [200.0, 0.0], [100.0, 100.0], [200.0, 100.0]];
    let mesh = TriMesh {
        nodes,
        triangles: vec![[0, 1, 2], [2, 1, 3]],
    };
    // The diagonal from (200, 0) to (100, 100), opposite node 0 of the first triangle.
    let mesh = mesh_file(mesh, "feature_edges", vec![1, 0]);
    let skeleton = Skeleton::new(&mesh, &image.geometry).unwrap();
    assert_eq!(
        skeleton.edges().filter(|(_, kind)| kind.is_some()).count(),
        1
    );
    let picture = draw_plane(&image, &overlay(skeleton), &Caption::default()).unwrap();
    let [width, height] = picture.size();
    // 20 steps of 8 pixels, and room for what stands round them.
    assert_eq!(
        [width, height],
        [520, 160 + (TOP_MARGIN + BOTTOM_MARGIN) as u32]
    );
    let middle = picture.color(LEFT_MARGIN as u32 + 80, TOP_MARGIN as u32 + 80);
    assert_eq!(middle, [255, 120, 0]);
    // Off the diagonal there is the image's grey: dark on the left, bright on the right.
    let [left, right] =
        [20, 140].map(|x| picture.color(LEFT_MARGIN as u32 + x, TOP_MARGIN as u32 + 40));
    assert!(
        left[0] == left[1] && left[0] < 80 && right[0] > 180,
        "{left:?} {right:?}"
    );

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    picture.write(&path).unwrap();
    let back = crate::image::formats::png::read(&path).unwrap().image;
    assert_eq!(back.dims(), [width as usize, height as usize]);
}

#[test]
fn cells_are_drawn_as_simplices_are() {
    // Two halves of a square; the face between them is on a feature.
    let mut mesh = PolyMesh {
        nodes: vec![[4.0, 0.0], [4.0, 8.0], [0.0, 0.0], [8.0, 8.0]],
        face_cells: vec![[0, 1], [0, FIRST_SIDE]],
        on_feature: vec![true, false],
        ..PolyMesh::default()
    };
    mesh.faces.push([1, 0]);
    mesh.faces.push([0, 2]);
    let geometry = Geometry::with_spacing([0.0; 2], [2.0; 2]);
    let skeleton = Skeleton::new(&mesh_file(mesh, "none", vec![]), &geometry).unwrap();
    let edges: Vec<_> = skeleton.edges().collect();
    assert_eq!(
        edges[0],
        ([[2.0, 4.0], [2.0, 0.0]], Some(SurfaceKind::Fault))
    );
    assert_eq!(edges[1], ([[2.0, 0.0], [0.0, 0.0]], None));
}

#[test]
fn three_panels_meet_at_the_point_and_points_outside_are_refused() {
    let image = Image::new([9, 7, 5], vec![0.5; 315], Geometry::default());
    let mesh = mesh_file(cube(4.0), "feature_faces", vec![0; 6]);
    let skeleton = Skeleton::new(&mesh, &image.geometry).unwrap();
    let sections = |at| Sections::new(Path::new("image"), image.dims(), &image, at);
    let through = sections([4.0, 3.0, 2.0]).unwrap();
    let picture = draw_sections(
        &through,
        &image.geometry,
        &overlay(skeleton),
        &Caption::default(),
    )
    .unwrap();
    let [width, height] = picture.size();
    // x and y across, y and z down.
    assert_eq!(
        width,
        520.max((8.0 * 14.0 + PANEL_GAP + LEFT_MARGIN + RIGHT_MARGIN) as u32)
    );
    assert_eq!(
        height,
        (8.0 * 10.0 + PANEL_GAP + TOP_MARGIN + BOTTOM_MARGIN) as u32
    );
    for wrong in [[9.0, 3.0, 2.0], [4.0, -1.0, 2.0], [4.0, 3.0, f64::NAN]] {
        assert!(sections(wrong).is_err());
    }
}

#[test]
fn the_sample_axis_of_a_survey_is_upright() {
    let mut geometry = Geometry::<3>::default();
    assert_eq!(axis_along(&geometry, 2), 2);
    geometry.axes = [[0.0, 0.0, 4.0], [25.0, 3.0, 0.0], [-3.0, 25.0, 0.0]];
    assert_eq!(axis_along(&geometry, 2), 0);
    assert_eq!([0, 1].map(|c| axis_along(&geometry, c)), [1, 2]);
}

/// A section of two rows of samples, the fast axis along time: bright early, dark late.
#[test]
fn sections_of_seismic_stand_upright_and_keep_the_shape_of_the_world() {
    let samples: Vec<f32> = (0..40 * 20).map(|i| 1.0 - (i % 40) as f32 / 39.0).collect();
    let mut geometry = Geometry::<2> {
        origin: [500.0, 1000.0],
        axes: [[0.0, 4.0], [25.0, 0.0]],
        ..Geometry::default()
    };
    let draw = |geometry: &Geometry<2>| {
        let image = Image::new([40, 20], samples.clone(), geometry.clone());
        draw_plane(&image, &Overlay::default(), &Caption::default()).unwrap()
    };
    let ends = |canvas: &Canvas| {
        let [_, height] = canvas.size();
        let x = LEFT_MARGIN as u32 + 40;
        [TOP_MARGIN as u32 + 6, height - BOTTOM_MARGIN as u32 - 6].map(|y| canvas.color(x, y)[0])
    };
    geometry.units = ["m".into(), "ms".into()];
    let [early, late] = ends(&draw(&geometry));
    assert!(early > 200 && late < 60, "{early} {late}");
    // Time counted below zero: late is lowest all the same.
    geometry.axes[0] = [0.0, -4.0];
    let [early, late] = ends(&draw(&geometry));
    assert!(early > 200 && late < 60, "{early} {late}");
    // In metres, lengths are true: 475 m wide, 156 m high, 2 pixels a metre.
    geometry.units = ["m".into(), "m".into()];
    let [width, height] = draw(&geometry).size().map(|n| n as f32);
    let shape = (width - LEFT_MARGIN - RIGHT_MARGIN) / (height - TOP_MARGIN - BOTTOM_MARGIN);
    assert!((shape - 475.0 / 156.0).abs() < 0.05, "{shape}");
}

#[test]
fn faults_and_horizons_have_colours_of_their_own() {
    let image = Image::new([21, 21], vec![0.5; 441], Geometry::default());
    let skeleton = Skeleton::<2> {
        nodes: vec![[2.0, 5.0], [18.0, 5.0], [2.0, 15.0], [18.0, 15.0]],
        faces: Lists {
            offsets: vec![0, 2, 4],
            items: vec![0, 1, 2, 3],
        },
        kinds: vec![Some(SurfaceKind::Fault), Some(SurfaceKind::Horizon)],
    };
    let picture = draw_plane(&image, &overlay(skeleton), &Caption::default()).unwrap();
    let at = |y: f32| picture.color(LEFT_MARGIN as u32 + 80, (TOP_MARGIN + 8.0 * y) as u32);
    let shades = ColorMap::from_samples(image.as_slice());
    assert_eq!(at(5.0), shades.feature_color()[..3]);
    assert_eq!(at(15.0), shades.horizon_color()[..3]);
}

#[test]
fn cells_of_the_plane_are_painted_and_lines_are_drawn_where_they_are() {
    let image = Image::new([21, 21], vec![0.5; 441], Geometry::default());
    let nodes = vec![[0.0, 0.0], [20.0, 0.0], [0.0, 20.0], [20.0, 20.0]];
    let mesh = TriMesh {
        nodes,
        triangles: vec![[0, 1, 2], [2, 1, 3]],
    };
    let mut mesh = mesh_file(mesh, "feature_edges", vec![1, 0]);
    let values = vec![0.0, 10.0, 10.0, 20.0];
    mesh.point_data.push(DataArray::scalars("pressure", values));
    let skeleton = Skeleton::new(&mesh, &image.geometry).unwrap();
    let stored = StoredMesh::new(mesh, "square").unwrap();
    let paint = Paint::from_array(&stored, "pressure", "square").unwrap();
    let painted = PaintedCells::new(&stored, paint).unwrap();
    let line = OverlayShape {
        lines: vec![vec![[2.0, 5.0, 0.0], [12.0, 5.0, 0.0]]],
        ..OverlayShape::default()
    };
    let over = Overlay {
        painted_cells: Some(painted),
        shapes: vec![line],
        ..overlay(skeleton)
    };
    let picture = draw_plane(&image, &over, &Caption::default()).unwrap();
    let at = |x: f32, y: f32| {
        picture.color(
            (LEFT_MARGIN + 8.0 * x) as u32,
            (TOP_MARGIN + 8.0 * y) as u32,
        )
    };
    let ([r, _, b], [s, _, c]) = (at(1.0, 1.0), at(19.0, 19.0));
    assert!(b > r && s > c, "{r} {b}, {s} {c}");
    // The diagonal is a feature: dark. The line is green, and ends where it ends.
    assert!(at(10.0, 10.0).iter().all(|c| *c < 40));
    let [r, g, b] = at(8.0, 5.0);
    assert!(g > r + 40 && g > b + 40, "{r} {g} {b}");
    assert_ne!(at(13.0, 5.0), [r, g, b]);
    let error = Paint::from_array(&stored, "presure", "square")
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("give one of feature_edges, pressure"),
        "{error}"
    );
}

#[test]
fn sections_are_painted_by_region_and_surfaces_leave_traces() {
    let image = Image::new([10; 3], vec![0.5; 1000], Geometry::default());
    let mesh = mesh_file(cube(9.0), "region", vec![0, 3, 3, 3, 3, 3]);
    let stored = StoredMesh::new(mesh, "cube").unwrap();
    let paint = Paint::from_array(&stored, "region", "cube").unwrap();
    let sheet = OverlayShape {
        kind: Some(SurfaceKind::Fault),
        triangles: vec![[[6.0, -30.0, -30.0], [6.0, 90.0, 4.0], [6.0, -30.0, 90.0]]],
        ..OverlayShape::default()
    };
    let over = Overlay {
        painted_cells: Some(PaintedCells::new(&stored, paint).unwrap()),
        shapes: vec![sheet],
        ..Overlay::default()
    };
    let at = [4.0, 4.0, 5.0];
    let through = Sections::new(Path::new("image"), image.dims(), &image, at).unwrap();
    let picture = draw_sections(&through, &image.geometry, &over, &Caption::default()).unwrap();
    // The section across z is the first panel, x across and y down.
    let color = |x: f32, y: f32| {
        picture.color(
            (LEFT_MARGIN + 8.0 * x) as u32,
            (TOP_MARGIN + 8.0 * y) as u32,
        )
    };
    // The first cell holds 0 < z < y < x < 9 or another order of the three; it is not painted.
    let painted = (0..81).filter(|i| {
        let [r, g, b] = color((i % 9) as f32 + 0.6, (i / 9) as f32 + 0.3);
        r != g || g != b
    });
    let painted = painted.count();
    assert!((50..80).contains(&painted), "{painted}");
    let [r, g, b] = color(6.0, 2.0);
    assert!(r > g + 60 && g > b, "{r} {g} {b}");
}
