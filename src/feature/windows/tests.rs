use super::*;
use crate::comm::run_threads;
use crate::feature::scenes::Noise;
use crate::image::{Geometry, Image};

/// An image that gives its layers as if it were in a file.
pub struct LayeredImage<'a, const D: usize>(pub &'a Image<D>);

impl<const D: usize> ImageLayers<D> for LayeredImage<'_, D> {
    fn dims(&self) -> [usize; D] {
        self.0.dims()
    }

    fn geometry(&self) -> &Geometry<D> {
        &self.0.geometry
    }

    fn read_rows(&self, first: usize, rows: Range<usize>, out: &mut [f32]) -> Result<()> {
        let nx = self.dims()[0];
        let layers = self.0.as_slice().chunks(layer_len(self.dims())).skip(first);
        let out = out.chunks_exact_mut(rows.len() * nx);
        for (out, layer) in out.zip(layers) {
            out.copy_from_slice(&layer[rows.start * nx..rows.end * nx]);
        }
        Ok(())
    }

    fn load(&self) -> Result<Image<D>> {
        Ok(self.0.clone())
    }
}

/// How an image is looked at.
struct ReadMode {
    from_file: bool,
    limits: [usize; 2],
    /// Samples of a layer that a strip has, if it is looked at in strips.
    strip: Option<usize>,
}

/// All that windows show of an image: as it is, smoothed and blurred; and how many windows there are.
fn window_contents<const D: usize>(image: &Image<D>, way: &ReadMode) -> ([Vec<f32>; 3], usize) {
    let patience = &CancelToken::never();
    let by_layers = LayeredImage(image);
    let mut samples = match way.from_file {
        true => Samples::from_layers(&by_layers, -1.0),
        false => {
            let negated: Vec<f32> = image.as_slice().iter().map(|s| -s).collect();
            Samples::in_memory(image.dims(), negated)
        }
    }
    .with_limits(way.limits);
    if let Some(strip) = way.strip {
        samples = samples.with_strips(strip, usize::MAX);
    }
    samples.smooth(1.5, patience);
    samples.smooth(0.8, patience);
    let (dims, layer) = (image.dims(), layer_len(image.dims()));
    let (nx, count) = (dims[0], dims[D - 1]);
    let wanted = [&[][..], &[1.5, 0.8], &[0.8]].map(|scales| gaussian_of(image, scales));
    let mut next = [0; 2];
    let mut windows = 0;
    let work = &mut |window: &LayerWindow<'_, D>| {
        let WindowInterior {
            rows: own_rows,
            layers,
        } = &window.interior;
        assert_eq!(
            [own_rows.start, layers.start],
            next,
            "windows follow one another"
        );
        next[1] = layers.end;
        if layers.end == count {
            next = [own_rows.end, 0];
        }
        windows += 1;
        let stacks = [(window.raw, 20), (window.smoothed, 3), (window.blurred, 20)];
        let mut shown: Vec<Vec<f32>> = Vec::new();
        for ((stack, halo), wanted) in stacks.into_iter().zip(&wanted) {
            // What is in the halo is as right as what is the window's own.
            let near = WindowInterior {
                rows: widen(own_rows, halo, rows_per_layer(dims)),
                layers: widen(layers, halo, count),
            };
            assert_eq!(stack.origin[D - 1], near.layers.start);
            assert_eq!(stack.volume.dims[D - 1], near.layers.len());
            for (i, rows) in near.layers.clone().zip(stack.interior_rows(&near)) {
                let first = i * layer + near.rows.start * nx;
                assert!(rows == &wanted[first..first + rows.len()], "halo of {halo}");
            }
            shown.push(
                stack
                    .interior_rows(&window.interior)
                    .flatten()
                    .copied()
                    .collect(),
            );
        }
        let own = [own_rows.start, own_rows.end, layers.start, layers.end];
        (own, shown)
    };
    let all = &|_: &WindowInterior| 1;
    let mut shown = [(); 3].map(|()| vec![f32::NAN; image.as_slice().len()]);
    let take = &mut |([first_row, row, first, end], seen): ([usize; 4], Vec<Vec<f32>>)| {
        for (shown, values) in shown.iter_mut().zip(seen) {
            let each = (row - first_row) * nx;
            for (i, values) in (first..end).zip(values.chunks(each)) {
                let to = i * layer + first_row * nx;
                shown[to..to + each].copy_from_slice(values);
            }
        }
    };
    samples
        .for_each_window(3, Some((0.8, 20)), all, patience, work, take)
        .unwrap();
    assert_eq!(next, [rows_per_layer(dims), 0]);
    (shown, windows)
}

fn gaussian_of<const D: usize>(image: &Image<D>, scales: &[f64]) -> Vec<f32> {
    let mut samples: Vec<f32> = image.as_slice().iter().map(|s| -s).collect();
    for &scale in scales {
        let patience = &CancelToken::never();
        gaussian::smooth(image.dims(), &mut samples, [scale; D], patience);
    }
    samples
}

fn noise<const D: usize>(dims: [usize; D]) -> Image<D> {
    let mut noise = Noise::new(5);
    let samples = (0..dims.iter().product()).map(|_| noise.normal() as f32);
    Image::new(dims, samples.collect(), Geometry::default())
}

