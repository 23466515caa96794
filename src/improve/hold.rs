//! What holds a node: the sides of the box, and the features it lies on.

use super::lookup::Lookup;
use super::sheets::{NearSheets, SAME_SHEET, Sheets};
use crate::files::kept::fields;
use crate::geometry::{add_scaled, dot, norm};
use crate::lattice::AtomKind;

/// Nodes this close to a sheet lie on it: settling leaves less.
const ON_SHEET: f64 = 0.11;

/// The sheets near a node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Beside {
    /// None is close.
    Nothing,
    /// One: its normal, and the node's signed distance from it.
    One([f32; 3], f32),
    /// Several.
    Several,
}

impl Beside {
    /// Whether both ends of an edge, between two nodes with these sheets beside them, are surely on the
    /// same side of these. `alone` tells which end is on its only sheet.
    #[inline]
    pub fn on_one_side(self, other: Self, edge: [f64; 3], alone: [bool; 2]) -> bool {
        let edge = edge.map(|c| c as f32);
        let along = |n: [f32; 3]| dot(n, edge);
        match (self, other) {
            (Self::One(m, r), Self::One(n, s)) => {
                // Where each end is with respect to the other's sheet: if an end on a sheet is about
                // on the other's, they are one.
                let (p, q) = (s - along(n), r + along(m));
                let from_first = p * s > 0.0 || alone[0] && p.abs() < ONE_SHEET;
                let from_second = q * r > 0.0 || alone[1] && q.abs() < ONE_SHEET;
                (alone[1] || from_first) && (alone[0] || from_second)
            }
            (Self::One(..), Self::Nothing) => alone[0],
            (Self::Nothing, Self::One(..)) => alone[1],
            _ => false,
        }
    }
}

/// Two planes are of one sheet if a point on one is at most this far off the other.
const ONE_SHEET: f32 = 1.0;

/// The directions in which a node may move.
#[derive(Debug, Clone, Copy)]
pub struct Freedom {
    axes: u8,
    /// Directions, at right angles to one another and to the fixed axes, that are taken away.
    basis: [Option<[f64; 3]>; 2],
}

impl Freedom {
    /// The part of `v` along which the node may move.
    #[inline]
    pub fn project(&self, mut v: [f64; 3]) -> [f64; 3] {
        for b in self.basis.iter().flatten() {
            v = add_scaled(v, -dot(v, *b), *b);
        }
        for k in 0..3 {
            if self.axes >> k & 1 == 1 {
                v[k] = 0.0;
            }
        }
        v
    }
}

/// The constraints of one node.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Hold {
    /// Bit k: coordinate k is fixed (the node lies in a side normal to axis k, or is fixed).
    pub axes: u8,
    /// How many sheets hold the node.
    pub count: u8,
    /// No feature is anywhere near.
    pub far: bool,
    /// On one sheet, and no other is near.
    pub alone: bool,
    pub(super) normals: [[f32; 3]; 2],
}

fields! {
    Hold as Hold { axes, count, far, alone, normals }
}

impl Hold {
    /// By the sides of the box `[0, extent]` and by the features on which the node lies.
    ///
    /// Also gives the sheets that are near, of which those that do not hold the node are known only if
    /// they are close.
    pub fn new(x: [f64; 3], kind: AtomKind, extent: [f64; 3], sheets: &Sheets) -> (Self, Beside) {
        let mut hold = Self::by_box(x, kind, extent);
        hold.far = sheets.far(x);
        if hold.far || !sheets.close(x) {
            return (hold, Beside::Nothing);
        }
        let near = sheets.near(x);
        for sheet in near.iter().filter(|s| s.offset.abs() < ON_SHEET) {
            hold.add(sheet.normal);
        }
        let mut all = near.iter();
        let beside = match (all.next(), all.next()) {
            (None, _) => Beside::Nothing,
            (Some(only), None) => Beside::One(only.normal.map(|c| c as f32), only.offset as f32),
            _ => Beside::Several,
        };
        hold.alone = hold.count == 1 && matches!(beside, Beside::One(..));
        (hold, beside)
    }

    /// By the sides of the box `[0, extent]` alone.
    pub fn by_box(x: [f64; 3], kind: AtomKind, extent: [f64; 3]) -> Self {
        let mut hold = Self::default();
        if kind == AtomKind::Fixed {
            hold.axes = 7;
        }
        for k in 0..3 {
            if x[k] == 0.0 || x[k] == extent[k] {
                hold.axes |= 1 << k;
            }
        }
        hold
    }

