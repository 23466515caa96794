//! Connected components of labels: samples of one label that touch face to face.

use super::volume::Volume;
use crate::geometry::grid_index::index_at;
use crate::geometry::union_find::UnionFind;
use std::collections::{BTreeMap, BTreeSet};

/// One connected component of a label.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Component<const D: usize> {
    /// Index of its label.
    pub label: u32,
    /// Number of its samples.
    pub sample_count: usize,
    /// Index in memory of its first sample.
    pub first_sample: usize,
    /// Corner of its bounding box nearest to the origin.
    pub min_corner: [usize; D],
    /// Opposite corner of its bounding box, included in the box.
    pub max_corner: [usize; D],
}

/// All connected components of all labels.
#[derive(Debug, Clone)]
pub struct Components<const D: usize> {
    /// Number of samples along each axis.
    pub dims: [usize; D],
    /// Index of the component of each sample.
    pub component_of_sample: Vec<u32>,
    /// The components, in the order of their first samples.
    pub components: Vec<Component<D>>,
}

impl<const D: usize> Components<D> {
    /// Finds the components of an image, given the label index of each sample.
    pub fn from_labels(dims: [usize; D], label: &[u32]) -> Self {
        let volume = Volume::new(dims, &[]);
        let strides = volume.strides();
        let mut sets = UnionFind::new(label.len());
        for_each_sample(dims, |i, at| {
            for k in 0..D {
                if at[k] > 0 && label[i - strides[k]] == label[i] {
                    sets.unite((i - strides[k]) as u32, i as u32);
                }
            }
        });
        let (component_of_sample, count) = sets.into_labels();
        let mut components: Vec<Component<D>> = Vec::with_capacity(count);
        for_each_sample(dims, |i, at| {
            match components.get_mut(component_of_sample[i] as usize) {
                Some(part) => {
                    part.sample_count += 1;
                    part.min_corner = std::array::from_fn(|k| part.min_corner[k].min(at[k]));
                    part.max_corner = std::array::from_fn(|k| part.max_corner[k].max(at[k]));
                }
                // A set is represented by its first sample, and sets are numbered in the order of
                // these.
                None => components.push(Component {
                    label: label[i],
                    sample_count: 1,
                    first_sample: i,
                    min_corner: at,
                    max_corner: at,
                }),
            }
        });
        Self {
            dims,
            component_of_sample,
            components,
        }
    }

    /// Returns the pairs of components that touch at a side, an edge or a corner of a sample, the smaller
    /// number first.
    pub fn contacts(&self) -> BTreeSet<[u32; 2]> {
        let mut pairs = BTreeSet::new();
        let strides = Volume::new(self.dims, &[]).strides();
        // Half of the neighbours of a sample are enough, as the others visit this sample.
        let count = 3usize.pow(D as u32);
        for_each_sample(self.dims, |i, at| {
            for number in count / 2 + 1..count {
                let step: [usize; D] = index_at([3; D], number);
                let is_inside =
                    (0..D).all(|k| at[k] + step[k] > 0 && at[k] + step[k] <= self.dims[k]);
                if !is_inside {
                    continue;
                }
                let neighbour = (0..D).fold(i, |n, k| n + step[k] * strides[k] - strides[k]);
                let [a, b] = [i, neighbour].map(|i| self.component_of_sample[i]);
                if a != b {
                    pairs.insert([a.min(b), a.max(b)]);
                }
            }
        });
        pairs
    }

