//! Facets into surfaces, and their measures.

use super::*;

#[test]
fn sheets_that_cross_stay_two_and_meet() {
    for degrees in [30.0, 45.0, 90.0, 140.0] {
        let (nodes, facets) = crossing_sheets(degrees);
        let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
        let found = measure(&surfaces, &nodes, &MapAxes::from_axis(2, true), &[]);
        assert_eq!(found.len(), 2, "{degrees}");
        assert!((found[0].area - 100.0).abs() < 1e-9 && (found[1].area - 80.0).abs() < 1e-9);
        assert_eq!(
            [
                &found[0].adjacent_surfaces[..],
                &found[1].adjacent_surfaces[..]
            ],
            [[2], [1]]
        );
        assert_eq!([found[0].components, found[0].holes], [1, 0]);
        assert!((found[0].rim - 40.0).abs() < 1e-9 && found[0].rms_plane_distance < 1e-9);
    }
}

#[test]
fn the_order_of_facets_changes_nothing() {
    let (nodes, facets) = crossing_sheets(40.0);
    let want = Surfaces::find(&nodes, facets.clone(), &[], &Options::default());
    let mut seed = 7;
    for _ in 0..5 {
        let mut keyed: Vec<(f64, [u32; 3])> =
            facets.iter().map(|&f| (random(&mut seed), f)).collect();
        keyed.sort_by(|a, b| a.0.total_cmp(&b.0));
        let shuffled = keyed.into_iter().map(|k| k.1).collect();
        assert_eq!(
            Surfaces::find(&nodes, shuffled, &[], &Options::default()),
            want
        );
    }
}

#[test]
fn a_gap_at_the_crossing_does_not_part_a_surface() {
    // Of the second sheet, the strips on both sides of the crossing are missing.
    let (nodes, mut facets) = crossing_sheets(60.0);
    let first = facets.len() - 160;
    let off = |f: &[u32; 3]| {
        f.iter()
            .all(|&n| dot(nodes[n as usize], [0.5, 3f64.sqrt() / 2.0, 0.0]).abs() < 1.1)
    };
    let rest: Vec<[u32; 3]> = facets.drain(first..).collect();
    let (gap, kept): (Vec<_>, Vec<_>) = rest.into_iter().partition(off);
    assert_eq!(gap.len(), 40);
    facets.extend(kept);
    let surfaces = Surfaces::find(&nodes, facets.clone(), &[], &Options::default());
    assert_eq!(surfaces.len(), 2);
    assert!((areas(&surfaces, &nodes)[1] - 60.0).abs() < 1e-9);
}

/// Where two faults cross at a low angle, of the one a wide strip is missing: it stays one. A parallel
/// fault that ends at the same crossing, but farther off than facets are wide, does not join it.
fn wide_gap_surfaces(off: f64) -> usize {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [10, 10], |i, j| [i - 13.0, 0.0, j]);
    add_sheet(&mut nodes, &mut facets, [10, 10], |i, j| [i + 1.0, off, j]);
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
fn a_strip_missing_at_a_low_angle_crossing_does_not_part_a_surface() {
    assert_eq!(wide_gap_surfaces(0.0), 2);
    assert_eq!(wide_gap_surfaces(0.5), 2);
    assert_eq!(wide_gap_surfaces(2.5), 3);
}

/// A horizon and a fault across it, `cut` squares long of the ten that it would need; beyond the fault
/// the horizon goes on after `gap` squares.
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
fn horizons_end_on_faults_but_go_on_around_them() {
    assert_eq!(fault_horizon_surfaces(10, 0.0), 2);
    assert_eq!(fault_horizon_surfaces(10, 1.0), 2, "across a gap");
    assert_eq!(fault_horizon_surfaces(4, 0.0), 1, "around the fault's end");
}

