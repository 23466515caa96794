//! Tests of the grouping of facets into surfaces, and of their measures.

use super::*;
use crate::geometry::sorted_distinct;

#[test]
fn crossing_sheets_are_two_adjacent_surfaces() {
    for degrees in [30.0, 45.0, 90.0, 140.0] {
        let (nodes, facets) = crossing_sheets(degrees);
        let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
        let measures = measure(&surfaces, &nodes, &MapAxes::from_axis(2, true), &[]);
        assert_eq!(measures.len(), 2, "{degrees}");
        assert!((measures[0].area - 100.0).abs() < 1e-9 && (measures[1].area - 80.0).abs() < 1e-9);
        assert_eq!(
            [
                &measures[0].adjacent_surfaces[..],
                &measures[1].adjacent_surfaces[..]
            ],
            [[2], [1]]
        );
        assert_eq!([measures[0].components, measures[0].holes], [1, 0]);
        assert!((measures[0].rim - 40.0).abs() < 1e-9 && measures[0].rms_plane_distance < 1e-9);
    }
}

#[test]
fn the_order_of_facets_changes_nothing() {
    let (nodes, facets) = crossing_sheets(40.0);
    let expected = Surfaces::find(&nodes, facets.clone(), &[], &Options::default());
    let mut seed = 7;
    for _ in 0..5 {
        let mut keyed: Vec<(f64, [u32; 3])> =
            facets.iter().map(|&f| (random(&mut seed), f)).collect();
        keyed.sort_by(|a, b| a.0.total_cmp(&b.0));
        let shuffled = keyed.into_iter().map(|k| k.1).collect();
        assert_eq!(
            Surfaces::find(&nodes, shuffled, &[], &Options::default()),
            expected
        );
    }
}

#[test]
fn a_gap_at_the_crossing_does_not_divide_a_surface() {
    // The strips of the second sheet on both sides of the crossing are missing.
    let (nodes, mut facets) = crossing_sheets(60.0);
    let first = facets.len() - 160;
    let is_near_crossing = |f: &[u32; 3]| {
        f.iter()
            .all(|&n| dot(nodes[n as usize], [0.5, 3f64.sqrt() / 2.0, 0.0]).abs() < 1.1)
    };
    let second_sheet: Vec<[u32; 3]> = facets.drain(first..).collect();
    let (gap, kept): (Vec<_>, Vec<_>) = second_sheet.into_iter().partition(is_near_crossing);
    assert_eq!(gap.len(), 40);
    facets.extend(kept);
    let surfaces = Surfaces::find(&nodes, facets.clone(), &[], &Options::default());
    assert_eq!(surfaces.len(), 2);
    assert!((areas(&surfaces, &nodes)[1] - 60.0).abs() < 1e-9);
}

/// Returns the number of surfaces where two faults cross at a low angle and a wide strip of one of
/// them is missing. The two halves of that fault are shifted by `offset`: they stay one fault if
/// the offset is small, but not if it is larger than facets are wide.
fn wide_gap_surfaces(offset: f64) -> usize {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [10, 10], |i, j| [i - 13.0, 0.0, j]);
    add_sheet(&mut nodes, &mut facets, [10, 10], |i, j| {
        [i + 1.0, offset, j]
    });
    let (sin, cos) = 25f64.to_radians().sin_cos();
    add_sheet(&mut nodes, &mut facets, [16, 10], |i, j| {
        [(i - 8.0) * cos - 1.0, (i - 8.0) * sin, j]
    });
    let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
    let mut areas = areas(&surfaces, &nodes);
    areas.sort_by(|a, b| b.total_cmp(a));
    assert!((areas.iter().sum::<f64>() - 360.0).abs() < 1e-9);
    areas.len()
}

#[test]
fn a_missing_strip_at_a_low_angle_crossing_does_not_divide_a_surface() {
    assert_eq!(wide_gap_surfaces(0.0), 2);
    assert_eq!(wide_gap_surfaces(0.5), 2);
    assert_eq!(wide_gap_surfaces(2.5), 3);
}

