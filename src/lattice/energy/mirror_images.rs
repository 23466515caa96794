//! Mirror images of atoms beyond the sides of the box, so that Voronoi cells end exactly on the
//! sides (Hale 2002).
//!
//! An image acts on the atoms inside the box as an atom would. It lies where its atom is mirrored
//! in one side, or in two or three sides that meet. By symmetry the force of all images on an atom
//! is the derivative of the energy with respect to the atom's position, while its images move with
//! it: each pair of an atom and an image has a mirrored counterpart, and an atom and its own image
//! share their energy.

use super::neighbours::IntPoint;
use crate::lattice::halo::OwnedAndGhosts;

/// Images are kept of atoms that are nearer to a side than this multiple of their cutoff.
const REACH_MARGIN: f32 = 1.2;

/// A mirror image of an atom.
#[derive(Clone, Copy)]
struct MirrorImage {
    atom: u32,
    /// Bits of the sides that mirror it: bit k for the near side along axis k, bit `3 + k` for the
    /// far side.
    sides: u8,
}

/// The mirror images of all atoms near the sides of a box, in the order of the atoms.
#[derive(Clone, Default)]
pub struct MirrorImages {
    /// The far corner of the box.
    extent: [i32; 3],
    /// Count of axes along which the box has sides.
    axes: usize,
    images: Vec<MirrorImage>,
    /// Where each atom's images start, and one more at the end.
    starts: Vec<u32>,
}

impl MirrorImages {
    /// Creates an empty list of images for a box of `axes` dimensions.
    pub fn new(extent: IntPoint, axes: usize) -> Self {
        Self {
            extent: [extent[0], extent[1], extent[2]],
            axes,
            ..Self::default()
        }
    }

    /// Returns the count of images.
    pub fn len(&self) -> usize {
        self.images.len()
    }

    /// Returns the atom of each image, in the order of the images.
    pub fn atoms(&self) -> impl Iterator<Item = usize> + '_ {
        self.images.iter().map(|image| image.atom as usize)
    }

    /// Returns the count of owned atoms and their images.
    pub fn owned_point_count(&self, halo: &OwnedAndGhosts<'_>) -> usize {
        let owned = halo.owned();
        owned.len() + self.atoms().filter(|atom| owned.contains(atom)).count()
    }

    /// Returns the atom of image `n`, and the sides that mirror it.
    pub fn source(&self, n: usize) -> (u32, u8) {
        (self.images[n].atom, self.images[n].sides)
    }

    /// Returns the image of an atom in the given sides.
    pub fn find(&self, atom: usize, sides: u8) -> Option<usize> {
        let position = self
            .images_of(atom)
            .iter()
            .position(|image| image.sides == sides)?;
        Some(self.starts[atom] as usize + position)
    }

    /// Finds the images that `atoms` need; `cutoff` is the distance within which each atom feels
    /// others.
    pub fn rebuild(&mut self, atoms: &[IntPoint], cutoff: impl Fn(usize) -> f32) {
        self.images.clear();
        self.starts.clear();
        for (n, point) in atoms.iter().enumerate() {
            self.starts.push(self.images.len() as u32);
            let atom = n as u32;
            let sides = self.side_combinations(self.sides_near(point, REACH_MARGIN * cutoff(n)));
            self.images
                .extend(sides.map(|sides| MirrorImage { atom, sides }));
        }
        self.starts.push(self.images.len() as u32);
    }

    /// Returns `true` if all images exist that an atom at `point` needs.
    pub fn are_sufficient(&self, atom: usize, point: &IntPoint, cutoff: f32) -> bool {
        let needed = self.sides_near(point, cutoff);
        self.images_of(atom)
            .iter()
            .fold(0, |all, image| all | image.sides)
            & needed
            == needed
    }

    /// Writes the positions of all images.
    pub fn update_positions(&self, atoms: &[IntPoint], images: &mut [IntPoint]) {
        for (target, image) in images.iter_mut().zip(&self.images) {
            let mut point = atoms[image.atom as usize];
            for k in 0..self.axes {
                if image.sides >> k & 1 == 1 {
                    point[k] = -point[k];
                } else if image.sides >> (3 + k) & 1 == 1 {
                    point[k] = 2 * self.extent[k] - point[k];
                }
            }
            *target = point;
        }
    }

    /// Returns the pair (atom, point) that mirrors the pair of atom `i` and point `j`: atom `j` and
    /// `i`, or the atom of image `j` and the image of `i` in the same sides. The first `atoms`
    /// points are atoms, and images follow.
    pub fn mirror_pair(&self, atoms: usize, i: u32, j: u32) -> (u32, u32) {
        let Some(image) = (j as usize).checked_sub(atoms) else {
            return (j, i);
        };
        let (atom, sides) = self.source(image);
        let mirrored = self.find(i as usize, sides);
        (atom, mirrored.map_or(i, |image| (atoms + image) as u32))
    }

    /// Returns the images of an atom.
    fn images_of(&self, atom: usize) -> &[MirrorImage] {
        &self.images[self.starts[atom] as usize..self.starts[atom + 1] as usize]
    }

    /// Returns the bits of the sides that are nearer to a point than `cutoff`.
    fn sides_near(&self, point: &IntPoint, cutoff: f32) -> u8 {
        (0..self.axes).fold(0, |sides, k| {
            let opposite = (self.extent[k] - point[k]) as f32;
            sides
                | u8::from((point[k] as f32) < cutoff) << k
                | u8::from(opposite < cutoff) << (3 + k)
        })
    }

    /// Returns all sets of sides in `allowed` that meet.
    fn side_combinations(&self, allowed: u8) -> impl Iterator<Item = u8> + use<> {
        let last = if allowed == 0 { 0 } else { 0b11_1111 };
        (1..=last).filter(move |sides| sides & !allowed == 0 && sides & sides >> 3 == 0)
    }
}
