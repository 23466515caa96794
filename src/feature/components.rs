//! Connected parts of labels: samples of one label that touch face to face.

use super::volume::Volume;
use crate::geometry::union_find::UnionFind;
use std::collections::BTreeMap;

/// One connected part of a label.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Component<const D: usize> {
    /// The number of its label.
    pub label: u32,
    /// How many samples it has.
    pub sample_count: usize,
    /// The first of them in memory.
    pub first_sample: usize,
    /// The corner of its bounding box nearest to the origin.
    pub min_corner: [usize; D],
    /// The opposite corner, itself in the box.
    pub max_corner: [usize; D],
}

/// All connected parts of all labels.
#[derive(Debug, Clone)]
pub struct Components<const D: usize> {
    /// Number of samples along each axis.
    pub dims: [usize; D],
    /// For each sample the number of its component.
    pub component_of_sample: Vec<u32>,
    /// The components in the order of their first samples.
    pub components: Vec<Component<D>>,
}

impl<const D: usize> Components<D> {
    /// Those of an image of which each sample has the number of its label.
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
                // A set is named by its first sample, and sets are numbered in this order.
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

    /// Gives the components that are not to be kept the label of what they touch most; those that touch
    /// only others of their kind follow these. Says how many samples of how many components went.
    pub fn absorb(&self, label: &mut [u32], keep: impl Fn(&Component<D>) -> bool) -> [usize; 2] {
        let goes: Vec<bool> = self.components.iter().map(|part| !keep(part)).collect();
        if !goes.contains(&true) {
            return [0; 2];
        }
        let strides = Volume::new(self.dims, &[]).strides();
        let mut touching: BTreeMap<(u32, u32), usize> = BTreeMap::new();
        for_each_sample(self.dims, |i, at| {
            for k in 0..D {
                if at[k] == 0 {
                    continue;
                }
                let [a, b] = [i - strides[k], i].map(|i| self.component_of_sample[i]);
                for (part, other) in [(a, b), (b, a)] {
                    if part != other && goes[part as usize] {
                        *touching.entry((part, other)).or_default() += 1;
                    }
                }
            }
        });
        let mut into: Vec<Option<u32>> = (self.components.iter().zip(&goes))
            .map(|(part, goes)| (!goes).then_some(part.label))
            .collect();
        loop {
            let mut best: BTreeMap<u32, (usize, u32)> = BTreeMap::new();
            for (&(part, other), &count) in &touching {
                if let (None, Some(label)) = (into[part as usize], into[other as usize])
                    && best.get(&part).is_none_or(|(most, _)| *most < count)
                {
                    best.insert(part, (count, label));
                }
            }
            if best.is_empty() {
                break;
            }
            for (part, (_, label)) in best {
                into[part as usize] = Some(label);
            }
        }
        let mut gone = [0; 2];
        for (part, into) in self.components.iter().zip(&into) {
            if into.is_some_and(|into| into != part.label) {
                gone[0] += part.sample_count;
                gone[1] += 1;
            }
        }
        for (label, &part) in label.iter_mut().zip(&self.component_of_sample) {
            *label = into[part as usize].unwrap_or(*label);
        }
        gone
    }
}

impl<const D: usize> Component<D> {
    /// Whether it touches a side of an image of `dims` samples.
    pub fn touches_side(&self, dims: [usize; D]) -> bool {
        (0..D).any(|k| self.min_corner[k] == 0 || self.max_corner[k] + 1 == dims[k])
    }

    /// The radius of a ball (in the plane: a disc) of the same volume, where a sample has the volume
    /// `sample`.
    pub fn radius(&self, sample: f64) -> f64 {
        let volume = self.sample_count as f64 * sample;
        match D {
            2 => (volume / std::f64::consts::PI).sqrt(),
            _ => (volume * 0.75 / std::f64::consts::PI).cbrt(),
        }
    }
}

/// Visits samples in the order of memory, with their coordinates.
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
    fn parts_are_counted_and_small_ones_go_to_what_they_touch() {
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
        let gone = parts.absorb(&mut label, |part| part.sample_count > 1);
        assert_eq!(gone, [2, 2]);
        assert_eq!(label[14], 1);
        assert_eq!(label[19], 1);
        assert_eq!(label[6], 2);
    }
}
