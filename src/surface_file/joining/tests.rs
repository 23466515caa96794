//! Tests the joining of sticks that were picked on surfaces that are known exactly.

use super::*;
use crate::geometry::random::Random;
use crate::geometry::{cross, sub};

/// Length of a sample in metres: no place of a joined surface may be farther off.
const SAMPLE: f64 = 10.0;

/// Largest error of the area.
const MAX_AREA_ERROR: f64 = 0.02;

/// Number of sections on which sticks are picked.
const SECTIONS: usize = 9;

/// Top and base, and length along the strike.
const DEPTHS: [f64; 2] = [-5.0, -305.0];
const LENGTH: f64 = 600.0;

/// Shapes of faults.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Shape {
    Plane,
    /// Bends along its strike.
    Curved,
    /// Flattens downwards on an arc.
    Listric,
    /// Its dip changes along its strike.
    Twisted,
}

/// A fault: x across the strike is a function of the place along the strike and of z.
#[derive(Debug, Clone, Copy)]
struct Fault {
    shape: Shape,
    dip: f64,
    strike: f64,
}

impl Fault {
    fn across(&self, s: f64, z: f64) -> f64 {
        let (depth, height, dip) = (DEPTHS[0] - z, DEPTHS[0] - DEPTHS[1], self.dip.to_radians());
        match self.shape {
            Shape::Plane => depth / dip.tan(),
            Shape::Curved => {
                depth / dip.tan() + 0.12 * LENGTH * (std::f64::consts::PI * s / LENGTH).sin()
            }
            Shape::Listric => {
                let base_dip = (self.dip - 40.0).max(15.0).to_radians();
                let radius = height / (base_dip.cos() - dip.cos());
                let angle = (dip.cos() + depth / radius).clamp(-1.0, 1.0).acos();
                radius * (dip.sin() - angle.sin())
            }
            Shape::Twisted => depth / (dip + 0.3 * (s / LENGTH - 0.5)).tan(),
        }
    }

    fn point(&self, s: f64, z: f64) -> Point {
        let ((sin, cos), n) = (self.strike.to_radians().sin_cos(), self.across(s, z));
        [1000.0 + s * sin + n * cos, 2000.0 + s * cos - n * sin, z]
    }

    /// Returns the distance of a point near the surface from it, to first order.
    fn distance(&self, p: Point) -> f64 {
        let (sin, cos) = self.strike.to_radians().sin_cos();
        let (x, y) = (p[0] - 1000.0, p[1] - 2000.0);
        let (n, s) = (x * cos - y * sin, x * sin + y * cos);
        let z = p[2].clamp(DEPTHS[1] + 0.1, DEPTHS[0] - 0.1);
        let slope_s = (self.across(s + 0.1, z) - self.across(s - 0.1, z)) / 0.2;
        let slope_z = (self.across(s, z + 0.1) - self.across(s, z - 0.1)) / 0.2;
        let normal = norm([1.0, slope_s, slope_z]);
        (n - self.across(s, p[2].clamp(DEPTHS[1], DEPTHS[0]))).abs() / normal
    }

    /// Returns the area between two curves s(z).
    fn area(&self, low: impl Fn(f64) -> f64, high: impl Fn(f64) -> f64) -> f64 {
        const N: usize = 24;
        let share = |k: usize| k as f64 / N as f64;
        let node = |i: usize, j: usize| {
            let z = DEPTHS[0] + (DEPTHS[1] - DEPTHS[0]) * share(j);
            self.point(low(z) + (high(z) - low(z)) * share(i), z)
        };
        let cells = (0..N).flat_map(|i| (0..N).map(move |j| (i, j)));
        cells
            .map(|(i, j)| {
                let [a, b, c, d] = [
                    node(i, j),
                    node(i + 1, j),
                    node(i, j + 1),
                    node(i + 1, j + 1),
                ];
                area(&[a, b, c]) + area(&[d, b, c])
            })
            .sum()
    }

