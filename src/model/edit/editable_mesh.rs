//! A mesh that can be changed in places: what a file holds, in slots that may be empty.

use super::resolve::EditLattice;
use super::unknown_arrays;
use crate::error::cause;
use crate::files::vtk::{DataArray, Values};
use crate::image::Geometry;
use crate::lattice::AtomKind;
use crate::lattice::seeding::{Alignment, kind_at};
use crate::mesh::Simplices;
use crate::mesh::check::check;
use crate::report::{assess_angles, smallest_angles};
use crate::store::output::{ANGLES_ARRAY, HORIZON_FACES_ARRAY, IMAGE_ARRAY};
use crate::store::{FieldValue, MeshFile, StoredMesh, face_bits_to_physical, replace_nodes};
use crate::{Error, Result};

/// Coordinates nearer to a side of the box than this, over its length, are on it: what is left of
/// them after the way into the world and back.
const SIDE_TOLERANCE: f64 = 1e-9;

/// Names of what is stored for each node and cell.
const ATOM_KIND: &str = "atom_kind";
const FEATURE: &str = "feature";
const DISTANCE: &str = "distance";
const REGION: &str = "region";

/// A mesh in slots.
#[derive(Debug, Clone)]
pub struct EditableMesh<const D: usize, M> {
    place: String,
    /// The far corner of the box.
    pub extent: [f64; D],
    /// Length of one sample along each axis of lattice space.
    pub step: [f64; D],
    /// From samples to physical coordinates.
    pub geometry: Geometry<D>,
    /// What belongs to the whole mesh.
    pub fields: Vec<(String, FieldValue)>,
    /// Nodes in lattice space.
    pub nodes: Vec<[f64; D]>,
    /// The same in the world.
    pub physical: Vec<[f64; D]>,
    /// What each node may do.
    pub kinds: Vec<AtomKind>,
    /// d at each node.
    pub distance: Vec<f32>,
    /// b at each node.
    pub feature: Vec<f32>,
    /// Whether there is a node in the slot.
    pub is_used: Vec<bool>,
    /// Node numbers of cells, positively oriented in lattice space, [`MIN_THICKNESS_RATIO`] in an empty slot.
    corners: Vec<u32>,
    /// Each cell's region.
    pub region: Vec<i32>,
    angle: Vec<f32>,
    volume: Vec<f32>,
    /// As in the file: of the cells in the world.
    feature_bits: Vec<u8>,
    /// The same of faces on horizons.
    horizon_bits: Vec<u8>,
    /// Numbers that nodes shall have in the end, with those they have.
    pub renumberings: Vec<(u32, u32)>,
    marker: std::marker::PhantomData<M>,
}

/// In an empty slot.
const EMPTY_SLOT: u32 = u32::MAX;

