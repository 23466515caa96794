//! Extends a mesh of tetrahedra beyond its image: over-, under- and sideburden for geomechanics.
//!
//! The mesh of the image does not change. One side of the box after the other gets a layer of cells that
//! coarsen away from the image: first the sides, then above and below, so that each layer covers the whole
//! side of the box so far. Atoms of a layer are placed by Delaunay refinement from the nodes on that side,
//! as it follows a distance that grows fast; their triangulation is made to match the faces on the side
//! ([`improve_beside`](crate::improve::tets::improve_beside)).

use super::spec::Padding;
use super::topography::Topography;
use super::{BOX_TOLERANCE, CellKind, MeshScene, StageRunner, estimate};
use crate::comm::SelfComm;
use crate::error::{Error, Result, cause};
use crate::geometry::grid_index::index_at;
use crate::geometry::{bounding_box, norm, volume6};
use crate::image::{Geometry, ScalarField};
use crate::improve::Target;
use crate::improve::feature_planes::FeaturePlanes;
use crate::improve::tets::{ImproveContext, improve_beside};
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::{self, Alignment, Atoms, Seeding};
use crate::mesh::check::check;
use crate::mesh::complex::{NONE, neighbours};
use crate::mesh::delaunay::distributed_delaunay_with_neighbours;
use crate::mesh::{FACES, TetMesh, TriMesh};
use crate::mesh_file::Burden;
use crate::parallel::prelude::*;
use crate::progress::{CancelToken, Stage};
use crate::report::{PaddingRegion, PaddingReport, quality};

/// Increase of the distance between nodes with the distance from the image.
const GROWTH: f64 = 0.3;

/// Smallest thickness of a layer, in units of the largest distance between nodes in the image.
const MIN_THICKNESS: f64 = 1.5;

/// Largest distance between nodes, in units of the shortest side of the layer. Two cells must fit in.
const MAX_WIDTH: f64 = 0.499;

/// Largest number of samples of the distance in a layer, along its thickness and along the side.
const MAX_DISTANCE_SAMPLES: [usize; 2] = [128, 256];

/// Distance from the side below which no atom of a layer may be, in units of d.
const MIN_HEIGHT: f64 = 0.4;

/// The part of a mesh that continues beyond the image, in the image's lattice space.
#[derive(Debug, Clone)]
pub struct PaddingCells<const D: usize> {
    /// The nodes beyond the image.
    pub nodes: Vec<[f64; D]>,
    /// The nodes of each cell, `D + 1` a cell. They are numbered from the mesh's own nodes on.
    pub connectivity: Vec<u32>,
    /// The part to which each cell belongs.
    pub burdens: Vec<Burden>,
    /// The kind of each node.
    pub kinds: Vec<AtomKind>,
    /// The nominal distance at each node.
    pub distances: Vec<f32>,
    /// The low corner of the box of the whole mesh.
    pub low: [f64; D],
    /// The high corner of the box of the whole mesh.
    pub high: [f64; D],
    /// Number of the side of this box that follows a topography, if one is given: 2 axis for the lower side,
    /// 2 axis + 1 for the upper side. The box touches the topography at its highest point.
    pub bent_side: Option<usize>,
}

/// A mesh that is being continued. Its first nodes and cells are those of the image's mesh.
struct PaddedMesh {
    mesh: TetMesh,
    low: [f64; 3],
    high: [f64; 3],
    /// Data of the cells and nodes beyond the image.
    burdens: Vec<Burden>,
    distances: Vec<f32>,
}

