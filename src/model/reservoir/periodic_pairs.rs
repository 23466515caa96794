//! The nodes of a periodic mesh that are images of one another on opposite sides.

use std::collections::BTreeMap;

use crate::mesh_file::array_names::{FAR_AXES_ARRAY, PERIODIC_NODE_ARRAY};
use crate::store::MeshFile;

/// A node on a far side, and the node that it is the image of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PeriodicPair {
    /// The node on a far side.
    pub node: u32,
    /// The node on the near side.
    pub base: u32,
    /// Bit k for each axis of the image along which the two are a period apart.
    pub axes: u8,
}

/// The images among the nodes of a mesh.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PeriodicImages {
    /// The number that a node shares with its images, and the axes on whose far side it lies.
    places: Vec<(u32, u8)>,
    /// The node at each place.
    nodes: BTreeMap<(u32, u8), u32>,
}

impl PeriodicImages {
    /// Reads the images from the arrays of a mesh file; there are none if it is not periodic.
    pub fn from_file<M>(file: &MeshFile<M>) -> Self {
        let array = |name: &str| {
            let array = file.point_data.iter().find(|array| array.name == name)?;
            array.values.to_u32()
        };
        let (Some(numbers), Some(axes)) = (array(PERIODIC_NODE_ARRAY), array(FAR_AXES_ARRAY))
        else {
            return Self::default();
        };
        let axes = axes.into_iter().map(|bits| bits as u8);
        Self::new(numbers.into_iter().zip(axes).collect())
    }

    /// Creates the images from the number that each node shares with its images, and the axes on
    /// whose far side it lies.
    fn new(places: Vec<(u32, u8)>) -> Self {
        let numbered = (0..).zip(&places);
        Self {
            nodes: numbered.map(|(node, place)| (*place, node)).collect(),
            places,
        }
    }

    /// Returns `true` if the mesh is not periodic.
    pub fn is_empty(&self) -> bool {
        self.places.iter().all(|(_, axes)| *axes == 0)
    }

    /// Returns the nodes on far sides, each with the image that is far along the fewest axes.
    pub fn node_pairs(&self) -> Vec<PeriodicPair> {
        let mut bases: BTreeMap<u32, (u32, u8, u32)> = BTreeMap::new();
        for (&(number, axes), &node) in &self.nodes {
            let entry = (axes.count_ones(), axes, node);
            let base = bases.entry(number).or_insert(entry);
            *base = entry.min(*base);
        }
        let pair = |(node, &(number, axes)): (u32, &(u32, u8))| {
            let &(_, near_axes, base) = bases.get(&number)?;
            let is_image = node != base && near_axes & !axes == 0;
            is_image.then_some(PeriodicPair {
                node,
                base,
                axes: axes & !near_axes,
            })
        };
        (0..).zip(&self.places).filter_map(pair).collect()
    }

    /// Returns the edge that an edge on far sides is the image of, and the axes along which the two
    /// are a period apart.
    pub fn base_edge(&self, edge: [u32; 2]) -> Option<([u32; 2], u8)> {
        let places = edge.map(|n| self.places.get(n as usize).copied());
        let [Some(first), Some(second)] = places else {
            return None;
        };
        let axes = first.1 & second.1;
        let base = |(number, bits): (u32, u8)| self.nodes.get(&(number, bits & !axes)).copied();
        let ends = [base(first)?, base(second)?];
        (axes != 0).then_some((ends, axes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_image_has_one_base_also_where_the_base_is_missing() {
        // The corners of a square and a node in its middle; then without the base.
        let images = PeriodicImages::new(vec![(0, 0), (0, 1), (0, 2), (0, 3), (4, 0)]);
        let pair = |node, base, axes| PeriodicPair { node, base, axes };
        assert_eq!(
            images.node_pairs(),
            [pair(1, 0, 1), pair(2, 0, 2), pair(3, 0, 3)]
        );
        assert_eq!(images.base_edge([1, 3]), Some(([0, 2], 1)));
        assert_eq!(images.base_edge([0, 1]), None);
        assert!(!images.is_empty());
        let images = PeriodicImages::new(vec![(7, 1), (7, 2), (7, 3), (4, 0)]);
        assert_eq!(images.node_pairs(), [pair(2, 0, 2)]);
        assert!(PeriodicImages::default().is_empty());
    }
}
