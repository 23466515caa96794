//! Sites whose Voronoi faces are the facets of a surface.

mod balls;
mod surface;
mod tidy;

use crate::geometry::buckets::Buckets;
use crate::geometry::distance2;
use balls::{Balls, env};
pub use surface::Surface;

/// Sites on either side of the facets of a surface, and the balls that all other sites keep out of.
#[derive(Debug, Clone, Default)]
pub struct Conforming<const D: usize> {
    /// The sites.
    pub sites: Vec<[f64; D]>,
    /// The facets that are faces of cells, and the sites above and below each.
    pub pairs: Vec<(u32, [u32; 2])>,
    /// The centres of the balls.
    pub centres: Vec<[f64; D]>,
    /// The squares of their radii.
    pub squares: Vec<f64>,
}

/// Finds sites for a surface in the box `[0, extent]`.
pub fn conform<const D: usize>(surface: &mut Surface<D>, extent: [f64; D]) -> Conforming<D> {
    let mut balls = Balls::new(surface, extent);
    let mut rounds = Vec::new();
    for _ in 0..env("ROUNDS", 0.0) as usize {
        let changed = balls.shrink();
        rounds.push(changed);
        if changed == 0 {
            break;
        }
    }
    eprintln!("rounds {rounds:?}");
    let start = std::time::Instant::now();
    if env("BASE", 0.02) < 1.0 { balls.search(env("PASSES", 30.0) as usize, env("BASE", 0.02));
    balls.search(env("PASSES", 30.0) as usize, 0.2); }
    balls.search(env("PASSES", 30.0) as usize, 1.0);
    eprintln!("searched {:?}", start.elapsed());
    let mut dropped = vec![false; balls.surface.facets.len()];
    let apart = env("APART", 0.25);
    if apart > 0.0 {
        for round in 0..2 {
            let mut points: Vec<[f64; D]> = Vec::new();
            let mut of: Vec<(usize, f64)> = Vec::new();
            for f in 0..balls.surface.facets.len() {
                if dropped[f] || balls.free(f) != Some([true, true]) { continue; }
                if let Some(pair) = balls.points(f) { points.extend(pair); of.extend([(f, balls.size(f)); 2]); }
            }
            if points.is_empty() { break; }
            let reach = apart * of.iter().map(|o| o.1).fold(0.0, f64::max);
            let grid = Buckets::new(&points, reach);
            let mut close: Vec<(f64, usize, usize)> = Vec::new();
            for i in 0..points.len() {
                grid.visit(points[i], |j| {
                    let d = distance2(&points[i], &points[j]).sqrt() / of[i].1.min(of[j].1);
                    if j > i && of[i].0 != of[j].0 && d < apart && d > 1e-6 { close.push((d, i, j)); }
                });
            }
            close.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut count = [0; 3];
            for (_, i, j) in close {
                let (f, g) = (of[i].0, of[j].0);
                if dropped[f] || dropped[g] { continue; }
                let bend = { let n = [f, g].map(|f| crate::geometry::unit(crate::geometry::normal(&balls.surface.corners(f)))); crate::geometry::dot(n[0], n[1]).abs() };
                let shared = balls.surface.facets[f].iter().filter(|n| balls.surface.facets[g].contains(n)).count();
                if round == 0 {
                    if shared == 2 && bend < 0.97 && balls.snap(f, g) { count[0] += 1; }
                    continue;
                }
                let area = |f: usize| { let n = crate::geometry::normal(&balls.surface.corners(f)); crate::geometry::dot(n, n) };
                let small = if area(f) < area(g) { f } else { g };
                dropped[small] = true;
                count[if bend > 0.97 { 1 } else { 2 }] += 1;
            }
            eprintln!("too close: snapped {}, dropped flat {}, dropped bent {}", count[0], count[1], count[2]);
        }
    }
    let surface = &*balls.surface;
    let (mut none, mut half, mut both, mut flat) = (0, 0, 0, 0);
    let mut points: Vec<[f64; D]> = Vec::new();
    let mut size: Vec<f64> = Vec::new();
    let mut pairs: Vec<(u32, [u32; 2])> = Vec::new();
    let mut heights = Vec::new();
    for f in 0..surface.facets.len() {
        match balls.free(f) {
            None => flat += 1,
            Some([true, true]) if dropped[f] => {}
            Some([true, true]) => {
                none += 1;
                let first = points.len() as u32;
                let pair = balls.points(f).unwrap_or_default_points();
                heights.push(0.5 * distance2(&pair[0], &pair[1]).sqrt() / balls.size(f));
                points.extend(pair);
                size.extend([balls.size(f); 2]);
                pairs.push((f as u32, [first, first + 1]));
            }
            Some([false, false]) => both += 1,
            Some(_) => half += 1,
        }
    }
    balls.classify();
    heights.sort_by(f64::total_cmp);
    let q = |v: &[f64], p: f64| v.get((p * v.len() as f64) as usize).copied().unwrap_or(0.0);
    eprintln!(
        "facets {}: pairs {none}, half {half}, both covered {both}, no points {flat}; heights {:.3} {:.3} {:.3} {:.3}",
        surface.facets.len(), q(&heights, 0.0), q(&heights, 0.01), q(&heights, 0.1), q(&heights, 0.5)
    );
    // The rims.
    let mut rims = 0;
    for (ridge, facets) in surface.ridges() {
        let [f] = facets[..] else { continue };
        let f = f as usize;
        let nodes = surface.facets[f];
        let on_side = ridge.iter().filter(|&&n| n != crate::mesh::complex::NONE).fold(0xff, |s, &n| s & surface.sides(n, extent));
        if on_side != 0 { continue; }
        let Some(k) = (0..D).find(|&k| !ridge.contains(&nodes[k])) else { continue };
        let Some(x) = balls.beyond(f, k) else { continue };
        let margin = 0.1 * balls.size(f);
        if (0..D).all(|k| x[k] > margin && x[k] < extent[k] - margin) {
            let covered = surface.nodes.iter().zip(&balls.squares).any(|(n, w)| distance2(n, &x) < w * (1.0 - 1e-9));
            if !covered { rims += 1; points.push(x); size.push(balls.size(f)); }
        }
    }
    // Those at one place are one.
    let reach = size.iter().copied().fold(f64::INFINITY, f64::min) * 0.5;
    let mut number: Vec<u32> = Vec::new();
    let mut sites: Vec<[f64; D]> = Vec::new();
    let mut close = Vec::new();
    if !points.is_empty() {
        let grid = Buckets::new(&points, reach);
        for i in 0..points.len() {
            let mut first = i;
            let mut nearest = f64::INFINITY;
            grid.visit(points[i], |j| {
                let d = distance2(&points[i], &points[j]).sqrt();
                if d < 1e-6 * size[i] { first = first.min(j); } else { nearest = nearest.min(d / size[i]); }
            });
            close.push(nearest);
            if first < i { number.push(number[first]); } else { number.push(sites.len() as u32); sites.push(points[i]); }
        }
    }
    close.sort_by(f64::total_cmp);
    eprintln!("rim sites {rims}; points {} sites {}; nearest {:.3} {:.3} {:.3} {:.3} {:.3}", points.len(), sites.len(), q(&close, 0.0), q(&close, 0.01), q(&close, 0.05), q(&close, 0.2), q(&close, 0.5));
    for (_, pair) in &mut pairs {
        *pair = pair.map(|p| number[p as usize]);
    }
    Conforming { sites, pairs, centres: surface.nodes.clone(), squares: balls.squares }
}

trait OrDefault<const D: usize> { fn unwrap_or_default_points(self) -> [[f64; D]; 2]; }
impl<const D: usize> OrDefault<D> for Option<[[f64; D]; 2]> {
    fn unwrap_or_default_points(self) -> [[f64; D]; 2] { self.unwrap_or([[0.0; D]; 2]) }
}