/// Returns the number of surfaces of a horizon that a fault crosses. The fault is `cut` squares
/// long; ten would cut the horizon completely. Beyond the fault the horizon continues after `gap`
/// squares.
fn fault_horizon_surfaces(cut: usize, gap: f64) -> usize {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [8, 10], |i, j| [i - 8.0, j, 0.0]);
    add_sheet(&mut nodes, &mut facets, [8, 10], |i, j| [i + gap, j, 0.0]);
    let mut horizons = facets.clone();
    horizons.iter_mut().for_each(|facet| facet.sort_unstable());
    horizons.sort_unstable();
    add_sheet(&mut nodes, &mut facets, [cut, 10], |i, j| [0.0, i, j - 5.0]);
    let surfaces = Surfaces::find(&nodes, facets, &horizons, &Options::default());
    let kinds = kind::surface_kinds(&surfaces, &nodes, &horizons);
    assert_eq!(
        kinds.iter().filter(|k| **k == SurfaceKind::Fault).count(),
        1
    );
    assert_eq!(surfaces.dropped_count, 0);
    surfaces.len() - 1
}

#[test]
fn horizons_end_on_faults_but_continue_around_them() {
    assert_eq!(fault_horizon_surfaces(10, 0.0), 2);
    assert_eq!(fault_horizon_surfaces(10, 1.0), 2, "across a gap");
    assert_eq!(fault_horizon_surfaces(4, 0.0), 1, "around the fault's end");
}

#[test]
fn small_surfaces_next_to_a_large_one_are_dropped_by_default() {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [40, 40], |i, j| [i, j, 0.0]);
    add_sheet(&mut nodes, &mut facets, [4, 4], |i, j| [i, j, 9.0]);
    add_sheet(&mut nodes, &mut facets, [7, 7], |i, j| [i, j, 18.0]);
    let result = |min_area| {
        let options = Options {
            min_area,
            ..Options::default()
        };
        let surfaces = Surfaces::find(&nodes, facets.clone(), &[], &options);
        let share = surfaces.dropped_share(&nodes);
        assert!((share - surfaces.dropped_area / 1665.0).abs() < 1e-12);
        (surfaces.len(), surfaces.dropped_area)
    };
    assert_eq!(result(None), (2, 16.0));
    assert_eq!(result(Some(0.0)), (3, 0.0));
}

#[test]
fn angles_between_different_units_are_not_given() {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [8, 8], |i, j| [i, j, 2.0 * i]);
    let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
    let angles = |axis: usize, units: [&str; 3]| {
        let up = MapAxes::from_axis(axis, true).with_units(&units.map(String::from));
        let measures = measure(&surfaces, &nodes, &up, &[]);
        let rounded = |angle: Option<f64>| angle.map(|a| a.round());
        (rounded(measures[0].strike), rounded(measures[0].dip))
    };
    // The surface dips to the west.
    assert_eq!(angles(2, ["m", "m", "m"]), (Some(180.0), Some(63.0)));
    assert_eq!(angles(2, ["m", "m", "ms"]), (Some(180.0), None));
    assert_eq!(angles(0, ["m", "m", "ms"]), (None, None));
}

#[test]
fn steps_that_close_a_hole_belong_to_the_surface_but_other_fragments_do_not() {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [12, 12], |i, j| [i, j, 0.0]);
    // The two triangles of a square are replaced by four that bulge.
    let removed: Vec<[u32; 3]> = facets.drain(132..134).collect();
    let edges = |f: &[u32; 3]| {
        [[f[0], f[1]], [f[1], f[2]], [f[0], f[2]]].map(|[a, b]| [a.min(b), a.max(b)])
    };
    let mut rim: Vec<[u32; 2]> = removed.iter().flat_map(edges).collect();
    rim.sort_unstable();
    let rim: Vec<[u32; 2]> = (rim.chunk_by(|a, b| a == b))
        .filter(|same| same.len() == 1)
        .map(|same| same[0])
        .collect();
    assert_eq!(rim.len(), 4, "a square");
    let sheet_count = facets.len();
    let corner = nodes[rim[0][0] as usize];
    nodes.push([corner[0] + 0.5, corner[1] + 0.5, 0.9]);
    let top = nodes.len() as u32 - 1;
    facets.extend(rim.iter().map(|&[a, b]| [a, b, top]));
    // Another triangle stands on the sheet with one edge.
    let foot = facets[0].map(|n| nodes[n as usize]);
    nodes.push([foot[0][0], foot[0][1], 1.0]);
    facets.push([facets[0][0], facets[0][1], top + 1]);
    let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
    assert_eq!((surfaces.len(), surfaces.dropped_count), (1, 1));
    assert_eq!(surfaces.facets.len(), sheet_count + 4);
    let measures = measure(&surfaces, &nodes, &MapAxes::from_axis(2, true), &[]);
    assert_eq!((measures[0].components, measures[0].holes), (1, 0));
}

