//! Meshes and flow set-ups for tests.

use super::{Barriers, ElementFlow, FaultLaw, Rock};
use crate::mesh::Simplices;
use crate::mesh::boxes::{faces_on, jittered_box};
use crate::mesh::interface::marks_from_bits;

/// Returns a box of length 3, made of jittered cubes, with a fault at x = 1.5 that ends at 2 along
/// the last axis. The second value holds the bits of the fault's faces.
pub fn faulted_box<const D: usize, M: Simplices<D>>() -> (M, Vec<u8>) {
    let mesh = jittered_box([6; D], [3.0; D], 0.25, |x| x[0] != 1.5);
    let bits = faces_on(&mesh, |x| x[0] == 1.5 && x[D - 1] <= 2.0);
    (mesh, bits)
}

/// Prepares the flow through a mesh whose marked faces all have the same fault law.
pub fn flow_through<const D: usize, M: Simplices<D>>(
    mesh: &M,
    bits: &[u8],
    rock: Rock,
    faults: FaultLaw,
) -> ElementFlow<D, M> {
    let barriers = Barriers::uniform(marks_from_bits::<D>(bits), faults);
    ElementFlow::new(mesh, &barriers, rock).unwrap()
}
