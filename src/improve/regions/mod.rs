//! Assigns the labels of the image to cells, and fits faces to the interfaces between labels.
//!
//! - `anchors`: keeps nodes on given surfaces meanwhile
//! - `assign`: assigns to each cell the label of the largest part of its volume
//! - `fit`: moves nodes between labels so that faces lie on the interface on average
//! - `balance`: computes by how much interfaces move so that regions have their volumes
//!
//! An interface that is a union of faces between cells of different labels has no holes, whatever
//! the labels are. Its faces count as faces on features.

mod anchors;
mod assign;
mod balance;
mod fit;

pub use anchors::AnchoredNodes;
pub use assign::{SamplePoints, Votes, assign_labels, interface_marks};
pub use fit::{InterfaceFit, fit, remove_spikes};

use crate::mesh::Simplices;

/// Returns the total volume of the cells of each label, for `count` labels.
fn region_volumes<const D: usize, M: Simplices<D>>(
    mesh: &M,
    regions: &[u32],
    count: usize,
) -> Vec<f64> {
    let mut volumes = vec![0.0; count];
    for (region, volume) in regions.iter().zip(mesh.volumes()) {
        volumes[*region as usize] += volume;
    }
    volumes
}
