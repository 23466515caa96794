//! Mirror images of atoms beyond the sides of the box (Hale 2002: so that Voronoi cells end exactly
//! on the sides).
//!
//! An image acts on the atoms inside as an atom would; it is where its atom is, mirrored in one side
//! or in two or three that meet. By symmetry the force of all images on an atom is the derivative of
//! the energy with respect to the atom's position, its images moving with it: of each pair of an atom
//! and an image there is another, mirrored, and an atom and its own image share their energy.

use super::neighbours::IntPoint;
use crate::lattice::halo::OwnedAndGhosts;

/// Images are kept of atoms nearer to a side than this many reaches.
const REACH_MARGIN: f32 = 1.2;

/// A mirror image of an atom.
#[derive(Clone, Copy)]
struct MirrorImage {
    atom: u32,
    /// The sides that mirror it: bit k for the near one along axis k, bit `3 + k` for the far one.
    sides: u8,
}

/// The mirror images of all atoms near the sides of a box, in the order of the atoms.
#[derive(Clone, Default)]
pub struct MirrorImages {
    /// The far corner of the box.
    extent: [i32; 3],
    /// Number of axes along which the box has sides.
    axes: usize,
    images: Vec<MirrorImage>,
    /// Where each atom's images start, and one more at the end.
    starts: Vec<u32>,
}

impl MirrorImages {
    /// No images yet, for a box of `axes` dimensions.
    pub fn new(extent: IntPoint, axes: usize) -> Self {
        Self {
            extent: [extent[0], extent[1], extent[2]],
            axes,
            ..Self::default()
        }
    }

    /// Number of images.
    pub fn len(&self) -> usize {
        self.images.len()
    }

    /// The atoms of the images, in order.
    pub fn atoms(&self) -> impl Iterator<Item = usize> + '_ {
        self.images.iter().map(|image| image.atom as usize)
    }

    /// How many points are own atoms and images of these.
    pub fn owned_point_count(&self, held: &OwnedAndGhosts<'_>) -> usize {
        let own = held.owned();
        own.len() + self.atoms().filter(|atom| own.contains(atom)).count()
    }

    /// The atom that the `n`th image is of, and the sides that mirror it.
    pub fn source(&self, n: usize) -> (u32, u8) {
        (self.images[n].atom, self.images[n].sides)
    }

    /// The image of an atom in these sides.
    pub fn find(&self, atom: usize, sides: u8) -> Option<usize> {
        let place = self
            .images_of(atom)
            .iter()
            .position(|own| own.sides == sides)?;
        Some(self.starts[atom] as usize + place)
    }

    /// Finds the images that `atoms` need; `reach` is how far each may feel another.
    pub fn rebuild(&mut self, atoms: &[IntPoint], reach: impl Fn(usize) -> f32) {
        self.images.clear();
        self.starts.clear();
        for (n, point) in atoms.iter().enumerate() {
            self.starts.push(self.images.len() as u32);
            let atom = n as u32;
            let sides = self.side_combinations(self.sides_near(point, REACH_MARGIN * reach(n)));
            self.images
                .extend(sides.map(|sides| MirrorImage { atom, sides }));
        }
        self.starts.push(self.images.len() as u32);
    }

    /// Whether there are all images that an atom at `point` needs.
    pub fn are_sufficient(&self, atom: usize, point: &IntPoint, reach: f32) -> bool {
        let near = self.sides_near(point, reach);
        self.images_of(atom)
            .iter()
            .fold(0, |all, image| all | image.sides)
            & near
            == near
    }

    /// Writes the positions of all images.
    pub fn update_positions(&self, atoms: &[IntPoint], images: &mut [IntPoint]) {
        for (place, image) in images.iter_mut().zip(&self.images) {
            let mut point = atoms[image.atom as usize];
            for k in 0..self.axes {
                if image.sides >> k & 1 == 1 {
                    point[k] = -point[k];
                } else if image.sides >> (3 + k) & 1 == 1 {
                    point[k] = 2 * self.extent[k] - point[k];
                }
            }
            *place = point;
        }
    }

    /// The pair (atom, point) that mirrors the pair of atom `i` and point `j`: atom `j` and `i`, or
    /// the atom of image `j` and the image of `i` in the same sides. Points are numbered through,
    /// `atoms` of them before the images.
    pub fn mirror_pair(&self, atoms: usize, i: u32, j: u32) -> (u32, u32) {
        let Some(image) = (j as usize).checked_sub(atoms) else {
            return (j, i);
        };
        let (atom, sides) = self.source(image);
        let same = self.find(i as usize, sides);
        (atom, same.map_or(i, |image| (atoms + image) as u32))
    }

    /// The images of an atom.
    fn images_of(&self, atom: usize) -> &[MirrorImage] {
        &self.images[self.starts[atom] as usize..self.starts[atom + 1] as usize]
    }

    /// The sides nearer to a point than `reach`.
    fn sides_near(&self, point: &IntPoint, reach: f32) -> u8 {
        (0..self.axes).fold(0, |near, k| {
            let far = (self.extent[k] - point[k]) as f32;
            near | u8::from((point[k] as f32) < reach) << k | u8::from(far < reach) << (3 + k)
        })
    }

    /// All sets of sides that meet, of those in `near`.
    fn side_combinations(&self, near: u8) -> impl Iterator<Item = u8> + use<> {
        let last = if near == 0 { 0 } else { 0b11_1111 };
        (1..=last).filter(move |sides| sides & !near == 0 && sides & sides >> 3 == 0)
    }
}