impl PaddedMesh {
    /// Moves the nodes above the image, so that the mesh ends at a topography and not at the box's side. The
    /// box grows or shrinks with them. Returns the largest distance of the mesh's top from the topography.
    ///
    /// # Errors
    /// Returns [`Error::Job`] where the topography has a hole, cuts into the image, or is so steep that cells
    /// turn inside out.
    fn end_at(&mut self, topography: &Topography, image_mesh: &TetMesh) -> Result<f64> {
        let (side, first) = (topography.side(), image_mesh.nodes.len());
        let (axis, is_high) = (side / 2, side % 2 == 1);
        let bounds = bounding_box(image_mesh.nodes.iter().copied());
        let thickness = if is_high {
            self.high[axis] - bounds[1][axis]
        } else {
            bounds[0][axis] - self.low[axis]
        };
        let (top, _) = side_triangles(
            &self.mesh,
            axis,
            if is_high { self.high } else { self.low }[axis],
        )?;
        let nodes = &mut self.mesh.nodes[first..];
        topography.stretch(nodes, thickness)?;
        let coordinates = nodes.iter().map(|x| x[axis]);
        if is_high {
            self.high[axis] = coordinates.fold(bounds[1][axis], f64::max);
        } else {
            self.low[axis] = coordinates.fold(bounds[0][axis], f64::min);
        }
        let cells = image_mesh.tets.len()..self.mesh.tets.len();
        let is_inverted = |&c: &usize| volume6(&self.mesh.corners(c)) <= 0.0;
        let inverted: Vec<usize> = cells.filter(is_inverted).collect();
        if let Some(&cell) = inverted.first() {
            let corner = self.mesh.corners(cell)[0];
            return Err(topography.steepness_error(corner, inverted.len()));
        }
        let position = |n: u32| self.mesh.nodes[n as usize];
        topography.deviation(top.into_iter().map(|face| face.map(position)))
    }
}

/// A layer beyond one side of a box.
struct Layer {
    axis: usize,
    /// `true` if the layer is at the high end of the axis.
    is_high: bool,
    /// Thickness in lattice units.
    thickness: f64,
    burden: Burden,
}

/// Returns the vertical axis, and `true` if its low end is above.
pub(super) fn vertical_axis(geometry: &Geometry<3>) -> (usize, bool) {
    let vertical = (0..3)
        .find(|&k| geometry.main_coordinate(k) == 2)
        .unwrap_or(2);
    let is_low_above = geometry.points_down() || geometry.axes[vertical][2] < 0.0;
    (vertical, is_low_above)
}

/// Returns the layers that `padding` asks for, in the order in which they are made.
fn layers(padding: &Padding, geometry: &Geometry<3>, step: [f64; 3]) -> Vec<Layer> {
    let (vertical, is_low_above) = vertical_axis(geometry);
    let spacing = geometry.spacing();
    let layer = |axis: usize, is_high, distance: f64, burden| Layer {
        axis,
        is_high,
        thickness: distance / spacing[axis] * step[axis],
        burden,
    };
    let horizontal = (0..3).filter(|&k| k != vertical);
    let sides = horizontal.flat_map(|k| [false, true].map(|high| (k, high)));
    let mut layers: Vec<Layer> = sides
        .map(|(k, high)| layer(k, high, padding.sides, Burden::Side))
        .collect();
    layers.push(layer(vertical, !is_low_above, padding.above, Burden::Over));
    layers.push(layer(vertical, is_low_above, padding.below, Burden::Under));
    layers.retain(|layer| layer.thickness > 0.0);
    layers
}

/// Simplices that can be continued beyond an image.
pub(super) trait Pad<const D: usize>: Sized {
    /// Extends a mesh of an image with this geometry beyond it, up to the topography if there is one.
    /// Returns `None` if the job is stopped, and in the plane.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a layer that is too thin and a topography that is too steep, and the
    /// errors of seeding and of the triangulation.
    fn pad(
        &self,
        _: &Padding,
        _: Option<&Topography>,
        _: &MeshScene<'_, D>,
        _: &Geometry<D>,
        _: f64,
        _: &mut StageRunner<'_>,
    ) -> Result<Option<(PaddingCells<D>, PaddingReport)>> {
        Ok(None)
    }
}

impl Pad<2> for TriMesh {}

