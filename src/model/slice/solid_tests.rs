use super::*;
use crate::files::vtk::DataArray;
use crate::model::slice::tests::{cube, mesh_file};

/// Returns an image of 10 x 10 x 10 samples that is dark for low x and bright for high x.
fn half_dark_image() -> Image<3> {
    let samples = (0..1000).map(|i| if i % 10 < 5 { 0.0 } else { 1.0 });
    Image::new([10; 3], samples.collect(), Geometry::default())
}

/// Returns a view of a cube of six tetrahedra.
fn test_solid<'a>(image: Option<&'a Image<3>>, paint: Option<(&str, DataArray)>) -> SolidView<'a> {
    let mut mesh = mesh_file(cube(9.0), "feature_faces", vec![1, 0, 0, 0, 0, 0]);
    let color = paint.map(|(location, array)| {
        let name = array.name.clone();
        match location {
            "cells" => mesh.cell_data.push(array),
            _ => mesh.point_data.push(array),
        }
        name
    });
    let stored = StoredMesh::new(mesh, "cube").unwrap();
    SolidView {
        space: stored.space.clone(),
        image,
        mesh: Some(SolidMesh::from_stored(&stored).unwrap()),
        paint: color.map(|name| Paint::from_array(&stored, &name, "cube").unwrap()),
        shapes: Vec::new(),
        up_direction: None,
        cut: CutMode::Corner,
        cut_point: None,
    }
}

fn count_pixels(canvas: &Canvas, matches: impl Fn([u8; 3]) -> bool) -> usize {
    let [width, height] = canvas.size();
    (100..height - 100)
        .flat_map(|y| (100..width - 150).map(move |x| (x, y)))
        .filter(|&(x, y)| matches(canvas.color(x, y)))
        .count()
}

fn draw(solid: &SolidView) -> Canvas {
    solid.draw(&Caption::default()).unwrap()
}

const IS_WHITE: fn([u8; 3]) -> bool = |c| c == [255; 3];
const IS_DARK: fn([u8; 3]) -> bool = |[r, g, b]| r < 45 && g < 45 && b < 45;
const IS_BRIGHT: fn([u8; 3]) -> bool = |[r, g, b]| (150..255).contains(&r) && r == g && g == b;
const IS_RED: fn([u8; 3]) -> bool = |[r, _, b]| r > b && r - b > 60;
const IS_BLUE: fn([u8; 3]) -> bool = |[r, _, b]| b > r && b - r > 60;

#[test]
fn cells_are_painted_with_the_image_and_the_corner_is_open() {
    let image = half_dark_image();
    let cut_at = |point| SolidView {
        cut_point: Some(point),
        ..test_solid(Some(&image), None)
    };
    let uncut = draw(&cut_at([9.0, 0.0, 0.0]));
    let cut = draw(&cut_at([0.0, 9.0, 9.0]));
    let (dark, bright) = (
        count_pixels(&uncut, IS_DARK),
        count_pixels(&uncut, IS_BRIGHT),
    );
    assert!(dark > 50_000 && bright > 50_000, "{dark} {bright}");
    // Some of the cells are cut away.
    assert_ne!(count_pixels(&cut, IS_WHITE), count_pixels(&uncut, IS_WHITE));
    assert!(cut_at([10.0, 0.0, 0.0]).draw(&Caption::default()).is_err());
}

#[test]
fn a_plane_across_x_shows_what_is_behind_it() {
    let image = half_dark_image();
    // The viewer is at large x. The part that remains is dark, except for a narrow part at the
    // plane.
    for mesh in [true, false] {
        let mut half = test_solid(Some(&image), None);
        if !mesh {
            half.mesh = None;
        }
        half.cut = CutMode::X;
        half.cut_point = Some([4.0, 4.5, 4.5]);
        let half = draw(&half);
        let (dark, bright) = (count_pixels(&half, IS_DARK), count_pixels(&half, IS_BRIGHT));
        assert!(dark > 50_000 && bright < 2_000, "{mesh}: {dark} {bright}");
    }
}

#[test]
fn nodes_and_cells_are_painted_from_blue_to_red() {
    // Values by x: nodes of the cube with even numbers are on the left.
    let by_x: Vec<f64> = (0..8).map(|i| f64::from(i & 1)).collect();
    let mut painted = test_solid(None, Some(("nodes", DataArray::scalars("pressure", by_x))));
    for cut in [CutMode::Corner, CutMode::Y, CutMode::Z] {
        painted.cut = cut;
        let canvas = draw(&painted);
        let (red, blue) = (
            count_pixels(&canvas, IS_RED),
            count_pixels(&canvas, IS_BLUE),
        );
        assert!(red > 20_000 && blue > 20_000, "{cut:?}: {red} {blue}");
        // Blue is to the left of red.
        let [width, height] = canvas.size();
        let mean = |matches: fn([u8; 3]) -> bool| {
            let columns = (0..width - 150).filter(|&x| matches(canvas.color(x, height / 2)));
            let columns: Vec<u32> = columns.collect();
            columns.iter().sum::<u32>() / columns.len().max(1) as u32
        };
        assert!(mean(IS_BLUE) < mean(IS_RED), "{cut:?}");
        // The colour bar.
        let bar = [TOP_MARGIN as u32 + 3, TOP_MARGIN as u32 + 250];
        let [high, low] = bar.map(|y| canvas.color(width - RIGHT_MARGIN as u32 + 40, y));
        assert!(IS_RED(high) && IS_BLUE(low), "{high:?} {low:?}");
    }
}

