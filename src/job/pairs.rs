//! Atoms in pairs, one the other's mirror image in a feature: so the face between them lies on it.
//!
//! Atoms at rest alongside a feature keep off it, but those on one side know little of those on the
//! other, and the faces between them zigzag across the feature. It helps to do at features what is
//! done at the sides of the box: the first layer of atoms on one side stays, that on the other gives
//! way to its mirror image.

use crate::feature::FeaturePoint;
use crate::geometry::buckets::Buckets;
use crate::geometry::scatter::Scatter;
use crate::geometry::{add_scaled, distance2, dot, in_space, sub};
use crate::improve::sheets::{SAME_SHEET, Sheet, Sheets};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::Atoms;

/// Atoms no farther from a feature than this, in units of d, belong to its first layers: the cells
/// of others do not reach it.
const BESIDE: f64 = 0.85;
/// Neighbours in a layer are no farther apart than this, in units of d.
const NEXT: f64 = 1.6;
/// No image is put nearer to an atom that stays than this, in units of d.
const ROOM: f64 = 0.6;
/// An atom nearer to a feature than this, in units of d, is moved away to it first.
const OFF: f64 = 0.3;

/// The middles of pairs on one feature are no farther apart than need be: at least this, in units of
/// d, where pairs are added.
const APART: f64 = 0.8;
/// Distance from the feature of atoms that are added, in units of d.
const HEIGHT: f64 = 0.42;

/// An atom beside a feature.
#[derive(Clone, Copy)]
struct Beside {
    atom: usize,
    /// Its position; z = 0 in the plane.
    x: [f64; 3],
    d: f64,
    /// The nearest sheet, its normal turned so that all normals of one surface agree.
    sheet: Sheet,
    surface: Option<u32>,
}

impl Beside {
    /// The atom, off the feature as far as it must be, and its image; `None` if one is not well inside
    /// the box, the feature ends here, or another one passes between the two.
    fn pair<const D: usize>(&self, extent: [f64; D], sheets: &Sheets) -> Option<[[f64; 3]; 2]> {
        let Sheet { normal, offset } = self.sheet;
        let height = offset.abs().max(OFF * self.d) * offset.signum();
        let [x, foot, image] =
            [height, 0.0, -height].map(|h| add_scaled(self.x, h - offset, normal));
        let margin = 0.05 * self.d;
        let inside = |p: [f64; 3]| (0..D).all(|k| p[k] > margin && p[k] < extent[k] - margin);
        let same = |s: &Sheet| dot(s.normal, normal).abs() > SAME_SHEET;
        let goes_on = |s: &Sheet| same(s) && s.offset.abs() < 0.2 * self.d;
        let between = |s: &Sheet| {
            !same(s) && s.offset * (s.offset - 2.0 * height * dot(s.normal, normal)) < 0.0
        };
        let sound = inside(x)
            && inside(image)
            && sheets.near(foot).iter().any(goes_on)
            && !sheets.near(x).iter().any(between);
        sound.then_some([x, image])
    }
}

