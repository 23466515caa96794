//! Cells take the labels of the image, and the faces between them lie where labels change.
//!
//! - `assign`: a cell has the label of most of its volume
//! - `fit`: nodes between labels move so that faces lie on the interface in the mean
//! - `balance`: by how much interfaces must give way for regions to have their volumes
//!
//! An interface that is a union of faces between cells of different labels has no holes, whatever the
//! labels are, and counts as what lies on features.

mod assign;
mod balance;
mod fit;

pub use assign::{SamplePoints, Votes, assign_labels, interface_marks};
pub use fit::{InterfaceFit, fit, remove_spikes};

use crate::mesh::Simplices;

/// The volume of the cells of each label, of which there are `count`.
fn region_volumes<const D: usize, M: Simplices<D>>(
    mesh: &M,
    regions: &[u32],
    count: usize,
) -> Vec<f64> {
    let mut volumes = vec![0.0; count];
    for (c, &region) in regions.iter().enumerate() {
        volumes[region as usize] += mesh.volume(c);
    }
    volumes
}
