//! How far the points of features are from a mesh's faces.
//!
//! Most points have a face close by. So first the faces look for points, in a grid, and tell each how
//! near they are. Only points that no face has found look for a face themselves, in a tree. Where several hold parts
//! of a mesh, all know its faces, and each does a share of both.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use super::fidelity::corners;
use super::nearest::{Points, Tree, square_to_face};
use super::surface::Surface;
use crate::geometry::{cross, dot, in_space, sub};
use crate::mesh::part::Holders;
use crate::observer::Patience;
use crate::ranks::joined;
use rayon::prelude::*;

/// How far faces look for points, in samples.
const REACH: f64 = 1.0;
/// Faces or points in one task; unit tests have few.
const CHUNK: usize = if cfg!(test) { 64 } else { 4096 };

/// Distances from points to the nearest face of each of two sets, infinite where a set has none. Each
/// face belongs to the sets of its bits.
///
/// # Errors
/// Those of the other holders.
pub(super) fn to_faces<const D: usize, H: Holders + ?Sized>(
    surface: &Surface<D, [f64; D]>,
    points: &[[f32; D]],
    wanted: [u8; 2],
    holders: &H,
    patience: &Patience<'_>,
) -> Result<[Vec<f64>; 2], H::Error> {
    let Surface {
        nodes, faces, sets, ..
    } = surface;
    let shapes: Vec<[[f64; D]; D]> = faces.iter().map(|&f| corners(nodes, f)).collect();
    let boxes: Vec<[[f64; D]; 2]> = shapes.iter().map(box_of).collect();
    let look = holders.share(shapes.len(), holders.rank());
    let close = by_faces(&shapes, &boxes, sets, look, points, wanted, patience);
    // Chunks are the same whoever has them.
    let chunks = points.len().div_ceil(CHUNK);
    let share = |of: usize| {
        let Range { start, end } = holders.share(chunks, of);
        CHUNK * start..points.len().min(CHUNK * end)
    };
    let close = least(close, share, holders)?;
    let points = &points[share(holders.rank())];
    let mut tree = None;
    let own = [0, 1].map(|i| {
        let (close, set) = (&close[i], wanted[i]);
        let exists = sets.iter().any(|s| s & set != 0);
        if exists && close.iter().any(|square| square.is_infinite()) {
            let tree = tree.get_or_insert_with(|| Tree::new(&boxes, sets));
            let chunks = points.par_chunks(CHUNK).zip(close.par_chunks(CHUNK));
            let far =
                chunks
                    .take_any_while(|_| !patience.over())
                    .flat_map_iter(|(points, close)| {
                        let mut hint = None;
                        let mut of_point = |(p, &square): (&[f32; D], &f64)| {
                            if square.is_finite() {
                                return square.sqrt();
                            }
                            let p = p.map(f64::from);
                            let square_to = |f: usize| square_to_face(p, &shapes[f]);
                            let found = tree.nearest(p, set, f64::INFINITY, hint, square_to);
                            hint = found.map(|(f, _)| f);
                            found.map_or(f64::INFINITY, |(_, square)| square.sqrt())
                        };
                        let distances: Vec<f64> =
                            points.iter().zip(close).map(&mut of_point).collect();
                        distances
                    });
            far.collect()
        } else {
            close.iter().map(|square| square.sqrt()).collect()
        }
    });
    let all = holders.told("distances to faces", own)?;
    let (first, second) = all
        .into_iter()
        .map(|[first, second]| (first, second))
        .unzip();
    Ok([joined(first), joined(second)])
}

/// The least squares that any of the holders has, of the points of this one's share.
fn least<H: Holders + ?Sized>(
    squares: [Vec<f64>; 2],
    share: impl Fn(usize) -> Range<usize>,
    holders: &H,
) -> Result<[Vec<f64>; 2], H::Error> {
    if holders.count() == 1 {
        return Ok(squares);
    }
    let of = |to: usize| {
        squares
            .each_ref()
            .map(|squares| squares[share(to)].to_vec())
    };
    let to = (0..holders.count()).map(of).collect();
    let mut from = holders
        .passed("squares of distances to faces", to)?
        .into_iter();
    let mut least: [Vec<f64>; 2] = from.next().unwrap_or_default();
    for other in from {
        for (least, other) in least.iter_mut().zip(other) {
            let both = least.iter_mut().zip(other);
            both.for_each(|(least, square)| *least = least.min(square));
        }
    }
    Ok(least)
}

/// The box round a face: its low and its high corner.
fn box_of<const D: usize>(face: &[[f64; D]; D]) -> [[f64; D]; 2] {
    let mut found = [face[0]; 2];
    for p in face {
        for k in 0..D {
            found[0][k] = found[0][k].min(p[k]);
            found[1][k] = found[1][k].max(p[k]);
        }
    }
    found
}

