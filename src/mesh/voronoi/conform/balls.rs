//! Balls round the nodes of a surface, whose spheres meet in mirror points of its facets.

use rayon::prelude::*;

use super::surface::{Surface, meeting};
use crate::geometry::buckets::Buckets;
use crate::geometry::{add_scaled, distance2, dot, normal, unit};
use crate::mesh::poly::Lists;

pub(super) fn env(name: &str, or: f64) -> f64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(or)
}

/// Balls round the nodes of a surface.
pub(super) struct Balls<'a, const D: usize> {
    pub surface: &'a mut Surface<D>,
    /// The directions in which each node may move.
    ways: Vec<Vec<[f64; D]>>,
    home: Vec<[f64; D]>,
    extent: [f64; D],
    stars: Lists,
    /// The length of edges at each node.
    pub sizes: Vec<f64>,
    /// The squares of radii.
    pub squares: Vec<f64>,
    /// For each facet the nodes, but its own, whose balls may cover its points.
    near: Lists,
    high: f64,
    low: f64,
    base: f64,
}

/// Means of nodes and their neighbours.
fn smoothed<const D: usize>(surface: &Surface<D>, mut values: Vec<f64>, rounds: usize) -> Vec<f64> {
    for _ in 0..rounds {
        let mut sums: Vec<(f64, f64)> = values.iter().map(|&v| (v, 1.0)).collect();
        for facet in &surface.facets {
            let mean = facet.iter().map(|&n| values[n as usize]).sum::<f64>() / D as f64;
            for &n in facet {
                sums[n as usize].0 += mean;
                sums[n as usize].1 += 1.0;
            }
        }
        values = sums.iter().map(|(sum, count)| sum / count).collect();
    }
    values
}

impl<'a, const D: usize> Balls<'a, D> {
    pub fn new(surface: &'a mut Surface<D>, extent: [f64; D]) -> Self {
        let ways = surface.ways(extent);
        let mut balls = Self {
            ways,
            home: surface.nodes.clone(),
            extent,
            stars: surface.stars(),
            sizes: smoothed(surface, surface.sizes(), env("SMOOTH", 2.0) as usize),
            squares: Vec::new(),
            near: Lists::default(),
            high: env("HIGH", 0.3),
            low: env("LOW", 0.08),
            base: 1.0,
            surface,
        };
        let first: Vec<f64> = (0..balls.surface.nodes.len()).map(|n| balls.first(n).sqrt()).collect();
        let first = smoothed(balls.surface, first, env("SMOOTHR", 2.0) as usize);
        balls.squares = first.iter().map(|r| r * r).collect();
        for _ in 0..20 {
            if !balls.raise() {
                break;
            }
        }
        balls.near = balls.found_near();
        balls
    }

    fn first(&self, n: usize) -> f64 {
        let size2 = self.sizes[n].powi(2);
        let star = self.stars.get(n);
        let flat = |&f: &u32| {
            let x = self.surface.corners(f as usize);
            let height = meeting(&x, &[0.0; D]).map_or(f64::INFINITY, |m| -m.1);
            height.min(0.45 * size2)
        };
        star.iter().map(flat).sum::<f64>() / star.len().max(1) as f64 + self.high.powi(2) * size2
    }

    pub fn size(&self, f: usize) -> f64 {
        let nodes = self.surface.facets[f];
        nodes.iter().map(|&n| self.sizes[n as usize]).sum::<f64>() / D as f64
    }

    /// Where the spheres of a facet meet: half-way, and the square of the height.
    fn meeting(&self, f: usize) -> Option<([f64; D], f64)> {
        let squares = self.surface.facets[f].map(|n| self.squares[n as usize]);
        meeting(&self.surface.corners(f), &squares)
    }

    /// Whether a facet has its points high enough.
    fn least(&self, f: usize) -> f64 {
        (self.low * self.size(f)).powi(2)
    }

    /// The two points of a facet.
    pub fn points(&self, f: usize) -> Option<[[f64; D]; 2]> {
        let (centre, square) = self.meeting(f)?;
        if square < 0.999 * self.least(f) {
            return None;
        }
        let up = unit(normal(&self.surface.corners(f)));
        let height = square.sqrt();
        Some([height, -height].map(|h| add_scaled(centre, h, up)))
    }