#[test]
fn confetti_beside_a_large_surface_is_dropped_by_default() {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [40, 40], |i, j| [i, j, 0.0]);
    add_sheet(&mut nodes, &mut facets, [4, 4], |i, j| [i, j, 9.0]);
    add_sheet(&mut nodes, &mut facets, [7, 7], |i, j| [i, j, 18.0]);
    let found = |min_area| {
        let options = Options {
            min_area,
            ..Options::default()
        };
        let surfaces = Surfaces::find(&nodes, facets.clone(), &[], &options);
        let share = surfaces.dropped_share(&nodes);
        assert!((share - surfaces.dropped_area / 1665.0).abs() < 1e-12);
        (surfaces.len(), surfaces.dropped_area)
    };
    assert_eq!(found(None), (2, 16.0));
    assert_eq!(found(Some(0.0)), (3, 0.0));
}

#[test]
fn angles_between_different_units_are_not_given() {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [8, 8], |i, j| [i, j, 2.0 * i]);
    let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
    let angles = |axis: usize, units: [&str; 3]| {
        let up = MapAxes::from_axis(axis, true).with_units(&units.map(String::from));
        let found = measure(&surfaces, &nodes, &up, &[]);
        let round = |angle: Option<f64>| angle.map(|a| a.round());
        (round(found[0].strike), round(found[0].dip))
    };
    // The surface dips to the west.
    assert_eq!(angles(2, ["m", "m", "m"]), (Some(180.0), Some(63.0)));
    assert_eq!(angles(2, ["m", "m", "ms"]), (Some(180.0), None));
    assert_eq!(angles(0, ["m", "m", "ms"]), (None, None));
}

#[test]
fn steps_that_close_a_hole_are_of_the_surface_and_what_stands_on_it_is_not() {
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [12, 12], |i, j| [i, j, 0.0]);
    // The two triangles of a square go, and four that bulge come.
    let gone: Vec<[u32; 3]> = facets.drain(132..134).collect();
    let edges = |f: &[u32; 3]| {
        [[f[0], f[1]], [f[1], f[2]], [f[0], f[2]]].map(|[a, b]| [a.min(b), a.max(b)])
    };
    let mut rim: Vec<[u32; 2]> = gone.iter().flat_map(edges).collect();
    rim.sort_unstable();
    let rim: Vec<[u32; 2]> = (rim.chunk_by(|a, b| a == b))
        .filter(|same| same.len() == 1)
        .map(|same| same[0])
        .collect();
    assert_eq!(rim.len(), 4, "a square");
    let whole = facets.len();
    let corner = nodes[rim[0][0] as usize];
    nodes.push([corner[0] + 0.5, corner[1] + 0.5, 0.9]);
    let top = nodes.len() as u32 - 1;
    facets.extend(rim.iter().map(|&[a, b]| [a, b, top]));
    // And one that stands on the sheet with one edge.
    let foot = facets[0].map(|n| nodes[n as usize]);
    nodes.push([foot[0][0], foot[0][1], 1.0]);
    facets.push([facets[0][0], facets[0][1], top + 1]);
    let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
    assert_eq!((surfaces.len(), surfaces.dropped_count), (1, 1));
    assert_eq!(surfaces.facets.len(), whole + 4);
    let found = measure(&surfaces, &nodes, &MapAxes::from_axis(2, true), &[]);
    assert_eq!((found[0].components, found[0].holes), (1, 0));
}

