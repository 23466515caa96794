//! Lattice space and its content: the box, the weight of the image, fixed atoms and wells.

use super::{FixedAtom, LatticeParams, Weight};
use crate::error::cause;
use crate::image::placing::Frame;
use crate::image::{Geometry, ScalarField};
use crate::lattice::energy::Beta;
use crate::lattice::seeding::wells::WellTrajectory;
use crate::{Error, Result};

/// Largest radius of a well, in units of the distance between atoms.
const MAX_WELL_WIDTH: f64 = 0.2;

/// The domain of a job: its box in lattice space, with the weight of the image, fixed atoms and
/// wells.
pub(super) struct JobDomain<const D: usize> {
    /// Length of one sample along each axis of lattice space.
    pub step: [f64; D],
    /// The far corner of the box.
    pub extent: [f64; D],
    /// Weight of the image.
    pub beta: Beta<D>,
    /// Fixed atoms.
    pub fixed_atoms: Vec<[f64; D]>,
    /// Trajectories of wells, clipped to the box.
    pub well_paths: Vec<WellTrajectory<D>>,
}

impl<const D: usize> JobDomain<D> {
    /// Returns the domain of an image of dimensions `dims` with these parameters.
    ///
    /// # Errors
    /// Returns [`Error::Seeding`] for atoms and wells outside the image, and [`Error::Job`] for
    /// weights of other dimensions.
    pub fn new(
        dims: [usize; D],
        geometry: &Geometry<D>,
        params: &LatticeParams<'_, D>,
    ) -> Result<Self> {
        let step = params.spec().metric.step(geometry);
        let extent = lattice_extent(dims, step);
        Ok(Self {
            step,
            extent,
            beta: lattice_beta(params.beta(), dims, step)?,
            fixed_atoms: lattice_points(params.fixed_atoms(), geometry, step, extent)?,
            well_paths: lattice_well_paths(params, geometry, step, extent)?,
        })
    }
}

/// Returns the far corner of the box in lattice space.
pub(super) fn lattice_extent<const D: usize>(dims: [usize; D], step: [f64; D]) -> [f64; D] {
    std::array::from_fn(|k| (dims[k].max(1) - 1) as f64 * step[k])
}

/// Returns the weight of the image as a field in lattice space.
pub(crate) fn lattice_beta<const D: usize>(
    weight: &Weight<D>,
    dims: [usize; D],
    step: [f64; D],
) -> Result<Beta<D>> {
    let image = match weight {
        Weight::Constant(beta) => return Ok(Beta::Constant(*beta)),
        Weight::Image(image) => image,
    };
    if image.dims() != dims {
        return Err(Error::Job(cause(
            "beta",
            format!("has {:?} samples, but the image has {dims:?}", image.dims()),
            "give one weight per sample of the image",
        )));
    }
    Ok(Beta::Field(ScalarField {
        dims,
        step,
        samples: image.as_slice().to_vec(),
    }))
}

/// Returns the trajectories of wells in lattice space, clipped to the box.
pub(crate) fn lattice_well_paths<const D: usize>(
    params: &LatticeParams<'_, D>,
    geometry: &Geometry<D>,
    step: [f64; D],
    extent: [f64; D],
) -> Result<Vec<WellTrajectory<D>>> {
    let min_distance = params
        .spec()
        .well_distance
        .map(|length| length.value)
        .unwrap_or(params.spacing().min());
    let spacing = geometry.spacing();
    let sample = (0..D).fold(f64::INFINITY, |s, k| s.min(spacing[k] / step[k]));
    let mut paths = Vec::new();
    for well in params.wells() {
        let refuse =
            |problem: String, remedy: &str| Err(Error::Seeding(cause(&well.name, problem, remedy)));
        if well.radius >= MAX_WELL_WIDTH * min_distance * sample {
            return refuse(
                format!(
                    "has a radius of {}, but cells are only about {} wide there",
                    well.radius,
                    min_distance * sample
                ),
                "give a smaller radius or a larger distance between atoms",
            );
        }
        let to_lattice = |&x: &[f64; D]| -> Option<[f64; D]> {
            let index = geometry.to_index(x)?;
            Some(std::array::from_fn(|k| index[k] * step[k]))
        };
        let points: Option<Vec<_>> = well.points.iter().map(to_lattice).collect();
        let path = WellTrajectory {
            name: well.name.clone(),
            points: points.unwrap_or_default(),
        };
        let clipped = path.clip_to_box(extent);
        if clipped.is_empty() {
            let dims = std::array::from_fn(|k| (extent[k] / step[k]).round() as usize + 1);
            let frame = Frame::new(geometry, dims);
            let problem = format!(
                "lies outside the image: it has {}, the image {}",
                frame.ranges_of(well.points.iter().copied()),
                frame.ranges()
            );
            let turned =
                (well.points.iter()).any(|&x| is_inside_if_turned(x, geometry, step, extent));
            return refuse(problem, outside_remedy(turned));
        }
        paths.extend(clipped);
    }
    Ok(paths)
}