impl<const D: usize, M: Simplices<D>> EditableMesh<D, M> {
    /// Of a file, which `place` names in errors. What is stored for each node or cell besides what
    /// [`job::run`](crate::job::run) stores is dropped.
    ///
    /// # Errors
    /// [`Error::Mesh`] if the file does not record its lattice space, or what its nodes are, or if
    /// the mesh is not valid.
    pub fn new(file: MeshFile<M>, place: &str) -> Result<Self> {
        let nodes = file.mesh.nodes().len();
        let cells = file.mesh.len();
        let StoredMesh {
            lattice,
            world,
            space,
            arrays,
            ..
        } = StoredMesh::new(file, place)?;
        let MeshFile {
            point_data,
            cell_data,
            field_data,
            ..
        } = arrays;
        let of_nodes = |name: &str| scalar_array(&point_data, name, nodes);
        let of_cells = |name: &str| scalar_array(&cell_data, name, cells);
        let refuse = |problem: String| {
            Error::Mesh(cause(place, problem, "give a mesh that atomesh mesh wrote"))
        };
        if !space.is_stored {
            return Err(refuse("does not record its lattice space".into()));
        }
        let found = check(&lattice, [0.0; D], space.extent, space.tolerance());
        if let Some(problem) = found.problems.first() {
            return Err(refuse(format!("is not valid: {problem}")));
        }
        let lacks = |name: &str| refuse(format!("lacks the point data {name}"));
        let distance = of_nodes(DISTANCE).ok_or_else(|| lacks(DISTANCE))?;
        if !distance.iter().all(|d| *d > 0.0) {
            return Err(refuse(format!(
                "has point data {DISTANCE} that are not positive"
            )));
        }
        let extent = space.extent;
        let on_sides = |x: &[f64; D]| -> [f64; D] {
            std::array::from_fn(|k| match x[k] {
                c if c.abs() <= SIDE_TOLERANCE * extent[k] => 0.0,
                c if (c - extent[k]).abs() <= SIDE_TOLERANCE * extent[k] => extent[k],
                c => c,
            })
        };
        let corners = lattice.connectivity().to_vec();
        let lattice: Vec<[f64; D]> = lattice.nodes().iter().map(on_sides).collect();
        let kinds = of_nodes(ATOM_KIND).unwrap_or_default();
        let kind = |n: usize| match kinds.get(n) {
            Some(kind) if *kind == f64::from(AtomKind::Fixed as u8) => AtomKind::Fixed,
            _ => kind_at(lattice[n], extent),
        };
        let floats = |values: Option<Vec<f64>>, count: usize| -> Vec<f32> {
            let values = values.unwrap_or_else(|| vec![0.0; count]);
            values.into_iter().map(|v| v as f32).collect()
        };
        let whole = |values: Option<Vec<f64>>| values.unwrap_or_else(|| vec![0.0; cells]);
        let bits = |name: &str| {
            let values = whole(of_cells(name)).into_iter();
            values.map(|b| b as u8).collect()
        };
        Ok(Self {
            place: place.to_string(),
            extent,
            step: space.step,
            geometry: space.geometry,
            fields: field_data,
            kinds: (0..nodes).map(kind).collect(),
            nodes: lattice,
            physical: world.nodes,
            distance: distance.into_iter().map(|d| d as f32).collect(),
            feature: floats(of_nodes(FEATURE), nodes),
            is_used: vec![true; nodes],
            corners,
            region: (whole(of_cells(REGION)).into_iter())
                .map(|r| r as i32)
                .collect(),
            angle: floats(of_cells(M::MIN_ANGLE_ARRAY), cells),
            volume: floats(of_cells(M::VOLUME_NAME), cells),
            feature_bits: bits(M::FEATURE_FACES_ARRAY),
            horizon_bits: bits(HORIZON_FACES_ARRAY),
            renumberings: Vec::new(),
            marker: std::marker::PhantomData,
        })
    }

    /// Checks that an image of these dims fills the mesh's box.
    ///
    /// # Errors
    /// [`Error::Image`] if it does not.
    pub fn check_dims(&self, dims: [usize; D]) -> Result<()> {
        let own: [f64; D] = std::array::from_fn(|k| self.extent[k] / self.step[k] + 1.0);
        if (0..D).any(|k| (dims[k] as f64 - own[k]).abs() > 1e-6) {
            return Err(Error::Image(cause(
                &self.place,
                format!("was made of an image of {own:?} samples, not of {dims:?}"),
                "give the image that was meshed",
            )));
        }
        Ok(())
    }

