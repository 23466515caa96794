//! The connected parts of the labels of an image: their boundaries, which parts are neighbours, and the
//! Euler numbers of their surfaces.
//!
//! The Euler number of a part is a sum over the blocks of `2^D` samples around each vertex between samples
//! (also round those outside the image, so that the part ends at the sides of the box). A block's
//! contribution depends only on which of its samples belong to the part. There are two of them: samples
//! that touch at an edge or a corner only are connected (26 neighbours), or they are not (6 neighbours).
//! The difference is not zero where a part touches itself at an edge or a corner, and there a mesh may go
//! either way. (Ohser, Nagel, Schladitz: The Euler number of discretized sets, 2002.)

use crate::feature::components::Components;
use crate::feature::label_map;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::grid_index::{index_at, strides};
use crate::geometry::union_find::UnionFind;
use crate::geometry::{NONE, sorted_distinct};
use crate::parallel::prelude::*;

/// Number of rows of vertices, or of samples, in one task.
const ROWS_PER_TASK: usize = 64;

/// A face between two samples of different parts, seen from one of these.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VoxelFace {
    /// Index of the sample inside the part.
    pub sample: u32,
    /// Axis of the face's normal.
    pub axis: u8,
    /// `true` if the part lies below the face along the axis.
    pub is_upper: bool,
}

/// Euler number of a part, and its contacts with itself.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct EulerRange {
    /// Smallest and largest Euler number, as contacts at edges and corners go one way or the other.
    pub bounds: [i64; 2],
    /// Number of vertices at which the part touches itself at an edge or a corner only.
    pub contacts: usize,
}

/// The connected parts of the labels of an image.
pub struct VoxelParts<'a, const D: usize> {
    /// The parts.
    pub components: &'a Components<D>,
    /// Index of the label of each sample.
    pub labels: &'a [u32],
    /// Number of samples inside the box for each part: samples on a side of the box count by half.
    pub volumes: Vec<f64>,
    /// Euler numbers.
    pub euler: Vec<EulerRange>,
    /// Faces between labels, sorted by part: those of part p are `face_start[p]..face_start[p + 1]`.
    pub faces: Vec<VoxelFace>,
    /// First face of each part.
    pub face_start: Vec<u32>,
    /// Pairs of parts that are neighbours in one of the 26 directions (8 in 2-D), the smaller first,
    /// ascending.
    neighbours: Vec<[u32; 2]>,
}

/// Findings of one task about blocks. Contributions to Euler numbers are in units of `1 / 2^D`.
#[derive(Default)]
struct BlockSurvey {
    /// Parts with contributions to their Euler numbers if all contacts are connections.
    connected: Vec<(u32, i64)>,
    contacts: Vec<Contact>,
    /// Pairs of parts that are neighbours.
    pairs: Vec<[u32; 2]>,
}

/// A vertex at which a part touches itself at an edge or a corner only.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Contact {
    part: u32,
    vertex: u64,
    /// Change of the Euler number if it is no connection, in units of `1 / 2^D`.
    change: i64,
}

impl<'a, const D: usize> VoxelParts<'a, D> {
    /// Measures the parts of an image, given the index of the label of each sample.
    pub fn new(components: &'a Components<D>, labels: &'a [u32]) -> Self {
        let (dims, part_count) = (components.dims, components.components.len());
        let parts = &components.component_of_sample;
        let volumes = label_map::volumes(dims, [1.0; D], parts, part_count);
        let (euler, neighbours) = survey_blocks(dims, parts, part_count);
        let faces = faces_between(dims, labels);
        let part_of_face = faces
            .iter()
            .map(|face| parts[face.sample as usize] as usize);
        let (face_start, order) = sort_by_group(part_count, part_of_face);
        Self {
            components,
            labels,
            volumes,
            euler,
            faces: order.iter().map(|&f| faces[f as usize]).collect(),
            face_start,
            neighbours,
        }
    }

    /// Returns `true` if two parts are neighbours in one of the 26 directions (8 in 2-D).
    pub fn are_neighbours(&self, a: u32, b: u32) -> bool {
        let pair = [a.min(b), a.max(b)];
        self.neighbours.binary_search(&pair).is_ok()
    }

    /// Returns the pairs of parts that are neighbours.
    pub fn neighbours(&self) -> &[[u32; 2]] {
        &self.neighbours
    }