#[test]
fn a_surface_that_ends_at_another_is_separate() {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [10, 10], |i, j| [i - 5.0, 0.0, j]);
    add_sheet(&mut nodes, &mut facets, [6, 10], |i, j| {
        [0.8 * i, 0.6 * i, j]
    });
    let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
    let areas = areas(&surfaces, &nodes);
    assert!(areas.len() == 2 && (areas[0] - 100.0).abs() < 1e-9 && (areas[1] - 60.0).abs() < 1e-9);
}

#[test]
fn small_surfaces_are_dropped_and_counted() {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [6, 6], |i, j| [i, j, 0.0]);
    add_sheet(&mut nodes, &mut facets, [1, 2], |i, j| [i, j, 5.0]);
    let find = |min_area| {
        let options = Options {
            min_area,
            ..Options::default()
        };
        Surfaces::find(&nodes, facets.clone(), &[], &options)
    };
    let surfaces = find(None);
    assert_eq!((surfaces.len(), surfaces.dropped_count), (1, 1));
    assert!((surfaces.dropped_area - 2.0).abs() < 1e-12);
    assert_eq!(find(Some(1.9)).len(), 2);
    assert!(Surfaces::<3>::find(&[], vec![], &[], &Options::default()).is_empty());
}

/// Lines in 2-D are grouped as surfaces in 3-D are.
#[test]
fn crossing_lines_in_two_dimensions_are_two_surfaces() {
    let mut nodes = vec![[0.0, 0.0]];
    let mut facets = Vec::new();
    for degrees in [10.0f64, 55.0, 190.0, 235.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let mut last = 0;
        for i in 1..=12 {
            // The line is slightly curved.
            let (r, a) = (f64::from(i), 0.004 * f64::from(i * i));
            nodes.push([r * cos - a * sin, r * sin + a * cos]);
            let next = nodes.len() as u32 - 1;
            facets.push([last, next]);
            last = next;
        }
    }
    let mut surfaces = Surfaces::find(&nodes, facets.clone(), &[], &Options::default());
    surfaces.orient(&nodes, [0.0, 1.0]);
    let measures = measure(&surfaces, &nodes, &MapAxes::from_axis(1, true), &[]);
    assert_eq!(measures.len(), 2);
    for line in &measures {
        assert_eq!((line.facets, line.components, line.rim), (24, 1, 2.0));
        assert!((line.area - 24.0).abs() < 0.2 && line.strike.is_none());
        assert_eq!(line.adjacent_surfaces.len(), 1);
    }
    let mut dips: Vec<f64> = measures.iter().map(|m| m.dip.unwrap()).collect();
    dips.sort_by(f64::total_cmp);
    // The line that fits arms of 0.004 r^2 best has the slope 0.004 (3/4) 12.
    let tilt = 0.036f64.atan().to_degrees();
    assert!(
        (dips[0] - 10.0 - tilt).abs() < 0.1 && (dips[1] - 55.0 - tilt).abs() < 0.1,
        "{dips:?}"
    );
    for s in 0..2 {
        // The orientation is consistent: segments follow each other.
        let first_nodes = sorted_distinct(surfaces.facets_of(s).iter().map(|f| f[0]));
        assert_eq!(first_nodes.len(), 24);
    }
    // Without the segments at the crossing there are still two lines.
    facets.retain(|f| f[0] != 0);
    let separate = Surfaces::find(&nodes, facets, &[], &Options::default());
    assert_eq!(areas(&separate, &nodes).len(), 2);
}

