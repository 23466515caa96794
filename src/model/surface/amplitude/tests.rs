//! Tests on analytic volumes: layers of known displacement.

use super::*;
use crate::geometry::random::uniform;

/// Samples along each axis; the last is vertical, and its index grows downwards.
const DIMS: [usize; 3] = [100, 50, 110];

/// Returns the amplitude of layers at a depth: cosines of many wavelengths.
fn layers(depth: f64) -> f64 {
    let wave = |k: u64| {
        let wavelength = 8.0 + 22.0 * uniform(1, k);
        (std::f64::consts::TAU * (depth / wavelength + uniform(2, k))).cos()
    };
    (0..14).map(wave).sum::<f64>() / 14f64.sqrt()
}

/// A planar fault through `x` at mid depth that dips along x by `dip` degrees.
#[derive(Clone, Copy)]
struct Plane {
    x: f64,
    dip: f64,
    /// The throw (samples downwards) at a position along y.
    throw: fn(f64) -> f64,
}

impl Plane {
    /// Returns the horizontal distance from the fault, positive in the hanging wall.
    fn distance(&self, [x, _, z]: [f64; 3]) -> f64 {
        x - self.x - (z - 55.0) / self.dip.to_radians().tan()
    }

    /// Returns the fault as a sheet of triangles with edges of 4 samples.
    fn sheet(&self) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
        let [n, m] = [12u32, 12];
        let node = |i: u32, j: u32| {
            let (y, z) = (1.0 + 4.0 * f64::from(i), 31.0 + 4.0 * f64::from(j));
            [self.x + (z - 55.0) / self.dip.to_radians().tan(), y, z]
        };
        let nodes = (0..=n).flat_map(|i| (0..=m).map(move |j| node(i, j)));
        let index = |i: u32, j: u32| i * (m + 1) + j;
        let squares = (0..n).flat_map(|i| (0..m).map(move |j| (i, j)));
        let facets = squares.flat_map(|(i, j)| {
            let [a, b, c, d] =
                [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)].map(|(i, j)| index(i, j));
            [[a, b, d], [a, d, c]]
        });
        (nodes.collect(), facets.collect())
    }
}

/// Returns layers that the faults have displaced, with noise of `noise` times the signal. Layers dip
/// along x and y.
fn displaced(faults: &[Plane], noise: f64) -> Image<3> {
    let [nx, ny, nz] = DIMS;
    let mut samples = Vec::with_capacity(nx * ny * nz);
    for k in 0..nz {
        for j in 0..ny {
            for i in 0..nx {
                let [mut x, y, mut z] = [i, j, k].map(|i| i as f64);
                for fault in faults {
                    if fault.distance([x, y, z]) > 0.0 {
                        let throw = (fault.throw)(y);
                        x -= throw / fault.dip.to_radians().tan();
                        z -= throw;
                    }
                }
                let grain = uniform(3, samples.len() as u64) - uniform(4, samples.len() as u64);
                samples.push((layers(z + 0.12 * x - 0.08 * y) + noise * 2.45 * grain) as f32);
            }
        }
    }
    Image::new(DIMS, samples, geometry())
}

/// Returns samples of 25 x 25 x 4, with z upwards.
fn geometry() -> Geometry<3> {
    let mut geometry = Geometry::with_spacing([0.0; 3], [25.0, 25.0, 4.0]);
    geometry.axes[2][2] = -4.0;
    geometry
}

/// Measures the faults in the image.
fn measured(faults: &[Plane], image: &Image<3>) -> AmplitudeMeasures {
    let (mut nodes, mut surfaces) = (Vec::new(), Surfaces::default());
    surfaces.start.push(0);
    for fault in faults {
        let (sheet, facets) = fault.sheet();
        let first = nodes.len() as u32;
        nodes.extend(sheet);
        surfaces
            .facets
            .extend(facets.iter().map(|f| f.map(|n| n + first)));
        surfaces.start.push(surfaces.facets.len());
    }
    let kinds = vec![SurfaceKind::Fault; faults.len()];
    measure_amplitudes(
        &surfaces,
        &kinds,
        &nodes,
        image,
        &geometry(),
        [0.0, 0.0, 1.0],
    )
}

#[test]
fn throws_of_planar_faults_are_exact_to_half_a_sample() {
    for (dip, noise) in [
        (45.0, 0.0),
        (60.0, 0.0),
        (60.0, 0.5),
        (75.0, 0.25),
        (90.0, 0.0),
    ] {
        let fault = Plane {
            x: 50.0,
            dip,
            throw: |_| 7.3,
        };
        let measures = measured(&[fault], &displaced(&[fault], noise));
        let measure = measures.surfaces[0];
        let throw = measure.throw.unwrap();
        // Samples are 4 apart. The sides of a vertical fault have no order.
        let sign = if dip == 90.0 {
            throw.median.signum()
        } else {
            1.0
        };
        let [min, mean, max] = [throw.min, throw.median, throw.max].map(|t| sign * t / 4.0);
        assert!((mean - 7.3).abs() < 0.5, "{dip} {noise} {throw:?}");
        assert!(
            min.min(max) > 6.6 && min.max(max) < 8.0,
            "{dip} {noise} {throw:?}"
        );
        assert!(
            throw.correlation > 0.7 && throw.area_share > 0.6,
            "{dip} {noise} {throw:?}"
        );
        assert!(
            measure.confidence.unwrap() > 3.0,
            "{dip} {noise} {measure:?}"
        );
    }
}

