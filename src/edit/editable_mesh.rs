//! A mesh of simplices that can be changed in place: nodes and cells are stored in slots, some of
//! which may be empty.

use super::resolve::EditLattice;
use super::{newest_fields, unknown_arrays};
use crate::error::cause;
use crate::files::vtk::{DataArray, Values};
use crate::geometry::NONE;
use crate::image::Geometry;
use crate::job::output::physical_angles;
use crate::lattice::AtomKind;
use crate::lattice::seeding::{Alignment, kind_at};
use crate::mesh::Simplices;
use crate::mesh::check::check;
use crate::mesh_file::array_names::{ANGLES_ARRAY, HORIZON_FACES_ARRAY, IMAGE_ARRAY, LIVE_ARRAY};
use crate::report::{assess_angles, smallest_angles};
use crate::store::{FieldValue, MeshFile, StoredMesh, face_bits_to_physical, replace_nodes};
use crate::{Error, Result};

/// Largest distance, relative to the extent of the box, at which a coordinate counts as lying on a
/// side. It covers the rounding errors of the conversion to physical coordinates and back.
const SIDE_TOLERANCE: f64 = 1e-9;

/// Names of the arrays of nodes and cells.
const ATOM_KIND: &str = "atom_kind";
const FEATURE: &str = "feature";
const DISTANCE: &str = "distance";
const REGION: &str = "region";

/// A mesh whose nodes and cells are stored in slots.
#[derive(Debug, Clone)]
pub struct EditableMesh<const D: usize, M> {
    place: String,
    /// Far corner of the box in lattice space.
    pub extent: [f64; D],
    /// Length of one sample along each axis, in units of lattice space.
    pub step: [f64; D],
    /// Map from sample indices to physical coordinates.
    pub geometry: Geometry<D>,
    /// Fields of the file that belong to the whole mesh.
    pub fields: Vec<(String, FieldValue)>,
    /// Node positions in lattice space.
    pub nodes: Vec<[f64; D]>,
    /// Node positions in physical coordinates.
    pub physical: Vec<[f64; D]>,
    /// Kind of each node: how it may move.
    pub kinds: Vec<AtomKind>,
    /// Nominal distance d at each node.
    pub distance: Vec<f32>,
    /// Potential b at each node.
    pub feature: Vec<f32>,
    /// `true` if the slot holds a node.
    pub is_used: Vec<bool>,
    /// Node numbers of the cells, positively oriented in lattice space; the first one is
    /// [`NONE`] in an empty slot.
    corners: Vec<u32>,
    /// Region of each cell.
    pub region: Vec<i32>,
    angle: Vec<f32>,
    volume: Vec<f32>,
    /// For each cell, the bits of its faces on features. As in the file, they follow the order of
    /// the nodes in physical space.
    feature_bits: Vec<u8>,
    /// For each cell, the bits of its faces on horizons, in the same order.
    horizon_bits: Vec<u8>,
    /// Pairs of the present number of a node and the number that [`compact`](Self::compact) gives
    /// it.
    pub renumberings: Vec<(u32, u32)>,
    marker: std::marker::PhantomData<M>,
}

/// Returns a position in the box `[0, extent]`, exactly on the sides that it nearly lies on.
fn snap_to_sides<const D: usize>(x: &[f64; D], extent: [f64; D]) -> [f64; D] {
    std::array::from_fn(|k| match x[k] {
        c if c.abs() <= SIDE_TOLERANCE * extent[k] => 0.0,
        c if (c - extent[k]).abs() <= SIDE_TOLERANCE * extent[k] => extent[k],
        c => c,
    })
}

/// Returns the error for a mesh of which cells were left out.
pub(super) fn left_out_error(place: &str) -> Error {
    Error::Mesh(cause(
        place,
        "is a mesh of which labels were left out, and edits need the cells beyond them",
        "edit the mesh of all labels, and leave labels out afterwards (atomesh export --drop)",
    ))
}