    /// Returns the place along the strike at which an upright section, which starts at `s` and turns
    /// by `angle` from the dip direction, cuts the fault at z.
    fn section(&self, s: f64, angle: f64, z: f64) -> f64 {
        (0..30).fold(s, |at, _| {
            0.5 * (at + s + self.across(at, z) * angle.to_radians().tan())
        })
    }
}

fn area(t: &[Point; 3]) -> f64 {
    0.5 * norm(cross(sub(t[1], t[0]), sub(t[2], t[0])))
}

/// Where sticks are picked.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Picked {
    /// On sections that turn by this angle from the dip direction.
    Sections(f64),
    /// On horizontal slices.
    Slices,
    /// On sections and on slices.
    Both,
    /// On two families of oblique sections.
    Crossing,
}

/// Returns a random whole number below `count`.
fn below(random: &mut Random, count: usize) -> usize {
    (random.draw() * count as f64) as usize
}

/// Returns random points of a stick, from end to end.
fn stick(random: &mut Random, count: usize, place: impl Fn(f64) -> Point) -> Vec<Point> {
    let last = (count - 1) as f64;
    let jitter = |k: usize, random: &mut Random| {
        let is_inside = k > 0 && k + 1 < count;
        (k as f64
            + if is_inside {
                0.6 * (random.draw() - 0.5)
            } else {
                0.0
            })
            / last
    };
    (0..count).map(|k| place(jitter(k, random))).collect()
}

/// Picks sticks in a random order and in random directions, one missing in every third case. Also
/// returns the area between the outermost sticks.
fn pick(fault: &Fault, picked: Picked, seed: u64) -> (Vec<Vec<Point>>, f64) {
    let mut random = Random::new(seed);
    let depth = |t: f64| DEPTHS[0] + (DEPTHS[1] - DEPTHS[0]) * t;
    let mut sticks = Vec::new();
    let start = |k: usize| LENGTH * k as f64 / (SECTIONS - 1) as f64;
    let angles = match picked {
        Picked::Sections(angle) => vec![angle],
        Picked::Both => vec![0.0],
        Picked::Slices => vec![],
        Picked::Crossing => vec![40.0, -35.0],
    };
    let missing = if seed % 3 == 1 { 3 } else { SECTIONS };
    for &angle in &angles {
        for k in (0..SECTIONS).filter(|&k| k != missing) {
            let count = 6 + below(&mut random, 8);
            let at = |t: f64| fault.point(fault.section(start(k), angle, depth(t)), depth(t));
            sticks.push(stick(&mut random, count, at));
        }
    }
    let slices: &[f64] = match picked {
        Picked::Slices => &[0.0, 0.25, 0.5, 0.75, 1.0],
        Picked::Both => &[0.25, 0.5, 0.75],
        _ => &[],
    };
    for &slice in slices {
        let count = 20 + below(&mut random, 8);
        let at = |t: f64| fault.point(LENGTH * t, depth(slice));
        sticks.push(stick(&mut random, count, at));
    }
    for i in (1..sticks.len()).rev() {
        sticks.swap(i, below(&mut random, i + 1));
        if random.draw() < 0.5 {
            sticks[i].reverse();
        }
    }
    let bound = |start: f64, choose: fn(f64, f64) -> f64| {
        let angles = if angles.is_empty() {
            vec![0.0]
        } else {
            angles.clone()
        };
        move |z: f64| {
            let places = angles.iter().map(|&angle| fault.section(start, angle, z));
            places.reduce(choose).unwrap_or(start)
        }
    };
    let area = fault.area(bound(0.0, f64::min), bound(LENGTH, f64::max));
    (sticks, area)
}

fn named(sticks: &[Vec<Point>]) -> Vec<Stick> {
    let stick = |(i, points): (usize, &Vec<Point>)| Stick {
        name: (i + 1).to_string(),
        line: Some(100 + i),
        points: points.clone(),
    };
    sticks.iter().enumerate().map(stick).collect()
}

