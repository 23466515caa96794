//! From a job's mesh of simplices to a file: physical coordinates, and what each node and cell is.

use std::path::Path;

use crate::parallel::prelude::*;

use super::cells::cells_to_file;
use super::labels::labels_field;
use super::parts::{as_part, is_in_parts, part_of, write_part};
use super::{write_cells_vtu, write_lines, write_vtu};
use crate::error::cause;
use crate::feature::Settled;
use crate::files::vtk::DataArray;
use crate::image::{Geometry, Source};
pub use crate::job::Provenance;
use crate::job::horizons::horizon_bits;
use crate::job::{Made, Marked, Meshing, Outcome, Space};
use crate::mesh::part::Part;
use crate::mesh::{Mesh, Simplices};
use crate::observer::Patience;
use crate::ranks::Ranks;
use crate::report::{Quality, quality, quality_of_part, smallest_angles};
use crate::store::{
    AnyMesh, FieldValue, LatticeSpace, MeshFile, face_bits_to_physical, to_physical,
};
use crate::{Error, Result, ranks};

/// The outcome of a job where the image lies in the world, with all that is known of each node and
/// cell.
pub fn to_file<const D: usize, M: Simplices<D>>(
    outcome: &Outcome<D>,
    made: &Marked<M>,
) -> MeshFile<M>
where
    Space<D>: Meshing<D, Mesh = M>,
{
    let geometry = &outcome.geometry;
    let lattice = &made.mesh;
    let nodes = lattice.nodes();
    let mesh = to_physical(lattice, outcome.step, geometry);
    let kinds: Vec<u8> = made.kinds.iter().map(|&kind| kind as u8).collect();
    let potential = &outcome.features.potential;
    let feature: Vec<f32> = nodes
        .par_iter()
        .map(|&x| potential.value(x) as f32)
        .collect();
    let distance: Vec<f32> = nodes
        .par_iter()
        .map(|&x| outcome.distance.at(x) as f32)
        .collect();
    let cells = || (0..lattice.len()).into_par_iter();
    let smallest = smallest_angles(lattice);
    let volume: Vec<f32> = cells().map(|c| mesh.volume(c) as f32).collect();
    let horizons = horizon_bits(lattice, &made.feature_faces, &outcome.features);
    let mirrored = geometry.determinant() < 0.0;
    let mut file = MeshFile {
        mesh,
        point_data: vec![
            DataArray::scalars("atom_kind", kinds),
            DataArray::scalars("feature", feature),
            DataArray::scalars(DISTANCE, distance),
        ],
        cell_data: vec![
            DataArray::scalars(
                "region",
                match made.regions.is_empty() {
                    true => vec![0i32; lattice.len()],
                    false => made.regions.clone(),
                },
            ),
            DataArray::scalars(M::MIN_ANGLE, smallest),
            DataArray::scalars(M::VOLUME, volume),
            DataArray::scalars(
                M::FEATURE_FACES,
                face_bits_to_physical::<D>(&made.feature_faces, mirrored),
            ),
            DataArray::scalars(ANGLES, made.judged.cells.clone()),
        ],
        field_data: {
            let mut fields =
                common_fields(geometry, outcome.step, outcome.extent, &outcome.provenance);
            fields.extend(settled_field(&outcome.features.settled));
            fields.extend(outcome.features.labels.as_ref().and_then(labels_field));
            fields
        },
    };
    // A rank without cells has the arrays that others have.
    if outcome.features.of_all().on_horizon > 0 {
        let bits = face_bits_to_physical::<D>(&horizons, mirrored);
        file.cell_data.push(DataArray::scalars(HORIZON_FACES, bits));
    }
    file
}