/// Returns the part of a layer at this depth (before displacement) on one side of a fault, at least 4
/// samples off it, as triangles with edges of 4 samples.
fn layer_sheet(fault: Plane, depth: f64, hanging: bool) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let throw = (fault.throw)(0.0);
    let shift = throw * (1.0 + 0.12 / fault.dip.to_radians().tan());
    let level = depth + if hanging { shift } else { 0.0 };
    let node = |i: u32, j: u32| {
        let (x, y) = (2.0 + 4.0 * f64::from(i), 1.0 + 4.0 * f64::from(j));
        [x, y, level - 0.12 * x + 0.08 * y]
    };
    let nodes: Vec<[f64; 3]> = (0..24)
        .flat_map(|i| (0..12).map(move |j| node(i, j)))
        .collect();
    let squares = (0..23u32).flat_map(|i| (0..11u32).map(move |j| 12 * i + j));
    let facets = squares.flat_map(|a| [[a, a + 12, a + 13], [a, a + 13, a + 1]]);
    let is_on_side = |facet: &[u32; 3]| {
        facet.iter().all(|&n| {
            let distance = fault.distance(nodes[n as usize]);
            if hanging {
                distance > 4.0
            } else {
                distance < -4.0
            }
        })
    };
    let facets = facets.filter(is_on_side).collect();
    (nodes, facets)
}

#[test]
fn horizons_on_both_sides_give_the_throw() {
    let fault = Plane {
        x: 50.0,
        dip: 60.0,
        throw: |_| 7.3,
    };
    let mut sheets = vec![fault.sheet()];
    for depth in [46.0, 57.0, 66.0] {
        sheets.push(layer_sheet(fault, depth, false));
        sheets.push(layer_sheet(fault, depth, true));
    }
    let (mut nodes, mut surfaces) = (Vec::new(), Surfaces::default());
    surfaces.start.push(0);
    for (sheet, facets) in sheets {
        let first = nodes.len() as u32;
        nodes.extend(sheet);
        surfaces
            .facets
            .extend(facets.iter().map(|f| f.map(|n| n + first)));
        surfaces.start.push(surfaces.facets.len());
    }
    let mut kinds = vec![SurfaceKind::Horizon; 7];
    kinds[0] = SurfaceKind::Fault;
    let image = displaced(&[fault], 0.25);
    let up = [0.0, 0.0, 1.0];
    let measures = measure_amplitudes(&surfaces, &kinds, &nodes, &image, &geometry(), up);
    let measure = measures.surfaces[0];
    let throw = measure.horizon_throw.unwrap();
    // Samples are 4 apart.
    assert!((throw.median / 4.0 - 7.3).abs() < 0.6, "{throw:?}");
    assert!(throw.pairs >= 2 && throw.area_share > 0.6, "{throw:?}");
    assert!((measure.throw.unwrap().median / 4.0 - 7.3).abs() < 0.5);
    assert!(measures.surfaces[1].horizon_throw.is_none());
}

#[test]
fn two_faults_have_throws_of_opposite_sign() {
    let faults = [
        Plane {
            x: 34.0,
            dip: 70.0,
            throw: |_| 6.0,
        },
        Plane {
            x: 66.0,
            dip: 70.0,
            throw: |_| -4.5,
        },
    ];
    let measures = measured(&faults, &displaced(&faults, 0.1));
    for (measure, expected) in measures.surfaces.iter().zip([6.0, -4.5]) {
        let throw = measure.throw.unwrap();
        assert!((throw.median / 4.0 - expected).abs() < 0.3, "{throw:?}");
    }
}

#[test]
fn throw_falls_to_zero_where_a_fault_dies_out() {
    let fault = Plane {
        x: 50.0,
        dip: 65.0,
        throw: |y| 8.0 * (1.0 - y / 49.0),
    };
    let measures = measured(&[fault], &displaced(&[fault], 0.1));
    let (nodes, facets) = fault.sheet();
    let mut count = 0;
    for (facet, throw) in facets.iter().zip(&measures.throws) {
        let y = facet.iter().map(|&n| nodes[n as usize][1]).sum::<f64>() / 3.0;
        if !throw.is_nan() {
            count += 1;
            // Averages over neighbours flatten the ends.
            let error = f64::from(*throw) / 4.0 - (fault.throw)(y);
            assert!(error.abs() < 1.0, "{y} {throw}");
        }
    }
    assert!(count > facets.len() / 2, "{count} of {}", facets.len());
    let throw = measures.surfaces[0].throw.unwrap();
    assert!(throw.min / 4.0 < 1.2 && throw.max / 4.0 > 6.8, "{throw:?}");
}

