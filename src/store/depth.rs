//! Converts meshes in two-way time to depth.

use crate::parallel::prelude::*;

use super::stored_mesh::{Storable, StoredMesh};
use super::{FieldValue, LatticeSpace, MeshFile};
use crate::error::cause;
use crate::files::vtk::DataArray;
use crate::image::{Geometry, VelocityModel};
use crate::mesh::Mesh;
use crate::mesh_file::array_names::{AXES_FIELD, ORIGIN_FIELD, UNITS_FIELD, VELOCITY_FIELD};
use crate::mesh_file::lattice_space::LATTICE_SPACE_FIELDS;
use crate::{Error, Result};

/// Cell arrays with the size of cells in the world.
const SIZE_ARRAYS: [&str; 2] = ["volume", "area"];

/// Converts a mesh in two-way time to depth with a constant velocity, as
/// [`Geometry::to_depth`] does. Positions in lattice space do not change.
///
/// # Errors
/// Returns the errors of [`Geometry::to_depth`].
pub fn to_depth<const D: usize, M: Mesh<D>>(
    file: MeshFile<M>,
    velocity: f64,
) -> Result<MeshFile<M>> {
    let geometry = match LatticeSpace::from_file(&file, file.mesh.nodes()) {
        Some(space) => space.geometry,
        None => Geometry::default(),
    };
    let (depth, factor) = geometry.to_depth(velocity)?;
    let scale = |x: &[f64; D]| Some(std::array::from_fn(|k| x[k] * factor[k]));
    let positions = file.mesh.mapped_positions(scale);
    let (mut mesh, mut arrays) = file.into_parts();
    if let Some(mut positions) = positions {
        mesh.swap_positions(&mut positions, false);
    }
    let volume_factor: f64 = factor.iter().product();
    set_sizes(&mut arrays.cell_data, |c, size| {
        (size[c] * volume_factor) as f32
    });
    for (name, value) in &mut arrays.field_data {
        match (name.as_str(), value) {
            (ORIGIN_FIELD, FieldValue::F64s(origin)) => *origin = depth.origin.to_vec(),
            (AXES_FIELD, FieldValue::F64s(axes)) => *axes = depth.axes.as_flattened().to_vec(),
            (UNITS_FIELD, FieldValue::Text(units)) => *units = depth.units.join(","),
            _ => {}
        }
    }
    let velocity = FieldValue::F64s(vec![velocity]);
    arrays.field_data.push((VELOCITY_FIELD.into(), velocity));
    Ok(arrays.with_mesh(mesh))
}

/// Replaces the sizes of cells. `size` gets the number of the cell and all old values.
fn set_sizes(arrays: &mut [DataArray], size: impl Fn(usize, &[f64]) -> f32) {
    let sizes = arrays.iter_mut();
    for array in sizes.filter(|array| SIZE_ARRAYS.contains(&array.name.as_str())) {
        let old = array.values.to_f64();
        let new: Vec<f32> = (0..old.len()).map(|c| size(c, &old)).collect();
        array.values = new.into();
    }
}

