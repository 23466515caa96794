//! Surfaces with better triangles: flips, collapses and tangential smoothing.

use super::balls::env;
use super::surface::Surface;
use crate::geometry::{add_scaled, cross, dot, in_space, norm, sub, unit};
use crate::mesh::complex::NONE;

impl<const D: usize> Surface<D> {
    /// Which nodes are inside of one surface: not at rims, lines or sides of the box.
    fn inner(&self, extent: [f64; D]) -> Vec<bool> {
        let mut inner: Vec<bool> = (0..self.nodes.len() as u32).map(|n| self.sides(n, extent) == 0).collect();
        for (ridge, facets) in self.ridges() {
            let sharp = facets.len() != 2 || {
                let n = [facets[0], facets[1]].map(|f| self.up(f as usize));
                dot(n[0], n[1]).abs() < 0.85
            };
            if sharp {
                ridge.iter().filter(|&&n| n != NONE).for_each(|&n| inner[n as usize] = false);
            }
        }
        inner
    }

    /// For each node in a chain of sharp ridges (of a rim, a line, a border) the two next to it; the
    /// directions in which nodes may move.
    pub(super) fn ways(&self, extent: [f64; D]) -> Vec<Vec<[f64; D]>> {
        let mut ways = vec![Vec::new(); self.nodes.len()];
        if D != 3 { return ways; }
        let inner = self.inner(extent);
        let chains = self.chains(extent);
        let stars = self.stars();
        for n in 0..self.nodes.len() {
            if let Some([a, b]) = chains[n] {
                ways[n].push(unit(sub(self.nodes[b as usize], self.nodes[a as usize])));
            } else if inner[n] {
                let mut normal = [0.0; 3];
                for &f in stars.get(n) {
                    let x = self.corners(f as usize).map(in_space);
                    let v = cross(sub(x[1], x[0]), sub(x[2], x[0]));
                    normal = add_scaled(normal, if dot(v, normal) < 0.0 { -1.0 } else { 1.0 }, v);
                }
                let normal = unit(normal);
                let axis = (0..3).min_by(|&i, &j| normal[i].abs().total_cmp(&normal[j].abs())).unwrap_or(0);
                let mut e = [0.0; 3];
                e[axis] = 1.0;
                let u = unit(cross(normal, e));
                let v = cross(normal, u);
                for w in [u, v] { ways[n].push(std::array::from_fn(|k| w[k])); }
            }
        }
        ways
    }

    fn chains(&self, extent: [f64; D]) -> Vec<Option<[u32; 2]>> {
        // Class of each sharp ridge: sides and number of facets.
        let mut at: Vec<Vec<(u32, (u8, usize))>> = vec![Vec::new(); self.nodes.len()];
        for (ridge, facets) in self.ridges() {
            let side = self.sides(ridge[0], extent) & self.sides(ridge[1], extent);
            let sharp = facets.len() != 2 || {
                let n = [facets[0], facets[1]].map(|f| self.up(f as usize));
                dot(n[0], n[1]).abs() < 0.85
            };
            if sharp {
                at[ridge[0] as usize].push((ridge[1], (side, facets.len())));
                at[ridge[1] as usize].push((ridge[0], (side, facets.len())));
            }
        }
        (0..self.nodes.len()).map(|n| match at[n][..] {
            [(a, x), (b, y)] if x == y && self.sides(n as u32, extent) == x.0 => {
                let [p, q] = [a, b].map(|m| unit(sub(in_space(self.nodes[m as usize]), in_space(self.nodes[n]))));
                (dot(p, q) < -0.8).then_some([a, b])
            }
            _ => None,
        }).collect()
    }

    fn up(&self, f: usize) -> [f64; 3] {
        let x = self.corners(f).map(in_space);
        unit(cross(sub(x[1], x[0]), sub(x[D - 1], x[0])))
    }

    pub fn tidy(&mut self, extent: [f64; D]) {
        if D != 3 { return; }
        for _ in 0..env("TIDY", 4.0) as usize {
            self.flip();
            let short = env("SHORT", 0.55);
            if short > 0.0 { self.collapse(extent, short); self.flip(); }
            self.smooth(extent);
        }
        self.flip();
    }

