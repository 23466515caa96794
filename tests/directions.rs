//! Tests that all triangles of an interface face one way in files of surfaces: outwards from the region that
//! it encloses, or else from the region with the smaller number to the other.

use std::collections::BTreeMap;
use std::path::Path;

use crate::common::{is_close, run, write_npy};

/// Samples along each axis of the images.
const SIDE: usize = 25;

type Triangle = [[f64; 3]; 3];

/// Returns the distance of a sample from a point.
fn distance_from(centre: [f64; 3], [x, y, z]: [usize; 3]) -> f64 {
    let p = [x, y, z].map(|i| i as f64);
    (0..3)
        .map(|k| (p[k] - centre[k]).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// Returns the triangles of each surface of a file in STL's text, OBJ or GOCAD's format.
fn triangles(path: &Path) -> BTreeMap<String, Vec<Triangle>> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut surfaces: BTreeMap<String, Vec<Triangle>> = BTreeMap::new();
    let (mut name, mut nodes, mut corners) = (String::new(), BTreeMap::new(), Vec::new());
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let point = |words: &[&str]| [0, 1, 2].map(|k| words[k].parse::<f64>().unwrap());
        match words[..] {
            ["solid" | "g", new] => name = new.into(),
            ["vertex", ..] => corners.push(point(&words[1..])),
            ["endfacet"] => {
                let triangle = [0, 1, 2].map(|k| corners[k]);
                surfaces.entry(name.clone()).or_default().push(triangle);
                corners.clear();
            }
            ["v", ..] => {
                nodes.insert((nodes.len() + 1).to_string(), point(&words[1..]));
            }
            ["VRTX" | "PVRTX", number, ..] => {
                nodes.insert(number.into(), point(&words[2..]));
            }
            ["f" | "TRGL", a, b, c] => {
                let triangle = [a, b, c].map(|n| nodes[n]);
                surfaces.entry(name.clone()).or_default().push(triangle);
            }
            _ => {
                if let Some(new) = line.strip_prefix("name:") {
                    name = new.trim().into();
                }
            }
        }
    }
    surfaces
}

/// Returns how often an edge between corners occurs more in one direction than in the other, at most: 0 if
/// triangles that face one way are closed, and 1 if they are open. Two bodies may touch in an edge.
fn excess_of_directions(triangles: &[Triangle]) -> i32 {
    let mut counts: BTreeMap<[[u64; 3]; 2], [i32; 2]> = BTreeMap::new();
    for triangle in triangles {
        let corners = triangle.map(|x| x.map(f64::to_bits));
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            counts.entry([a.min(b), a.max(b)]).or_default()[usize::from(a > b)] += 1;
        }
    }
    let excess = counts.values().map(|[a, b]| (a - b).abs());
    excess.max().unwrap_or(0)
}

/// Returns the volume that triangles enclose; it is negative if they face it.
fn volume(triangles: &[Triangle]) -> f64 {
    let cone = |[a, b, c]: &Triangle| {
        let cross =
            [0, 1, 2].map(|k| b[(k + 1) % 3] * c[(k + 2) % 3] - b[(k + 2) % 3] * c[(k + 1) % 3]);
        (0..3).map(|k| a[k] * cross[k]).sum::<f64>() / 6.0
    };
    triangles.iter().map(cone).sum()
}

/// Meshes an image of labels and returns the interfaces in the files of each command that writes all of their
/// triangles, with the name of the command.
fn interfaces(
    label: impl Fn([usize; 3]) -> f32,
    options: &str,
) -> Vec<(String, BTreeMap<String, Vec<Triangle>>)> {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy(&folder.join("labels.npy"), [SIDE; 3], label);
    run(
        folder,
        &format!("mesh labels.npy --feature labels --distance 3 -o m.vtu --quiet {options}"),
    );
    let commands = [
        "export m.vtu --to stl -o s.stl",
        "export m.vtu --to obj -o s.obj",
        "surface m.vtu --min-area 0 -o s.obj",
        "surface m.vtu --min-area 0 -o s.ts",
        "surface m.vtu --by regions -o s.obj",
        "surface m.vtu --by regions -o s.ts",
    ];
    // Surfaces leave out the smallest faces of Voronoi cells.
    let is_closed = |command: &&str| !(options.contains("voronoi") && command.contains("min-area"));
    let of_command = |command: &str| {
        run(folder, &format!("{command} --quiet"));
        let mut surfaces = triangles(&folder.join(command.rsplit(' ').next().unwrap()));
        surfaces.retain(|name, _| !name.contains("outside") && name.contains('_'));
        assert!(!surfaces.is_empty(), "{command}");
        (format!("{command} {options}"), surfaces)
    };
    commands
        .into_iter()
        .filter(is_closed)
        .map(of_command)
        .collect()
}