impl<const D: usize, M: Simplices<D>> EditableMesh<D, M> {
    /// Creates an editable mesh from a file, which `place` names in errors. Node and cell arrays
    /// that [`job::run`](crate::job::run()) does not write are dropped.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if the file does not record its lattice space or the nominal
    /// distances of its nodes, or if the mesh is not valid.
    pub fn new(file: MeshFile<M>, place: &str) -> Result<Self> {
        let nodes = file.mesh.nodes().len();
        let cells = file.mesh.len();
        let StoredMesh {
            lattice,
            world,
            space,
            arrays,
            outer,
            ..
        } = StoredMesh::new(file, place)?;
        let MeshFile {
            point_data,
            cell_data,
            field_data,
            ..
        } = arrays;
        let node_array = |name: &str| scalar_array(&point_data, name, nodes);
        let cell_array = |name: &str| scalar_array(&cell_data, name, cells);
        let refuse = |problem: String| {
            Error::Mesh(cause(place, problem, "give a mesh that atomesh mesh wrote"))
        };
        if !space.is_stored {
            return Err(refuse("does not record where its lattice lies".into()));
        }
        if outer.is_some() {
            return Err(left_out_error(place));
        }
        let validity = check(&lattice, [0.0; D], space.extent, space.tolerance());
        if let Some(problem) = validity.problems.first() {
            return Err(refuse(format!("is not valid: {problem}")));
        }
        let missing_array = |name: &str| refuse(format!("has no point array {name}"));
        let distance = node_array(DISTANCE).ok_or_else(|| missing_array(DISTANCE))?;
        if !distance.iter().all(|d| *d > 0.0) {
            return Err(refuse(format!(
                "has values in the point array {DISTANCE} that are not positive"
            )));
        }
        let extent = space.extent;
        let corners = lattice.connectivity().to_vec();
        let snapped = lattice.nodes().iter().map(|x| snap_to_sides(x, extent));
        let lattice: Vec<[f64; D]> = snapped.collect();
        let kinds = node_array(ATOM_KIND).unwrap_or_default();
        let kind = |n: usize| match kinds.get(n) {
            Some(kind) if *kind == f64::from(AtomKind::Fixed as u8) => AtomKind::Fixed,
            _ => kind_at(lattice[n], extent),
        };
        let floats = |values: Option<Vec<f64>>, count: usize| -> Vec<f32> {
            let values = values.unwrap_or_else(|| vec![0.0; count]);
            values.into_iter().map(|v| v as f32).collect()
        };
        let or_zeros = |values: Option<Vec<f64>>| values.unwrap_or_else(|| vec![0.0; cells]);
        let bits = |name: &str| {
            let values = or_zeros(cell_array(name)).into_iter();
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
            feature: floats(node_array(FEATURE), nodes),
            is_used: vec![true; nodes],
            corners,
            region: (or_zeros(cell_array(REGION)).into_iter())
                .map(|r| r as i32)
                .collect(),
            angle: floats(cell_array(M::MIN_ANGLE_ARRAY), cells),
            volume: floats(cell_array(M::VOLUME_NAME), cells),
            feature_bits: bits(M::FEATURE_FACES_ARRAY),
            horizon_bits: bits(HORIZON_FACES_ARRAY),
            renumberings: Vec::new(),
            marker: std::marker::PhantomData,
        })
    }

    /// Checks that an image of these dimensions fills the mesh's box.
    ///
    /// # Errors
    /// Returns [`Error::Image`] if it does not.
    pub fn check_dims(&self, dims: [usize; D]) -> Result<()> {
        let mesh_dims: [f64; D] = std::array::from_fn(|k| self.extent[k] / self.step[k] + 1.0);
        if (0..D).any(|k| (dims[k] as f64 - mesh_dims[k]).abs() > 1e-6) {
            return Err(Error::Image(cause(
                &self.place,
                format!("was made from an image of {mesh_dims:?} samples, not of {dims:?}"),
                "give the image that was meshed",
            )));
        }
        Ok(())
    }

    /// Returns the atoms of the mesh. No node slot may be empty.
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

    /// Returns the number of cell slots, empty ones included.
    pub fn cell_slot_count(&self) -> usize {
        self.corners.len() / (D + 1)
    }

    /// Returns the node numbers of a cell, or `None` if the slot is empty.
    pub fn cell(&self, c: usize) -> Option<&[u32]> {
        let cell = &self.corners[(D + 1) * c..(D + 1) * (c + 1)];
        (cell[0] != NONE).then_some(cell)
    }

    /// Appends a node slot and returns its number. The caller sets the node's position and values.
    pub fn add_node(&mut self) -> u32 {
        self.nodes.push([0.0; D]);
        self.physical.push([0.0; D]);
        self.kinds.push(AtomKind::Interior);
        self.distance.push(0.0);
        self.feature.push(0.0);
        self.is_used.push(true);
        (self.nodes.len() - 1) as u32
    }

    /// Moves a node to a position in lattice space, and sets its physical position accordingly.
    pub fn set_node_position(&mut self, n: usize, x: [f64; D]) {
        self.nodes[n] = x;
        self.physical[n] = self
            .geometry
            .to_physical(std::array::from_fn(|k| x[k] / self.step[k]));
    }

    /// Sets the physical position of a node to `x`, if `x` is the node's lattice position but for
    /// rounding.
    pub fn set_exact_position(&mut self, n: usize, x: [f64; D]) {
        let Some(index) = self.geometry.to_index(x) else {
            return;
        };
        let deviation =
            |k: usize| (index[k] * self.step[k] - self.nodes[n][k]).abs() / self.extent[k];
        if (0..D).all(|k| deviation(k) <= SIDE_TOLERANCE) {
            self.physical[n] = x;
        }
    }

    /// Replaces the cells in `slots` by those of `part`.
    ///
    /// `node_numbers` holds the number in this mesh of each node of `part`. `bits` holds two arrays
    /// of bits for the part's cells: those of faces on features and those of faces on horizons; the
    /// latter may be empty. `bits` and `regions` belong to the part's cells in lattice space.
    pub fn replace_cells(
        &mut self,
        slots: &[usize],
        part: &M,
        node_numbers: &[u32],
        bits: [&[u8]; 2],
        regions: &[i32],
    ) {
        let mirrored = self.geometry.determinant() < 0.0;
        let [bits, horizons] = bits.map(|bits| face_bits_to_physical::<D>(bits, mirrored));
        let nodes = part.nodes().iter().zip(node_numbers);
        let physical: Vec<[f64; D]> = nodes.map(|(_, &n)| self.physical[n as usize]).collect();
        let physical = replace_nodes(part, physical, &self.geometry);
        let angles = smallest_angles(part);
        for c in 0..part.len().max(slots.len()) {
            let slot = slots.get(c).copied().unwrap_or_else(|| {
                self.corners.extend([NONE; 4].iter().take(D + 1));
                self.region.push(0);
                self.angle.push(0.0);
                self.volume.push(0.0);
                self.feature_bits.push(0);
                self.horizon_bits.push(0);
                self.cell_slot_count() - 1
            });
            let corners = &mut self.corners[(D + 1) * slot..(D + 1) * (slot + 1)];
            if c >= part.len() {
                corners.fill(NONE);
                continue;
            }
            for (corner, &local) in corners.iter_mut().zip(part.cell(c)) {
                *corner = node_numbers[local as usize];
            }
            self.region[slot] = regions[c];
            self.feature_bits[slot] = bits[c];
            self.horizon_bits[slot] = horizons.get(c).copied().unwrap_or(0);
            self.angle[slot] = angles[c];
            self.volume[slot] = physical.volume(c) as f32;
        }
    }

    /// Applies `renumberings`, then moves the last nodes and the last cells into empty slots, so
    /// that no slot is empty. The node numbers in `atoms` are updated accordingly.
    pub fn compact(&mut self, atoms: &mut [Option<u32>]) {
        // Entry `n`: the new number of the node that was in slot `n`.
        let mut new_index: Vec<u32> = (0..self.nodes.len() as u32).collect();
        for (old, new) in std::mem::take(&mut self.renumberings) {
            self.move_node_slot(old as usize, new as usize);
            new_index[old as usize] = new;
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
            // This node may be one that `renumberings` moved here, so search by its present number.
            for p in new_index.iter_mut().filter(|p| **p as usize == end - 1) {
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
        for corner in self.corners.iter_mut().filter(|c| **c != NONE) {
            *corner = new_index[*corner as usize];
        }
        for atom in atoms.iter_mut().flatten() {
            *atom = new_index[*atom as usize];
        }
        self.compact_cells();
    }

    fn move_node_slot(&mut self, source: usize, target: usize) {
        self.nodes[target] = self.nodes[source];
        self.physical[target] = self.physical[source];
        self.kinds[target] = self.kinds[source];
        self.distance[target] = self.distance[source];
        self.feature[target] = self.feature[source];
        (self.is_used[target], self.is_used[source]) = (true, false);
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
            self.corners[size * end] = NONE;
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

    /// Converts the mesh into the contents of a file. Call [`compact`](Self::compact) first.
    pub fn into_file(self) -> MeshFile<M> {
        let kinds: Vec<u8> = self.kinds.iter().map(|&kind| kind as u8).collect();
        let lattice = M::from_parts(self.nodes, self.corners);
        let mirrored = self.geometry.determinant() < 0.0;
        let bits = face_bits_to_physical::<D>(&self.feature_bits, mirrored);
        let distance = |n: u32| f64::from(self.distance[n as usize]);
        let angles = assess_angles(&lattice, &bits, self.extent, distance).cell_classes;
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
            field_data: newest_fields(self.fields),
        };
        let angles = physical_angles(&file.mesh, &self.geometry, self.step);
        file.cell_data.extend(angles);
        if self.horizon_bits.iter().any(|&bits| bits != 0) {
            let array = DataArray::scalars(HORIZON_FACES_ARRAY, self.horizon_bits);
            file.cell_data.push(array);
        }
        file
    }
}

/// Returns the names of arrays that an edit cannot keep.
pub fn dropped_arrays<const D: usize, M: Simplices<D>>(file: &MeshFile<M>) -> Vec<String> {
    let known = [
        ATOM_KIND,
        FEATURE,
        DISTANCE,
        REGION,
        M::MIN_ANGLE_ARRAY,
        M::PHYSICAL_ANGLE_ARRAY,
        M::VOLUME_NAME,
        M::FEATURE_FACES_ARRAY,
        ANGLES_ARRAY,
        HORIZON_FACES_ARRAY,
        IMAGE_ARRAY,
        LIVE_ARRAY,
    ];
    unknown_arrays(file, &known)
}

/// Returns the array of this name, if it has one component and `count` values.
fn scalar_array(arrays: &[DataArray], name: &str, count: usize) -> Option<Vec<f64>> {
    let array = arrays.iter().find(|array| array.name == name)?;
    let matches = array.components == 1 && array.values.len() == count;
    matches.then(|| Values::to_f64(&array.values))
}