    /// The normals of the sheets that hold the node.
    pub fn normals(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        self.normals[..usize::from(self.count)]
            .iter()
            .map(|n| n.map(f64::from))
    }

    /// Whether a sheet of this normal holds the node.
    pub fn on(&self, normal: [f64; 3]) -> bool {
        self.normals().any(|n| dot(n, normal).abs() > SAME_SHEET)
    }

    /// Adds a sheet if there is room.
    pub fn add(&mut self, normal: [f64; 3]) {
        if usize::from(self.count) < self.normals.len() && !self.on(normal) {
            self.normals[usize::from(self.count)] = normal.map(|c| c as f32);
            self.count += 1;
        }
    }

    /// Forgets the sheets.
    pub fn clear_sheets(&mut self) {
        self.count = 0;
        self.alone = false;
    }

    /// Without the sheets.
    pub fn within_sides(&self) -> Self {
        Self {
            axes: self.axes,
            ..Self::default()
        }
    }

    /// The directions in which the node may move.
    pub fn freedom(&self) -> Freedom {
        Freedom {
            axes: self.axes,
            basis: self.basis(),
        }
    }

    /// Orthonormal directions in the box-allowed space that the sheets take away.
    fn basis(&self) -> [Option<[f64; 3]>; 2] {
        let mut basis: [Option<[f64; 3]>; 2] = [None; 2];
        for (i, mut n) in self.normals().enumerate() {
            for k in 0..3 {
                if self.axes >> k & 1 == 1 {
                    n[k] = 0.0;
                }
            }
            if let Some(b) = basis[0].filter(|_| i == 1) {
                n = add_scaled(n, -dot(n, b), b);
            }
            let length = norm(n);
            if length > 0.2 {
                basis[i] = Some(n.map(|c| c / length));
            }
        }
        basis
    }

    /// Whether this node may take the other's place: everything that holds it holds the other.
    pub fn within(&self, other: &Hold) -> bool {
        self.axes & !other.axes == 0 && self.normals().all(|n| other.on(n))
    }

    /// Puts `x` back onto the sheets that hold it (a few Newton steps), never off the box's sides.
    /// Returns None if the sheets are no longer there.
    pub fn settle(&mut self, x: [f64; 3], extent: [f64; 3], sheets: &Sheets) -> Option<[f64; 3]> {
        self.steps_onto(x, extent, [0.0, 0.01], |x| sheets.near(x))
    }

    /// The same by planes that are [remembered](Lookup), and no nearer to the sheets than `stray`.
    pub fn settle_within(
        &mut self,
        stray: f64,
        x: [f64; 3],
        extent: [f64; 3],
        sheets: &Sheets,
        lookup: &mut Lookup,
    ) -> Option<[f64; 3]> {
        // One step goes to a plane; how far off those of the next cell are is no matter.
        self.steps_onto(x, extent, [stray, 0.1], |x| lookup.near(sheets, x))
    }

    /// Steps until the node is at most `stray` off all sheets, or was by no more than `close` farther
    /// off before the last.
    fn steps_onto(
        &mut self,
        mut x: [f64; 3],
        extent: [f64; 3],
        [stray, close]: [f64; 2],
        mut near: impl FnMut([f64; 3]) -> NearSheets,
    ) -> Option<[f64; 3]> {
        if self.count == 0 {
            return Some(x);
        }
        let beyond = |offset: f64| offset - offset.clamp(-stray, stray);
        for _ in 0..3 {
            let here = near(x);
            let mut worst = 0.0f64;
            for i in 0..usize::from(self.count) {
                let held = self.normals[i].map(f64::from);
                let sheet = here
                    .iter()
                    .max_by(|a, b| {
                        dot(a.normal, held)
                            .abs()
                            .total_cmp(&dot(b.normal, held).abs())
                    })
                    .filter(|s| dot(s.normal, held).abs() > 0.7)?;
                self.normals[i] = sheet.normal.map(|c| c as f32);
                worst = worst.max(beyond(sheet.offset).abs());
            }
            let step = self.step_to(&here, beyond)?;
            x = add_scaled(x, 1.0, step);
            for k in 0..3 {
                x[k] = x[k].clamp(0.0, extent[k]);
            }
            if worst < close {
                return Some(x);
            }
        }
        let here = near(x);
        let close = self.normals().all(|held| {
            here.iter()
                .any(|s| dot(s.normal, held).abs() > 0.7 && beyond(s.offset).abs() < 0.1)
        });
        close.then_some(x)
    }

