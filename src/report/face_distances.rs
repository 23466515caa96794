//! How far the points of features are from a mesh's faces.
//!
//! Most points have a face close by. So first the faces look for points, in a grid, and tell each how
//! near they are. Only points that no face has found look for a face themselves, in a tree. Where several have some
//! points and some faces each, they are told the faces round the box of their points; of the few points that have none
//! of these, all are told.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use super::mesh_faces::MeshFaces;
use super::nearest::{BoxTree, PointGrid, squared_distance_to_face};
use crate::comm::LocalOrComm;
use crate::comm::concatenate;
use crate::geometry::{cross, dot, sub, to_3d};
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// How far faces look for points, in samples.
const SEARCH_RADIUS: f64 = 1.0;
/// How far from the box of one's points faces are told, and how many points at once all are told of; unit tests have
/// few.
const EXCHANGE_RADIUS: f64 = if cfg!(test) { 2.0 } else { 32.0 };
const MAX_EXCHANGED_FACES: usize = if cfg!(test) { 100 } else { 1 << 16 };
/// Faces or points in one task; the same.
const ITEMS_PER_TASK: usize = if cfg!(test) { 64 } else { 4096 };

/// Distances from a holder's points to the nearest face of each of two sets that any has, infinite where a set has none.
/// Each face belongs to the sets of its bits.
///
/// # Errors
/// Those of the other holders.
pub(super) fn distances_to_faces<const D: usize, H: LocalOrComm + ?Sized>(
    surface: &MeshFaces<'_, D>,
    points: &[[f32; D]],
    wanted: [u8; 2],
    holders: &H,
    patience: &CancelToken<'_>,
) -> Result<[Vec<f64>; 2], H::Error> {
    let mut squares = {
        let round = BoxedFaces::gather_near(surface, points, holders)?;
        let mut squares = round.squared_distances_nearby(points, wanted, patience);
        round.search_from_points(points, wanted, EXCHANGE_RADIUS, &mut squares, patience);
        squares
    };
    let exists = wanted.map(|set| surface.sets.iter().any(|sets| sets & set != 0));
    let exists = holders.try_all_gather("sets of faces", exists)?;
    let exists = [0, 1].map(|k| exists.iter().any(|exists| exists[k]));
    let is_far = |&i: &usize| (0..2).any(|k| exists[k] && squares[k][i].is_infinite());
    let far: Vec<usize> = (0..points.len()).filter(is_far).collect();
    let (mut far, mut own) = (far.chunks(MAX_EXCHANGED_FACES), None);
    loop {
        let some = far.next().unwrap_or_default();
        let of_some: Vec<[f32; D]> = some.iter().map(|&i| points[i]).collect();
        let told = holders.try_all_gather("points far from faces", of_some)?;
        let counts: Vec<usize> = told.iter().map(Vec::len).collect();
        let told = concatenate(told);
        if told.is_empty() {
            break;
        }
        let own = own.get_or_insert_with(|| BoxedFaces::from_surface(surface));
        let mut from_own = [0, 1].map(|_| vec![f64::INFINITY; told.len()]);
        own.search_from_points(&told, wanted, f64::INFINITY, &mut from_own, patience);
        let mut end = 0;
        let of_each = |count: usize| {
            let here = end..end + count;
            end = here.end;
            from_own
                .each_ref()
                .map(|squares| squares[here.clone()].to_vec())
        };
        let answers = counts.into_iter().map(of_each).collect();
        for answer in holders.try_all_to_all("squares of distances to faces", answers)? {
            for (squares, answer) in squares.iter_mut().zip(answer) {
                for (&i, square) in some.iter().zip(answer) {
                    squares[i] = squares[i].min(square);
                }
            }
        }
    }
    for squares in &mut squares {
        squares
            .iter_mut()
            .for_each(|square| *square = square.sqrt());
    }
    Ok(squares)
}

/// A face as others are told of it, and its sets.
type SentFace<const D: usize> = ([[f64; D]; D], u8);

/// Faces of a surface.
struct BoxedFaces<const D: usize> {
    shapes: Vec<[[f64; D]; D]>,
    /// The box round each: its low and its high corner.
    boxes: Vec<[[f64; D]; 2]>,
    sets: Vec<u8>,
}

