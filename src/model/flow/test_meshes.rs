//! Flow through meshes for tests.

use super::{Barriers, ElementFlow, FaultLaw, Rock};
use crate::mesh::Simplices;
use crate::mesh::boxes::{faces_on, jittered_box};
use crate::mesh::interface::marks_from_bits;

/// A box three long of jittered cubes with a fault at x = 1.5 that ends at 2 along the last axis.
pub fn faulted_box<const D: usize, M: Simplices<D>>() -> (M, Vec<u8>) {
    let mesh = jittered_box([6; D], [3.0; D], 0.25, |x| x[0] != 1.5);
    let bits = faces_on(&mesh, |x| x[0] == 1.5 && x[D - 1] <= 2.0);
    (mesh, bits)
}

/// Flow through a mesh whose marked faces all resist alike.
pub fn flow_through<const D: usize, M: Simplices<D>>(
    mesh: &M,
    bits: &[u8],
    rock: Rock,
    faults: FaultLaw,
) -> ElementFlow<D, M> {
    let barriers = Barriers::uniform(marks_from_bits::<D>(bits), faults);
    ElementFlow::new(mesh, &barriers, rock).unwrap()
}
