//! Writes feature points as a table (`.csv`) or as VTK poly data (`.vtp`).

use std::io::Write;
use std::path::Path;

use crate::Result;
use crate::feature::{FeatureKind, Features};
use crate::files::atomic_write;
use crate::files::vtk::{ArraySource, PolyData};
use crate::geometry::{add_scaled, dot, to_3d, unit};
use crate::image::Geometry;
use crate::surface_file::has_extension;

/// Writes the feature points of an image in physical coordinates. Lattice space must be that of
/// samples.
///
/// Columns (arrays) are position, unit normal, strength, strength over the strength down to which
/// surfaces are followed, number of the feature surface, and 1 for points on horizons.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write_feature_points<const D: usize>(
    path: &Path,
    features: &Features<D>,
    geometry: &Geometry<D>,
) -> Result<()> {
    let gradients = index_gradients(geometry);
    let positions: Vec<[f64; 3]> = (features.points.iter())
        .map(|point| to_3d(geometry.to_physical(point.position.map(f64::from))))
        .collect();
    let normals: Vec<[f64; 3]> = (features.points.iter())
        .map(|point| to_3d(physical_normal(&gradients, point.normal.map(f64::from))))
        .collect();
    let horizons: Vec<u8> = (0..features.points.len())
        .map(|i| u8::from(features.on_horizon.get(i) == Some(&true)))
        .collect();
    let low = |is_horizon: bool| {
        let mut resolved = features.resolved.iter();
        let used = resolved.find(|r| (r.kind == FeatureKind::Horizons) == is_horizon);
        used.or(features.resolved.first())
            .map_or(f32::NAN, |r| r.low)
    };
    let ratios: Vec<f32> = (features.points.iter().zip(&horizons))
        .map(|(point, horizon)| point.strength / low(*horizon == 1))
        .collect();
    let strengths: Vec<f32> = features.points.iter().map(|point| point.strength).collect();
    if has_extension(path, &["csv"]) {
        return atomic_write(path, |out| {
            writeln!(
                out,
                "x,y,z,normal_x,normal_y,normal_z,strength,strength_over_threshold,surface,horizon"
            )?;
            for (i, [x, y, z]) in positions.iter().enumerate() {
                let ([a, b, c], strength, ratio) = (normals[i], strengths[i], ratios[i]);
                let (surface, horizon) = (features.surface[i], horizons[i]);
                writeln!(
                    out,
                    "{x},{y},{z},{a:.6},{b:.6},{c:.6},{strength},{ratio},{surface},{horizon}"
                )?;
            }
            Ok(())
        });
    }
    PolyData {
        point_data: Some(vec![
            ArraySource::slice("normal", 3, normals.as_flattened()),
            ArraySource::slice("strength", 1, &strengths),
            ArraySource::slice("strength_over_threshold", 1, &ratios),
            ArraySource::slice("surface", 1, &features.surface),
            ArraySource::slice("horizon", 1, &horizons),
        ]),
        ..PolyData::new("Verts", &positions, positions.len(), |i| i as i64 + 1)
    }
    .write(path)
}

/// Returns for each image axis the increase of its index along each coordinate.
fn index_gradients<const D: usize>(geometry: &Geometry<D>) -> [[f64; D]; D] {
    let index_step = |c: usize| {
        let mut position = geometry.origin;
        position[c] += 1.0;
        geometry.to_index(position).unwrap_or([0.0; D])
    };
    let steps: [[f64; D]; D] = std::array::from_fn(index_step);
    std::array::from_fn(|k| std::array::from_fn(|c| steps[c][k]))
}

/// Returns the unit normal in physical coordinates of a surface with this normal in samples.
fn physical_normal<const D: usize>(gradients: &[[f64; D]; D], normal: [f64; D]) -> [f64; D] {
    let sum =
        (gradients.iter().zip(normal)).fold([0.0; D], |sum, (row, n)| add_scaled(sum, n, *row));
    if dot(sum, sum) > 0.0 { unit(sum) } else { sum }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::{DetectionOptions, FeaturePoint};

    #[test]
    fn points_are_written_in_physical_coordinates() {
        let mut geometry = Geometry::with_spacing([100.0, 200.0, -50.0], [10.0, 10.0, 2.0]);
        geometry.axes[2][2] = -2.0;
        let options = DetectionOptions::<3>::default();
        let mut features = Features::empty([4, 4, 4], &options);
        // A plane of 45 degrees in samples.
        features.points.push(FeaturePoint {
            position: [1.0, 2.0, 3.0],
            normal: [0.0, 0.5f32.sqrt(), 0.5f32.sqrt()],
            strength: 6.0,
        });
        features.surface.push(7);
        features.on_horizon.push(false);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        write_feature_points(&path, &features, &geometry).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let fields: Vec<&str> = text.lines().nth(1).unwrap().split(',').collect();
        assert_eq!(fields[..3], ["110", "220", "-56"]);
        assert_eq!((fields[6], fields[8], fields[9]), ("6", "7", "0"));
        // The plane falls by 2 over 10: its normal is (0, 0.2, -1) / norm.
        let normal: Vec<f64> = fields[3..6].iter().map(|f| f.parse().unwrap()).collect();
        assert!((normal[1] / normal[2] + 0.2).abs() < 1e-4, "{normal:?}");
        let path = folder.path().join("a.vtp");
        write_feature_points(&path, &features, &geometry).unwrap();
        let text = String::from_utf8_lossy(&std::fs::read(&path).unwrap()).into_owned();
        assert!(text.contains("NumberOfVerts=\"1\"") && text.contains("strength_over_threshold"));
    }
}