    /// Returns the faces of a part.
    pub fn faces_of(&self, part: u32) -> &[VoxelFace] {
        let [begin, end] = [part, part + 1].map(|p| self.face_start[p as usize] as usize);
        &self.faces[begin..end]
    }

    /// Returns the label of a part.
    pub fn label_of(&self, part: u32) -> u32 {
        self.components.components[part as usize].label
    }

    /// Returns the centre of a face, in index space.
    #[inline]
    pub fn centre(&self, face: VoxelFace) -> [f64; D] {
        let at = index_at(self.components.dims, face.sample as usize);
        let mut centre = at.map(|i| i as f64);
        centre[face.axis as usize] += if face.is_upper { 0.5 } else { -0.5 };
        centre
    }

    /// Returns the index of the sample nearest to a position, `None` outside the image.
    #[inline]
    pub fn sample_at(&self, x: [f64; D]) -> Option<usize> {
        let (mut sample, mut stride) = (0, 1);
        for k in 0..D {
            let i = x[k].round();
            if i < 0.0 || i >= self.components.dims[k] as f64 {
                return None;
            }
            sample += i as usize * stride;
            stride *= self.components.dims[k];
        }
        Some(sample)
    }

    /// Returns the part of a sample.
    #[inline]
    pub fn part_at(&self, sample: usize) -> u32 {
        self.components.component_of_sample[sample]
    }

    /// Returns the distance from a position to the boundary of a label between samples, at most
    /// [`MAX_BOUNDARY_DISTANCE`].
    pub fn boundary_distance(&self, x: [f64; D], label: u32) -> f64 {
        let dims = self.components.dims;
        let strides = strides(dims);
        let base: [i64; D] =
            std::array::from_fn(|k| (x[k].round() as i64).clamp(0, dims[k] as i64 - 1));
        // The position may lie up to half a sample from the nearest one, or more outside the box.
        let offset = (0..D)
            .map(|k| (x[k] - base[k] as f64).abs())
            .fold(0.0, f64::max);
        let mut square = MAX_BOUNDARY_DISTANCE * MAX_BOUNDARY_DISTANCE;
        for radius in 0i64.. {
            // Faces of samples in this shell are at least this far away.
            let least = radius as f64 - 0.5 - offset;
            if least > 0.0 && least * least >= square {
                break;
            }
            self.visit_shell(base, radius, |at| {
                let sample: usize = (0..D).map(|k| at[k] as usize * strides[k]).sum();
                if self.labels[sample] != label {
                    return;
                }
                for k in 0..D {
                    for step in [-1i64, 1] {
                        let beyond = at[k] + step;
                        if beyond < 0 || beyond >= dims[k] as i64 {
                            continue;
                        }
                        let other = (sample as i64 + step * strides[k] as i64) as usize;
                        if self.labels[other] == label {
                            continue;
                        }
                        let mut sum = 0.0;
                        for j in 0..D {
                            let gap = x[j] - at[j] as f64;
                            let gap = if j == k {
                                gap - 0.5 * step as f64
                            } else {
                                (gap.abs() - 0.5).max(0.0)
                            };
                            sum += gap * gap;
                        }
                        square = square.min(sum);
                    }
                }
            });
        }
        square.sqrt()
    }

    /// Visits the samples of the image at a distance of `radius`, the largest along all axes.
    fn visit_shell(&self, base: [i64; D], radius: i64, mut visit: impl FnMut([i64; D])) {
        let dims = self.components.dims;
        let low: [i64; D] = std::array::from_fn(|k| (base[k] - radius).max(0));
        let high: [i64; D] = std::array::from_fn(|k| (base[k] + radius).min(dims[k] as i64 - 1));
        let mut at = low;
        'samples: loop {
            // Along x, only the two ends are in the shell, unless another axis is at an end.
            let is_at_end = (1..D).any(|k| (at[k] - base[k]).abs() == radius);
            if is_at_end {
                for x in low[0]..=high[0] {
                    at[0] = x;
                    visit(at);
                }
            } else {
                let ends = [base[0] - radius, base[0] + radius];
                let count = if radius == 0 { 1 } else { 2 };
                for &x in &ends[..count] {
                    if (low[0]..=high[0]).contains(&x) {
                        at[0] = x;
                        visit(at);
                    }
                }
            }
            for k in 1..D {
                at[k] += 1;
                if at[k] <= high[k] {
                    continue 'samples;
                }
                at[k] = low[k];
            }
            break;
        }
    }
}