#[test]
fn a_surface_that_ends_at_another_is_its_own() {
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

/// Lines that cross: the same grouping, one dimension down.
#[test]
fn in_two_dimensions_lines_cross_too() {
    let mut nodes = vec![[0.0, 0.0]];
    let mut facets = Vec::new();
    for degrees in [10.0f64, 55.0, 190.0, 235.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let mut last = 0;
        for i in 1..=12 {
            // Not quite straight.
            let (r, a) = (f64::from(i), 0.004 * f64::from(i * i));
            nodes.push([r * cos - a * sin, r * sin + a * cos]);
            let next = nodes.len() as u32 - 1;
            facets.push([last, next]);
            last = next;
        }
    }
    let mut surfaces = Surfaces::find(&nodes, facets.clone(), &[], &Options::default());
    surfaces.orient(&nodes, [0.0, 1.0]);
    let found = measure(&surfaces, &nodes, &MapAxes::from_axis(1, true), &[]);
    assert_eq!(found.len(), 2);
    for line in &found {
        assert_eq!((line.facets, line.components, line.rim), (24, 1, 2.0));
        assert!((line.area - 24.0).abs() < 0.2 && line.strike.is_none());
        assert_eq!(line.adjacent_surfaces.len(), 1);
    }
    let mut dips: Vec<f64> = found.iter().map(|m| m.dip.unwrap()).collect();
    dips.sort_by(f64::total_cmp);
    // The line that fits arms of 0.004 r^2 best rises by 0.004 (3/4) 12.
    let tilt = 0.036f64.atan().to_degrees();
    assert!(
        (dips[0] - 10.0 - tilt).abs() < 0.1 && (dips[1] - 55.0 - tilt).abs() < 0.1,
        "{dips:?}"
    );
    for s in 0..2 {
        // Consistent orientation: the segments follow each other.
        let mut begin: Vec<u32> = surfaces.facets_of(s).iter().map(|f| f[0]).collect();
        begin.sort_unstable();
        begin.dedup();
        assert_eq!(begin.len(), 24);
    }
    // Without the segments at the crossing it stays two lines.
    facets.retain(|f| f[0] != 0);
    let apart = Surfaces::find(&nodes, facets, &[], &Options::default());
    assert_eq!(areas(&apart, &nodes).len(), 2);
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
        // x is east, y north, z up; down the dip is to the right of the strike.
        let along: [f64; 3] = [s.sin(), s.cos(), 0.0];
        let down: [f64; 3] = [d.cos() * s.cos(), -d.cos() * s.sin(), -d.sin()];
        let (mut nodes, mut facets) = (Vec::new(), Vec::new());
        add_sheet(&mut nodes, &mut facets, [7, 5], |i, j| {
            std::array::from_fn(|k| 1e5 + i * along[k] + j * down[k])
        });
        // Turned at random: orientation is found again.
        let mut seed = 3;
        facets.iter_mut().for_each(|f| {
            if random(&mut seed) < 0.5 {
                f.swap(1, 2);
            }
        });
        let mut surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
        let up = MapAxes::from_axis(2, true);
        surfaces.orient(&nodes, up.up);
        let [found] = &measure(&surfaces, &nodes, &up, &[])[..] else {
            panic!("one")
        };
        assert!((found.dip.unwrap() - dip).abs() < 1e-6, "{dip} {found:?}");
        assert!(
            (found.strike.unwrap() - strike + 180.0).rem_euclid(360.0) - 180.0 < 1e-6,
            "{found:?}"
        );
        let all_up = |f: &[u32; 3]| normal(&f.map(|n| nodes[n as usize]))[2] > 0.0;
        assert!(surfaces.facets.iter().all(all_up));
        let middle: [f64; 3] = std::array::from_fn(|k| 1e5 + 3.5 * along[k] + 2.5 * down[k]);
        assert!(
            norm(std::array::from_fn::<f64, 3, _>(
                |k| found.centre[k] - middle[k]
            )) < 1e-6
        );
    }
}

#[test]
fn rims_holes_and_closed_surfaces() {
    // A ring: an annulus has a hole.
    let ring = |i: f64, j: f64| {
        let a = i / 24.0 * std::f64::consts::TAU;
        [(3.0 + j) * a.cos(), (3.0 + j) * a.sin(), 0.0]
    };
    let (mut nodes, mut facets) = (Vec::new(), Vec::new());
    add_sheet(&mut nodes, &mut facets, [24, 3], ring);
    // A torus: closed, no rim; bends of 30 degrees from square to square.
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
    let found = measure(&surfaces, &nodes, &up, &[]);
    assert_eq!(found.len(), 2);
    let (torus, ring) = (&found[0], &found[1]);
    assert_eq!((torus.rim, torus.components, torus.holes), (0.0, 1, 0));
    assert_eq!((ring.components, ring.holes), (1, 1));
    let around = |r: f64| 24.0 * 2.0 * r * (std::f64::consts::PI / 24.0).sin();
    assert!((ring.rim - around(3.0) - around(6.0)).abs() < 1e-9);
    // All of a closed surface's facets show the same side: their normals sum to zero.
    let sum = surfaces.facets_of(0).iter().fold([0.0; 3], |sum, f| {
        geometry::add_scaled(sum, 1.0, normal(&f.map(|n| nodes[n as usize])))
    });
    assert!(norm(sum) < 1e-9 * torus.area);
}