#[test]
fn closed_interfaces_face_outwards_from_the_region_that_they_enclose() {
    let ball = |centre: [f64; 3], radius: f64, x| distance_from(centre, x) < radius;
    let middle = [12.0; 3];
    let sphere = |radius: f64| 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3);
    type Label = Box<dyn Fn([usize; 3]) -> f32>;
    let cases: Vec<(Label, Vec<f64>)> = vec![
        (
            Box::new(move |x| f32::from(u8::from(ball(middle, 8.0, x)))),
            vec![sphere(8.0)],
        ),
        // The number inside is the smaller one.
        (
            Box::new(move |x| if ball(middle, 8.0, x) { -3.0 } else { 5.0 }),
            vec![sphere(8.0)],
        ),
        // Two bodies of one label.
        (
            Box::new(move |x| {
                let is_inside = ball([6.0, 7.0, 6.0], 4.0, x) || ball([17.0, 16.0, 17.0], 5.0, x);
                f32::from(u8::from(is_inside))
            }),
            vec![sphere(4.0) + sphere(5.0)],
        ),
        // One body in another one.
        (
            Box::new(move |x| {
                let count = [10.0, 5.0]
                    .iter()
                    .filter(|&&radius| ball(middle, radius, x))
                    .count();
                count as f32
            }),
            vec![sphere(10.0), sphere(5.0)],
        ),
        // A shell, which faces its cavity and its surroundings.
        (
            Box::new(move |x| f32::from(u8::from(ball(middle, 10.0, x) && !ball(middle, 5.0, x)))),
            vec![sphere(10.0) - sphere(5.0)],
        ),
    ];
    for (index, (label, volumes)) in cases.into_iter().enumerate() {
        for options in ["", "--cells voronoi", "--axes x,y,-z"] {
            let mut first: Option<Vec<f64>> = None;
            for (command, surfaces) in interfaces(&label, options) {
                let place = format!("case {index}: {command}");
                assert_eq!(
                    surfaces.len(),
                    volumes.len(),
                    "{place}: {:?}",
                    surfaces.keys()
                );
                let mut found: Vec<f64> = Vec::new();
                for (name, triangles) in &surfaces {
                    assert_eq!(
                        excess_of_directions(triangles),
                        0,
                        "{place} {name} is open or not turned one way"
                    );
                    found.push(volume(triangles));
                }
                found.sort_by(|a, b| b.total_cmp(a));
                // All files have the same triangles. The samples of balls of radius 4 and 5 are 7 % less
                // than the balls.
                let same = first.get_or_insert_with(|| found.clone());
                assert!(
                    (found.iter().zip(&*same)).all(|(a, b)| is_close(*a, *b, 1e-4)),
                    "{place}: {found:?} {same:?}"
                );
                for (found, expected) in found.iter().zip(&volumes) {
                    assert!(
                        is_close(*found, *expected, 0.1),
                        "{place}: {found} {expected}"
                    );
                }
            }
        }
    }
}

#[test]
fn open_interfaces_face_one_way_from_the_smaller_number_to_the_larger() {
    type Label = Box<dyn Fn([usize; 3]) -> f32>;
    let at_side = |x| f32::from(u8::from(distance_from([0.0, 12.0, 12.0], x) < 9.0));
    let two_in_one = |x: [usize; 3]| match (distance_from([12.0; 3], x) < 9.0, x[0] < 12) {
        (false, _) => 2.0,
        (true, true) => 1.0,
        (true, false) => 3.0,
    };
    let layers = |x: [usize; 3]| match (distance_from([12.0; 3], x) < 7.0, x[2] < 12) {
        (true, _) => 3.0,
        (false, low) => {
            if low {
                1.0
            } else {
                2.0
            }
        }
    };
    let cases: [(Label, usize); 3] = [
        (Box::new(at_side), 1),
        (Box::new(two_in_one), 3),
        (Box::new(layers), 3),
    ];
    for (index, (label, count)) in cases.into_iter().enumerate() {
        for options in ["", "--cells voronoi"] {
            for (command, surfaces) in interfaces(&label, options) {
                let place = format!("case {index}: {command}");
                assert_eq!(surfaces.len(), count, "{place}: {:?}", surfaces.keys());
                for (name, triangles) in &surfaces {
                    let excess = excess_of_directions(triangles);
                    assert_eq!(excess, 1, "{place} {name} is not turned one way");
                    let (mut forward, mut backward) = (0.0, 0.0);
                    for [a, b, c] in triangles {
                        let centre = [0, 1, 2].map(|k| (a[k] + b[k] + c[k]) / 3.0);
                        let edge = |to: &[f64; 3]| [0, 1, 2].map(|k| to[k] - a[k]);
                        let (u, v) = (edge(b), edge(c));
                        let normal = [0, 1, 2].map(|k| {
                            u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]
                        });
                        let length = normal.iter().map(|n| n * n).sum::<f64>().sqrt();
                        let at = |step: f64| {
                            label([0, 1, 2].map(|k| {
                                (centre[k] + step * normal[k] / length)
                                    .round()
                                    .clamp(0.0, 24.0) as usize
                            }))
                        };
                        // Areas, since the smallest faces of Voronoi cells have any direction.
                        forward += length * f64::from(u8::from(at(-1.5) < at(1.5)));
                        backward += length * f64::from(u8::from(at(-1.5) > at(1.5)));
                    }
                    assert!(
                        forward > 9.0 * backward,
                        "{place} {name}: {forward} {backward}"
                    );
                }
            }
        }
    }
}