impl<const D: usize> BoxedFaces<D> {
    /// Those that one has.
    fn from_surface(surface: &MeshFaces<'_, D>) -> Self {
        let faces = 0..surface.faces.len();
        Self::from_sent(faces.map(|f| (surface.corners(f), surface.sets[f])))
    }

    /// Those of all holders that may be within [`EXCHANGE_RADIUS`] of the box of some points.
    fn gather_near<H: LocalOrComm + ?Sized>(
        surface: &MeshFaces<'_, D>,
        points: &[[f32; D]],
        holders: &H,
    ) -> Result<Self, H::Error> {
        let (mut low, mut high) = ([f64::INFINITY; D], [f64::NEG_INFINITY; D]);
        for p in points {
            for k in 0..D {
                low[k] = low[k].min(f64::from(p[k]) - EXCHANGE_RADIUS);
                high[k] = high[k].max(f64::from(p[k]) + EXCHANGE_RADIUS);
            }
        }
        let boxes = holders.try_all_gather("boxes of points", [low, high])?;
        let of = |[low, high]: [[f64; D]; 2]| -> Vec<SentFace<D>> {
            let faces = (0..surface.faces.len()).into_par_iter();
            let faces = faces.map(|f| (surface.corners(f), surface.sets[f]));
            let meets = |(shape, _): &SentFace<D>| {
                let [from, to] = face_box(shape);
                (0..D).all(|k| from[k] <= high[k] && low[k] <= to[k])
            };
            faces.filter(meets).collect()
        };
        let told =
            holders.try_all_to_all("faces round points", boxes.into_iter().map(of).collect())?;
        Ok(Self::from_sent(told.into_iter().flatten()))
    }

    fn from_sent(faces: impl Iterator<Item = SentFace<D>>) -> Self {
        let (shapes, sets): (Vec<_>, _) = faces.unzip();
        Self {
            boxes: shapes.par_iter().map(face_box).collect(),
            shapes,
            sets,
        }
    }

