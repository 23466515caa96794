//! The places that the user assigned to object and background, and the cells and samples in them.

use super::SegmentSeeds;
use crate::error::cause;
use crate::image::Geometry;
use crate::mesh::Mesh;
use crate::model::surface::adjacency::{CellAdjacency, find_cell};
use crate::store::LatticeSpace;
use crate::{Error, Result};

/// A box or a point in physical coordinates.
pub(super) struct Place<const D: usize> {
    /// The option that gives it.
    name: String,
    low: [f64; D],
    high: [f64; D],
}

impl<const D: usize> Place<D> {
    /// Returns the box with these two corners.
    pub(super) fn new(name: String, a: [f64; D], b: [f64; D]) -> Self {
        Self {
            name,
            low: std::array::from_fn(|k| a[k].min(b[k])),
            high: std::array::from_fn(|k| a[k].max(b[k])),
        }
    }

    pub(super) fn contains(&self, p: [f64; D]) -> bool {
        (0..D).all(|k| self.low[k] <= p[k] && p[k] <= self.high[k])
    }

    fn centre(&self) -> [f64; D] {
        std::array::from_fn(|k| 0.5 * (self.low[k] + self.high[k]))
    }

    fn outside_error(&self, container: &str) -> Error {
        let remedy = "give physical coordinates; atomesh info shows their range";
        let problem = format!("lies outside the {container}");
        Error::Job(cause(&self.name, problem, remedy))
    }
}

/// All places that the user assigned.
pub(super) struct Places<const D: usize> {
    pub(super) object: Vec<Place<D>>,
    pub(super) background: Vec<Place<D>>,
}

impl<const D: usize> Places<D> {
    /// Returns the cells whose centres lie in the boxes, and the cells that contain the centres of
    /// the boxes.
    pub(super) fn cells<M: Mesh<D>>(
        &self,
        mesh: &M,
        space: &LatticeSpace<D>,
        cells: &CellAdjacency<D>,
        face_cells: &[[u32; 2]],
    ) -> Result<SegmentSeeds> {
        let centres = cells.centres.iter().map(|&p| space.to_world(p));
        let centres: Vec<[f64; D]> = centres.collect();
        self.seeds(|place, seeds| {
            let middle = space
                .to_lattice(place.centre())
                .and_then(|p| find_cell(mesh, face_cells, p))
                .ok_or_else(|| place.outside_error("mesh"))?;
            seeds.push(middle);
            let inside = (0..).zip(&centres).filter(|(_, p)| place.contains(**p));
            seeds.extend(inside.map(|(c, _)| c));
            Ok(())
        })
    }

    /// Returns the samples in the boxes, and those nearest to the centres of the boxes.
    pub(super) fn samples(&self, dims: [usize; D], geometry: &Geometry<D>) -> Result<SegmentSeeds> {
        let count: usize = dims.iter().product();
        let index_of = |mut i: usize| {
            dims.map(|n| {
                let index = i % n;
                i /= n;
                index as f64
            })
        };
        self.seeds(|place, seeds| {
            let index = (geometry.to_index(place.centre())).map(|p| p.map(f64::round));
            let middle = index
                .filter(|p| (0..D).all(|k| 0.0 <= p[k] && p[k] < dims[k] as f64))
                .ok_or_else(|| place.outside_error("image"))?;
            let index = (0..D)
                .rev()
                .fold(0, |index, k| index * dims[k] + middle[k] as usize);
            seeds.push(index as u32);
            if place.low != place.high {
                let is_inside = |i: &usize| place.contains(geometry.to_physical(index_of(*i)));
                seeds.extend((0..count).filter(is_inside).map(|i| i as u32));
            }
            Ok(())
        })
    }

    /// Returns what `add` finds in each place, sorted and each once.
    fn seeds(&self, add: impl Fn(&Place<D>, &mut Vec<u32>) -> Result<()>) -> Result<SegmentSeeds> {
        let find = |places: &[Place<D>]| {
            let mut seeds = Vec::new();
            places.iter().try_for_each(|place| add(place, &mut seeds))?;
            seeds.sort_unstable();
            seeds.dedup();
            Ok::<_, Error>(seeds)
        };
        Ok(SegmentSeeds {
            object: find(&self.object)?,
            background: find(&self.background)?,
        })
    }
}