#[test]
fn strike_and_dip_of_known_planes() {
    for (strike, dip) in [
        (0.0f64, 30.0f64),
        (90.0, 60.0),
        (215.0, 45.0),
        (330.0, 89.0),
    ] {
        let (s, d) = (strike.to_radians(), dip.to_radians());
        // x is east, y north, z up; the dip direction is to the right of the strike.
        let strike_direction: [f64; 3] = [s.sin(), s.cos(), 0.0];
        let dip_direction: [f64; 3] = [d.cos() * s.cos(), -d.cos() * s.sin(), -d.sin()];
        let (mut nodes, mut facets) = (Vec::new(), Vec::new());
        add_sheet(&mut nodes, &mut facets, [7, 5], |i, j| {
            std::array::from_fn(|k| 1e5 + i * strike_direction[k] + j * dip_direction[k])
        });
        // Facets are flipped at random, and `orient` restores their orientation.
        let mut seed = 3;
        facets.iter_mut().for_each(|f| {
            if random(&mut seed) < 0.5 {
                f.swap(1, 2);
            }
        });
        let mut surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
        let up = MapAxes::from_axis(2, true);
        surfaces.orient(&nodes, up.up);
        let [plane] = &measure(&surfaces, &nodes, &up, &[])[..] else {
            panic!("one")
        };
        assert!((plane.dip.unwrap() - dip).abs() < 1e-6, "{dip} {plane:?}");
        assert!(
            (plane.strike.unwrap() - strike + 180.0).rem_euclid(360.0) - 180.0 < 1e-6,
            "{plane:?}"
        );
        let is_upward = |f: &[u32; 3]| normal(&f.map(|n| nodes[n as usize]))[2] > 0.0;
        assert!(surfaces.facets.iter().all(is_upward));
        let centre: [f64; 3] =
            std::array::from_fn(|k| 1e5 + 3.5 * strike_direction[k] + 2.5 * dip_direction[k]);
        assert!(
            norm(std::array::from_fn::<f64, 3, _>(
                |k| plane.centre[k] - centre[k]
            )) < 1e-6
        );
    }
}

#[test]
fn rims_holes_and_closed_surfaces() {
    // An annulus has one hole.
    let ring = |i: f64, j: f64| {
        let a = i / 24.0 * std::f64::consts::TAU;
        [(3.0 + j) * a.cos(), (3.0 + j) * a.sin(), 0.0]
    };
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [24, 3], ring);
    // A torus is closed and has no rim; its squares bend by 30 degrees.
    add_sheet(&mut nodes, &mut facets, [24, 16], |i, j| {
        let (a, b) = (
            i / 24.0 * std::f64::consts::TAU,
            j / 16.0 * std::f64::consts::TAU,
        );
        let r = 12.0 + 5.0 * b.cos();
        [r * a.cos(), r * a.sin(), 30.0 + 5.0 * b.sin()]
    });
    let mut surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
    let up = MapAxes::from_axis(2, true);
    surfaces.orient(&nodes, up.up);
    let measures = measure(&surfaces, &nodes, &up, &[]);
    assert_eq!(measures.len(), 2);
    let (torus, ring) = (&measures[0], &measures[1]);
    assert_eq!((torus.rim, torus.components, torus.holes), (0.0, 1, 0));
    assert_eq!((ring.components, ring.holes), (1, 1));
    let perimeter = |r: f64| 24.0 * 2.0 * r * (std::f64::consts::PI / 24.0).sin();
    assert!((ring.rim - perimeter(3.0) - perimeter(6.0)).abs() < 1e-9);
    // All facets of a closed surface have the same orientation, so their normals sum to zero.
    let sum = surfaces.facets_of(0).iter().fold([0.0; 3], |sum, f| {
        geometry::add_scaled(sum, 1.0, normal(&f.map(|n| nodes[n as usize])))
    });
    assert!(norm(sum) < 1e-9 * torus.area);
}

/// Labels of facets return to the faces of all kinds of cells.
#[test]
fn labels_of_facets_return_to_their_faces() {
    fn check<const D: usize, F: Mesh<D>>(mesh: &F, face_count: usize) {
        let plane = plane_facets(mesh, 0, 2.0, |_| false);
        let labelled: Vec<([u32; D], u32)> = plane.iter().map(|&f| (f, 7)).collect();
        let labels = facet_selection::labels_of_faces(mesh, &labelled);
        assert_eq!(labels.len(), mesh.face_count());
        let marks: Vec<bool> = labels.iter().map(|&l| l == 7).collect();
        assert_eq!(
            marks.iter().filter(|is_marked| **is_marked).count(),
            face_count
        );
        assert_eq!(facet_selection::marked_facets(mesh, &marks), plane);
    }
    // A face between two simplices has two numbers.
    check::<3, TetMesh>(&cubes([4, 3, 2]), 2 * 2 * 6);
    check::<2, TriMesh>(&cubes([4, 3]), 2 * 3);
    check::<3, PolyMesh<3>>(&boxes([4, 3, 2]), 6);
    check::<2, PolyMesh<2>>(&squares([4, 3]), 3);
}

