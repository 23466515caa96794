//! Wedges: all sites round a node of the surface are on its sphere, and where four neighbours among them are
//! nearly on one circle, two of their cells touch in a sliver of a face that begins at the node. Radii change
//! a little so that it is gone, or wider.

use rayon::prelude::*;

use super::balls::{Balls, WIDE};
use crate::geometry::buckets::Buckets;
use crate::geometry::{distance2, dot, normal, sub, unit};

/// A wedge as long as a radius is slender if a fourth site is nearer than this to the plane of three, in radii;
/// one half as long, if nearer than four times this, ...
const SLENDER: f64 = 1e-3;
/// ... but not more than this, ...
const MOST: f64 = 0.08;
/// ... nor, however long the wedge, less than this.
const LEAST: f64 = 2e-3;
/// A site nearer than this to the plane is on the circle of the three, as the sites of two facets with a common
/// edge are, and there is no wedge.
const ON_CIRCLE: f64 = 1e-9;
/// Wedges end within this distance, in radii.
const LONG: f64 = 1.5;
/// Rounds in which radii change.
const ROUNDS: usize = 2;
/// By how much: the squares of radii become so many times as large.
const FACTORS: [f64; 8] = [0.993, 1.007, 0.985, 1.015, 0.97, 1.03, 0.94, 1.06];

/// What is slender round the nodes of a surface.
pub struct Wedges<'a, const D: usize> {
    balls: &'a mut Balls<D>,
    /// The facets whose points a node's radius may change or cover.
    touched: &'a [Vec<u32>],
    /// Whether the sites of a facet may be there.
    fits: &'a dyn Fn(&[[f64; D]; 2]) -> bool,
    /// The sites of each facet that has any.
    sites: Vec<Option<[[f64; D]; 2]>>,
    /// For each node the other facets near it.
    near: Vec<Vec<u32>>,
    /// How slender wedges at each node are.
    faults: Vec<f64>,
}

impl<'a, const D: usize> Wedges<'a, D> {
    /// Finds those between the sites of some `facets`.
    pub fn new(
        balls: &'a mut Balls<D>,
        touched: &'a [Vec<u32>],
        facets: &[u32],
        fits: &'a dyn Fn(&[[f64; D]; 2]) -> bool,
    ) -> Self {
        let mut sites = vec![None; balls.surface.facets.len()];
        for &f in facets {
            sites[f as usize] = balls.points(f as usize);
        }
        let mut wedges = Self {
            near: near(balls, &sites),
            sites,
            faults: Vec::new(),
            balls,
            touched,
            fits,
        };
        wedges.faults = (0..touched.len()).map(|n| wedges.fault(n)).collect();
        wedges
    }

    /// Changes radii at and beside nodes with slender wedges, as long as there are fewer then; no facet
    /// loses its sites so.
    pub fn widen(mut self) {
        for _ in 0..ROUNDS {
            let mut better = false;
            for n in 0..self.faults.len() {
                for m in self.around(n) {
                    if self.faults[n] == 0.0 {
                        break;
                    }
                    better |= self.change(m, self.faults[n]);
                }
            }
            if !better {
                break;
            }
        }
    }

    /// A node and its neighbours.
    fn around(&self, n: usize) -> Vec<usize> {
        let facets = &self.balls.surface.facets;
        let star = self.balls.stars.get(n).iter();
        let mut around: Vec<usize> = star
            .flat_map(|&f| facets[f as usize].map(|n| n as usize))
            .collect();
        around.sort_unstable();
        around.dedup();
        around
    }

    /// Finds a better radius for a node, best of all one that takes away as much as is `wanted`; whether
    /// there is one.
    fn change(&mut self, m: usize, wanted: f64) -> bool {
        let around = self.around(m);
        let own = self.balls.squares[m];
        let touched = self.touched[m].iter().copied();
        let having: Vec<u32> = touched
            .filter(|&f| self.sites[f as usize].is_some())
            .collect();
        let before: f64 = around.iter().map(|&n| self.faults[n]).sum();
        let mut best = (before - ON_CIRCLE, own);
        for to in FACTORS.map(|factor| own * factor) {
            if to > (WIDE * self.balls.sizes[m]).powi(2) {
                continue;
            }
            self.set(m, to);
            let mut after = 0.0;
            for &n in &around {
                after += self.fault(n);
                if after >= best.0 {
                    break;
                }
            }
            if after < best.0 && self.holds(&having) {
                best = (after, to);
                if after <= before - wanted {
                    break;
                }
            }
        }
        self.set(m, best.1);
        if best.1 != own {
            for n in around {
                self.faults[n] = self.fault(n);
            }
        }
        best.1 != own
    }

    /// Whether all of these facets still have sites.
    fn holds(&self, facets: &[u32]) -> bool {
        let pair = |&f: &u32| self.balls.points(f as usize);
        facets
            .iter()
            .all(|f| pair(f).is_some_and(|pair| (self.fits)(&pair)))
    }

    /// Changes a radius, and with it sites.
    fn set(&mut self, m: usize, square: f64) {
        self.balls.squares[m] = square;
        for f in self.balls.stars.get(m).iter().map(|&f| f as usize) {
            if self.sites[f].is_some() {
                self.sites[f] = self.balls.meet(f).or(self.sites[f]);
            }
        }
    }