/// For each set and point the square of the distance to the nearest of some `faces` where that is within
/// [`REACH`]; infinite elsewhere.
fn by_faces<const D: usize>(
    shapes: &[[[f64; D]; D]],
    boxes: &[[[f64; D]; 2]],
    sets: &[u8],
    faces: Range<usize>,
    points: &[[f32; D]],
    wanted: [u8; 2],
    patience: &Patience<'_>,
) -> [Vec<f64>; 2] {
    let mut extent = [0f64; D];
    for p in points {
        for k in 0..D {
            extent[k] = extent[k].max(p[k].into());
        }
    }
    let (grid, order) = Points::new(points, extent);
    let none = || AtomicU64::new(f64::INFINITY.to_bits());
    // Squares are not negative, so their bits are in their order; the least does not depend on which
    // face comes first.
    let least: [Vec<AtomicU64>; 2] = [0, 1].map(|_| points.iter().map(|_| none()).collect());
    let look = |f: usize| {
        let shape = &shapes[f];
        let [low, high] = boxes[f];
        let [a, b, c] = [shape[0], shape[1], shape[D - 1]].map(in_space);
        let normal = cross(sub(b, a), sub(c, a));
        let flat = dot(normal, normal) * (1.0 + 1e-9);
        let of_set = wanted.map(|set| sets[f] & set != 0);
        let [low, high] = [(low, -REACH), (high, REACH)].map(|(p, by)| p.map(|c| c + by));
        grid.within(low, high, |i| {
            let known = least
                .each_ref()
                .map(|least| f64::from_bits(least[i].load(Relaxed)));
            let mut most = 0f64;
            for k in 0..2 {
                most = if of_set[k] { most.max(known[k]) } else { most };
            }
            let p = grid.position(i).map(f64::from);
            let height = dot(normal, sub(in_space(p), a));
            if height * height > flat * most.min(REACH * REACH) {
                return;
            }
            let square = square_to_face(p, shape);
            if square > REACH * REACH {
                return;
            }
            for k in 0..2 {
                if of_set[k] && square < known[k] {
                    least[k][i].fetch_min(square.to_bits(), Relaxed);
                }
            }
        });
    };
    (0..faces.len().div_ceil(CHUNK))
        .into_par_iter()
        .for_each(|chunk| {
            if !patience.over() {
                let first = faces.start + chunk * CHUNK;
                (first..faces.end.min(first + CHUNK)).for_each(look);
            }
        });
    least.map(|least| {
        let mut squares = vec![f64::INFINITY; points.len()];
        for (&i, square) in order.iter().zip(least) {
            squares[i as usize] = f64::from_bits(square.into_inner());
        }
        squares
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;
    use crate::ranks::{Alone, shared};

    /// What one alone finds, and several as well.
    fn to_faces(
        nodes: &[[f64; 3]],
        faces: &[[u32; 3]],
        sets: &[u8],
        points: &[[f32; 3]],
        wanted: [u8; 2],
        patience: &Patience<'_>,
    ) -> [Vec<f64>; 2] {
        let surface = Surface {
            numbers: (0..nodes.len() as u32).collect(),
            nodes: nodes.to_vec(),
            faces: faces.to_vec(),
            sets: sets.to_vec(),
        };
        let Ok(found) = super::to_faces(&surface, points, wanted, &Alone, patience);
        for count in [2, 7] {
            let all = shared(count, |group| {
                super::to_faces(&surface, points, wanted, group, patience).unwrap()
            });
            assert!(all.iter().all(|other| *other == found));
        }
        found
    }

    /// Triangles here and there, of set 1, 2 or both, flat ones too, and points among them and far off.
    #[test]
    fn distances_are_those_of_a_scan() {
        let mut random = Random::new(5);
        let mut point = |size: f64| -> [f64; 3] { std::array::from_fn(|_| size * random.draw()) };
        let mut nodes = Vec::new();
        for f in 0..120 {
            let at = point(12.0);
            for _ in 0..3 {
                let off = point(if f % 7 == 0 { 0.0 } else { 3.0 });
                nodes.push(std::array::from_fn(|k| at[k] + off[k]));
            }
        }
        let faces: Vec<[u32; 3]> = (0..120).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        let sets: Vec<u8> = (0..120).map(|f| [3, 3, 1, 2][f % 4]).collect();
        let points: Vec<[f32; 3]> = (0..6000)
            .map(|_| point(19.0).map(|c| (c - 3.0) as f32))
            .collect();
        let endless = Patience::endless();
        for wanted in [[1, 2], [2, 4]] {
            let found = to_faces(&nodes, &faces, &sets, &points, wanted, &endless);
            for (found, set) in found.into_iter().zip(wanted) {
                let of_set: Vec<_> = (faces.iter().zip(&sets))
                    .filter(|(_, s)| **s & set != 0)
                    .map(|(f, _)| corners(&nodes, *f))
                    .collect();
                let mut close = 0;
                for (found, p) in found.iter().zip(&points) {
                    let p = p.map(f64::from);
                    let squares = of_set.iter().map(|f| square_to_face(p, f));
                    assert_eq!(*found, squares.fold(f64::INFINITY, f64::min).sqrt());
                    close += usize::from(*found <= REACH);
                }
                let both = if set == 4 { 0..1 } else { 500..5500 };
                assert!(both.contains(&close), "{close}");
            }
        }
        let of = |points: &[[f32; 3]]| to_faces(&[], &[], &[], points, [1, 2], &endless);
        assert_eq!(of(&[[0.0; 3]]), [[f64::INFINITY], [f64::INFINITY]]);
        assert!(of(&[])[0].is_empty());
    }
}