    fn smooth(&mut self, extent: [f64; D]) {
        let inner = self.inner(extent);
        let stars = self.stars();
        for (n, chain) in self.chains(extent).into_iter().enumerate() {
            let Some([a, b]) = chain else { continue };
            let [p, q] = [a, b].map(|m| self.nodes[m as usize]);
            let t = unit(sub(q, p));
            let x = self.nodes[n];
            let middle: [f64; D] = std::array::from_fn(|k| 0.5 * (p[k] + q[k]));
            self.nodes[n] = add_scaled(x, dot(sub(middle, x), t), t);
        }
        for n in 0..self.nodes.len() {
            if !inner[n] { continue; }
            let here = in_space(self.nodes[n]);
            let star = stars.get(n);
            // Normal, and the mean of the facets' centres by area.
            let (mut normal, mut sum, mut weight) = ([0.0; 3], [0.0; 3], 0.0);
            let mut first = None;
            for &f in star {
                let x = self.corners(f as usize).map(in_space);
                let mut v = cross(sub(x[1], x[0]), sub(x[2], x[0]));
                let against = *first.get_or_insert(v);
                if dot(v, against) < 0.0 { v = v.map(|c| -c); }
                normal = add_scaled(normal, 1.0, v);
                let area = norm(v);
                let centre: [f64; 3] = std::array::from_fn(|k| (x[0][k] + x[1][k] + x[2][k]) / 3.0);
                sum = add_scaled(sum, area, centre);
                weight += area;
            }
            if weight <= 0.0 { continue; }
            let normal = unit(normal);
            let step = sub(sum.map(|c| c / weight), here);
            let step = add_scaled(step, -dot(step, normal), normal);
            let before: Vec<[f64; 3]> = star.iter().map(|&f| self.up(f as usize)).collect();
            let old = self.nodes[n];
            let worst = |s: &Self| star.iter().map(|&f| s.shape(f as usize)).fold(f64::INFINITY, f64::min);
            let was = worst(self);
            for share in [1.0, 0.5] {
                self.nodes[n] = std::array::from_fn(|k| here[k] + share * step[k]);
                let kept = star.iter().zip(&before).all(|(&f, b)| dot(self.up(f as usize), *b) > 0.9);
                if kept && worst(self) > was { break; }
                self.nodes[n] = old;
            }
        }
    }

    /// 1 for an equilateral triangle, 0 for a flat one.
    fn shape(&self, f: usize) -> f64 {
        let x = self.corners(f).map(in_space);
        let [u, v, w] = [sub(x[1], x[0]), sub(x[2], x[1]), sub(x[0], x[2])];
        2.0 * 3f64.sqrt() * norm(cross(u, v)) / (dot(u, u) + dot(v, v) + dot(w, w))
    }

    fn collapse(&mut self, extent: [f64; D], short: f64) {
        let inner = self.inner(extent);
        let sizes = self.sizes();
        let ridges: Vec<[u32; 2]> = self.ridges().into_iter().filter(|r| r.1.len() == 2).map(|r| r.0).collect();
        let mut touched = vec![false; self.nodes.len()];
        let mut gone = vec![false; self.facets.len()];
        let mut stars: Vec<Vec<u32>> = vec![Vec::new(); self.nodes.len()];
        for (f, facet) in self.facets.iter().enumerate() {
            facet.iter().for_each(|&n| stars[n as usize].push(f as u32));
        }
        for [p, q] in ridges {
            let [pu, qu] = [p as usize, q as usize];
            if touched[pu] || touched[qu] { continue; }
            let length = norm(sub(self.nodes[pu], self.nodes[qu]));
            if length > short * 0.5 * (sizes[pu] + sizes[qu]) { continue; }
            // The one that goes must be inside.
            let (go, stay) = match (inner[pu], inner[qu]) { (true, _) => (pu, qu), (_, true) => (qu, pu), _ => continue };
            let both: Vec<u32> = stars[go].iter().copied().filter(|&f| self.facets[f as usize].contains(&(stay as u32))).collect();
            let rest: Vec<u32> = stars[go].iter().copied().filter(|f| !both.contains(f)).collect();
            let common = {
                let of = |n: usize| { let mut v: Vec<u32> = stars[n].iter().flat_map(|&f| self.facets[f as usize]).collect(); v.sort_unstable(); v.dedup(); v };
                let b = of(stay);
                of(go).into_iter().filter(|n| b.binary_search(n).is_ok()).count()
            };
            if both.len() != 2 || common != 4 { continue; }
            let old = self.nodes[go];
            let up: Vec<[f64; 3]> = rest.iter().map(|&f| self.up(f as usize)).collect();
            let to = if inner[stay] && inner[go] { std::array::from_fn(|k| 0.5 * (self.nodes[go][k] + self.nodes[stay][k])) } else { self.nodes[stay] };
            let old_stay = self.nodes[stay];
            let rest_stay: Vec<u32> = stars[stay].iter().copied().filter(|f| !both.contains(f)).collect();
            let up_stay: Vec<[f64; 3]> = rest_stay.iter().map(|&f| self.up(f as usize)).collect();
            self.nodes[go] = to;
            self.nodes[stay] = to;
            let fine = rest.iter().zip(&up).chain(rest_stay.iter().zip(&up_stay)).all(|(&f, u)| dot(self.up(f as usize), *u) > 0.9 && self.shape(f as usize) > 0.3);
            if !fine {
                self.nodes[go] = old;
                self.nodes[stay] = old_stay;
                continue;
            }
            for &f in &both { gone[f as usize] = true; }
            for &f in &rest {
                for n in &mut self.facets[f as usize] { if *n as usize == go { *n = stay as u32; } }
            }
            for &f in both.iter().chain(&rest).chain(&rest_stay) { for n in self.facets[f as usize] { touched[n as usize] = true; } }
            touched[go] = true;
        }
        let mut left = gone.iter();
        self.facets.retain(|_| left.next().is_some_and(|g| !*g));
        self.drop_unused();
    }

    fn drop_unused(&mut self) {
        let mut number = vec![NONE; self.nodes.len()];
        let mut nodes = Vec::new();
        for facet in &mut self.facets {
            for n in facet {
                let to = &mut number[*n as usize];
                if *to == NONE { *to = nodes.len() as u32; nodes.push(self.nodes[*n as usize]); }
                *n = *to;
            }
        }
        self.nodes = nodes;
    }
}