/// Faces of all kinds of cells know by number what their facets are labelled.
#[test]
fn labels_come_back_to_the_faces_they_were_given() {
    fn check<const D: usize, F: Mesh<D>>(mesh: &F, numbers: usize) {
        let wall = plane_facets(mesh, 0, 2.0, |_| false);
        let labelled: Vec<([u32; D], u32)> = wall.iter().map(|&f| (f, 7)).collect();
        let labels = facet_selection::labels_of_faces(mesh, &labelled);
        assert_eq!(labels.len(), mesh.face_count());
        let marks: Vec<bool> = labels.iter().map(|&l| l == 7).collect();
        assert_eq!(marks.iter().filter(|on| **on).count(), numbers);
        assert_eq!(facet_selection::marked_facets(mesh, &marks), wall);
    }
    // Both numbers of a face between two simplices.
    check::<3, TetMesh>(&cubes([4, 3, 2]), 2 * 2 * 6);
    check::<2, TriMesh>(&cubes([4, 3]), 2 * 3);
    #[cfg(feature = "tetgen")]
    check::<3, PolyMesh<3>>(&boxes([4, 3, 2]), 6);
    check::<2, PolyMesh<2>>(&squares([4, 3]), 3);
}

#[test]
fn surfaces_that_are_mostly_of_horizons_are_horizons() {
    let mesh: TetMesh = cubes([6, 6, 6]);
    let (layer, fault) = (
        plane_facets(&mesh, 2, 2.0, |_| false),
        plane_facets(&mesh, 0, 3.0, |_| false),
    );
    let facets = [layer.clone(), fault.clone()].concat();
    let surfaces = Surfaces::find(&mesh.nodes, facets, &[], &Options::default());
    // A few of the fault's facets are taken for a horizon's.
    let mut horizons = [layer, fault[..10].to_vec()].concat();
    horizons.sort_unstable();
    let up = MapAxes::from_axis(2, true);
    for m in measure(&surfaces, &mesh.nodes, &up, &horizons) {
        let want = if m.dip.unwrap() < 45.0 {
            SurfaceKind::Horizon
        } else {
            SurfaceKind::Fault
        };
        assert_eq!(m.kind, want);
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
        let along: [f64; 3] = [s.sin(), s.cos(), 0.0];
        let down: [f64; 3] = [d.cos() * s.cos(), -d.cos() * s.sin(), -d.sin()];
        // Four samples to a cell, in a survey of 200 samples down; each node off by up to a quarter of one.
        let [length, depth] = [4.0 * f64::max(sides[0], sides[1]), 4.0 * sides[2] / d.sin()];
        let mut seed = 5;
        let offsets: Vec<[f64; 3]> = (0..40 * 52)
            .map(|_| std::array::from_fn(|_| 0.5 * (random(&mut seed) - 0.5)))
            .collect();
        let (mut nodes, mut facets) = (Vec::new(), Vec::new());
        add_sheet(&mut nodes, &mut facets, [30, 50], |i, j| {
            let off = offsets[i as usize + 40 * j as usize];
            std::array::from_fn(|k| {
                (i * length * along[k] + j * depth * down[k]) / sides[k] + off[k]
            })
        });
        let surfaces = Surfaces::find(&nodes, facets, &[], &Options::default());
        let origin = [5e5, 6.7e6, -2000.0];
        let to_world = |x: &[f64; 3]| std::array::from_fn(|k| origin[k] + x[k] * sides[k]);
        let world: Vec<[f64; 3]> = nodes.iter().map(to_world).collect();
        let geometry = crate::image::Geometry::with_spacing(origin, sides);
        let up = MapAxes::from_axis(2, true).with_geometry(&geometry);
        let found = measure(&surfaces, &world, &up, &[]);
        let largest = &found[0];
        let turned = (largest.strike.unwrap() - strike + 180.0).rem_euclid(360.0) - 180.0;
        assert!(turned.abs() < 1.0, "{sides:?} {largest:?}");
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