    /// For each set and point the square of the distance to the nearest face where that is within [`INFLUENCE_RADIUS`]; infinite
    /// elsewhere.
    fn squared_distances_nearby(
        &self,
        points: &[[f32; D]],
        wanted: [u8; 2],
        patience: &CancelToken<'_>,
    ) -> [Vec<f64>; 2] {
        let mut extent = [0f64; D];
        for p in points {
            for k in 0..D {
                extent[k] = extent[k].max(p[k].into());
            }
        }
        let (grid, order) = PointGrid::new(points, extent);
        let none = || AtomicU64::new(f64::INFINITY.to_bits());
        // Squares are not negative, so their bits are in their order; the least does not depend on which
        // face comes first.
        let least: [Vec<AtomicU64>; 2] = [0, 1].map(|_| points.iter().map(|_| none()).collect());
        let look = |f: usize| {
            let shape = &self.shapes[f];
            let [low, high] = self.boxes[f];
            let [a, b, c] = [shape[0], shape[1], shape[D - 1]].map(to_3d);
            let normal = cross(sub(b, a), sub(c, a));
            let flat = dot(normal, normal) * (1.0 + 1e-9);
            let of_set = wanted.map(|set| self.sets[f] & set != 0);
            let [low, high] =
                [(low, -SEARCH_RADIUS), (high, SEARCH_RADIUS)].map(|(p, by)| p.map(|c| c + by));
            grid.visit_box(low, high, |i| {
                let known = least
                    .each_ref()
                    .map(|least| f64::from_bits(least[i].load(Relaxed)));
                let mut most = 0f64;
                for k in 0..2 {
                    most = if of_set[k] { most.max(known[k]) } else { most };
                }
                let p = grid.position(i).map(f64::from);
                let height = dot(normal, sub(to_3d(p), a));
                if height * height > flat * most.min(SEARCH_RADIUS * SEARCH_RADIUS) {
                    return;
                }
                let square = squared_distance_to_face(p, shape);
                if square > SEARCH_RADIUS * SEARCH_RADIUS {
                    return;
                }
                for k in 0..2 {
                    if of_set[k] && square < known[k] {
                        least[k][i].fetch_min(square.to_bits(), Relaxed);
                    }
                }
            });
        };
        let count = self.shapes.len();
        (0..count.div_ceil(ITEMS_PER_TASK))
            .into_par_iter()
            .for_each(|chunk| {
                if !patience.is_cancelled() {
                    (chunk * ITEMS_PER_TASK..count.min((chunk + 1) * ITEMS_PER_TASK))
                        .for_each(look);
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

    /// Lets points that have no face look for the nearest one of each set that is nearer than `limit`.
    fn search_from_points(
        &self,
        points: &[[f32; D]],
        wanted: [u8; 2],
        limit: f64,
        squares: &mut [Vec<f64>; 2],
        patience: &CancelToken<'_>,
    ) {
        let mut tree = None;
        for (set, squares) in wanted.into_iter().zip(squares) {
            let exists = self.sets.iter().any(|s| s & set != 0);
            if !exists || squares.iter().all(|square| square.is_finite()) {
                continue;
            }
            let tree = tree.get_or_insert_with(|| BoxTree::new(&self.boxes, &self.sets));
            let chunks = points
                .par_chunks(ITEMS_PER_TASK)
                .zip(squares.par_chunks_mut(ITEMS_PER_TASK));
            chunks.for_each(|(points, squares)| {
                let mut hint = None;
                for (p, square) in points.iter().zip(squares) {
                    if square.is_finite() || patience.is_cancelled() {
                        continue;
                    }
                    let p = p.map(f64::from);
                    let square_to = |f: usize| squared_distance_to_face(p, &self.shapes[f]);
                    let found = tree.nearest(p, set, limit * limit, hint, square_to);
                    hint = found.map(|(f, _)| f);
                    *square = found.map_or(f64::INFINITY, |(_, square)| square);
                }
            });
        }
    }
}

/// The box round a face: its low and its high corner.
fn face_box<const D: usize>(face: &[[f64; D]; D]) -> [[f64; D]; 2] {
    let mut found = [face[0]; 2];
    for p in face {
        for k in 0..D {
            found[0][k] = found[0][k].min(p[k]);
            found[1][k] = found[1][k].max(p[k]);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::{SelfComm, partition_range, run_threads};
    use crate::geometry::random::Random;

    /// What one finds who has all, and several with some each as well.
    fn to_faces(
        nodes: &[[f64; 3]],
        faces: &[[u32; 3]],
        sets: &[u8],
        points: &[[f32; 3]],
        wanted: [u8; 2],
        patience: &CancelToken<'_>,
    ) -> [Vec<f64>; 2] {
        let of = |faces: &[[u32; 3]], sets: &[u8]| MeshFaces {
            nodes,
            faces: faces.to_vec(),
            sets: sets.to_vec(),
        };
        let surface = of(faces, sets);
        let Ok(found) = super::distances_to_faces(&surface, points, wanted, &SelfComm, patience);
        // By where they are, that points are not all round all faces.
        let mut order: Vec<usize> = (0..points.len()).collect();
        order.sort_by(|&i, &j| points[i][0].total_cmp(&points[j][0]));
        for count in [2, 7] {
            run_threads(count, |group| {
                let share = |things: usize| partition_range(things, group.rank(), count);
                let own = &order[share(points.len())];
                let some: Vec<[f32; 3]> = own.iter().map(|&i| points[i]).collect();
                let of_own = share(faces.len());
                let surface = of(&faces[of_own.clone()], &sets[of_own]);
                let all =
                    super::distances_to_faces(&surface, &some, wanted, group, patience).unwrap();
                for (of_some, found) in all.into_iter().zip(&found) {
                    assert!(of_some.into_iter().eq(own.iter().map(|&i| found[i])));
                }
            });
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
        let endless = CancelToken::never();
        for wanted in [[1, 2], [2, 4]] {
            let found = to_faces(&nodes, &faces, &sets, &points, wanted, &endless);
            for (found, set) in found.into_iter().zip(wanted) {
                let of_set: Vec<_> = (faces.iter().zip(&sets))
                    .filter(|(_, s)| **s & set != 0)
                    .map(|(f, _)| f.map(|n| nodes[n as usize]))
                    .collect();
                let mut close = 0;
                for (found, p) in found.iter().zip(&points) {
                    let p = p.map(f64::from);
                    let squares = of_set.iter().map(|f| squared_distance_to_face(p, f));
                    assert_eq!(*found, squares.fold(f64::INFINITY, f64::min).sqrt());
                    close += usize::from(*found <= SEARCH_RADIUS);
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