    /// Gives each component that is not to be kept the label that it touches most. Components that
    /// touch only other removed ones follow these. Returns the number of samples and of components
    /// whose label changed.
    pub fn absorb(&self, label: &mut [u32], keep: impl Fn(&Component<D>) -> bool) -> [usize; 2] {
        let absorbed: Vec<bool> = self.components.iter().map(|part| !keep(part)).collect();
        if !absorbed.contains(&true) {
            return [0; 2];
        }
        let strides = Volume::new(self.dims, &[]).strides();
        let mut contacts: BTreeMap<(u32, u32), usize> = BTreeMap::new();
        for_each_sample(self.dims, |i, at| {
            for k in 0..D {
                if at[k] == 0 {
                    continue;
                }
                let [a, b] = [i - strides[k], i].map(|i| self.component_of_sample[i]);
                for (part, other) in [(a, b), (b, a)] {
                    if part != other && absorbed[part as usize] {
                        *contacts.entry((part, other)).or_default() += 1;
                    }
                }
            }
        });
        let mut new_label: Vec<Option<u32>> = (self.components.iter().zip(&absorbed))
            .map(|(part, absorbed)| (!absorbed).then_some(part.label))
            .collect();
        loop {
            let mut best: BTreeMap<u32, (usize, u32)> = BTreeMap::new();
            for (&(part, other), &count) in &contacts {
                if let (None, Some(label)) = (new_label[part as usize], new_label[other as usize])
                    && best.get(&part).is_none_or(|(max, _)| *max < count)
                {
                    best.insert(part, (count, label));
                }
            }
            if best.is_empty() {
                break;
            }
            for (part, (_, label)) in best {
                new_label[part as usize] = Some(label);
            }
        }
        let mut absorbed_counts = [0; 2];
        for (part, label) in self.components.iter().zip(&new_label) {
            if label.is_some_and(|label| label != part.label) {
                absorbed_counts[0] += part.sample_count;
                absorbed_counts[1] += 1;
            }
        }
        for (label, &part) in label.iter_mut().zip(&self.component_of_sample) {
            *label = new_label[part as usize].unwrap_or(*label);
        }
        absorbed_counts
    }
}

impl<const D: usize> Component<D> {
    /// Returns `true` if the component touches a side of an image of `dims` samples.
    pub fn touches_side(&self, dims: [usize; D]) -> bool {
        (0..D).any(|k| self.min_corner[k] == 0 || self.max_corner[k] + 1 == dims[k])
    }

    /// Returns the radius of a ball (a disc in 2-D) of the same volume, if one sample has the
    /// volume `sample_volume`.
    pub fn radius(&self, sample_volume: f64) -> f64 {
        let volume = self.sample_count as f64 * sample_volume;
        match D {
            2 => (volume / std::f64::consts::PI).sqrt(),
            _ => (volume * 0.75 / std::f64::consts::PI).cbrt(),
        }
    }
}

/// Calls `visit` for each sample in the order of memory, with its index and coordinates.
pub fn for_each_sample<const D: usize>(dims: [usize; D], mut visit: impl FnMut(usize, [usize; D])) {
    let mut at = [0; D];
    for i in 0..dims.iter().product() {
        visit(i, at);
        for k in 0..D {
            at[k] += 1;
            if at[k] < dims[k] {
                break;
            }
            at[k] = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn components_are_counted_and_small_ones_are_absorbed() {
        #[rustfmt::skip]
        let mut label = [
            0, 0, 0, 1, 1,
            0, 2, 0, 1, 1,
            0, 2, 0, 1, 3,
            0, 0, 0, 1, 4,
        ];
        let parts = Components::from_labels([5, 4], &label);
        let sizes: Vec<_> = parts
            .components
            .iter()
            .map(|p| (p.label, p.sample_count))
            .collect();
        assert_eq!(sizes, [(0, 10), (1, 6), (2, 2), (3, 1), (4, 1)]);
        assert_eq!(
            (
                parts.components[2].min_corner,
                parts.components[2].max_corner
            ),
            ([1, 1], [1, 2])
        );
        assert!(
            parts.components[1].touches_side([5, 4]) && !parts.components[2].touches_side([5, 4])
        );
        let absorbed = parts.absorb(&mut label, |part| part.sample_count > 1);
        assert_eq!(absorbed, [2, 2]);
        assert_eq!(label[14], 1);
        assert_eq!(label[19], 1);
        assert_eq!(label[6], 2);
    }
}