/// Largest distance from the voxels' boundary that is measured, in samples.
pub const MAX_BOUNDARY_DISTANCE: f64 = 24.0;

/// Returns the faces between samples of different labels, from both sides, in the order of samples.
fn faces_between<const D: usize>(dims: [usize; D], labels: &[u32]) -> Vec<VoxelFace> {
    let strides = strides(dims);
    let row = dims[0].max(1);
    let task = row * ROWS_PER_TASK;
    let faces_in = |(number, samples): (usize, &[u32])| {
        let mut faces = Vec::new();
        for (place, &label) in samples.iter().enumerate() {
            let sample = number * task + place;
            let at = index_at(dims, sample);
            for k in 0..D {
                let is_other = |other: usize| labels[other] != label;
                let (sample, axis) = (sample as u32, k as u8);
                if at[k] > 0 && is_other(sample as usize - strides[k]) {
                    faces.push(VoxelFace {
                        sample,
                        axis,
                        is_upper: false,
                    });
                }
                if at[k] + 1 < dims[k] && is_other(sample as usize + strides[k]) {
                    faces.push(VoxelFace {
                        sample,
                        axis,
                        is_upper: true,
                    });
                }
            }
        }
        faces
    };
    let faces: Vec<Vec<VoxelFace>> = labels.par_chunks(task).enumerate().map(faces_in).collect();
    faces.into_iter().flatten().collect()
}

/// Returns the contributions of a block to the Euler number, in units of `1 / 2^D`, for each set of its
/// samples that belong to a part: bit i for sample i. With `connected`, samples that touch at an edge or
/// a corner are connected.
fn block_contributions<const D: usize>(connected: bool) -> Vec<i64> {
    let contribution = |pattern: usize| {
        let mut sum = 0;
        // Each element of the block (vertex, edge, face, voxel) has a direction along each axis: 0 if it
        // is not extended along it, or 1 or 2 if it goes down or up.
        for element in 0..3usize.pow(D as u32) {
            let direction = |k: usize| element / 3usize.pow(k as u32) % 3;
            let extended = (0..D).filter(|&k| direction(k) > 0).count();
            let touches = |sample: usize| {
                (0..D).all(|k| direction(k) == 0 || direction(k) - 1 == sample >> k & 1)
            };
            let mut samples = (0..1 << D).filter(|&s| touches(s));
            let is_in_part = |s: usize| pattern >> s & 1 == 1;
            // An element belongs to 2^extended blocks.
            let weight = 1i64 << (D - extended);
            let (counts, dimension) = if connected {
                (samples.any(is_in_part), extended)
            } else {
                // The dual element joins the samples round this one.
                (samples.all(is_in_part), D - extended)
            };
            if counts {
                sum += if dimension % 2 == 0 { weight } else { -weight };
            }
        }
        sum
    };
    (0..1 << (1 << D)).map(contribution).collect()
}

/// Returns the Euler numbers of the parts, and the pairs of parts that are neighbours.
fn survey_blocks<const D: usize>(
    dims: [usize; D],
    parts: &[u32],
    part_count: usize,
) -> (Vec<EulerRange>, Vec<[u32; 2]>) {
    let tables = [true, false].map(block_contributions::<D>);
    let strides = strides(dims);
    let vertices = dims.map(|n| n + 1);
    let row_count: usize = vertices[1..].iter().product();
    let survey = |task: usize| {
        let mut survey = BlockSurvey::default();
        for row in task * ROWS_PER_TASK..row_count.min((task + 1) * ROWS_PER_TASK) {
            let first = index_at(vertices, row * vertices[0]);
            for x in 0..vertices[0] {
                let mut block = [NONE; 8];
                for (s, part) in block[..1 << D].iter_mut().enumerate() {
                    let mut sample = Some(0);
                    for k in 0..D {
                        let i = (if k == 0 { x } else { first[k] }) + (s >> k & 1);
                        let is_inside = (1..=dims[k]).contains(&i);
                        sample = sample
                            .filter(|_| is_inside)
                            .map(|sum| sum + (i - 1) * strides[k]);
                    }
                    *part = sample.map_or(NONE, |sample| parts[sample]);
                }
                let block = &block[..1 << D];
                if block.iter().any(|part| *part != block[0]) {
                    survey.add_block(block, (row * vertices[0] + x) as u64, &tables);
                }
            }
        }
        survey.pairs = sorted_distinct(std::mem::take(&mut survey.pairs));
        survey.connected.sort_unstable();
        survey.connected.dedup_by(|next, sum| {
            let is_same = next.0 == sum.0;
            sum.1 += if is_same { next.1 } else { 0 };
            is_same
        });
        survey
    };
    let tasks = (0..row_count.div_ceil(ROWS_PER_TASK)).into_par_iter();
    let found: Vec<BlockSurvey> = tasks.map(survey).collect();
    let (mut connected, mut contacts, mut neighbours) =
        (vec![0; part_count], Vec::new(), Vec::new());
    for survey in found {
        for (part, sum) in survey.connected {
            connected[part as usize] += sum;
        }
        contacts.extend(survey.contacts);
        neighbours.extend(survey.pairs);
    }
    contacts.sort_unstable();
    let mut euler: Vec<EulerRange> = connected
        .into_iter()
        .map(|sum: i64| EulerRange {
            bounds: [sum >> D; 2],
            contacts: 0,
        })
        .collect();
    widen_by_contacts::<D>(
        &contacts,
        crate::geometry::grid_index::strides(vertices),
        &mut euler,
    );
    (euler, sorted_distinct(neighbours))
}