/// Replaces the first layer of atoms on one side of every feature by the mirror image of that on the
/// other, and adds pairs where the feature's `points` (in space, as those of `sheets`) have none near.
/// Atoms of both layers become fixed, all others stay as they are. Fixed atoms stay.
pub fn mirrored<const D: usize>(
    atoms: &Atoms<D>,
    extent: [f64; D],
    points: &[FeaturePoint<3>],
    sheets: &Sheets,
    distance: &Distance<D>,
) -> Atoms<D> {
    let mut layers: Vec<Beside> = (0..atoms.len())
        .filter(|&i| atoms.kinds[i] == AtomKind::Interior)
        .filter_map(|atom| {
            let x = in_space(atoms.positions[atom]);
            let d = distance.at(atoms.positions[atom]);
            let sheet = *sheets.near(x).iter().next()?;
            (sheet.offset.abs() < BESIDE * d).then_some(Beside {
                atom,
                x,
                d,
                sheet,
                surface: None,
            })
        })
        .collect();
    let reach = NEXT * distance.max();
    let grid = Buckets::new(&layers.iter().map(|b| b.x).collect::<Vec<_>>(), reach);
    orient(&mut layers, &grid);

    // No pair comes too near to an atom of the user's.
    let held = (0..atoms.len()).filter(|&i| atoms.kinds[i] != AtomKind::Interior);
    let held: Vec<[f64; 3]> = held.map(|i| in_space(atoms.positions[i])).collect();
    let held_grid = Buckets::new(&held, reach);
    let clear = |pair: &[[f64; 3]; 2], d: f64| {
        let mut clear = true;
        for &x in pair {
            held_grid.visit(x, |j| {
                let off = sub(held[j], x);
                clear &= dot(off, off) >= (ROOM * d).powi(2);
            });
        }
        clear
    };

    // Atoms that stay as they are; the others of the layers come in pairs, or give way to them.
    let mut stays = vec![true; atoms.len()];
    let mut pairs: Vec<[f64; 3]> = Vec::new();
    // The upper side first; then what is left alone on the lower one.
    for side in [1.0, -1.0] {
        let before = pairs.clone();
        let paired = Buckets::new(&before, reach);
        for b in layers.iter().filter(|b| side * b.sheet.offset > 0.0) {
            if !stays[b.atom] {
                continue;
            }
            let pair = b.pair(extent, sheets).filter(|pair| clear(pair, b.d));
            let Some([x, image]) = pair else {
                continue;
            };
            let gives_way = |other: &Beside| {
                other.surface == b.surface && side * other.sheet.offset < 0.0 && stays[other.atom]
            };
            let near = |p: [f64; 3], room: f64| {
                let off = sub(p, image);
                dot(off, off) < (room * b.d).powi(2)
            };
            let mut free = true;
            grid.visit(image, |j| {
                let other = &layers[j];
                let blocks = stays[other.atom] && !gives_way(other) && other.atom != b.atom;
                free &= !(blocks && near(other.x, ROOM));
            });
            paired.visit(image, |j| free &= !near(before[j], ROOM));
            if !free {
                continue;
            }
            let mut gone = Vec::new();
            grid.visit(image, |j| {
                if gives_way(&layers[j]) && near(layers[j].x, 1.0) {
                    gone.push(layers[j].atom);
                }
            });
            gone.iter().for_each(|&atom| stays[atom] = false);
            stays[b.atom] = false;
            pairs.extend([x, image]);
        }
    }
    // Where a feature is still without pairs there were too few atoms beside it: more are put there.
    let mut feet = Pairs::new(reach, in_space(extent));
    let (made, _) = pairs.as_chunks::<2>();
    made.iter().for_each(|&pair| feet.add(pair));
    for point in points {
        let p = point.position.map(f64::from);
        let d = distance.at(std::array::from_fn(|k| p[k]));
        if !feet.middles.is_free(&p, APART * d) {
            continue;
        }
        let normal = point.normal.map(f64::from);
        let same = |s: &&Sheet| dot(s.normal, normal).abs() > SAME_SHEET;
        let here = sheets.near(p);
        let Some(sheet) = here.iter().find(same) else {
            continue;
        };
        let foot = add_scaled(p, -sheet.offset, sheet.normal);
        let b = Beside {
            atom: usize::MAX,
            x: add_scaled(foot, HEIGHT * d, sheet.normal),
            d,
            sheet: Sheet {
                normal: sheet.normal,
                offset: HEIGHT * d,
            },
            surface: None,
        };
        let Some(pair) = b.pair(extent, sheets).filter(|pair| clear(pair, d)) else {
            continue;
        };
        // No place where it comes too near to another pair or to an atom that must stay.
        if !pair.iter().any(|&x| feet.any_atom(x, ROOM * d)) {
            for x in pair {
                grid.visit(x, |j| {
                    let off = sub(layers[j].x, x);
                    if dot(off, off) < (APART * d).powi(2) {
                        stays[layers[j].atom] = false;
                    }
                });
            }
            feet.add(pair);
            pairs.extend(pair);
        }
    }
    let mut result = Atoms {
        positions: Vec::with_capacity(atoms.len()),
        kinds: Vec::with_capacity(atoms.len()),
    };
    for i in (0..atoms.len()).filter(|&i| stays[i]) {
        result.positions.push(atoms.positions[i]);
        result.kinds.push(atoms.kinds[i]);
    }
    for x in pairs {
        result.positions.push(std::array::from_fn(|k| x[k]));
        result.kinds.push(AtomKind::Fixed);
    }
    result
}