    fn raise(&mut self) -> bool {
        let mut raised = false;
        for f in 0..self.surface.facets.len() {
            let want = (0.6 * self.high * self.size(f)).powi(2);
            let Some((_, square)) = self.meeting(f) else { continue };
            if square < want {
                for n in self.surface.facets[f] {
                    let most = (0.9 * self.sizes[n as usize]).powi(2);
                    let to = (self.squares[n as usize] + want - square).min(most);
                    if to > self.squares[n as usize] {
                        self.squares[n as usize] = to;
                        raised = true;
                    }
                }
            }
        }
        raised
    }

    fn found_near(&self) -> Lists {
        let surface = &*self.surface;
        let largest = self.squares.iter().fold(0.0f64, |m, &w| m.max(w)).sqrt();
        let grid = Buckets::new(&surface.nodes, largest.max(1e-300));
        let found: Vec<Vec<u32>> = (0..surface.facets.len())
            .into_par_iter()
            .map(|f| {
                let mut near = Vec::new();
                let Some((centre, square)) = self.meeting(f) else { return near };
                let height = square.max(0.0).sqrt();
                grid.visit_within(centre, 1.3 * (largest + height), |j| {
                    let reach = 1.3 * (self.squares[j].sqrt() + height);
                    if distance2(&surface.nodes[j], &centre) < reach * reach
                        && !surface.facets[f].contains(&(j as u32))
                    {
                        near.push(j as u32);
                    }
                });
                near.sort_unstable();
                near
            })
            .collect();
        let mut lists = Lists::default();
        found.into_iter().for_each(|near| lists.push(near));
        lists
    }

    fn covers(&self, j: u32, s: &[f64; D]) -> bool {
        let square = self.squares[j as usize];
        distance2(s, &self.surface.nodes[j as usize]) < square * (1.0 - 1e-9)
    }

    fn inside(&self, f: usize, s: &[f64; D]) -> bool {
        let margin = self.low * self.size(f);
        (0..D).all(|k| s[k] > margin && s[k] < self.extent[k] - margin)
    }

    /// Lowers the square at a node, but not so far that the points of a facet get lost.
    fn lower(&mut self, n: u32, to: f64) -> bool {
        let before = self.squares[n as usize];
        let star: Vec<u32> = self.stars.get(n as usize).to_vec();
        let high = |balls: &Self, f: u32| {
            balls.meeting(f as usize).is_some_and(|m| m.1 >= balls.least(f as usize))
        };
        let well: Vec<u32> = star.into_iter().filter(|&f| high(self, f)).collect();
        let mut ok = |balls: &mut Self, to: f64| {
            balls.squares[n as usize] = to;
            well.iter().all(|&f| high(balls, f))
        };
        if ok(self, to) {
            return true;
        }
        let (mut good, mut bad) = (before, to);
        for _ in 0..6 {
            let middle = 0.5 * (good + bad);
            if ok(self, middle) {
                good = middle;
            } else {
                bad = middle;
            }
        }
        self.squares[n as usize] = good;
        false
    }

    fn lower_facet(&mut self, f: usize) {
        let Some((_, square)) = self.meeting(f) else { return };
        let by = 0.36 * square;
        for n in self.surface.facets[f] {
            let to = self.squares[n as usize] - by;
            self.lower(n, to);
        }
    }

    /// Shrinks balls until none covers points of facets; the number of facets in which that was changed.
    pub fn shrink(&mut self) -> usize {
        let mut changed = 0;
        for f in 0..self.surface.facets.len() {
            let mut touched = false;
            for side in 0..2 {
                let Some(points) = self.points(f) else { break };
                if !self.inside(f, &points[side]) {
                    self.lower_facet(f);
                    touched = true;
                }
                for i in 0..self.near.get(f).len() {
                    let j = self.near.get(f)[i];
                    let Some(points) = self.points(f) else { break };
                    let s = points[side];
                    if self.covers(j, &s) {
                        touched = true;
                        let to = distance2(&s, &self.surface.nodes[j as usize]);
                        if !self.lower(j, to) {
                            self.lower_facet(f);
                        }
                    }
                }
            }
            changed += usize::from(touched);
        }
        changed
    }

    /// Which of a facet's points are fit for sites.
    pub fn free(&self, f: usize) -> Option<[bool; 2]> {
        let points = self.points(f)?;
        Some(points.map(|s| {
            self.inside(f, &s) && !self.near.get(f).iter().any(|&j| self.covers(j, &s))
        }))
    }