impl Pad<3> for TetMesh {
    fn pad(
        &self,
        padding: &Padding,
        topography: Option<&Topography>,
        scene: &MeshScene<'_, 3>,
        geometry: &Geometry<3>,
        min_dihedral: f64,
        stages: &mut StageRunner<'_>,
    ) -> Result<Option<(PaddingCells<3>, PaddingReport)>> {
        stages.begin(Stage::Padding);
        let mut padded = PaddedMesh {
            mesh: self.clone(),
            low: [0.0; 3],
            high: scene.extent,
            burdens: Vec::new(),
            distances: Vec::new(),
        };
        let step = scene.features.potential.step;
        for layer in layers(padding, geometry, step) {
            let builder = LayerBuilder {
                layer: &layer,
                scene,
                low: padded.low,
                high: padded.high,
                min_dihedral,
                far_width: match topography {
                    Some(topography) if layer.burden == Burden::Over => topography.top_width(),
                    _ => f64::INFINITY,
                },
            };
            if !builder.add_to(&mut padded, stages)? {
                return Ok(None);
            }
        }
        let (low, high) = (padded.low, padded.high);
        let box_check = check(&padded.mesh, low, high, BOX_TOLERANCE);
        if let Some(problem) = box_check.problems.first() {
            return Err(Error::Mesh(cause(
                "the mesh beyond the image",
                format!("came out invalid: {problem}"),
                "choose another distance, and please report it with the image: this is an error in atomesh",
            )));
        }
        let kind = |&x: &[f64; 3]| {
            // A coordinate is exactly that of the side on which the node lies.
            let sides = (0..3)
                .filter(|&k| x[k] == low[k] || x[k] == high[k])
                .count();
            [
                AtomKind::Interior,
                AtomKind::Side,
                AtomKind::Edge,
                AtomKind::Corner,
            ][sides]
        };
        let kinds = padded.mesh.nodes[self.nodes.len()..]
            .iter()
            .map(kind)
            .collect();
        let deviation = match topography {
            Some(topography) => Some(padded.end_at(topography, self)?),
            None => None,
        };
        let PaddedMesh {
            mesh: whole,
            low,
            high,
            burdens,
            distances,
        } = padded;
        let report = PaddingReport {
            topography_deviation: deviation,
            ..padding_report(&whole, self.tets.len(), &burdens)
        };
        Ok(Some((
            PaddingCells {
                kinds,
                connectivity: whole.tets[self.tets.len()..].concat(),
                nodes: whole.nodes[self.nodes.len()..].to_vec(),
                burdens,
                distances,
                low,
                high,
                bent_side: topography.map(Topography::side),
            },
            report,
        )))
    }
}

/// Measures the cells beyond the image: those of `mesh` from number `first` on.
fn padding_report(mesh: &TetMesh, first: usize, burdens: &[Burden]) -> PaddingReport {
    let beyond = TetMesh {
        nodes: mesh.nodes.clone(),
        tets: mesh.tets[first..].to_vec(),
    };
    let quality = quality(&beyond);
    let regions = Burden::ALL.map(|burden| {
        let cells = (0..beyond.tets.len()).filter(|&c| burdens[c] == burden);
        PaddingRegion {
            name: burden.name(),
            cells: cells.clone().count(),
            volume: cells.map(|c| volume6(&beyond.corners(c)) / 6.0).sum(),
        }
    });
    PaddingReport {
        regions: regions
            .into_iter()
            .filter(|region| region.cells > 0)
            .collect(),
        smallest_angle: quality.smallest_angle,
        largest_angle: quality.largest_angle,
        topography_deviation: None,
    }
}

