//! Assigns the labels of the image to cells, and fits faces to the interfaces between labels.
//!
//! - `anchors`: keeps nodes on given surfaces meanwhile
//! - `assign`: assigns to each cell the label of the largest part of its volume
//! - `fit`: moves nodes between labels so that faces lie on the interface on average
//! - `balance`: computes by how much interfaces move so that regions have their volumes
//! - `parts`: finds the connected parts of labels, in the image and in the mesh
//! - `topology`: keeps parts apart that touch nowhere in the image
//! - `pinches`: splits cells where this needs more than other labels of cells
//!
//! An interface that is a union of faces between cells of different labels has no holes, whatever
//! the labels are. Its faces count as faces on features.

mod anchors;
mod assign;
mod balance;
mod fit;
mod parts;
mod pinches;
mod topology;

pub use anchors::AnchoredNodes;
pub(super) use assign::directions;
pub use assign::{SamplePoints, Votes, assign_labels, interface_marks};
pub use fit::{InterfaceFit, fit, remove_spikes};
pub use parts::LabelParts;
pub use pinches::PinchedMesh;
pub use topology::PartTopology;

use crate::mesh::Simplices;
use crate::mesh::complex::NONE;

/// Returns the total volume of the cells of each part, for `count` parts. Cells without a part have
/// [`NONE`].
fn part_volumes<const D: usize, M: Simplices<D>>(
    mesh: &M,
    parts: &[u32],
    count: usize,
) -> Vec<f64> {
    let mut volumes = vec![0.0; count];
    for (part, volume) in parts.iter().zip(mesh.volumes()) {
        if *part != NONE {
            volumes[*part as usize] += volume;
        }
    }
    volumes
}