impl<const D: usize> Outcome<D>
where
    Space<D>: Meshing<D>,
{
    /// The mesh with all that is known of it, where the image lies in the world, as
    /// [`Self::write_with_image`] writes it; `None` unless the image has two axes or three.
    ///
    /// # Errors
    /// That of reading the image.
    pub fn file(&self, image: Source<'_, D>) -> Result<Option<AnyMesh>> {
        Ok(AnyMesh::of(match &self.made {
            Made::Simplices(made) => Box::new(with_image(to_file(self, made), image)?),
            Made::Voronoi { mesh, weld } => {
                Box::new(with_image(cells_to_file(self, mesh, *weld), image)?)
            }
        }))
    }

    /// Writes the mesh with all that is known of it, where the image lies in the world, as a VTU file:
    /// wholly or not at all. To a `.pvtu` file each rank writes its share of the tetrahedra or triangles; where ranks
    /// have but a part each, nothing else can be written.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be written, [`Error::Job`] for Voronoi cells in parts.
    pub fn write(&self, path: &Path) -> Result<()> {
        self.write_file(path, None)
    }

    /// The same with the image's value at each node and in the middle of each cell, as arrays `image`.
    ///
    /// # Errors
    /// As [`write`](Self::write), and that of reading the image.
    pub fn write_with_image(&self, path: &Path, image: Source<'_, D>) -> Result<()> {
        self.write_file(path, Some(image))
    }

    fn write_file(&self, path: &Path, image: Option<Source<'_, D>>) -> Result<()> {
        let in_parts = is_in_parts(path);
        match &self.made {
            Made::Simplices(made) if in_parts => {
                let (part, count) = (ranks::rank(), ranks::count());
                let file = to_file(self, made);
                let file = match &self.share {
                    Some(share) => as_part(file, &share.nodes),
                    None => part_of(file, part, count),
                };
                write_part(path, &with_values(file, image)?, part, count)
            }
            Made::Simplices(made) => write_vtu(path, &with_values(to_file(self, made), image)?),
            Made::Voronoi { .. } if in_parts => Err(no_parts(path)),
            Made::Voronoi { mesh, weld } => {
                let file = cells_to_file(self, mesh, *weld);
                write_cells_vtu(path, &with_values(file, image)?)
            }
        }
    }

    /// The shapes of tetrahedra or triangles where the image lies in the world, if they are other ones there. Where ranks
    /// have a part each, all must ask.
    ///
    /// # Errors
    /// Those of other ranks.
    pub fn quality_in_world(&self) -> Result<Option<Quality>> {
        let Some(made) = self.simplices() else {
            return Ok(None);
        };
        if self.geometry.has_shape_of(self.step) || !self.geometry.has_angles() {
            return Ok(None);
        }
        let mesh = to_physical(&made.mesh, self.step, &self.geometry);
        Ok(Some(match &self.share {
            None => quality(&mesh),
            Some(share) => quality_of_part(
                &Part::of_cells(&mesh, share.first, share.whole, &Ranks),
                &Patience::endless(),
            )?,
        }))
    }

    /// Writes the acute lines of tetrahedra or triangles, where the image lies in the world, as
    /// [`write_lines`] does; Voronoi cells have none.
    ///
    /// # Errors
    /// [`Error::Io`](crate::Error::Io) if the file cannot be written.
    pub fn write_lines(&self, path: &Path) -> Result<()> {
        let none = Vec::new();
        let (lines, nodes) = match self.simplices() {
            Some(made) => (&made.judged.angles.acute_lines, made.mesh.nodes()),
            None => (&none, &[][..]),
        };
        write_lines(path, lines, |n| {
            let x = nodes[n as usize];
            let index = std::array::from_fn(|k| x[k] / self.step[k]);
            self.geometry.to_physical(index)
        })
    }
}

/// Voronoi cells, of which no parts are written.
pub(crate) fn no_parts(path: &Path) -> Error {
    let problem = "is for tetrahedra and triangles: Voronoi cells are not written in parts";
    Error::Job(cause(
        path.display(),
        problem,
        "give a name that ends in .vtu",
    ))
}

/// The same, if there is an image.
fn with_values<const D: usize, M: Mesh<D>>(
    file: MeshFile<M>,
    image: Option<Source<'_, D>>,
) -> Result<MeshFile<M>> {
    match image {
        Some(image) => with_image(file, image),
        None => Ok(file),
    }
}