    /// The smallest allowed move that cancels the offsets from the held sheets.
    fn step_to(&self, near: &NearSheets, beyond: impl Fn(f64) -> f64) -> Option<[f64; 3]> {
        let free = |mut n: [f64; 3]| {
            for k in 0..3 {
                if self.axes >> k & 1 == 1 {
                    n[k] = 0.0;
                }
            }
            n
        };
        let offset = |held: [f64; 3]| {
            near.iter()
                .find(|s| dot(s.normal, held).abs() > 0.99)
                .map(|s| (s.normal, beyond(s.offset)))
        };
        let mut normals = self.normals();
        let (n, s) = offset(normals.next()?)?;
        let a = free(n);
        let aa = dot(a, a);
        if aa < 0.05 {
            return None;
        }
        let Some(second) = normals.next() else {
            return Some(a.map(|c| -c * s / aa));
        };
        let (m, u) = offset(second)?;
        let b = free(m);
        let (ab, bb) = (dot(a, b), dot(b, b));
        let determinant = aa * bb - ab * ab;
        if determinant < 0.02 {
            return None;
        }
        let (p, q) = (
            (-s * bb + u * ab) / determinant,
            (-u * aa + s * ab) / determinant,
        );
        Some(add_scaled(a.map(|c| c * p), q, b))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_on_one_side_of_the_sheets_they_see() {
        // Two parallel sheets, x = 0 and x = 3.6; what a node at x sees of one, by either normal.
        let beside =
            |x: f32, sheet: f32, sign: f32| Beside::One([sign, 0.0, 0.0], sign * (x - sheet));
        let safe = |p: (f32, Beside), q: (f32, Beside), alone: [bool; 2]| {
            let edge = [f64::from(q.0 - p.0), 2.0, 0.0];
            let there = p.1.on_one_side(q.1, edge, alone);
            let back = q.1.on_one_side(p.1, edge.map(|c| -c), [alone[1], alone[0]]);
            assert_eq!(there, back);
            there
        };
        for sign in [1.0, -1.0] {
            let see = |x: f32, sheet: f32| (x, beside(x, sheet, sign));
            let first = |x: f32| (x, beside(x, 0.0, 1.0));
            // Neither end on a sheet.
            assert!(safe(first(1.0), see(2.5, 0.0), [false; 2]));
            assert!(!safe(first(-1.0), see(2.5, 0.0), [false; 2]));
            assert!(safe(first(1.0), see(3.0, 3.6), [false; 2]));
            assert!(!safe(first(1.0), see(4.0, 3.6), [false; 2]));
            // One on its only sheet.
            assert!(safe(first(0.0), see(2.5, 0.0), [true, false]));
            assert!(safe(first(0.1), see(-2.5, 0.0), [true, false]));
            assert!(safe(first(0.0), see(3.0, 3.6), [true, false]));
            assert!(!safe(first(0.0), see(4.0, 3.6), [true, false]));
        }
        let (on, nothing) = ((0.0, beside(0.0, 0.0, 1.0)), (3.0, Beside::Nothing));
        assert!(safe(on, nothing, [true, false]));
        assert!(!safe((1.0, beside(1.0, 0.0, 1.0)), nothing, [false; 2]));
        assert!(!safe(on, (3.0, Beside::Several), [true, false]));
    }

    #[test]
    fn a_node_may_stray_from_its_sheet_so_far_and_no_farther() {
        let mut points = Vec::new();
        for k in 0..=12 {
            for j in 0..=12 {
                points.push(crate::feature::FeaturePoint {
                    position: [6.0, j as f32, k as f32],
                    normal: [1.0, 0.0, 0.0],
                    strength: 1.0,
                });
            }
        }
        let extent = [12.0; 3];
        let sheets = Sheets::new(&points, extent, 3.0, 6.0);
        let mut lookup = Lookup::default();
        for (from, exact, loose) in [(6.2, 6.0, 6.2), (6.9, 6.0, 6.25), (5.1, 6.0, 5.75)] {
            let mut hold = Hold::default();
            hold.add([1.0, 0.0, 0.0]);
            let x = [from, 6.0, 6.0];
            let on = hold.settle(x, extent, &sheets).unwrap();
            let near = hold
                .settle_within(0.25, x, extent, &sheets, &mut lookup)
                .unwrap();
            assert!((on[0] - exact).abs() < 1e-6, "{on:?}");
            assert!((near[0] - loose).abs() < 1e-6, "{near:?}");
            assert_eq!((on[1], on[2], near[1], near[2]), (6.0, 6.0, 6.0, 6.0));
        }
    }
}