/// Checks a joined surface against the fault: its area, and the distance of all of it.
fn check(fault: &Fault, joined: &JoinedSticks, expected_area: f64, case: &str) {
    let total: f64 = joined.triangles.iter().map(area).sum();
    let error = (total / expected_area - 1.0).abs();
    assert!(
        error <= MAX_AREA_ERROR,
        "{case}: {total} of {expected_area}, {:?}",
        joined.notes
    );
    for t in &joined.triangles {
        for weights in [
            [1.0, 1.0, 1.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, 1.0],
            [1.0, 0.0, 1.0],
        ] {
            let sum: f64 = weights.iter().sum();
            let place = std::array::from_fn(|k| (0..3).map(|i| weights[i] / sum * t[i][k]).sum());
            let distance = fault.distance(place);
            assert!(
                distance <= SAMPLE,
                "{case}: {distance} m off, {:?}",
                joined.notes
            );
        }
    }
}

/// Calls `test` with faults of all shapes and dips, and with the number of the case.
fn for_faults(mut test: impl FnMut(&Fault, u64)) {
    let mut case = 0;
    for shape in [Shape::Plane, Shape::Curved, Shape::Listric, Shape::Twisted] {
        for dip in [20.0, 35.0, 50.0, 65.0, 80.0, 90.0] {
            let min_dip = match shape {
                Shape::Listric => 50.0,
                Shape::Twisted => 30.0,
                _ => 0.0,
            };
            if dip >= min_dip {
                let strike = (37 * case % 180) as f64;
                test(&Fault { shape, dip, strike }, case);
                case += 1;
            }
        }
    }
}

#[test]
fn surfaces_are_within_2_percent_and_one_sample_whatever_the_order_and_the_sections() {
    for_faults(|fault, case| {
        let mut all = vec![Picked::Sections(0.0), Picked::Slices, Picked::Both];
        if fault.shape != Shape::Curved {
            all.push(Picked::Sections(25.0));
        }
        if fault.shape == Shape::Plane && fault.dip > 45.0 && fault.dip < 90.0 {
            all.extend([Picked::Sections(50.0), Picked::Crossing]);
        }
        for picked in all {
            let (sticks, area) = pick(fault, picked, case);
            let joined = join_sticks("F", &named(&sticks), [1.0; 3]).unwrap();
            assert_eq!(joined.notes, Vec::<String>::new());
            check(fault, &joined, area, &format!("{fault:?} {picked:?}"));
        }
    });
}

#[test]
fn sticks_that_repeat_or_continue_others_or_are_points_change_nothing() {
    for_faults(|fault, case| {
        for picked in [Picked::Sections(0.0), Picked::Slices, Picked::Both] {
            let (sticks, area) = pick(fault, picked, case);
            let mut with_point = sticks.clone();
            with_point.insert(1, vec![sticks[2][0]]);
            let mut twice = sticks.clone();
            twice.extend(
                sticks
                    .iter()
                    .map(|stick| stick.iter().rev().copied().collect()),
            );
            let mut divided = Vec::new();
            for (i, stick) in sticks.iter().enumerate() {
                let middle = stick.len() / 2;
                if i % 2 == 0 {
                    divided.insert(divided.len() / 2, stick[..=middle].to_vec());
                    divided.push(stick[middle..].to_vec());
                } else {
                    divided.push(stick.clone());
                }
            }
            for (sticks, note) in [
                (with_point, "stick 2 (line 101) left out: a single point"),
                (twice, "repeat others"),
                (divided, "continue others"),
            ] {
                let joined = join_sticks("F", &named(&sticks), [1.0; 3]).unwrap();
                assert!(joined.notes.join(";").contains(note), "{:?}", joined.notes);
                check(
                    fault,
                    &joined,
                    area,
                    &format!("{fault:?} {picked:?} {note}"),
                );
            }
        }
    });
}