/// Extends the ranges of Euler numbers by contacts, which may be connections or not. Contacts next to each
/// other are one.
fn widen_by_contacts<const D: usize>(
    contacts: &[Contact],
    strides: [usize; D],
    euler: &mut [EulerRange],
) {
    let mut groups = UnionFind::new(contacts.len());
    for (i, contact) in contacts.iter().enumerate() {
        euler[contact.part as usize].contacts += 1;
        for stride in strides {
            let next = (contact.part, contact.vertex + stride as u64);
            if let Ok(j) = contacts.binary_search_by_key(&next, |c| (c.part, c.vertex)) {
                groups.unite(i as u32, j as u32);
            }
        }
    }
    let (group_of, count) = groups.into_labels();
    let mut changes = vec![0; count];
    let mut part_of = vec![0; count];
    for (contact, &group) in contacts.iter().zip(&group_of) {
        changes[group as usize] += contact.change;
        part_of[group as usize] = contact.part;
    }
    for (part, change) in part_of.into_iter().zip(changes) {
        let change: i64 = change;
        let bounds = &mut euler[part as usize].bounds;
        bounds[0] += change.min(0).div_euclid(1 << D);
        bounds[1] -= (-change.max(0)).div_euclid(1 << D);
    }
}

impl BlockSurvey {
    /// Adds the contributions of a block to each of its parts, and the pairs of its parts.
    fn add_block(&mut self, block: &[u32], vertex: u64, [connected, separate]: &[Vec<i64>; 2]) {
        for (s, &part) in block.iter().enumerate() {
            if part == NONE || block[..s].contains(&part) {
                continue;
            }
            let is_in_part = |(t, other): (usize, &u32)| usize::from(*other == part) << t;
            let pattern: usize = block.iter().enumerate().map(is_in_part).sum();
            match self.connected.last_mut() {
                Some(last) if last.0 == part => last.1 += connected[pattern],
                _ => self.connected.push((part, connected[pattern])),
            }
            let change = separate[pattern] - connected[pattern];
            // Along an edge at which a part touches itself, only the ends change the number.
            if change != 0 || touches_at_edge(block, part) {
                self.contacts.push(Contact {
                    part,
                    vertex,
                    change,
                });
            }
            for &other in &block[s + 1..] {
                if other != NONE && other != part {
                    let pair = [part.min(other), part.max(other)];
                    if self.pairs.last() != Some(&pair) {
                        self.pairs.push(pair);
                    }
                }
            }
        }
    }
}

/// Returns `true` if two samples of a part in a block touch at an edge, and none that touches both at a
/// face is of the part.
fn touches_at_edge(block: &[u32], part: u32) -> bool {
    (0..block.len()).any(|s| {
        block[s] == part
            && (0..s).any(|t| {
                let different = s ^ t;
                let bits = different.count_ones();
                block[t] == part && bits == 2 && {
                    let bit = 1 << different.trailing_zeros();
                    block[s ^ bit] != part && block[t ^ bit] != part
                }
            })
    })
}