    /// The point beyond the rim of a facet, opposite its node k.
    pub fn beyond(&self, f: usize, k: usize) -> Option<[f64; D]> {
        let x = self.surface.corners(f);
        let nodes = self.surface.facets[f];
        let (i, j) = ((k + 1) % D, (k + 2) % D);
        let p = x[i];
        let w = self.squares[nodes[i] as usize];
        let (mut foot, mut along) = (p, [0.0; D]);
        if D == 3 {
            let u = crate::geometry::sub(x[j], p);
            let long = dot(u, u);
            let t = 0.5 * (long + w - self.squares[nodes[j] as usize]) / long;
            foot = add_scaled(p, t, u);
            along = unit(u);
        }
        let square = w - distance2(&foot, &p);
        let inward = crate::geometry::sub(x[k], p);
        let inward = unit(add_scaled(inward, -dot(inward, along), along));
        (square > 0.0).then(|| add_scaled(foot, -square.sqrt(), inward))
    }

    /// What is wrong with a facet: 0 if both of its points are fit for sites.
    fn fault(&self, f: usize) -> f64 {
        let size2 = self.size(f).powi(2);
        let Some((centre, square)) = self.meeting(f) else { return self.base + 1.0 };
        let least = self.least(f);
        if square < 0.999 * least {
            return self.base + ((least - square) / size2).min(1.0);
        }
        let up = unit(normal(&self.surface.corners(f)));
        let height = square.sqrt();
        let mut depth = 0.0f64;
        for h in [height, -height] {
            let s = add_scaled(centre, h, up);
            let margin = self.low * self.size(f);
            for k in 0..D {
                let out = (margin - s[k]).max(s[k] - self.extent[k] + margin);
                if out > 0.0 {
                    depth = depth.max(0.01 + out * out / size2);
                }
            }
            for &j in self.near.get(f) {
                let square = self.squares[j as usize];
                let over = square * (1.0 - 1e-9) - distance2(&s, &self.surface.nodes[j as usize]);
                depth = depth.max(over / size2);
            }
        }
        if depth > 0.0 { self.base + depth.min(1.0) } else { 0.0 }
    }

    /// Changes radii where facets are at fault, as long as that helps.
    pub fn search(&mut self, passes: usize, base: f64) {
        self.base = base;
        let count = self.surface.nodes.len();
        let mut touching: Vec<Vec<u32>> = (0..count).map(|n| self.stars.get(n).to_vec()).collect();
        for f in 0..self.surface.facets.len() {
            for &j in self.near.get(f) {
                touching[j as usize].push(f as u32);
            }
        }
        let mut faults: Vec<f64> = (0..self.surface.facets.len()).map(|f| self.fault(f)).collect();
        for pass in 0..passes {
            let mut wanted = vec![false; count];
            for f in 0..faults.len() {
                if faults[f] > 0.0 {
                    for &n in self.surface.facets[f].iter().chain(self.near.get(f)) {
                        wanted[n as usize] = true;
                    }
                }
            }
            let mut better = 0;
            for n in (0..count).filter(|&n| wanted[n]) {
                let before: f64 = touching[n].iter().map(|&f| faults[f as usize]).sum();
                if before == 0.0 { continue; }
                let own = self.squares[n];
                let mut best = (before - 1e-9, own);
                for factor in [0.8, 0.88, 0.94, 0.98, 0.995, 1.005, 1.02, 1.06, 1.12, 1.25] {
                    let to = own * factor;
                    if to > (0.95 * self.sizes[n]).powi(2) { continue; }
                    self.squares[n] = to;
                    let mut after = 0.0;
                    for &f in &touching[n] {
                        after += self.fault(f as usize);
                        if after >= best.0 { break; }
                    }
                    if after < best.0 { best = (after, to); }
                }
                self.squares[n] = best.1;
                let mut best_at = None;
                let at = self.surface.nodes[n];
                let far = env("FAR", 0.3) * self.sizes[n];
                for w in 0..self.ways[n].len() {
                    let way = self.ways[n][w];
                    for step in [0.02, -0.02, 0.06, -0.06, 0.15, -0.15] {
                        let to = add_scaled(at, step * self.sizes[n], way);
                        if distance2(&to, &self.home[n]) > far * far { continue; }
                        self.surface.nodes[n] = to;
                        let mut after = 0.0;
                        for &f in &touching[n] {
                            after += self.fault(f as usize);
                            if after >= best.0 { break; }
                        }
                        if after < best.0 { best = (after, best.1); best_at = Some(to); }
                    }
                }
                self.surface.nodes[n] = best_at.unwrap_or(at);
                if best.1 != own || best_at.is_some() {
                    better += 1;
                    for &f in &touching[n] { faults[f as usize] = self.fault(f as usize); }
                }
            }
            let failed = faults.iter().filter(|f| **f > 0.0).count();
            if pass % 5 == 0 || better == 0 { eprintln!("pass {pass}: better {better}, failed {failed}"); }
            if better == 0 { break; }
        }
    }

