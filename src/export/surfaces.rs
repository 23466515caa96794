//! Labelled surfaces with everything that is stored with them, for all formats of surfaces.

use super::FieldValue;
use crate::io::vtk::DataArray;

/// Surfaces, in physical coordinates: triangles (`D` = 3), or line segments (`D` = 2) at z = 0.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SurfaceFile<const D: usize> {
    /// Node positions.
    pub nodes: Vec<[f64; 3]>,
    /// Nodes of each facet, surface by surface.
    pub facets: Vec<[u32; D]>,
    /// Where the facets of each surface begin, and the end.
    pub start: Vec<usize>,
    /// Names of the surfaces, without spaces or line ends.
    pub names: Vec<String>,
    /// Arrays with a tuple per facet.
    pub cell_data: Vec<DataArray>,
    /// What belongs to the whole file.
    pub field_data: Vec<(String, FieldValue)>,
}

impl<const D: usize> SurfaceFile<D> {
    /// Surfaces named `name`1, `name`2 ... with only those nodes that they use.
    pub fn new(nodes: &[[f64; D]], facets: &[[u32; D]], start: &[usize], name: &str) -> Self {
        let mut used: Vec<u32> = facets.as_flattened().to_vec();
        used.sort_unstable();
        used.dedup();
        let place = |n: u32| used.partition_point(|&m| m < n) as u32;
        let version = FieldValue::Text(env!("CARGO_PKG_VERSION").to_string());
        let lifted = |&n: &u32| std::array::from_fn(|k| *nodes[n as usize].get(k).unwrap_or(&0.0));
        Self {
            nodes: used.iter().map(lifted).collect(),
            facets: facets.iter().map(|f| f.map(place)).collect(),
            start: start.to_vec(),
            names: (1..start.len()).map(|s| format!("{name}{s}")).collect(),
            cell_data: Vec::new(),
            field_data: vec![("atomesh_version".into(), version)],
        }
    }

    /// The facets of a surface.
    pub fn of(&self, surface: usize) -> &[[u32; D]] {
        &self.facets[self.start[surface]..self.start[surface + 1]]
    }

    /// The number of each facet's surface, from 1, as in the names.
    pub fn labels(&self) -> Vec<i32> {
        let sizes = self.start.windows(2).map(|w| w[1] - w[0]);
        let labels = (1..).zip(sizes);
        labels
            .flat_map(|(s, n)| std::iter::repeat_n(s, n))
            .collect()
    }
}
