//! Atoms in pairs, one the other's mirror image in a feature: so the face between them lies on it.
//!
//! Atoms at rest alongside a feature keep off it, but those on one side know little of those on the
//! other, and the faces between them zigzag across the feature. It helps to do at features what is
//! done at the sides of the box: the first layer of atoms on one side stays, that on the other gives
//! way to its mirror image.

use crate::distance::Distance;
use crate::improve::sheets::{SAME_SHEET, Sheet, Sheets};
use crate::mesh::{AtomKind, add_scaled, dot, sub};
use crate::seeding::Atoms;

/// Atoms no farther from a feature than this, in units of d, belong to its first layers: the cells
/// of others do not reach it.
const BESIDE: f64 = 0.85;
/// Neighbours in a layer are no farther apart than this, in units of d.
const NEXT: f64 = 1.6;
/// No image is put nearer to an atom that stays than this, in units of d.
const ROOM: f64 = 0.6;
/// An atom nearer to a feature than this, in units of d, is moved away to it first.
const OFF: f64 = 0.3;

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

/// Replaces the first layer of atoms on one side of every feature by the mirror image of that on the
/// other. Atoms of both layers become fixed, all others stay as they are. Fixed atoms stay.
pub fn mirrored<const D: usize>(
    atoms: &Atoms<D>,
    extent: [f64; D],
    sheets: &Sheets,
    distance: &Distance<D>,
) -> Atoms<D> {
    let mut layers: Vec<Beside> = (0..atoms.len())
        .filter(|&i| atoms.kinds[i] == AtomKind::Interior)
        .filter_map(|atom| {
            let x = lift(atoms.positions[atom]);
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
    let grid = Grid::new(layers.iter().map(|b| b.x), reach);
    orient(&mut layers, &grid);

    // Atoms that stay, and the images of those on the upper side.
    let mut stays = vec![true; atoms.len()];
    let mut pairs: Vec<([f64; 3], [f64; 3])> = Vec::new();
    for b in layers.iter().filter(|b| b.sheet.offset >= 0.0) {
        let height = b.sheet.offset.max(OFF * b.d);
        let x = add_scaled(b.x, height - b.sheet.offset, b.sheet.normal);
        let image = add_scaled(x, -2.0 * height, b.sheet.normal);
        let inside =
            |p: [f64; 3]| (0..D).all(|k| p[k] > 0.05 * b.d && p[k] < extent[k] - 0.05 * b.d);
        // Near the end of a feature there may be nothing to mirror in.
        let foot = add_scaled(x, -height, b.sheet.normal);
        let here = sheets.near(foot);
        let on_it = |s: &Sheet| {
            dot(s.normal, b.sheet.normal).abs() > SAME_SHEET && s.offset.abs() < 0.2 * b.d
        };
        if !inside(x) || !inside(image) || !here.iter().any(on_it) {
            continue;
        }
        // Of several features that cross, the image must be on the same side as the atom.
        let crossed = |s: &Sheet| {
            dot(s.normal, b.sheet.normal).abs() <= SAME_SHEET
                && s.offset * (s.offset - 2.0 * height * dot(s.normal, b.sheet.normal)) < 0.0
        };
        if sheets.near(x).iter().any(crossed) {
            continue;
        }
        let mut free = true;
        grid.visit(image, |j| {
            let other = &layers[j];
            let below = other.surface == b.surface && other.sheet.offset < 0.0;
            let off = sub(other.x, image);
            free &= below || other.atom == b.atom || dot(off, off) > (ROOM * b.d).powi(2);
        });
        if free {
            pairs.push((x, image));
            stays[b.atom] = false;
            grid.visit(image, |j| {
                let other = &layers[j];
                let off = sub(other.x, image);
                if other.surface == b.surface
                    && other.sheet.offset < 0.0
                    && dot(off, off) < b.d * b.d
                {
                    stays[other.atom] = false;
                }
            });
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
    for x in pairs.into_iter().flat_map(|(x, image)| [x, image]) {
        result.positions.push(std::array::from_fn(|k| x[k]));
        result.kinds.push(AtomKind::Fixed);
    }
    result
}

/// A point of the plane or of space, in space.
fn lift<const D: usize>(x: [f64; D]) -> [f64; 3] {
    std::array::from_fn(|k| x.get(k).copied().unwrap_or(0.0))
}

/// Gives neighbours along one surface the same surface number, and normals on the same side.
fn orient(layers: &mut [Beside], grid: &Grid) {
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

/// Points in cells of the reach within which they are sought.
struct Grid {
    cell: f64,
    low: [f64; 3],
    dims: [usize; 3],
    start: Vec<u32>,
    items: Vec<u32>,
}

impl Grid {
    fn new(points: impl Iterator<Item = [f64; 3]> + Clone, cell: f64) -> Self {
        let (low, high) = points.clone().fold(
            ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]),
            |(low, high), p| {
                let fold =
                    |f: fn(f64, f64) -> f64, q: [f64; 3]| std::array::from_fn(|k| f(p[k], q[k]));
                (fold(f64::min, low), fold(f64::max, high))
            },
        );
        let dims = std::array::from_fn(|k| ((high[k] - low[k]).max(0.0) / cell) as usize + 1);
        let mut grid = Self {
            cell,
            low,
            dims,
            start: vec![0; dims.iter().product::<usize>() + 1],
            items: vec![0; points.clone().count()],
        };
        for p in points.clone() {
            let cell = grid.index(grid.at(p));
            grid.start[cell + 1] += 1;
        }
        for i in 1..grid.start.len() {
            grid.start[i] += grid.start[i - 1];
        }
        let mut next = grid.start.clone();
        for (i, p) in points.enumerate() {
            let cell = grid.index(grid.at(p));
            grid.items[next[cell] as usize] = i as u32;
            next[cell] += 1;
        }
        grid
    }

    fn at(&self, p: [f64; 3]) -> [usize; 3] {
        std::array::from_fn(|k| (((p[k] - self.low[k]) / self.cell) as usize).min(self.dims[k] - 1))
    }

    fn index(&self, at: [usize; 3]) -> usize {
        (at[2] * self.dims[1] + at[1]) * self.dims[0] + at[0]
    }

    /// Runs `visit` on the points in the cell of `p` and those around it.
    fn visit(&self, p: [f64; 3], mut visit: impl FnMut(usize)) {
        let at = self.at(p);
        let low = at.map(|c| c.saturating_sub(1));
        let high: [usize; 3] = std::array::from_fn(|k| (at[k] + 1).min(self.dims[k] - 1));
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                let (from, to) = (self.index([low[0], y, z]), self.index([high[0], y, z]) + 1);
                for &i in &self.items[self.start[from] as usize..self.start[to] as usize] {
                    visit(i as usize);
                }
            }
        }
    }
}
