//! Connected parts of labels, in the image and in the mesh.
//!
//! A part consists of samples of one label that are connected by faces. Volumes are kept for each part,
//! and parts that touch nowhere in the image are kept apart in the mesh.

use crate::feature::LabelMap;
use crate::feature::components::Components;
use crate::feature::label_map::volumes;
use crate::feature::volume::Volume;
use crate::geometry::add_scaled;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::parallel::prelude::*;

/// The connected parts of the labels of an image.
#[derive(Debug, Clone)]
pub struct LabelParts<const D: usize> {
    components: Components<D>,
    /// Volume of each part inside the box, in lattice units.
    pub volumes: Vec<f64>,
    /// Pairs of parts that touch at a side, an edge or a corner of a sample, the
    /// smaller first, in ascending order.
    contacts: Vec<[u32; 2]>,
    /// The only part of each label; `None` if the label has several parts.
    only_part: Vec<Option<u32>>,
}

impl<const D: usize> LabelParts<D> {
    /// Finds the parts of the winners of a map.
    pub fn new(labelled: &LabelMap<D>) -> Self {
        let components = Components::from_labels(labelled.dims, &labelled.winner);
        let count = components.components.len();
        let part_of_sample = &components.component_of_sample;
        let mut part_volumes = volumes(labelled.dims, labelled.step, part_of_sample, count);
        let mut label_volumes = vec![0.0; labelled.labels.len()];
        let mut part_counts = vec![0; labelled.labels.len()];
        let mut only_part = vec![None; labelled.labels.len()];
        for (number, part) in components.components.iter().enumerate() {
            label_volumes[part.label as usize] += part_volumes[number];
            part_counts[part.label as usize] += 1;
            only_part[part.label as usize] = Some(number as u32);
        }
        for (only, count) in only_part.iter_mut().zip(part_counts) {
            *only = only.filter(|_| count == 1);
        }
        // Labels of grey values have volumes between those of samples.
        for (number, part) in components.components.iter().enumerate() {
            let label = part.label as usize;
            part_volumes[number] *= labelled.volumes[label] / label_volumes[label];
        }
        Self {
            volumes: part_volumes,
            contacts: components.contacts().into_iter().collect(),
            components,
            only_part,
        }
    }

    /// Returns the number of parts.
    pub fn count(&self) -> usize {
        self.volumes.len()
    }

    /// Returns the label of a part.
    pub fn label(&self, part: u32) -> u32 {
        self.components.components[part as usize].label
    }

    /// Returns `true` if two parts are the same, or touch in the image.
    pub fn may_touch(&self, a: u32, b: u32) -> bool {
        a == b || self.contacts.binary_search(&[a.min(b), a.max(b)]).is_ok()
    }

    /// Returns the part of each cell of a mesh with these labels: the part of most of the samples of
    /// its label that are in it, or else that of a neighbour of its label. Cells that no part reaches
    /// have [`NONE`].
    pub fn assign<M: Simplices<D>>(
        &self,
        mesh: &M,
        neighbours: &[u32],
        regions: &[u32],
        labelled: &LabelMap<D>,
    ) -> Vec<u32> {
        let volume = Volume::new(labelled.dims, &[]);
        let part_at = |x: [f64; D], label: u32| {
            let at = std::array::from_fn(|k| {
                let nearest = (x[k] / labelled.step[k] + 0.5).max(0.0) as usize;
                nearest.min(labelled.dims[k] - 1)
            });
            let part = self.components.component_of_sample[volume.index(at)];
            (self.label(part) == label).then_some(part)
        };
        let assign = |c: usize| {
            let label = regions[c];
            if let Some(part) = self.only_part[label as usize] {
                return part;
            }
            let corners = mesh.cell(c);
            let centre = |k: Option<usize>| {
                // The centroid, or a point between it and a corner.
                let weight = |i: usize| match k {
                    None => 1.0 / (D + 1) as f64,
                    Some(k) => 0.4 / (D + 1) as f64 + if i == k { 0.6 } else { 0.0 },
                };
                let corners = corners.iter().enumerate();
                corners.fold([0.0; D], |x, (i, &n)| {
                    add_scaled(x, weight(i), mesh.nodes()[n as usize])
                })
            };
            if let Some(part) = part_at(centre(None), label) {
                return part;
            }
            let found = (0..=D).filter_map(|k| part_at(centre(Some(k)), label));
            let mut found: Vec<u32> = found.collect();
            found.sort_unstable();
            let most = found.chunk_by(|a, b| a == b).max_by_key(|same| same.len());
            most.map_or(NONE, |same| same[0])
        };
        let mut parts: Vec<u32> = (0..mesh.len()).into_par_iter().map(assign).collect();
        let mut queue: Vec<u32> = (0..mesh.len() as u32)
            .filter(|&c| parts[c as usize] != NONE)
            .collect();
        if queue.len() == parts.len() {
            return parts;
        }
        let mut next = 0;
        while let Some(&c) = queue.get(next) {
            next += 1;
            for &n in &neighbours[(D + 1) * c as usize..][..D + 1] {
                if n != NONE
                    && parts[n as usize] == NONE
                    && regions[n as usize] == regions[c as usize]
                {
                    parts[n as usize] = parts[c as usize];
                    queue.push(n);
                }
            }
        }
        parts
    }
}