/// A mesh with the image's value at each node and in the middle of each cell, interpolated linearly, as
/// arrays `image`.
///
/// # Errors
/// That of reading the image.
pub fn with_image<const D: usize, M: Mesh<D>>(
    mut file: MeshFile<M>,
    image: Source<'_, D>,
) -> Result<MeshFile<M>> {
    let space = LatticeSpace::of(&file, file.mesh.nodes()).filter(|space| space.by_file);
    let geometry = space.map_or_else(|| image.geometry().clone(), |space| space.geometry);
    let (nodes, centre) = (file.mesh.nodes(), file.mesh.centres());
    let on_nodes = image.linear(nodes.len(), |n| geometry.to_index(nodes[n]))?;
    let in_cells = image.linear(file.mesh.len(), |c| geometry.to_index(centre(c)))?;
    drop(centre);
    let arrays = &mut file.point_data;
    arrays.push(DataArray::scalars(IMAGE, on_nodes));
    let arrays = &mut file.cell_data;
    arrays.push(DataArray::scalars(IMAGE, in_cells));
    Ok(file)
}

/// The arrays of the image's values.
pub(crate) const IMAGE: &str = "image";
/// The array that says which cells have angles beyond [30, 150], and whether features explain them.
pub(crate) const ANGLES: &str = "angles";
/// The array that says which faces on features lie on horizons, which are no barriers to flow: bits
/// of cells as in `feature_faces`, or for polyhedra and polygons pairs of cells.
pub(crate) const HORIZON_FACES: &str = "horizon_faces";
/// The array of d at each node.
pub(crate) const DISTANCE: &str = "distance";
/// Field data of welded Voronoi cells: the share of their size within which nodes are one.
pub(crate) const WELD: &str = "weld";
/// The unit of the numbers of an array of ours, by its name and the units of the coordinates; empty for
/// numbers without unit and where it is not known.
pub(crate) fn unit_of<const D: usize>(array: &str, units: &[String; D]) -> String {
    match array {
        "min_dihedral" | "min_angle" => "degrees".to_string(),
        DISTANCE => "samples".to_string(),
        "volume" | "area" if units.iter().all(|unit| *unit == units[0]) => {
            match units[0].as_str() {
                "" => String::new(),
                unit => format!("{unit}^{D}"),
            }
        }
        "volume" | "area" => units.join(" "),
        _ => String::new(),
    }
}
/// The field of units of the coordinates, commas between them.
pub(super) const UNITS: &str = "units";
/// The name under which a file keeps what feature detection settled on.
const SETTLED: &str = "features";

/// What feature detection settled on, so that a part of the mesh can be made again alike.
pub fn settled_field(settled: &[Settled]) -> Option<(String, FieldValue)> {
    let text = serde_json::to_string(settled).ok()?;
    Some((SETTLED.into(), FieldValue::Text(text)))
}

/// The same, of a file; `None` if it does not say.
pub fn settled_of<M>(file: &MeshFile<M>) -> Option<Vec<Settled>> {
    let mut fields = file.field_data.iter();
    fields.find_map(|(name, value)| match value {
        FieldValue::Text(text) if name == SETTLED => serde_json::from_str(text.trim()).ok(),
        _ => None,
    })
}

/// What every file says of itself: what made it, and where its lattice space is.
pub(crate) fn common_fields<const D: usize>(
    geometry: &Geometry<D>,
    step: [f64; D],
    extent: [f64; D],
    provenance: &Provenance,
) -> Vec<(String, FieldValue)> {
    let text = |text: &str| FieldValue::Text(text.to_string());
    vec![
        (UNITS.into(), text(&geometry.units.join(","))),
        ("atomesh_version".into(), text(env!("CARGO_PKG_VERSION"))),
        ("parameters".into(), text(&provenance.parameters)),
        ("input_sha256".into(), text(&provenance.input_sha256)),
        ("origin".into(), FieldValue::F64s(geometry.origin.to_vec())),
        ("axes".into(), FieldValue::F64s(geometry.axes.concat())),
        ("lattice_step".into(), FieldValue::F64s(step.to_vec())),
        ("lattice_extent".into(), FieldValue::F64s(extent.to_vec())),
    ]
}