impl<const D: usize, M: Storable<D>> StoredMesh<D, M> {
    /// Converts a mesh in two-way time to depth with a velocity volume; every node and
    /// site is moved vertically on its own. Positions in lattice space do not change. Because the
    /// world is no longer an affine image of lattice space, the file will not contain the position
    /// of lattice space. `place` names the mesh in errors. Returns notes for the user.
    ///
    /// # Errors
    /// Returns [`Error::Image`] if the mesh is not in two-way time or not covered by the
    /// velocities, and [`Error::Mesh`] if cells turn inside out.
    pub fn convert_to_depth(
        &mut self,
        velocities: &VelocityModel<D>,
        place: &str,
    ) -> Result<Vec<String>> {
        let geometry = &self.space.geometry;
        let coverage = velocities.check_coverage(self.world.nodes.iter().copied(), geometry)?;
        let (c, seconds) = (coverage.coordinate, coverage.seconds_per_unit);
        let depth_at =
            |x: [f64; D]| seconds.signum() * velocities.time_depth_curve(x).depth(x[c] * seconds);
        for points in [&mut self.world.nodes, &mut self.world.sites] {
            points.par_iter_mut().for_each(|p| p[c] = depth_at(*p));
        }
        let volumes = self.with_world_mesh(M::volumes);
        let is_inverted = |volume: &f64| volume.is_nan() || *volume <= 0.0;
        let count = volumes.iter().filter(|volume| is_inverted(volume)).count();
        if let Some(cell) = volumes.iter().position(is_inverted) {
            let problem = format!(
                "{count} of its {} cells turn inside out in depth by {}, the first is cell {cell}",
                volumes.len(),
                velocities.name
            );
            let remedy =
                "mesh the image in depth, by atomesh mesh --velocity, or smooth the velocities";
            return Err(Error::Mesh(cause(place, problem, remedy)));
        }
        set_sizes(&mut self.arrays.cell_data, |cell, _| volumes[cell] as f32);
        self.space.geometry = self.affine_geometry(c, coverage.depth_unit, depth_at);
        self.space.is_stored = false;
        let fields = &mut self.arrays.field_data;
        fields.retain(|(name, _)| {
            !LATTICE_SPACE_FIELDS.contains(&name.as_str()) && name != UNITS_FIELD
        });
        let units = FieldValue::Text(self.space.geometry.units.join(","));
        let velocity = FieldValue::Text(velocities.name.clone());
        fields.extend([
            (UNITS_FIELD.into(), units),
            (VELOCITY_FIELD.into(), velocity),
        ]);
        Ok(coverage.notes)
    }