    /// Makes the two nearest points of two facets one, by the radius at a node that only one of them has.
    pub fn snap(&mut self, f: usize, g: usize) -> bool {
        let (Some(a), Some(b)) = (self.points(f), self.points(g)) else { return false };
        for (own, other, from) in [(f, g, a), (g, f, b)] {
            let mut nearest = (f64::INFINITY, from[0]);
            let others = if own == f { b } else { a };
            for s in from { for t in others { let d = distance2(&s, &t); if d < nearest.0 { nearest = (d, s); } } }
            let Some(&n) = self.surface.facets[other].iter().find(|n| !self.surface.facets[own].contains(n)) else { continue };
            let touching: Vec<usize> = (0..self.surface.facets.len()).filter(|&t| self.surface.facets[t].contains(&n) || self.near.get(t).contains(&n)).collect();
            let before: f64 = touching.iter().map(|&t| self.fault(t)).sum();
            let was = self.squares[n as usize];
            self.squares[n as usize] = distance2(&nearest.1, &self.surface.nodes[n as usize]);
            let after: f64 = touching.iter().map(|&t| self.fault(t)).sum();
            if after <= before { return true; }
            self.squares[n as usize] = was;
        }
        false
    }

    pub fn classify(&self) {
        let ridges = self.surface.ridges();
        let mut kinds = std::collections::BTreeMap::new();
        for f in 0..self.surface.facets.len() {
            let Some(points) = self.points(f) else { continue };
            for s in points {
                if !self.inside(f, &s) {
                    *kinds.entry("outside".to_string()).or_insert(0) += 1;
                }
                for &j in self.near.get(f) {
                    if !self.covers(j, &s) { continue; }
                    let mut kind = "far".to_string();
                    for ridge in self.surface.ridges_of(f) {
                        let fs = &ridges[&ridge];
                        for &g in fs {
                            if self.surface.facets[g as usize].contains(&j) {
                                let ns = [f, g as usize].map(|f| unit(normal(&self.surface.corners(f))));
                                let bend = dot(ns[0], ns[1]).abs().min(1.0).acos().to_degrees();
                                kind = match fs.len() { 2 => format!("manifold {}", if bend < 10.0 {"<10"} else if bend < 30.0 {"<30"} else {">30"}), _ => format!("line {}", if bend < 20.0 {"<20"} else if bend < 45.0 {"<45"} else {">45"}) };
                            }
                        }
                    }
                    if kind == "far" && self.surface.facets[f].iter().any(|&n| self.stars.get(n as usize).iter().any(|&g| self.surface.facets[g as usize].contains(&j))) { kind = "vertex".into(); }
                    *kinds.entry(kind).or_insert(0) += 1;
                }
            }
        }
        let mut flats = std::collections::BTreeMap::new();
        for f in 0..self.surface.facets.len() {
            if self.points(f).is_some() { continue; }
            let x = self.surface.corners(f);
            let r = meeting(&x, &[0.0; D]).map_or(9e9, |m| -m.1).sqrt() / self.size(f);
            let worst = self.surface.ridges_of(f).iter().map(|ridge| {
                let count = ridges[ridge].len();
                let side = ridge.iter().filter(|&&n| n != u32::MAX).fold(0xff, |s, &n| s & self.surface.sides(n, self.extent)) != 0;
                let l = distance2(&self.surface.nodes[ridge[0] as usize], &self.surface.nodes[ridge[1] as usize]);
                (l, if side { "side" } else if count == 1 { "rim" } else if count == 2 { "inner" } else { "line" })
            }).max_by(|a, b| a.0.total_cmp(&b.0)).map(|w| w.1);
            let key = format!("{} longest {}", if r < 0.65 {"R<.65"} else if r < 0.8 {"R<.8"} else if r < 1.0 {"R<1"} else {"R>1"}, worst.unwrap_or(""));
            *flats.entry(key).or_insert(0) += 1;
        }
        eprintln!("no points: {flats:?}");
        eprintln!("covered by {kinds:?}");
        let mut counts = [0; 6];
        ridges.values().for_each(|f| counts[f.len().min(5)] += 1);
        eprintln!("ridges by facets {counts:?}");
    }
}