    /// How slender the wedges at a node are: a sum over sets of neighbouring sites that are nearly on one
    /// circle.
    fn fault(&self, n: usize) -> f64 {
        let star = self.balls.stars.get(n).iter();
        let sites = star.filter_map(|&f| self.sites[f as usize]).flatten();
        let sites: Vec<[f64; D]> = sites.collect();
        let mut sum = 0.0;
        for i in 0..sites.len() {
            for j in 0..i {
                for k in 0..j {
                    sum += self.slender(n, &sites, [i, j, k]);
                }
            }
        }
        sum
    }

    /// How near to the circle of three of the sites on a node's sphere others come, if none is inside.
    fn slender(&self, n: usize, sites: &[[f64; D]], three: [usize; 3]) -> f64 {
        let corners: [[f64; D]; D] = std::array::from_fn(|k| sites[three[k]]);
        let mut up = unit(normal(&corners));
        let radius = self.balls.squares[n].sqrt();
        let (mut above, mut below) = (false, false);
        let mut close = Vec::new();
        for (i, x) in sites.iter().enumerate() {
            if three.contains(&i) {
                continue;
            }
            let height = dot(sub(*x, corners[0]), up) / radius;
            if height.abs() >= MOST {
                above |= height > 0.0;
                below |= height < 0.0;
                if above && below {
                    return 0.0;
                }
            } else if height.abs() > ON_CIRCLE {
                close.push(height.abs());
            }
        }
        if close.is_empty() {
            return 0.0;
        }
        let outward = dot(sub(corners[0], self.balls.surface.nodes[n]), up) > 0.0;
        if above || (!below && !outward) {
            up = up.map(|c| -c);
        }
        let long = self.length(n, corners[0], up) / radius;
        let limit = (SLENDER / (long * long)).clamp(LEAST, MOST);
        let within = close.iter().filter(|&&height| height < limit);
        within.map(|height| 1.0 - height / limit).sum()
    }

    /// How far from a node, upwards, three cells of which one has its site at `x` meet before another begins.
    fn length(&self, n: usize, x: [f64; D], up: [f64; D]) -> f64 {
        let (node, square) = (self.balls.surface.nodes[n], self.balls.squares[n]);
        let others = self.near[n].iter().filter_map(|&f| self.sites[f as usize]);
        let end = |other: [f64; D]| {
            let towards = 2.0 * dot(sub(other, x), up);
            let end = (distance2(&other, &node) - square) / towards;
            if towards > 0.0 { end } else { f64::INFINITY }
        };
        others
            .flatten()
            .map(end)
            .fold(LONG * square.sqrt(), f64::min)
    }
}

/// For each node the facets of whose sites one may end a wedge there.
fn near<const D: usize>(balls: &Balls<D>, sites: &[Option<[[f64; D]; 2]>]) -> Vec<Vec<u32>> {
    let having = (0..sites.len()).filter_map(|f| sites[f].map(|pair| (f as u32, pair)));
    let (facets, points): (Vec<u32>, Vec<[f64; D]>) =
        having.flat_map(|(f, pair)| pair.map(|x| (f, x))).unzip();
    let reaches = balls
        .squares
        .iter()
        .map(|square| (1.0 + LONG) * square.sqrt());
    let reaches: Vec<f64> = reaches.collect();
    let largest = reaches.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let grid = Buckets::new(&points, largest);
    let near = |n: usize| {
        let x = balls.surface.nodes[n];
        let mut near = Vec::new();
        grid.visit_within(x, reaches[n], |i| {
            let own = balls.stars.get(n).contains(&facets[i]);
            if !own && distance2(&points[i], &x) < reaches[n].powi(2) {
                near.push(facets[i]);
            }
        });
        near.sort_unstable();
        near.dedup();
        near
    };
    (0..reaches.len()).into_par_iter().map(near).collect()
}

#[cfg(test)]
mod tests {
    use super::super::surface::Surface;
    use super::*;
    use crate::geometry::random::Random;

    /// Equilateral triangles, nearly: six sites above each node are nearly on one circle.
    fn nearly_regular() -> Surface<3> {
        let mut random = Random::new(1);
        let mut surface = Surface::default();
        let nodes = 8u32;
        for j in 0..nodes {
            for i in 0..nodes {
                let x = [
                    f64::from(i) + 0.5 * f64::from(j),
                    0.75f64.sqrt() * f64::from(j),
                    0.0,
                ];
                let x = x.map(|c| 10.0 + 4.0 * c + 0.004 * random.draw());
                surface.nodes.push(x);
                if i > 0 && j > 0 {
                    let [a, b] = [j * nodes + i, (j - 1) * nodes + i];
                    surface.facets.push([a, a - 1, b]);
                    surface.facets.push([a - 1, b - 1, b]);
                }
            }
        }
        surface
    }

    #[test]
    fn sites_nearly_on_one_circle_leave_it() {
        let extent = [80.0, 50.0, 20.0];
        let mut balls = Balls::new(nearly_regular(), extent);
        let sites = |balls: &Balls<3>| {
            let count = balls.surface.facets.len() as u32;
            let having = (0..count).filter(|&f| balls.points(f as usize).is_some());
            having.collect::<Vec<u32>>()
        };
        let facets = sites(&balls);
        let touched = balls.touched();
        let sum = |balls: &mut Balls<3>| {
            let wedges = Wedges::new(balls, &touched, &facets, &|_| true);
            wedges.faults.iter().sum::<f64>()
        };
        let before = sum(&mut balls);
        balls.widen(&facets, |_| true);
        let after = sum(&mut balls);
        assert!(before > 100.0 && after < 0.1 * before, "{before} {after}");
        assert_eq!(sites(&balls), facets, "no facet loses its sites");
    }
}
