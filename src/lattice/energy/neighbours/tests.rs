//! Tests of the neighbour list against all pairs.

use super::*;
use crate::geometry::random::Random;

#[test]
fn fixed_point_rounds_to_the_nearest() {
    let fixed = FixedPointMap { scale: 1024.0 };
    for (x, truth) in [(0.0, 0), (1.0, 1024), (-2.5, -2560), (0.75 / 1024.0, 1)] {
        assert_eq!(fixed.coordinate(x), truth);
    }
    assert!(FixedPointMap::new(&[255.0, 3.0]).coordinate(255.0) <= 1 << 29);
}

#[test]
fn lists_exactly_the_pairs_within_reach() {
    let fixed = FixedPointMap::new(&[20.0, 13.0, 9.0]);
    let mut random = Random::new(7);
    let positions: Vec<[f64; 3]> = (0..1500)
        .map(|_| [20.0, 13.0, 9.0].map(|e| e * random.draw()))
        .collect();
    let points: Vec<IntPoint> = positions.iter().map(|x| fixed.to_point(x)).collect();
    // The last 200 are points, but not atoms.
    let atoms = 1300;
    for slope in [0.0, 0.15] {
        let reach: Vec<f32> = positions
            .iter()
            .map(|x| ((1.5 + slope * x[0]) * fixed.scale) as f32)
            .collect();
        let mut neighbours = Neighbours::default();
        let images = MirrorImages::new([0; 4], 3);
        let halo = OwnedAndGhosts::all(atoms);
        let point_set = PointSet {
            points: &points,
            halo: &halo,
            images: &images,
            reach: &reach,
            slope: slope as f32,
        };
        neighbours.build(point_set).unwrap();
        let mut listed = 0;
        for rows in &neighbours.chunks {
            assert!(!rows.has_overflowed);
            for n in 0..rows.len() {
                let i = rows.members[n] as usize;
                assert_eq!(i, listed);
                let mut neighbour_points: Vec<u32> =
                    rows.row(n).map(|m| rows.members[m as usize]).collect();
                neighbour_points.sort_unstable();
                let truth: Vec<u32> = (0..positions.len())
                    .filter(|&j| {
                        let r2: f64 = (0..3)
                            .map(|k| (positions[i][k] - positions[j][k]).powi(2))
                            .sum();
                        i != j && r2.sqrt() * fixed.scale < f64::from(reach[i].max(reach[j]))
                    })
                    .map(|j| j as u32)
                    .collect();
                assert_eq!(neighbour_points, truth, "atom {i}");
                listed += 1;
            }
        }
        assert_eq!(listed, atoms);
    }
}