/// Returns the triangles of a mesh on a side of its box, the plane at `side` along `axis`, and their nodes in rising
/// order.
fn side_triangles(mesh: &TetMesh, axis: usize, side: f64) -> Result<(Vec<[u32; 3]>, Vec<u32>)> {
    let neighbours = neighbours(mesh.nodes.len(), &mesh.tets).map_err(|face| {
        Error::Mesh(cause(
            format!("face {face:?}"),
            "belongs to more than two tetrahedra",
            "mesh the image again",
        ))
    })?;
    let is_on_side = |n: u32| mesh.nodes[n as usize][axis] == side;
    let faces = mesh.tets.iter().zip(&neighbours).flat_map(|(tet, around)| {
        let open = (0..4).filter(|&k| around[k] == NONE);
        open.map(|k| FACES[k].map(|i| tet[i]))
    });
    let triangles: Vec<[u32; 3]> = faces
        .filter(|face| face.iter().all(|&n| is_on_side(n)))
        .collect();
    let nodes = crate::geometry::sorted_distinct(triangles.iter().flatten().copied());
    Ok((triangles, nodes))
}

/// Makes one layer. Its own space is the box `[0, extent]`, in which the layer begins at the high end of
/// its axis: for layers at the high end of the box, the axis is reversed.
struct LayerBuilder<'a> {
    layer: &'a Layer,
    scene: &'a MeshScene<'a, 3>,
    /// The box so far.
    low: [f64; 3],
    high: [f64; 3],
    min_dihedral: f64,
    /// Largest distance between nodes on the far side, if its shape asks for one.
    far_width: f64,
}