/// Gives neighbours along one surface the same surface number, and normals on the same side.
fn orient(layers: &mut [Beside], grid: &Buckets<3>) {
    let mut surfaces = 0;
    let mut queue = std::collections::VecDeque::new();
    for first in 0..layers.len() {
        if layers[first].surface.is_some() {
            continue;
        }
        layers[first].surface = Some(surfaces);
        queue.push_back(first);
        while let Some(i) = queue.pop_front() {
            let b = layers[i];
            grid.visit(b.x, |j| {
                let other = &mut layers[j];
                if other.surface.is_some() {
                    return;
                }
                let turn = dot(b.sheet.normal, other.sheet.normal);
                let off = sub(other.x, b.x);
                // Both feet on one surface: the height over the plane of b is as the sheet says.
                let sign = turn.signum();
                let rise = dot(off, b.sheet.normal) + b.sheet.offset - sign * other.sheet.offset;
                if turn.abs() > SAME_SHEET
                    && dot(off, off) < (NEXT * b.d).powi(2)
                    && rise.abs() < 0.4 * b.d
                {
                    other.sheet = Sheet {
                        normal: other.sheet.normal.map(|c| sign * c),
                        offset: sign * other.sheet.offset,
                    };
                    other.surface = b.surface;
                    queue.push_back(j);
                }
            });
        }
        surfaces += 1;
    }
}

/// Pairs, to which more can be added, and their middles.
struct Pairs {
    /// Nothing that matters to a pair is farther from its middle.
    reach: f64,
    pairs: Vec<[[f64; 3]; 2]>,
    middles: Scatter<3>,
}

impl Pairs {
    /// No pairs yet, in the box `[0, extent]`.
    fn new(reach: f64, extent: [f64; 3]) -> Self {
        Self {
            reach,
            pairs: Vec::new(),
            middles: Scatter::new([0.0; 3], extent, reach),
        }
    }

    fn add(&mut self, pair: [[f64; 3]; 2]) {
        self.pairs.push(pair);
        self.middles.add(middle(pair));
    }

    /// Whether an atom of a pair is nearer than `room` to a point.
    fn any_atom(&self, p: [f64; 3], room: f64) -> bool {
        self.middles.any_near(&p, self.reach, |n| {
            self.pairs[n].iter().any(|y| distance2(y, &p) < room * room)
        })
    }
}

/// Half-way between the two atoms of a pair: on the feature.
fn middle([a, b]: [[f64; 3]; 2]) -> [f64; 3] {
    add_scaled(a, 0.5, sub(b, a))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::seeding::{Alignment, fcc};

    #[test]
    fn faces_lie_on_a_plane_between_pairs() {
        let extent = [40.0, 36.0, 38.0];
        let normal = [0.8f32, 0.6, 0.0];
        // The plane 0.8 x + 0.6 y = 27.
        let height = |x: [f64; 3]| 0.8 * x[0] + 0.6 * x[1] - 27.0;
        let mut points = Vec::new();
        for k in 0..39 {
            for j in 0..45 {
                let along = f64::from(j) - 22.0;
                let x = [21.6 - 0.6 * along, 16.2 + 0.8 * along, f64::from(k)];
                if (0..3).all(|k| (0.0..=extent[k]).contains(&x[k])) {
                    points.push(FeaturePoint {
                        position: x.map(|c| c as f32),
                        normal,
                        strength: 1.0,
                    });
                }
            }
        }
        let sheets = Sheets::new(&points, extent, 4.8, 10.0);
        let distance = Distance::Constant(6.0);
        let atoms = fcc(extent, &distance, &[], Alignment::Alongside).unwrap();
        let paired = mirrored(&atoms, extent, &points, &sheets, &distance);
        let fixed: Vec<[f64; 3]> = (0..paired.len())
            .filter(|&i| paired.kinds[i] == AtomKind::Fixed)
            .map(|i| paired.positions[i])
            .collect();
        assert!(
            fixed.len() > 60 && fixed.len().is_multiple_of(2),
            "{}",
            fixed.len()
        );
        for pair in fixed.chunks_exact(2) {
            assert!((height(pair[0]) + height(pair[1])).abs() < 1e-3);
            assert!(height(pair[0]).abs() > 0.29 * 6.0);
        }
        // The plane is as near to atoms on either side, nearly everywhere.
        let (mut all, mut even) = (0, 0);
        for k in 3..36 {
            for j in 0..45 {
                let along = f64::from(j) - 22.0;
                let p = [21.6 - 0.6 * along, 16.2 + 0.8 * along, f64::from(k)];
                if !(0..3).all(|k| p[k] > 3.0 && p[k] < extent[k] - 3.0) {
                    continue;
                }
                let nearest = |side: f64| {
                    let on_side = paired.positions.iter().filter(|x| side * height(**x) > 0.0);
                    let distance = on_side.map(|x| dot(sub(*x, p), sub(*x, p)).sqrt());
                    distance.fold(f64::INFINITY, f64::min)
                };
                all += 1;
                even += usize::from((nearest(1.0) - nearest(-1.0)).abs() < 0.02);
            }
        }
        assert!(all > 500 && even * 100 > all * 97, "{even} of {all}");
    }
}