#[test]
fn planes_without_displacement_have_no_throw_and_no_confidence() {
    let plane = Plane {
        x: 50.0,
        dip: 60.0,
        throw: |_| 0.0,
    };
    let measure = measured(&[plane], &displaced(&[plane], 0.3)).surfaces[0];
    let throw = measure.throw.unwrap();
    let largest = throw.min.abs().max(throw.max.abs());
    assert!(
        throw.median.abs() / 4.0 < 0.4 && largest / 4.0 < 1.0,
        "{throw:?}"
    );
    assert!(measure.confidence.unwrap() < 1.5, "{measure:?}");
    // Noise alone.
    let noise = (0..DIMS.iter().product::<usize>()).map(|i| uniform(5, i as u64) as f32);
    let noise = Image::new(DIMS, noise.collect(), geometry());
    let measure = measured(&[plane], &noise).surfaces[0];
    assert!(
        measure.throw.is_none_or(|t| t.area_share < 0.2),
        "{measure:?}"
    );
    assert!(measure.confidence.unwrap() < 1.5, "{measure:?}");
}

#[test]
fn horizons_are_peaks_or_troughs() {
    let image = Image::from_fn([20, 20, 40], Geometry::default(), |[_, _, z]| {
        5.0 + 3.0 * (std::f64::consts::TAU * z / 16.0).cos()
    });
    for (z, polarity, amplitude) in [(16.0, Polarity::Peak, 8.0), (24.0, Polarity::Trough, 2.0)] {
        let nodes = [[2.0, 2.0, z], [18.0, 2.0, z], [2.0, 18.0, z]];
        let surfaces = Surfaces {
            facets: vec![[0, 1, 2]],
            start: vec![0, 1],
            ..Surfaces::default()
        };
        let geometry = Geometry::default();
        let kinds = [SurfaceKind::Horizon];
        let up = [0.0, 0.0, 1.0];
        let measures = measure_amplitudes(&surfaces, &kinds, &nodes, &image, &geometry, up);
        let measure = measures.surfaces[0];
        assert_eq!(measure.polarity, Some(polarity));
        assert!((measure.amplitude.unwrap() - amplitude).abs() < 1e-5);
        assert!((f64::from(measures.amplitudes[0]) - amplitude).abs() < 1e-5);
        assert!(measure.confidence.unwrap() > 1.0 && measure.throw.is_none());
    }
}

#[test]
fn horizons_are_split_where_they_jump_to_another_reflector() {
    for throw in [0.0, 9.0] {
        let image = Image::from_fn([60, 40, 80], Geometry::default(), |[x, _, z]| {
            layers(if x > 30.0 { z - throw } else { z })
        });
        // A flat sheet of squares of 4 samples.
        let node = |i: u32| [4.0 * f64::from(i % 15), 4.0 * f64::from(i / 15), 40.0];
        let nodes: Vec<[f64; 3]> = (0..150).map(node).collect();
        let corners = (0..135u32).filter(|i| i % 15 < 14);
        let facets: Vec<[u32; 3]> = corners
            .flat_map(|a| [[a, a + 1, a + 16], [a, a + 16, a + 15]])
            .collect();
        let count = facets.len();
        let mut surfaces = Surfaces {
            start: vec![0, count],
            facets,
            ..Surfaces::default()
        };
        let kinds = [SurfaceKind::Horizon];
        let up = [0.0, 0.0, 1.0];
        split_horizons(&mut surfaces, &kinds, &nodes, &image, &image.geometry, up);
        if throw == 0.0 {
            assert_eq!(surfaces.start, [0, count]);
            continue;
        }
        assert!(surfaces.len() >= 2);
        let side = |facet: &[u32; 3]| {
            facet
                .iter()
                .map(|&n| nodes[n as usize][0] - 30.0)
                .sum::<f64>()
        };
        for s in 0..surfaces.len() {
            let facets = surfaces.facets_of(s);
            let right = facets.iter().filter(|facet| side(facet) > 0.0).count();
            let misplaced = right.min(facets.len() - right);
            // Clusters of 16 faces lie across the fault.
            assert!(
                misplaced * 8 <= facets.len() || facets.len() <= 2 * 16,
                "{misplaced} of {}",
                facets.len()
            );
        }
    }
}

#[test]
fn throws_of_both_signs_are_doubtful_and_the_median_ignores_outliers() {
    // A tenth of the area matches a reflector too high.
    let faces = |outlier: f64| -> Vec<[f64; 3]> {
        let good = (0..90).map(|i| [-33.0 - 0.01 * f64::from(i), 0.9, 1.0]);
        good.chain((0..10).map(|_| [outlier, 0.8, 1.0])).collect()
    };
    let throw = throw_of(&faces(160.0), 200.0).unwrap();
    assert!((throw.median + 33.4).abs() < 0.1, "{throw:?}");
    assert!(throw.is_doubtful && throw.max == 160.0, "{throw:?}");
    assert!((throw.correlation - 0.89).abs() < 1e-12 && throw.area_share == 0.5);
    assert!(!throw_of(&faces(-36.0), 200.0).unwrap().is_doubtful);
    assert_eq!(throw_of(&[], 200.0), None);
}