impl LayerBuilder<'_> {
    /// Returns the extent of the layer.
    fn extent(&self) -> [f64; 3] {
        let mut extent: [f64; 3] = std::array::from_fn(|k| self.high[k] - self.low[k]);
        extent[self.layer.axis] = self.layer.thickness;
        extent
    }

    /// Returns the coordinate, along the axis, of the side where the layer begins.
    fn side(&self) -> f64 {
        let ends = if self.layer.is_high {
            self.high
        } else {
            self.low
        };
        ends[self.layer.axis]
    }

    /// Returns the coordinate, along the axis, of the layer's far side.
    fn far_side(&self) -> f64 {
        let direction = if self.layer.is_high { 1.0 } else { -1.0 };
        self.side() + direction * self.layer.thickness
    }

    /// Converts a position in the layer's space to the image's lattice space. Sides stay exact.
    fn to_image(&self, x: [f64; 3], extent: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| {
            let (low, high) = if k != self.layer.axis {
                (self.low[k], self.high[k])
            } else {
                (self.far_side(), self.side())
            };
            let direction = if high < low { -1.0 } else { 1.0 };
            if x[k] == 0.0 {
                low
            } else if x[k] == extent[k] {
                high
            } else {
                low + direction * x[k]
            }
        })
    }

    /// Converts a node on the side where the layer begins to the layer's space.
    fn to_layer(&self, x: [f64; 3], extent: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| {
            if k == self.layer.axis || x[k] == self.high[k] {
                extent[k]
            } else {
                x[k] - self.low[k]
            }
        })
    }

    /// Returns the nominal distance in the layer.
    fn distance(&self, extent: [f64; 3]) -> Distance<3> {
        let image_distance = |x: [f64; 3]| {
            let nearest: [f64; 3] = std::array::from_fn(|k| x[k].clamp(0.0, self.scene.extent[k]));
            let offset: [f64; 3] = std::array::from_fn(|k| x[k] - nearest[k]);
            self.scene.distance.value_at(nearest) + GROWTH * norm(offset)
        };
        let min = self.scene.distance.min();
        let axis = self.layer.axis;
        let dims: [usize; 3] = std::array::from_fn(|k| {
            let max_count = MAX_DISTANCE_SAMPLES[usize::from(k != axis)];
            ((extent[k] / min).ceil() as usize + 1).clamp(2, max_count)
        });
        let step: [f64; 3] = std::array::from_fn(|k| extent[k] / (dims[k] - 1) as f64);
        let far_width = self.far_width.max(self.scene.distance.max());
        let max = MAX_WIDTH * extent.iter().copied().fold(f64::INFINITY, f64::min);
        let count = dims.iter().product::<usize>();
        let values: Vec<f32> = (0..count)
            .into_par_iter()
            .map(|i| {
                let index = index_at(dims, i);
                let x = std::array::from_fn(|k| index[k] as f64 * step[k]);
                let far = far_width + GROWTH * x[axis];
                image_distance(self.to_image(x, extent)).min(max).min(far) as f32
            })
            .collect();
        let field = ScalarField {
            dims,
            step,
            samples: values,
        };
        Distance::Field(field)
    }

    /// Returns atoms that fill the layer, first the fixed ones on the side where it begins. They are not
    /// moved afterwards: where the distance grows that fast, the energy would push them away from the side.
    fn place_atoms(
        &self,
        fixed: &[[f64; 3]],
        extent: [f64; 3],
        distance: &Distance<3>,
        stages: &mut StageRunner<'_>,
    ) -> Result<Atoms<3>> {
        let atoms = stages.run_or_interrupt(Stage::Padding, |cancel| {
            let (seeding, alignment) = (Seeding::Refine { seed: 0 }, Alignment::OnFeatures);
            seeding::seed(seeding, extent, distance, fixed, alignment, cancel)
        })?;
        let axis = self.layer.axis;
        let is_high_enough = |x: [f64; 3], kind: AtomKind| {
            let height = extent[axis] - x[axis];
            kind == AtomKind::Fixed || height > MIN_HEIGHT * distance.value_at(x)
        };
        let pairs = atoms.positions.into_iter().zip(atoms.kinds);
        let kept = pairs.filter(|&(x, kind)| is_high_enough(x, kind));
        let (mut positions, mut kinds): (Vec<_>, Vec<_>) = kept.unzip();
        // Fixed atoms come last.
        let first_fixed = positions.len() - fixed.len();
        positions.rotate_left(first_fixed);
        kinds.rotate_left(first_fixed);
        Ok(Atoms { positions, kinds })
    }

    /// Adds the layer to the mesh. Returns `false` if the job is stopped.
    fn add_to(&self, padded: &mut PaddedMesh, stages: &mut StageRunner<'_>) -> Result<bool> {
        let Layer {
            axis,
            thickness,
            burden,
            ..
        } = *self.layer;
        let width = self.scene.distance.max();
        if thickness < MIN_THICKNESS * width {
            let name = burden.name();
            return Err(Error::Job(cause(
                format!("pad ({name})"),
                format!("is {thickness:.4} samples thick, but cells are up to {width:.4} wide"),
                format!("give at least {MIN_THICKNESS} times as much as cells are wide"),
            )));
        }
        let extent = self.extent();
        let distance = self.distance(extent);
        estimate::afford(&estimate::estimate_from_distance(
            &distance,
            extent,
            CellKind::Simplices,
        ))?;
        let (triangles, side_nodes) = side_triangles(&padded.mesh, axis, self.side())?;
        let position = |&n: &u32| self.to_layer(padded.mesh.nodes[n as usize], extent);
        let fixed: Vec<[f64; 3]> = side_nodes.iter().map(position).collect();
        let mut atoms = match self.place_atoms(&fixed, extent, &distance, stages) {
            Err(Error::Interrupted(_)) => return Ok(false),
            atoms => atoms?,
        };
        atoms.positions[..fixed.len()].copy_from_slice(&fixed);
        let delaunay =
            distributed_delaunay_with_neighbours(&atoms.positions, stages.kernel, &SelfComm)?;
        let local = |n: u32| side_nodes.partition_point(|&other| other < n) as u32;
        let triangles: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(local)).collect();
        let context = ImproveContext {
            extent,
            planes: &FeaturePlanes::new(&[], extent, 1.0, 1.0),
            distance: &distance,
            target: Target {
                min_dihedral: self.min_dihedral,
                ..Target::default()
            },
        };
        let improved = stages.run_cancellable(|cancel: &CancelToken<'_>| {
            improve_beside(delaunay, &atoms.kinds, axis, &triangles, context, cancel)
        });
        self.append(padded, &improved?.0, &side_nodes, &distance);
        Ok(true)
    }

    /// Appends the cells of the layer, whose first nodes are `side_nodes`, to the mesh.
    fn append(
        &self,
        padded: &mut PaddedMesh,
        layer: &TetMesh,
        side_nodes: &[u32],
        distance: &Distance<3>,
    ) {
        let extent = self.extent();
        let shared = side_nodes.len();
        let first_new = padded.mesh.nodes.len() as u32;
        let global = |n: u32| match side_nodes.get(n as usize) {
            Some(&node) => node,
            None => first_new + n - shared as u32,
        };
        let new_nodes = layer.nodes[shared..].iter();
        padded
            .mesh
            .nodes
            .extend(new_nodes.clone().map(|&x| self.to_image(x, extent)));
        padded
            .distances
            .extend(new_nodes.map(|&x| distance.value_at(x) as f32));
        let tets = layer.tets.iter().map(|tet| {
            let mut tet = tet.map(global);
            if self.layer.is_high {
                tet.swap(2, 3);
            }
            tet
        });
        padded.mesh.tets.extend(tets);
        let count = padded.burdens.len() + layer.tets.len();
        padded.burdens.resize(count, self.layer.burden);
        let axis = self.layer.axis;
        let ends = if self.layer.is_high {
            &mut padded.high
        } else {
            &mut padded.low
        };
        ends[axis] = self.far_side();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::{ExactSurface, ridge_image};
    use crate::job::spec::NominalDistance;
    use crate::job::{MeshSpec, Metric, Outcome, Params, run};
    use crate::progress::NoProgress;

    /// Meshes an image with one inclined feature.
    fn outcome(spec: MeshSpec) -> Result<Outcome> {
        let surfaces = [ExactSurface::plane([1.0, 0.4, 0.2], [16.0; 3])];
        let image = ridge_image([36, 34, 32], &surfaces, 1.5, 0.1);
        run(&image, &Params::new(spec)?, &mut NoProgress)
    }

    fn spec(padding: Option<&str>) -> MeshSpec {
        MeshSpec {
            distance: NominalDistance::Range { min: 4.0, max: 7.0 },
            pad: padding.map(|text| text.parse().unwrap()),
            ..MeshSpec::default()
        }
    }

    #[test]
    fn regions_beyond_the_image_have_exact_volumes_and_good_angles() {
        for (seed, metric) in [
            (1, Metric::Samples),
            (2, Metric::Samples),
            (3, Metric::Scales(vec![1.0, 1.0, 1.5])),
        ] {
            let outcome = outcome(MeshSpec {
                rng_seed: seed,
                metric,
                ..spec(Some("above=90,below=25,sides=40"))
            });
            let outcome = outcome.unwrap();
            let report = outcome.report.padding.as_ref().unwrap();
            let [x, y, z] = outcome.extent;
            let step = outcome.step;
            let area = (x + 80.0 * step[0]) * (y + 80.0 * step[1]);
            let volumes = [
                area * 90.0 * step[2],
                area * 25.0 * step[2],
                area * z - x * y * z,
            ];
            let names = ["overburden", "underburden", "sideburden"];
            assert_eq!(report.regions.len(), 3);
            for ((region, expected), name) in report.regions.iter().zip(volumes).zip(names) {
                assert_eq!(region.name, name);
                assert!((region.volume / expected - 1.0).abs() < 1e-9, "{report:?}");
                // Cells of the distance at the side would be ten times as many.
                assert!((region.cells as f64) < expected / 80.0, "{report:?}");
            }
            assert!(report.smallest_angle.worst > 25.0, "{report:?}");
        }
    }

    #[test]
    fn padding_that_is_too_thin_is_refused() {
        let error = outcome(spec(Some("above=50,below=6")))
            .unwrap_err()
            .to_string();
        assert!(
            error.starts_with("pad (underburden): is 6.0000 samples thick"),
            "{error}"
        );
    }
}