    /// The atoms, as long as no slot is empty.
    pub fn lattice(&self) -> EditLattice<'_, D> {
        EditLattice {
            place: &self.place,
            nodes: &self.nodes,
            kinds: &self.kinds,
            distance: &self.distance,
            extent: self.extent,
            step: self.step,
            geometry: &self.geometry,
            alignment: Alignment::OnFeatures,
        }
    }

    /// Slots of cells.
    pub fn cell_slot_count(&self) -> usize {
        self.corners.len() / (D + 1)
    }

    /// The node numbers of a cell; `None` in an empty slot.
    pub fn cell(&self, c: usize) -> Option<&[u32]> {
        let cell = &self.corners[(D + 1) * c..(D + 1) * (c + 1)];
        (cell[0] != EMPTY_SLOT).then_some(cell)
    }

    /// An empty slot for a node.
    pub fn add_node(&mut self) -> u32 {
        self.nodes.push([0.0; D]);
        self.physical.push([0.0; D]);
        self.kinds.push(AtomKind::Interior);
        self.distance.push(0.0);
        self.feature.push(0.0);
        self.is_used.push(true);
        (self.nodes.len() - 1) as u32
    }

    /// Puts a node elsewhere.
    pub fn set_node_position(&mut self, n: usize, x: [f64; D]) {
        self.nodes[n] = x;
        self.physical[n] = self
            .geometry
            .to_physical(std::array::from_fn(|k| x[k] / self.step[k]));
    }

    /// Puts a node of known lattice position at `x` in the world, if that is the same place to
    /// rounding.
    pub fn set_exact_position(&mut self, n: usize, x: [f64; D]) {
        let Some(index) = self.geometry.to_index(x) else {
            return;
        };
        let off = |k: usize| (index[k] * self.step[k] - self.nodes[n][k]).abs() / self.extent[k];
        if (0..D).all(|k| off(k) <= SIDE_TOLERANCE) {
            self.physical[n] = x;
        }
    }

    /// Exchanges the cells in `slots` for those of `part`, whose nodes have the given `numbers` here;
    /// `bits` (of faces on features, and on horizons; those may be none) and `regions` are those of
    /// the part's cells, all in lattice space.
    pub fn replace_cells(
        &mut self,
        slots: &[usize],
        part: &M,
        numbers: &[u32],
        bits: [&[u8]; 2],
        regions: &[i32],
    ) {
        let mirrored = self.geometry.determinant() < 0.0;
        let [bits, horizons] = bits.map(|bits| face_bits_to_physical::<D>(bits, mirrored));
        let nodes = part.nodes().iter().zip(numbers);
        let in_world: Vec<[f64; D]> = nodes.map(|(_, &n)| self.physical[n as usize]).collect();
        let in_world = replace_nodes(part, in_world, &self.geometry);
        let angles = smallest_angles(part);
        for c in 0..part.len().max(slots.len()) {
            let slot = slots.get(c).copied().unwrap_or_else(|| {
                self.corners.extend([EMPTY_SLOT; 4].iter().take(D + 1));
                self.region.push(0);
                self.angle.push(0.0);
                self.volume.push(0.0);
                self.feature_bits.push(0);
                self.horizon_bits.push(0);
                self.cell_slot_count() - 1
            });
            let corners = &mut self.corners[(D + 1) * slot..(D + 1) * (slot + 1)];
            if c >= part.len() {
                corners.fill(EMPTY_SLOT);
                continue;
            }
            for (corner, &local) in corners.iter_mut().zip(part.cell(c)) {
                *corner = numbers[local as usize];
            }
            self.region[slot] = regions[c];
            self.feature_bits[slot] = bits[c];
            self.horizon_bits[slot] = horizons.get(c).copied().unwrap_or(0);
            self.angle[slot] = angles[c];
            self.volume[slot] = in_world.volume(c) as f32;
        }
    }

    /// Gives nodes the numbers that they shall have, and puts the last ones into slots that are
    /// empty; `atoms` are numbers of nodes that follow. The same for cells.
    pub fn compact(&mut self, atoms: &mut [Option<u32>]) {
        // Where the node in each slot goes.
        let mut place: Vec<u32> = (0..self.nodes.len() as u32).collect();
        for (old, new) in std::mem::take(&mut self.renumberings) {
            self.move_node_slot(old as usize, new as usize);
            place[old as usize] = new;
        }
        let mut end = self.nodes.len();
        for hole in 0..self.nodes.len() {
            if self.is_used[hole] {
                continue;
            }
            while end > hole && !self.is_used[end - 1] {
                end -= 1;
            }
            if end <= hole {
                break;
            }
            self.move_node_slot(end - 1, hole);
            // The node may have come to the end by a new number.
            for p in place.iter_mut().filter(|p| **p as usize == end - 1) {
                *p = hole as u32;
            }
            end -= 1;
        }
        let count = self.is_used.iter().take_while(|used| **used).count();
        self.nodes.truncate(count);
        self.physical.truncate(count);
        self.kinds.truncate(count);
        self.distance.truncate(count);
        self.feature.truncate(count);
        self.is_used.truncate(count);
        for corner in self.corners.iter_mut().filter(|c| **c != EMPTY_SLOT) {
            *corner = place[*corner as usize];
        }
        for atom in atoms.iter_mut().flatten() {
            *atom = place[*atom as usize];
        }
        self.compact_cells();
    }

    fn move_node_slot(&mut self, from: usize, to: usize) {
        self.nodes[to] = self.nodes[from];
        self.physical[to] = self.physical[from];
        self.kinds[to] = self.kinds[from];
        self.distance[to] = self.distance[from];
        self.feature[to] = self.feature[from];
        (self.is_used[to], self.is_used[from]) = (true, false);
    }

    fn compact_cells(&mut self) {
        let size = D + 1;
        let mut end = self.cell_slot_count();
        for hole in 0..self.cell_slot_count() {
            if self.cell(hole).is_some() {
                continue;
            }
            while end > hole && self.cell(end - 1).is_none() {
                end -= 1;
            }
            if end <= hole {
                break;
            }
            end -= 1;
            self.corners
                .copy_within(size * end..size * (end + 1), size * hole);
            self.corners[size * end] = EMPTY_SLOT;
            self.region[hole] = self.region[end];
            self.angle[hole] = self.angle[end];
            self.volume[hole] = self.volume[end];
            self.feature_bits[hole] = self.feature_bits[end];
            self.horizon_bits[hole] = self.horizon_bits[end];
        }
        let count = (0..self.cell_slot_count())
            .take_while(|&c| self.cell(c).is_some())
            .count();
        self.corners.truncate(size * count);
        self.region.truncate(count);
        self.angle.truncate(count);
        self.volume.truncate(count);
        self.feature_bits.truncate(count);
        self.horizon_bits.truncate(count);
    }

    /// As a file holds it; after [`compact`](Self::compact).
    pub fn into_file(self) -> MeshFile<M> {
        let kinds: Vec<u8> = self.kinds.iter().map(|&kind| kind as u8).collect();
        let lattice = M::from_parts(self.nodes, self.corners);
        let mirrored = self.geometry.determinant() < 0.0;
        let bits = face_bits_to_physical::<D>(&self.feature_bits, mirrored);
        let distance = |n: u32| f64::from(self.distance[n as usize]);
        let angles = assess_angles(&lattice, &bits, self.extent, distance).cell_classes;
        // A field of the same name further down is a newer one.
        let mut fields: Vec<(String, FieldValue)> = Vec::new();
        for (name, value) in self.fields {
            match fields.iter_mut().find(|(known, _)| *known == name) {
                Some(field) => field.1 = value,
                None => fields.push((name, value)),
            }
        }
        let mut file = MeshFile {
            mesh: replace_nodes(&lattice, self.physical, &self.geometry),
            point_data: vec![
                DataArray::scalars(ATOM_KIND, kinds),
                DataArray::scalars(FEATURE, self.feature),
                DataArray::scalars(DISTANCE, self.distance),
            ],
            cell_data: vec![
                DataArray::scalars(REGION, self.region),
                DataArray::scalars(M::MIN_ANGLE_ARRAY, self.angle),
                DataArray::scalars(M::VOLUME_NAME, self.volume),
                DataArray::scalars(M::FEATURE_FACES_ARRAY, self.feature_bits),
                DataArray::scalars(ANGLES_ARRAY, angles),
            ],
            field_data: fields,
        };
        if self.horizon_bits.iter().any(|&bits| bits != 0) {
            let array = DataArray::scalars(HORIZON_FACES_ARRAY, self.horizon_bits);
            file.cell_data.push(array);
        }
        file
    }
}

/// Names of arrays that an edit cannot carry over.
pub fn dropped_arrays<const D: usize, M: Simplices<D>>(file: &MeshFile<M>) -> Vec<String> {
    let known = [
        ATOM_KIND,
        FEATURE,
        DISTANCE,
        REGION,
        M::MIN_ANGLE_ARRAY,
        M::VOLUME_NAME,
        M::FEATURE_FACES_ARRAY,
        ANGLES_ARRAY,
        HORIZON_FACES_ARRAY,
        IMAGE_ARRAY,
    ];
    unknown_arrays(file, &known)
}

/// A scalar array of the right length.
fn scalar_array(arrays: &[DataArray], name: &str, count: usize) -> Option<Vec<f64>> {
    let array = arrays.iter().find(|array| array.name == name)?;
    let right = array.components == 1 && array.values.len() == count;
    right.then(|| Values::to_f64(&array.values))
}