/// Returns `true` if a point would lie in the image with the other sign of its last coordinate:
/// programs differ in the sign of depths and times.
fn is_inside_if_turned<const D: usize>(
    mut point: [f64; D],
    geometry: &Geometry<D>,
    step: [f64; D],
    extent: [f64; D],
) -> bool {
    point[D - 1] = -point[D - 1];
    let index = geometry.to_index(point);
    index.is_some_and(|index| (0..D).all(|k| (0.0..=extent[k]).contains(&(index[k] * step[k]))))
}

/// Returns the remedy for positions outside the image, which may be inside if z is `turned`.
fn outside_remedy(turned: bool) -> &'static str {
    if turned {
        "give z with the other sign, as the image has it (`atomesh info` shows it)"
    } else {
        "give points inside, in the image's physical coordinates, or say how they differ: ,unit=ft ,z=down"
    }
}

/// Converts physical points to lattice space. All must lie in the box, and no two at the same
/// place.
pub(crate) fn lattice_points<const D: usize>(
    points: &[FixedAtom<D>],
    geometry: &Geometry<D>,
    step: [f64; D],
    extent: [f64; D],
) -> Result<Vec<[f64; D]>> {
    let refuse = |k: usize, problem: String, remedy: &str| {
        let FixedAtom { name, position } = &points[k];
        let position = position.map(|c| c.to_string()).join(", ");
        Error::Seeding(cause(
            format!("{name}: fixed atom ({position})"),
            problem,
            remedy,
        ))
    };
    let mut positions: Vec<[f64; D]> = Vec::with_capacity(points.len());
    for (k, point) in points.iter().enumerate() {
        let index = geometry.to_index(point.position).ok_or_else(|| {
            refuse(
                k,
                "the image's axes are linearly dependent".into(),
                "correct the image's geometry",
            )
        })?;
        let mut position = [0.0; D];
        for axis in 0..D {
            let x = index[axis] * step[axis];
            // Rounding errors of the coordinates must not push a point off its side.
            let slack = 1e-6 * extent[axis];
            if !(-slack..=extent[axis] + slack).contains(&x) {
                let index = index.map(|i| (1e3 * i).round() / 1e3);
                let turned = is_inside_if_turned(point.position, geometry, step, extent);
                return Err(refuse(
                    k,
                    format!("lies outside the image, at sample {index:?} (x first)"),
                    outside_remedy(turned),
                ));
            }
            position[axis] = x.clamp(0.0, extent[axis]);
        }
        positions.push(position);
    }
    let mut order: Vec<usize> = (0..positions.len()).collect();
    order.sort_by(|&a, &b| {
        positions[a]
            .partial_cmp(&positions[b])
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    for pair in order.windows(2) {
        if positions[pair[0]] == positions[pair[1]] {
            let (first, second) = (pair[0].min(pair[1]), pair[0].max(pair[1]));
            let problem = format!("is at the same place as that of {}", points[first].name);
            return Err(refuse(second, problem, "keep one of the two"));
        }
    }
    Ok(positions)
}