#[test]
fn a_stick_that_cannot_belong_is_named_and_left_out() {
    for_faults(|fault, case| {
        if fault.dip < 50.0 {
            return;
        }
        let (mut sticks, area) = pick(fault, Picked::Sections(0.0), case);
        let (sin, cos) = fault.strike.to_radians().sin_cos();
        let misplaced = sticks[2]
            .iter()
            .map(|p| [p[0] + 250.0 * cos, p[1] - 250.0 * sin, p[2]]);
        sticks.push(misplaced.collect());
        let joined = join_sticks("F", &named(&sticks), [1.0; 3]).unwrap();
        let expected = format!(
            "stick {} (line {}) left out: ",
            sticks.len(),
            99 + sticks.len()
        );
        assert!(joined.notes[0].starts_with(&expected), "{:?}", joined.notes);
        check(fault, &joined, area, &format!("{fault:?}"));
    });
}

#[test]
fn parts_beyond_a_gap_of_four_spacings_stay_apart() {
    let fault = Fault {
        shape: Shape::Plane,
        dip: 60.0,
        strike: 30.0,
    };
    let (sticks, area) = pick(&fault, Picked::Sections(0.0), 2);
    let (sin, cos) = fault.strike.to_radians().sin_cos();
    for (gap, parts) in [(150.0, 1.0), (400.0, 2.0)] {
        let moved = |p: &Point| {
            [
                p[0] + (LENGTH + gap) * sin,
                p[1] + (LENGTH + gap) * cos,
                p[2],
            ]
        };
        let second = sticks.iter().map(|stick| stick.iter().map(moved).collect());
        let both: Vec<Vec<Point>> = sticks.iter().cloned().chain(second).collect();
        let joined = join_sticks("F", &named(&both), [1.0; 3]).unwrap();
        let bridged = if parts == 1.0 {
            gap / LENGTH * area
        } else {
            0.0
        };
        check(&fault, &joined, 2.0 * area + bridged, &format!("gap {gap}"));
        assert_eq!(
            joined.notes.len(),
            usize::from(parts == 2.0),
            "{:?}",
            joined.notes
        );
    }
}

#[test]
fn sticks_of_two_faults_under_one_name_and_single_sticks_are_refused() {
    let fault = Fault {
        shape: Shape::Plane,
        dip: 60.0,
        strike: 0.0,
    };
    let (mut sticks, _) = pick(&fault, Picked::Sections(0.0), 2);
    let one = join_sticks("F", &named(&sticks[..1]), [1.0; 3])
        .unwrap_err()
        .to_string();
    assert!(one.starts_with("fault F: is a single stick; "), "{one}");
    for (i, stick) in sticks.iter_mut().enumerate().filter(|(i, _)| i % 3 == 0) {
        stick
            .iter_mut()
            .for_each(|p| p[0] += 150.0 + 40.0 * i as f64);
    }
    let many = join_sticks("F", &named(&sticks), [1.0; 3])
        .unwrap_err()
        .to_string();
    assert!(
        many.starts_with("fault F: its sticks make no single surface: sticks "),
        "{many}"
    );
}

#[test]
fn units_scale_the_sticks_and_not_the_triangles() {
    let fault = Fault {
        shape: Shape::Plane,
        dip: 60.0,
        strike: 30.0,
    };
    let (sticks, _) = pick(&fault, Picked::Sections(0.0), 5);
    let in_metres = join_sticks("F", &named(&sticks), [1.0; 3]).unwrap();
    let in_units: Vec<Vec<Point>> = sticks
        .iter()
        .map(|stick| {
            stick
                .iter()
                .map(|p| [p[0] * 2.0, p[1] * 2.0, p[2] * 0.5])
                .collect()
        })
        .collect();
    let joined = join_sticks("F", &named(&in_units), [0.5, 0.5, 2.0]).unwrap();
    assert_eq!(joined.triangles.len(), in_metres.triangles.len());
    for (a, b) in joined
        .triangles
        .as_flattened()
        .iter()
        .zip(in_metres.triangles.as_flattened())
    {
        assert_eq!([a[0] * 0.5, a[1] * 0.5, a[2] * 2.0], *b);
    }
}