fn check_windows_match_whole<const D: usize>(dims: [usize; D], strip: Option<usize>) {
    let image = noise(dims);
    let count = image.as_slice().len();
    let way = |from_file, limits| ReadMode {
        from_file,
        limits,
        strip,
    };
    let (whole, windows) = window_contents(&image, &way(false, [count; 2]));
    assert_eq!(windows, 1);
    let scales = [&[][..], &[1.5, 0.8], &[0.8]];
    for (shown, scales) in whole.iter().zip(scales) {
        assert!(shown == &gaussian_of(&image, scales), "{scales:?}");
    }
    let (mut least, layer) = (2, layer_len(dims));
    for own in [64, 48] {
        for from_file in [false, true] {
            let (parts, windows) = window_contents(&image, &way(from_file, [0, own * layer]));
            assert!(parts == whole, "{own} {from_file}");
            assert!(windows > least, "{own}: {windows}");
        }
        least += usize::from(strip.is_some());
    }
}

#[test]
fn windows_show_what_the_whole_shows() {
    check_windows_match_whole([9, 11, 150], None);
    check_windows_match_whole([13, 170], None);
}

#[test]
fn strips_show_what_the_whole_shows() {
    // Of 96 rows at least, with a halo of 32.
    check_windows_match_whole([5, 250, 130], Some(5 * 96));
    check_windows_match_whole([13, 170], Some(1));
}

#[test]
fn what_is_changed_in_strips_is_what_is_changed_as_a_whole() {
    // Sums over a box of eleven samples: each depends on five rows and five layers to either side.
    fn neighbour_sums<const D: usize>(volume: Volume<'_, D>) -> Vec<f32> {
        let mut sums = volume.samples.to_vec();
        for k in 1..D {
            let before = Volume::new(volume.dims, &sums);
            let sum = |i: usize| {
                let at = before.coordinates(i);
                let along = at[k].saturating_sub(5)..(at[k] + 6).min(volume.dims[k]);
                along
                    .map(|to| {
                        let mut near = at;
                        near[k] = to;
                        before.samples[before.index(near)]
                    })
                    .sum()
            };
            sums = (0..sums.len()).map(sum).collect();
        }
        sums
    }
    let image = noise([6, 150, 140]);
    let by_layers = LayeredImage(&image);
    let patience = &CancelToken::never();
    for from_file in [false, true] {
        let mut seen = Vec::new();
        // As a whole; some layers; some layers of some rows.
        for (limits, most) in [
            ([usize::MAX, 1], usize::MAX),
            ([0, 1], usize::MAX),
            ([0, 1], 6 * 110 * 64),
        ] {
            let samples = match from_file {
                true => Samples::from_layers(&by_layers, 1.0),
                false => Samples::in_memory(image.dims(), image.as_slice()),
            };
            let mut samples = samples.with_limits(limits).with_strips(1, most);
            samples.smooth(1.0, patience);
            let windows = std::cell::Cell::new(0);
            let changed = samples.map_windows(5, patience, |stack| {
                windows.set(windows.get() + 1);
                neighbour_sums(stack.volume)
            });
            seen.push((changed.unwrap().as_slice().to_vec(), windows.get()));
        }
        let [(whole, one), (layers, some), (strips, many)] = &seen[..] else {
            unreachable!("three ways")
        };
        assert!(whole == layers && whole == strips, "{from_file}");
        assert!(
            *one <= *some && *some > 3 && many > some,
            "{one} {some} {many}"
        );
    }
}

#[test]
fn what_nobody_wants_is_not_shown() {
    let image = noise([8, 7, 80]);
    let samples = Samples::in_memory(image.dims(), image.as_slice()).with_limits([0, 1]);
    let mut shown = Vec::new();
    let wanted = &|own: &WindowInterior| usize::from(own.layers.contains(&40));
    let patience = &CancelToken::never();
    let look = &mut |window: &LayerWindow<'_, 3>| {
        [window.interior.layers.start, window.interior.layers.end]
    };
    let keep = &mut |own: [usize; 2]| shown.push(own);
    samples
        .for_each_window(2, None, wanted, patience, look, keep)
        .unwrap();
    assert_eq!(shown, [[32, 48]]);
}

#[test]
fn what_others_have_is_asked_of_them_by_strips() {
    let (dims, layer) = ([3, 40, 17], 3 * 40);
    let samples: Vec<f32> = (0..layer * 17).map(|i| i as f32).collect();
    // Three shares, of which one is of no layer.
    let shares = [0..9, 9..9, 9..17];
    for rows in [0..40, 8..20, 33..40] {
        let strip = Strip::new(dims, rows, 4);
        let wanted = [3..12, 0..17, 5..5];
        let seen = run_threads(3, |group| {
            let rank = group.rank();
            let range = shares[rank].clone();
            let own = LayerBuffer {
                samples: samples[range.start * layer..range.end * layer].to_vec(),
                range,
            };
            own.exchange_layers(wanted[rank].clone(), &strip, group)
                .unwrap()
        });
        for (seen, wanted) in seen.iter().zip(&wanted) {
            assert_eq!(seen.range, *wanted);
            let layers = &samples[wanted.start * layer..wanted.end * layer];
            assert!(
                seen.samples.iter().eq(strip.strip_rows(layers).flatten()),
                "{wanted:?}"
            );
        }
    }
}
