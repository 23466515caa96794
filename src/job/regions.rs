//! The regions of a mesh of labels: which cells have which label, faces where labels change, and what
//! became of each connected part.

use rayon::prelude::*;

use super::{Marked, Scene};
use crate::feature::labelled::{Labelled, components};
use crate::feature::volume::Volume;
use crate::feature::{LabelWish, labelled};
use crate::image::Image;
use crate::improve::regions::{self, Fitting, Places};
use crate::mesh::Simplices;
use crate::observer::Patience;
use crate::report::{Lost, Region, Regions};

/// A part of a label of which the cells with its label hold less than this share is lost.
const HELD: f64 = 0.25;

/// Gives the cells of simplices their regions, and fits the faces between them; gives the number of each
/// cell's label.
pub(super) fn of_simplices<const D: usize, M: Simplices<D>>(
    made: &mut Marked<M>,
    neighbors: &[u32],
    scene: &Scene<'_, D>,
    labelled: &Labelled<D>,
    min_angle: Option<f64>,
    patience: &Patience<'_>,
) -> Vec<u8> {
    let regions = Places::of_simplices(&made.mesh).labels(labelled);
    if let Some(min_angle) = min_angle {
        let fitting = Fitting {
            labelled,
            regions: &regions,
            neighbors,
            kinds: &made.kinds,
            extent: scene.extent,
            min_angle,
        };
        regions::fit(&mut made.mesh, &fitting, patience);
        made.feature_faces = regions::marks::<D>(&regions, neighbors);
    }
    made.regions = of_labels(&regions, &labelled.labels);
    regions
}

/// The region of each cell: the value of its label, where all values are whole numbers, else its number.
pub(super) fn of_labels(numbers: &[u8], labels: &[f32]) -> Vec<i32> {
    let region = region_of(labels);
    numbers.iter().map(|&n| region(n as usize)).collect()
}

fn region_of(labels: &[f32]) -> impl Fn(usize) -> i32 + '_ {
    let whole = labels.iter().all(|l| l.fract() == 0.0 && l.abs() < 1e9);
    move |n| if whole { labels[n] as i32 } else { n as i32 }
}

/// What came of the labels of an image: `places` are those of the cells, whose volumes are `sizes` and whose
/// labels have `numbers`. `None` if they are too many, or `patience` does not last.
pub(super) fn report<const D: usize>(
    image: &Image<D>,
    wishes: &[LabelWish],
    places: &Places<'_, D>,
    sizes: &[f64],
    numbers: &[u8],
    step: [f64; D],
    patience: &Patience<'_>,
) -> Option<Regions> {
    let (labels, of_sample, parts) = components(image)?;
    if patience.over() {
        return None;
    }
    let dims = image.dims();
    let volume = Volume::new(dims, &[]);
    let world = image.geometry.determinant().abs() / step.iter().product::<f64>();
    // Of each cell, how many of its places lie in which part of its own label.
    let held: Vec<Vec<(u32, f64)>> = (0..numbers.len())
        .into_par_iter()
        .map(|c| {
            let (mut found, mut count) = (Vec::new(), 0.0f64);
            places.each(c, |x| {
                let at = std::array::from_fn(|k| {
                    ((x[k] / step[k]).round().max(0.0) as usize).min(dims[k] - 1)
                });
                let i = volume.index(at);
                count += 1.0;
                if of_sample[i] == numbers[c] {
                    let part = parts.of_sample[i];
                    match found.iter_mut().find(|(known, _)| *known == part) {
                        Some((_, sum)) => *sum += 1.0,
                        None => found.push((part, 1.0)),
                    }
                }
            });
            found.iter_mut().for_each(|(_, sum)| *sum *= sizes[c] / count);
            found
        })
        .collect();
    let mut inside = vec![0.0; parts.all.len()];
    for &(part, volume) in held.iter().flatten() {
        inside[part as usize] += volume;
    }
    let sample: f64 = step.iter().product();
    let samples = labelled::volumes(dims, step, &of_sample, labels.len());
    let region = region_of(&labels);
    let name = |n: usize| {
        let wish = wishes.iter().find(|wish| wish.label == labels[n]);
        wish.and_then(|wish| wish.name.clone())
    };
    let mut all: Vec<Region> = (0..labels.len())
        .map(|n| Region {
            label: f64::from(labels[n]),
            region: region(n),
            name: name(n),
            parts: 0,
            cells: 0,
            volume: 0.0,
            volume_of_samples: samples[n] * world,
            off_percent: 0.0,
        })
        .collect();
    for (&n, size) in numbers.iter().zip(sizes) {
        all[n as usize].cells += 1;
        all[n as usize].volume += size * world;
    }
    for region in &mut all {
        region.off_percent = 100.0 * (region.volume / region.volume_of_samples - 1.0);
    }
    let mut lost: Vec<Lost> = Vec::new();
    for (part, inside) in parts.all.iter().zip(&inside) {
        let n = part.label as usize;
        all[n].parts += 1;
        let size = part.samples as f64 * sample;
        if *inside >= HELD * size {
            continue;
        }
        let at = volume.coordinates(part.first);
        let new = Lost {
            label: f64::from(labels[n]),
            name: name(n),
            parts: 1,
            samples: part.samples,
            largest: part.samples,
            at: image.geometry.to_physical(at.map(|i| i as f64)).to_vec(),
            distance: keeping(size, D),
        };
        match lost.iter_mut().find(|known| known.label == new.label) {
            Some(known) => {
                known.parts += 1;
                known.samples += new.samples;
                if new.largest > known.largest {
                    (known.largest, known.at, known.distance) = (new.largest, new.at, new.distance);
                }
            }
            None => lost.push(new),
        }
    }
    Some(Regions { regions: all, lost })
}

/// A distance between atoms at which a part of this volume is kept: about half its width, in two digits.
fn keeping(volume: f64, dimensions: usize) -> f64 {
    let d = 0.55 * volume.powf(1.0 / dimensions as f64);
    let digit = 10f64.powf(d.log10().floor() - 1.0);
    (d / digit).floor() * digit
}
