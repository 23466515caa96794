use super::*;
use crate::files::vtk::DataArray;
use crate::mesh::poly::Lists;
use crate::mesh::poly::{FIRST_SIDE, PolyMesh};
use crate::mesh::{TetMesh, TriMesh};
use crate::model::surface::SurfaceKind;
use crate::store::MeshFile;

/// Returns a cube of side `size` as six tetrahedra around its diagonal.
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

/// Returns the faces of a unit cube of six tetrahedra.
pub(super) fn unit_cube() -> DrawableFaces {
    let stored = StoredMesh::new(mesh_file(cube(1.0), "none", vec![0; 6]), "cube").unwrap();
    DrawableFaces::from_mesh(&stored, &[]).unwrap()
}

#[test]
fn a_section_lies_in_its_plane_and_closes() {
    let mesh = mesh_file(cube(2.0), "feature_faces", vec![1, 0, 0, 0, 0, 0]);
    let skeleton = Skeleton::new(&mesh, &Geometry::default()).unwrap();
    // There are 12 faces on the sides and 6 around the diagonal; one lies on a feature.
    assert_eq!(skeleton.kinds.len(), 18);
    assert_eq!(skeleton.kinds.iter().flatten().count(), 1);
    for axis in 0..3 {
        for position in [0.3, 1.0, 1.7] {
            let segments: Vec<_> = skeleton
                .section(axis, position)
                .map(|(ends, _)| ends)
                .collect();
            // The rim of the section is a square of side 2. Every end must belong to at least two
            // segments.
            let mut rim_length = 0.0;
            for [p, q] in &segments {
                assert!((p[axis] - position).abs() < 1e-12 && (q[axis] - position).abs() < 1e-12);
                let on_rim =
                    |k: &usize| *k != axis && p[*k] == q[*k] && (p[*k] == 0.0 || p[*k] == 2.0);
                if (0..3).any(|k| on_rim(&k)) {
                    rim_length += (0..3).map(|k| (p[k] - q[k]).abs()).sum::<f64>();
                }
                for end in [p, q] {
                    let coincides = |r: &[f64; 3]| (0..3).all(|k| (r[k] - end[k]).abs() < 1e-12);
                    let meeting_count = segments.iter().flatten().filter(|r| coincides(r)).count();
                    assert!(meeting_count >= 2, "a loose end at {end:?}");
                }
            }
            assert!(
                (rim_length - 8.0).abs() < 1e-12,
                "axis {axis} at {position}: {rim_length}"
            );
        }
    }
    assert_eq!(skeleton.section(0, 2.5).count(), 0);
}

#[test]
fn polygons_are_cut_as_triangles_are() {
    // One rectangular face that crosses the plane z = 0.5 at right angles.
    let skeleton = Skeleton::<3> {
        nodes: vec![[0.0; 3], [4.0, 0.0, 0.0], [4.0, 0.0, 1.0], [0.0, 0.0, 1.0]],
        faces: Lists {
            offsets: vec![0, 4],
            items: vec![0, 1, 2, 3],
        },
        kinds: vec![Some(SurfaceKind::Fault)],
    };
    let segments: Vec<_> = skeleton.section(2, 0.5).collect();
    assert_eq!(
        segments,
        [([[4.0, 0.0, 0.5], [0.0, 0.0, 0.5]], Some(SurfaceKind::Fault))]
    );
}