    /// Returns an affine geometry in which depth, along coordinate `c`, is exact at both ends of
    /// the trace at the origin.
    fn affine_geometry(
        &self,
        c: usize,
        unit: &str,
        depth: impl Fn([f64; D]) -> f64,
    ) -> Geometry<D> {
        let (time, dims) = (&self.space.geometry, self.space.dims());
        let mut geometry = time.clone();
        geometry.origin[c] = depth(time.origin);
        for k in (0..D).filter(|&k| time.axes[k][c] != 0.0) {
            let steps = dims[k] - 1.0;
            let end = time.to_physical(std::array::from_fn(|l| if l == k { steps } else { 0.0 }));
            geometry.axes[k][c] = (depth(end) - geometry.origin[c]) / steps;
        }
        geometry.units = std::array::from_fn(|_| unit.to_string());
        geometry
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Image;
    use crate::mesh::poly::samples::two_cells;
    use crate::mesh::{Simplices, TetMesh};
    use crate::mesh_file::image_geometry_in_depth;
    use crate::store::stored_mesh::tests::file;

    /// Makes the file's third coordinate time.
    fn set_time_axis<M>(file: &mut MeshFile<M>) {
        let units = FieldValue::Text("m,m,ms".into());
        file.field_data.push((UNITS_FIELD.into(), units));
    }

    fn geometry(units: [&str; 3], origin: [f64; 3], spacing: [f64; 3]) -> Geometry<3> {
        Geometry {
            units: units.map(String::from),
            ..Geometry::with_spacing(origin, spacing)
        }
    }

    #[test]
    fn an_image_in_time_gets_the_position_of_its_mesh_in_depth() {
        let (mut time, space) = file(two_cells::<3>(0.75), -4.0);
        set_time_axis(&mut time);
        let names = ["sample", "crossline", "inline"].map(String::from);
        let image = Geometry {
            units: ["m", "m", "ms"].map(String::from),
            names: names.clone(),
            ..space.geometry.clone()
        };
        let dims = [5; 3];
        let geometry_below = |mesh: &MeshFile<_>, image: &Geometry<3>, dims: [usize; 3]| {
            image_geometry_in_depth(mesh, image, dims, "image.sgy")
        };
        assert_eq!(geometry_below(&time, &image, dims).unwrap(), None);
        let mut depth = to_depth(time, 3000.0).unwrap();
        let message = geometry_below(&depth, &image, [5, 5, 6])
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("image.sgy: is in two-way time, the mesh in depth;"),
            "{message}"
        );
        let below = geometry_below(&depth, &image, dims).unwrap().unwrap();
        assert_eq!((below.axes[2], below.names), ([0.0, 0.0, -6.0], names));
        assert_eq!(below.origin, [10.0, 10.0, 15.0]);
        let metres = Geometry {
            units: ["m", "m", "m"].map(String::from),
            ..image.clone()
        };
        assert_eq!(geometry_below(&depth, &metres, dims).unwrap(), None);
        // With a velocity file, no affine geometry can map the image to the mesh.
        let record = FieldValue::Text("velocity = \"v.sgy\"\n[input]\n".into());
        depth.field_data.push(("parameters".into(), record));
        let message = geometry_below(&depth, &image, dims)
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("image.sgy: is in two-way time"),
            "{message}"
        );
        assert!(
            message.contains("convert --velocity v.sgy image.sgy"),
            "{message}"
        );
        assert_eq!(geometry_below(&depth, &metres, dims).unwrap(), None);
    }

    /// Returns a mesh of one cell, with three nodes in corners of its box and one at `apex`,
    /// converted to depth with velocities that depend on x and time.
    fn depth_converted_cell(
        apex: [f64; 3],
        sample_interval: f64,
        v: impl Fn(f64, f64) -> f64,
    ) -> Result<StoredMesh<3, TetMesh>> {
        let single = TetMesh {
            nodes: vec![[0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], apex],
            tets: vec![[0, 1, 2, 3]],
        };
        let (mut file, _) = file(single, sample_interval);
        set_time_axis(&mut file);
        let volume = DataArray::scalars("volume", vec![1.0f32]);
        file.cell_data.push(volume);
        let mut stored = StoredMesh::new(file, "mesh.vtu")?;
        let velocity_at = |i: usize| v(10.0 * (i % 4) as f64, 0.1 * (i / 8) as f64) as f32;
        let volume_geometry = geometry(["m", "m", "s"], [0.0; 3], [10.0, 40.0, 0.1]);
        let image = Image::new(
            [4, 2, 3],
            (0..24).map(velocity_at).collect(),
            volume_geometry,
        );
        stored.convert_to_depth(&VelocityModel::new(image, "v.npy")?, "mesh.vtu")?;
        Ok(stored)
    }

    #[test]
    fn each_node_is_converted_by_its_own_trace() {
        for sample_interval in [2.0, -2.0] {
            let mut stored = depth_converted_cell([0.0, 0.0, 2.0], sample_interval, |x, t| {
                2000.0 + 10.0 * x + 400.0 * t
            })
            .unwrap();
            for (lattice, world) in stored.lattice.nodes().iter().zip(&stored.world.nodes) {
                // Lattice space has two units for each sample of 2 m.
                let [x, t] = [
                    10.0 + 4.0 * lattice[0],
                    0.001 * (10.0 + 2.0 * sample_interval * lattice[2]),
                ];
                let depth = (2000.0 + 10.0 * x) * t / 2.0 + 400.0 * t * t / 4.0;
                assert!((world[0] - x).abs() < 1e-12);
                assert!((world[2] - depth).abs() < 1e-9, "{world:?} {depth}");
            }
            let volume = stored.with_world_mesh(|mesh| mesh.volume(0));
            let volumes = stored.arrays.cell_array("volume").unwrap().values.to_f64();
            assert!(volume > 0.0 && (volumes[0] / volume - 1.0).abs() < 1e-6);
            assert_eq!(stored.space.geometry.units, ["m", "m", "m"]);
            // The written file records that no image in time fits the mesh.
            let again = StoredMesh::new(stored.into_file(), "again.vtu").unwrap();
            assert!(!again.space.is_stored && again.space.velocities.as_deref() == Some("v.npy"));
        }
    }

    #[test]
    fn cells_that_turn_inside_out_are_refused() {
        // Velocities are lower in the middle, where the flat cell has its apex, than at its ends.
        let sag = |min_velocity: f64, slope: f64| {
            depth_converted_cell([1.0, 1.0, 0.1], 2.0, move |x, _| {
                min_velocity + slope * (x - 20.0).abs()
            })
        };
        assert!(sag(5000.0, 10.0).is_ok());
        let message = sag(2000.0, 100.0).unwrap_err().to_string();
        assert!(
            message.contains("mesh.vtu: 1 of its 1 cells turn inside out in depth by v.npy"),
            "{message}"
        );
    }
}
