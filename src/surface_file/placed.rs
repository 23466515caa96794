//! Brings a surface that a user gives into the frame of an image, and drops its null values.

use super::interpretation::{PickedShape, PickedSurface};
use super::sticks::Stick;
use crate::error::{Error, Result, cause};
use crate::image::placing::{Frame, GivenFile};
use crate::image::point_nulls::{NullSearch, consecutive_pairs, pairs_in_plan};
use crate::image::stated::CoordinateOptions;

/// A surface in the physical coordinates of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedSurface {
    /// The triangles or the points.
    pub shape: PickedShape,
    /// The share of its points that lies in the image.
    pub share: f64,
    /// What was read, assumed, turned and dropped, each as a part of a sentence.
    pub notes: Vec<String>,
}

impl PickedSurface {
    /// Returns the surface in the frame of an image. `place` is the option that gives it, for
    /// messages, and `options` says what the file does not say.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for coordinates that do not suit the image ([`Frame::placing`]), and for
    /// a surface that consists of null values.
    pub fn placed<const D: usize>(
        &self,
        frame: &Frame<D>,
        place: &str,
        options: &CoordinateOptions,
    ) -> Result<PlacedSurface> {
        let (mut shape, mut nulls) = self.without_nulls(options);
        if shape.points().next().is_none() {
            let problem = format!("{} has no point: {}", self.name, nulls.join(", "));
            let remedy = "export it again, or keep all values: ,null=none";
            return Err(Error::Job(cause(place, problem, remedy)));
        }
        let file = GivenFile {
            place,
            stated: &self.coordinates,
            options,
        };
        let to_frame = |p: [f64; 3]| std::array::from_fn::<f64, D, _>(|k| p[k]);
        let placing = frame.placing(file, &mut shape.points().map(to_frame))?;
        shape.try_map_points(|p| {
            let placed = placing.apply(to_frame(p));
            Ok(std::array::from_fn(|k| placed.get(k).copied().unwrap_or(0.0)))
        })?;
        let mut notes = placing.notes.clone();
        notes.append(&mut nulls);
        Ok(PlacedSurface {
            shape,
            share: placing.share,
            notes,
        })
    }

    /// Returns the shape without null values, and a note on each of these.
    fn without_nulls(&self, options: &CoordinateOptions) -> (PickedShape, Vec<String>) {
        let mut named = self.coordinates.nulls.clone();
        named.extend(options.nulls.iter().flatten());
        let recognises = options.nulls.as_deref() != Some(&[]);
        if !recognises {
            named.clear();
        }
        let search = |points: &[[f64; 3]], groups: &dyn Fn() -> Vec<Vec<[u32; 2]>>| {
            NullSearch {
                points,
                named: &named,
                recognises,
            }
            .find(groups)
        };
        match &self.shape {
            PickedShape::Points(points) => {
                let groups = || vec![consecutive_pairs(0, points.len()), pairs_in_plan(points)];
                let nulls = search(points, &groups);
                let kept = points.iter().zip(nulls.flags).filter(|(_, null)| !null);
                let kept = kept.map(|(p, _)| *p).collect();
                (PickedShape::Points(kept), nulls.notes)
            }
            PickedShape::Sticks(sticks) => {
                let points: Vec<[f64; 3]> = self.shape.points().collect();
                let pairs = || {
                    let mut first = 0;
                    let of_stick = |stick: &Stick| {
                        first += stick.points.len();
                        consecutive_pairs(first - stick.points.len(), stick.points.len())
                    };
                    vec![sticks.iter().flat_map(of_stick).collect()]
                };
                let nulls = search(&points, &pairs);
                let mut flags = nulls.flags.into_iter();
                let mut kept = sticks.clone();
                for stick in &mut kept {
                    stick.points.retain(|_| !flags.next().unwrap_or(false));
                }
                kept.retain(|stick| !stick.points.is_empty());
                (PickedShape::Sticks(kept), nulls.notes)
            }
            PickedShape::Triangles(triangles) => {
                let (nodes, corners) = distinct_nodes(triangles);
                let edges = || {
                    let edges = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
                    vec![corners.iter().flat_map(edges).collect()]
                };
                let nulls = search(&nodes, &edges);
                let has_null = |t: &[u32; 3]| t.iter().any(|n| nulls.flags[*n as usize]);
                let kept = triangles.iter().zip(&corners).filter(|(_, t)| !has_null(t));
                let kept = kept.map(|(t, _)| *t).collect();
                (PickedShape::Triangles(kept), nulls.notes)
            }
        }
    }
}

/// Returns the distinct corners of triangles, and the numbers of each triangle's corners.
fn distinct_nodes(triangles: &[[[f64; 3]; 3]]) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let points = triangles.as_flattened();
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    let key = |i: u32| points[i as usize].map(f64::to_bits);
    order.sort_unstable_by_key(|&i| (key(i), i));
    let mut numbers = vec![0; points.len()];
    let mut nodes: Vec<[f64; 3]> = Vec::new();
    let mut previous = None;
    for i in order {
        if previous != Some(key(i)) {
            previous = Some(key(i));
            nodes.push(points[i as usize]);
        }
        numbers[i as usize] = nodes.len() as u32 - 1;
    }
    let corners = numbers.as_chunks::<3>().0.to_vec();
    (nodes, corners)
}