#[test]
fn the_feature_edge_is_drawn_in_its_color_where_it_is() {
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
    // 20 steps of 8 pixels, and the margins.
    assert_eq!(
        [width, height],
        [520, 160 + (TOP_MARGIN + BOTTOM_MARGIN) as u32]
    );
    let middle = picture.color(LEFT_MARGIN as u32 + 80, TOP_MARGIN as u32 + 80);
    assert_eq!(middle, [255, 120, 0]);
    // Next to the diagonal is the image's grey: dark on the left, bright on the right.
    let [left, right] =
        [20, 140].map(|x| picture.color(LEFT_MARGIN as u32 + x, TOP_MARGIN as u32 + 40));
    assert!(
        left[0] == left[1] && left[0] < 80 && right[0] > 180,
        "{left:?} {right:?}"
    );

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    picture.write(&path).unwrap();
    let decoded = crate::image::formats::png::read(&path).unwrap().image;
    assert_eq!(decoded.dims(), [width as usize, height as usize]);
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
    let sections = |point| Sections::new(Path::new("image"), image.dims(), &image, point);
    let planes = sections([4.0, 3.0, 2.0]).unwrap();
    let picture = draw_sections(
        &planes,
        &image.geometry,
        &overlay(skeleton),
        &Caption::default(),
    )
    .unwrap();
    let [width, height] = picture.size();
    // The panels show x and y horizontally, y and z vertically.
    assert_eq!(
        width,
        520.max((8.0 * 14.0 + PANEL_GAP + LEFT_MARGIN + RIGHT_MARGIN) as u32)
    );
    assert_eq!(
        height,
        (8.0 * 10.0 + PANEL_GAP + TOP_MARGIN + BOTTOM_MARGIN) as u32
    );
    for outside in [[9.0, 3.0, 2.0], [4.0, -1.0, 2.0], [4.0, 3.0, f64::NAN]] {
        assert!(sections(outside).is_err());
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

/// A 2-D section whose fast axis is time: bright at early times, dark at late ones.
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
    // With negative times, too, late samples are at the bottom.
    geometry.axes[0] = [0.0, -4.0];
    let [early, late] = ends(&draw(&geometry));
    assert!(early > 200 && late < 60, "{early} {late}");
    // With both axes in metres, lengths are true to scale: 475 m wide and 156 m high.
    geometry.units = ["m".into(), "m".into()];
    let [width, height] = draw(&geometry).size().map(|n| n as f32);
    let shape = (width - LEFT_MARGIN - RIGHT_MARGIN) / (height - TOP_MARGIN - BOTTOM_MARGIN);
    assert!((shape - 475.0 / 156.0).abs() < 0.05, "{shape}");
}

#[test]
fn faults_and_horizons_have_colors_of_their_own() {
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
    let color_at = |y: f32| picture.color(LEFT_MARGIN as u32 + 80, (TOP_MARGIN + 8.0 * y) as u32);
    let color_map = ColorMap::from_samples(image.as_slice());
    assert_eq!(color_at(5.0), color_map.feature_color()[..3]);
    assert_eq!(color_at(15.0), color_map.horizon_color()[..3]);
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
    let painted_overlay = Overlay {
        painted_cells: Some(painted),
        shapes: vec![line],
        ..overlay(skeleton)
    };
    let picture = draw_plane(&image, &painted_overlay, &Caption::default()).unwrap();
    let color_at = |x: f32, y: f32| {
        picture.color(
            (LEFT_MARGIN + 8.0 * x) as u32,
            (TOP_MARGIN + 8.0 * y) as u32,
        )
    };
    let ([r, _, b], [s, _, c]) = (color_at(1.0, 1.0), color_at(19.0, 19.0));
    assert!(b > r && s > c, "{r} {b}, {s} {c}");
    // The diagonal is a feature and is dark. The line is green and ends at its last point.
    assert!(color_at(10.0, 10.0).iter().all(|c| *c < 40));
    let [r, g, b] = color_at(8.0, 5.0);
    assert!(g > r + 40 && g > b + 40, "{r} {g} {b}");
    assert_ne!(color_at(13.0, 5.0), [r, g, b]);
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
    let fault = OverlayShape {
        kind: Some(SurfaceKind::Fault),
        triangles: vec![[[6.0, -30.0, -30.0], [6.0, 90.0, 4.0], [6.0, -30.0, 90.0]]],
        ..OverlayShape::default()
    };
    let fault_overlay = Overlay {
        painted_cells: Some(PaintedCells::new(&stored, paint).unwrap()),
        shapes: vec![fault],
        ..Overlay::default()
    };
    let point = [4.0, 4.0, 5.0];
    let planes = Sections::new(Path::new("image"), image.dims(), &image, point).unwrap();
    let picture = draw_sections(
        &planes,
        &image.geometry,
        &fault_overlay,
        &Caption::default(),
    )
    .unwrap();
    // The section across z is the first panel, with x to the right and y downwards.
    let color = |x: f32, y: f32| {
        picture.color(
            (LEFT_MARGIN + 8.0 * x) as u32,
            (TOP_MARGIN + 8.0 * y) as u32,
        )
    };
    // The first cell has region 0 and is not painted; it covers one sixth of the cube.
    let painted = (0..81).filter(|i| {
        let [r, g, b] = color((i % 9) as f32 + 0.6, (i / 9) as f32 + 0.3);
        r != g || g != b
    });
    let painted = painted.count();
    assert!((50..80).contains(&painted), "{painted}");
    let [r, g, b] = color(6.0, 2.0);
    assert!(r > g + 60 && g > b, "{r} {g} {b}");
}