#[test]
fn features_are_dark_lines_where_a_plane_cuts_them() {
    let flat = DataArray::scalars("pressure", vec![0.0, 1.0, 0.5, 0.5, 0.5, 0.5]);
    let mut painted = test_solid(None, Some(("cells", flat)));
    painted.cut = CutMode::Z;
    let black: fn([u8; 3]) -> bool = |[r, g, b]| r < 30 && g < 30 && b < 30;
    let with_features = count_pixels(&draw(&painted), black);
    for kind in &mut painted.mesh.as_mut().unwrap().faces.surfaces {
        *kind = 0;
    }
    let without_features = count_pixels(&draw(&painted), black);
    assert!(
        with_features > without_features + 500,
        "{with_features} {without_features}"
    );
}

#[test]
fn regions_have_colors_of_their_own_and_what_has_none_is_the_image() {
    let image = half_dark_image();
    let regions = DataArray::scalars("region", vec![0_i32, 0, 1, 1, 2, 2]);
    let canvas = draw(&test_solid(Some(&image), Some(("cells", regions))));
    let has_hue_of = |color: [u8; 3]| {
        move |c: [u8; 3]| {
            // The hue must fit, whatever the brightness.
            let light = f64::from(c[0]) / f64::from(color[0]);
            (0.5..1.1).contains(&light)
                && (0..3).all(|k| (f64::from(c[k]) - light * f64::from(color[k])).abs() < 4.0)
        }
    };
    let counts =
        [0, 1].map(|i| count_pixels(&canvas, has_hue_of(super::super::paint::CATEGORY_COLORS[i])));
    assert!(counts.iter().all(|n| *n > 10_000), "{counts:?}");
    assert!(count_pixels(&canvas, IS_DARK) + count_pixels(&canvas, IS_BRIGHT) > 10_000);
}

#[test]
fn near_shapes_hide_far_ones_and_stand_upright() {
    let square = |y: f64, kind| {
        let corners = [[0.0, y, 0.0], [4.0, y, 0.0], [4.0, y, 9.0], [0.0, y, 9.0]];
        let [a, b, c, d] = corners;
        OverlayShape {
            kind: Some(kind),
            triangles: vec![[a, b, c], [a, c, d]],
            ..OverlayShape::default()
        }
    };
    let line = OverlayShape {
        lines: vec![vec![[0.0, 0.0, 9.0], [4.0, 0.0, 9.0]]],
        ..OverlayShape::default()
    };
    let shapes = vec![
        square(2.0, SurfaceKind::Fault),
        square(5.0, SurfaceKind::Horizon),
        line,
    ];
    let mut view = SolidView {
        space: SolidView::bounding_space(&shapes),
        image: None,
        mesh: None,
        paint: None,
        up_direction: Some(SignedAxis {
            axis: 2,
            is_positive: true,
        }),
        shapes,
        cut: CutMode::Corner,
        cut_point: None,
    };
    let canvas = draw(&view);
    let green = |[r, g, b]: [u8; 3]| g > r && g > b && g - r > 40;
    let (near_count, far_count) = (
        count_pixels(&canvas, IS_RED),
        count_pixels(&canvas, |c| green(c) && c[2] > 80),
    );
    // The two squares are equal, but one hides a part of the other.
    assert!(
        2 * near_count > 3 * far_count && far_count > 1_000,
        "{near_count} {far_count}"
    );
    // The line is at the top or at the bottom, depending on the upward direction.
    let line_is_below = |canvas: &Canvas| {
        let [width, height] = canvas.size();
        let dark_green = |c: [u8; 3]| green(c) && c[2] < 80;
        let pixels = (0..width - 150).flat_map(|x| (60..height - 60).map(move |y| (x, y)));
        let pixels: Vec<u32> = (pixels.filter(|&(x, y)| dark_green(canvas.color(x, y))))
            .map(|(_, y)| y)
            .collect();
        assert!(pixels.len() > 100, "{}", pixels.len());
        2 * pixels.iter().sum::<u32>() / pixels.len() as u32 > height
    };
    assert!(!line_is_below(&canvas));
    view.up_direction = Some(SignedAxis {
        axis: 2,
        is_positive: false,
    });
    assert!(line_is_below(&draw(&view)));
}