#[test]
fn surfaces_that_lie_mostly_on_horizons_are_horizons() {
    let mesh: TetMesh = cubes([6, 6, 6]);
    let (layer, fault) = (
        plane_facets(&mesh, 2, 2.0, |_| false),
        plane_facets(&mesh, 0, 3.0, |_| false),
    );
    let facets = [layer.clone(), fault.clone()].concat();
    let surfaces = Surfaces::find(&mesh.nodes, facets, &[], &Options::default());
    // Some of the fault's facets are marked as a horizon's.
    let mut horizons = [layer, fault[..10].to_vec()].concat();
    horizons.sort_unstable();
    let up = MapAxes::from_axis(2, true);
    for m in measure(&surfaces, &mesh.nodes, &up, &horizons) {
        let expected = if m.dip.unwrap() < 45.0 {
            SurfaceKind::Horizon
        } else {
            SurfaceKind::Fault
        };
        assert_eq!(m.kind, expected);
    }
    let kinds = kind::surface_kinds(&surfaces, &mesh.nodes, &[]);
    assert_eq!(kinds, [SurfaceKind::Fault; 2]);
}

#[test]
fn strike_dip_and_area_of_rough_planes_on_flat_samples() {
    for (sides, strike, dip) in [
        ([25.0, 12.5, 4.0], 20.0f64, 60.0f64),
        ([100.0, 25.0, 2.0], 20.0, 60.0),
        ([100.0, 25.0, 2.0], 110.0, 75.0),
        ([12.5, 50.0, 2.5], 300.0, 45.0),
    ] {
        let (s, d) = (strike.to_radians(), dip.to_radians());
        let strike_direction: [f64; 3] = [s.sin(), s.cos(), 0.0];
        let dip_direction: [f64; 3] = [d.cos() * s.cos(), -d.cos() * s.sin(), -d.sin()];
        // Four samples in each cell, in a survey with a depth of 200 samples; each node is
        // displaced by up to a quarter of a sample.
        let [length, depth] = [4.0 * f64::max(sides[0], sides[1]), 4.0 * sides[2] / d.sin()];
        let mut seed = 5;
        let offsets: Vec<[f64; 3]> = (0..40 * 52)
            .map(|_| std::array::from_fn(|_| 0.5 * (random(&mut seed) - 0.5)))
            .collect();
        let (mut nodes, mut facets) = (Vec::new(), Vec::new());
        add_sheet(&mut nodes, &mut facets, [30, 50], |i, j| {
            let offset = offsets[i as usize + 40 * j as usize];
            std::array::from_fn(|k| {
                (i * length * strike_direction[k] + j * depth * dip_direction[k]) / sides[k]
                    + offset[k]
            })
        });
        let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
        let origin = [5e5, 6.7e6, -2000.0];
        let to_world = |x: &[f64; 3]| std::array::from_fn(|k| origin[k] + x[k] * sides[k]);
        let world: Vec<[f64; 3]> = nodes.iter().map(to_world).collect();
        let geometry = crate::image::Geometry::with_spacing(origin, sides);
        let up = MapAxes::from_axis(2, true).with_geometry(&geometry);
        let measures = measure(&surfaces, &world, &up, &[]);
        let largest = &measures[0];
        let strike_error = (largest.strike.unwrap() - strike + 180.0).rem_euclid(360.0) - 180.0;
        assert!(strike_error.abs() < 1.0, "{sides:?} {largest:?}");
        assert!(
            (largest.dip.unwrap() - dip).abs() < 1.5,
            "{sides:?} {largest:?}"
        );
        let area = 30.0 * length * 50.0 * depth;
        assert!(
            (largest.area / area - 1.0).abs() < 0.1,
            "{sides:?} {} {area}",
            largest.area
        );
        assert!(
            largest.rms_plane_distance > 0.1 && largest.rms_plane_distance < sides[0].max(sides[1])
        );
    }
}
