use super::*;
use crate::comm::run_threads;
use crate::feature::scenes::Noise;
use crate::image::{Geometry, Image};

/// An image that is read layer by layer, as if it were in a file.
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

/// How an image is read.
struct ReadMode {
    from_file: bool,
    limits: [usize; 2],
    /// Number of samples of a layer in a strip, if strips are used.
    strip: Option<usize>,
}

/// Returns the contents of all windows of an image: unsmoothed, smoothed and blurred samples; and
/// the number of windows.
fn window_contents<const D: usize>(image: &Image<D>, mode: &ReadMode) -> ([Vec<f32>; 3], usize) {
    let cancel = &CancelToken::never();
    let by_layers = LayeredImage(image);
    let mut samples = if mode.from_file {
        Samples::from_layers(&by_layers, -1.0)
    } else {
        let negated: Vec<f32> = image.as_slice().iter().map(|s| -s).collect();
        Samples::in_memory(image.dims(), negated)
    }
    .with_limits(mode.limits);
    if let Some(strip) = mode.strip {
        samples = samples.with_strips(strip, usize::MAX);
    }
    samples.smooth(1.5, cancel);
    samples.smooth(0.8, cancel);
    let (dims, layer) = (image.dims(), layer_len(image.dims()));
    let (nx, count) = (dims[0], dims[D - 1]);
    let expected = [&[][..], &[1.5, 0.8], &[0.8]].map(|scales| gaussian_of(image, scales));
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
        let mut contents: Vec<Vec<f32>> = Vec::new();
        for ((stack, halo), expected) in stacks.into_iter().zip(&expected) {
            assert_halo_matches(&stack, halo, &window.interior, dims, expected);
            let rows = stack.interior_rows(&window.interior);
            contents.push(rows.flatten().copied().collect());
        }
        let interior = [own_rows.start, own_rows.end, layers.start, layers.end];
        (interior, contents)
    };
    let every_window = &|_: &WindowInterior| 1;
    let mut contents = [(); 3].map(|()| vec![f32::NAN; image.as_slice().len()]);
    let take = &mut |([first_row, row, first, end], stacks): ([usize; 4], Vec<Vec<f32>>)| {
        for (content, values) in contents.iter_mut().zip(stacks) {
            let rows_len = (row - first_row) * nx;
            for (i, values) in (first..end).zip(values.chunks(rows_len)) {
                let target = i * layer + first_row * nx;
                content[target..target + rows_len].copy_from_slice(values);
            }
        }
    };
    samples
        .for_each_window(3, Some((0.8, 20)), every_window, cancel, work, take)
        .unwrap();
    assert_eq!(next, [rows_per_layer(dims), 0]);
    (contents, windows)
}

/// Checks that the samples of a stack are those `expected` of an image of dimensions `dims`, in the
/// interior of its window and in a halo of `halo` rows and layers.
fn assert_halo_matches<const D: usize>(
    stack: &LayerStack<'_, D>,
    halo: usize,
    interior: &WindowInterior,
    dims: [usize; D],
    expected: &[f32],
) {
    let with_halo = WindowInterior {
        rows: widen(&interior.rows, halo, rows_per_layer(dims)),
        layers: widen(&interior.layers, halo, dims[D - 1]),
    };
    assert_eq!(stack.origin[D - 1], with_halo.layers.start);
    assert_eq!(stack.volume.dims[D - 1], with_halo.layers.len());
    let layers = with_halo.layers.clone();
    for (i, rows) in layers.zip(stack.interior_rows(&with_halo)) {
        let first = i * layer_len(dims) + with_halo.rows.start * dims[0];
        assert!(
            rows == &expected[first..first + rows.len()],
            "halo of {halo}"
        );
    }
}

fn gaussian_of<const D: usize>(image: &Image<D>, scales: &[f64]) -> Vec<f32> {
    let mut samples: Vec<f32> = image.as_slice().iter().map(|s| -s).collect();
    for &scale in scales {
        let cancel = &CancelToken::never();
        gaussian::smooth(image.dims(), &mut samples, [scale; D], cancel);
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
    let mode = |from_file, limits| ReadMode {
        from_file,
        limits,
        strip,
    };
    let (whole, windows) = window_contents(&image, &mode(false, [count; 2]));
    assert_eq!(windows, 1);
    let scales = [&[][..], &[1.5, 0.8], &[0.8]];
    for (content, scales) in whole.iter().zip(scales) {
        assert!(content == &gaussian_of(&image, scales), "{scales:?}");
    }
    let (mut min_windows, layer) = (2, layer_len(dims));
    for window_layers in [64, 48] {
        for from_file in [false, true] {
            let (parts, windows) =
                window_contents(&image, &mode(from_file, [0, window_layers * layer]));
            assert!(parts == whole, "{window_layers} {from_file}");
            assert!(windows > min_windows, "{window_layers}: {windows}");
        }
        min_windows += usize::from(strip.is_some());
    }
}

#[test]
fn windows_show_what_the_whole_shows() {
    check_windows_match_whole([9, 11, 150], None);
    check_windows_match_whole([13, 170], None);
}

#[test]
fn strips_show_what_the_whole_shows() {
    // At least 96 rows, with a halo of 32.
    check_windows_match_whole([5, 250, 130], Some(5 * 96));
    check_windows_match_whole([13, 170], Some(1));
}

#[test]
fn mapping_in_strips_matches_mapping_the_whole() {
    // Sums over a box of eleven samples: each depends on five rows and five layers to either side.
    fn neighbour_sums<const D: usize>(volume: Volume<'_, D>) -> Vec<f32> {
        let mut sums = volume.samples.to_vec();
        for k in 1..D {
            let before = Volume::new(volume.dims, &sums);
            let sum = |i: usize| {
                let at = before.coordinates(i);
                let range = at[k].saturating_sub(5)..(at[k] + 6).min(volume.dims[k]);
                range
                    .map(|coordinate| {
                        let mut neighbour = at;
                        neighbour[k] = coordinate;
                        before.samples[before.index(neighbour)]
                    })
                    .sum()
            };
            sums = (0..sums.len()).map(sum).collect();
        }
        sums
    }
    let image = noise([6, 150, 140]);
    let by_layers = LayeredImage(&image);
    let cancel = &CancelToken::never();
    for from_file in [false, true] {
        let mut results = Vec::new();
        // As a whole; some layers; some layers of some rows.
        for (limits, max_with_halo) in [
            ([usize::MAX, 1], usize::MAX),
            ([0, 1], usize::MAX),
            ([0, 1], 6 * 110 * 64),
        ] {
            let samples = if from_file {
                Samples::from_layers(&by_layers, 1.0)
            } else {
                Samples::in_memory(image.dims(), image.as_slice())
            };
            let mut samples = samples.with_limits(limits).with_strips(1, max_with_halo);
            samples.smooth(1.0, cancel);
            let windows = std::cell::Cell::new(0);
            let changed = samples.map_windows(5, cancel, |stack| {
                windows.set(windows.get() + 1);
                neighbour_sums(stack.volume)
            });
            results.push((changed.unwrap().as_slice().to_vec(), windows.get()));
        }
        let [(whole, one), (layers, some), (strips, many)] = &results[..] else {
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
fn windows_without_work_are_skipped() {
    let image = noise([8, 7, 80]);
    let samples = Samples::in_memory(image.dims(), image.as_slice()).with_limits([0, 1]);
    let mut shown = Vec::new();
    let work_of = &|interior: &WindowInterior| usize::from(interior.layers.contains(&40));
    let cancel = &CancelToken::never();
    let range_of = &mut |window: &LayerWindow<'_, 3>| {
        [window.interior.layers.start, window.interior.layers.end]
    };
    let take = &mut |range: [usize; 2]| shown.push(range);
    samples
        .for_each_window(2, None, work_of, cancel, range_of, take)
        .unwrap();
    assert_eq!(shown, [[32, 48]]);
}

#[test]
fn strips_are_exchanged_between_ranks() {
    let (dims, layer) = ([3, 40, 17], 3 * 40);
    let samples: Vec<f32> = (0..layer * 17).map(|i| i as f32).collect();
    // Three shares, one of which is empty.
    let shares = [0..9, 9..9, 9..17];
    for rows in [0..40, 8..20, 33..40] {
        let strip = Strip::new(dims, rows, 4);
        let requested = [3..12, 0..17, 5..5];
        let received = run_threads(3, |comm| {
            let rank = comm.rank();
            let rows_of = |layers: Range<usize>| {
                strip.strip_rows(&samples[layers.start * layer..layers.end * layer])
            };
            SharedGrid::new(dims, comm)
                .fetch_layers(&shares[rank], &requested[rank], rows_of)
                .unwrap()
        });
        for (received, requested) in received.iter().zip(&requested) {
            let layers = &samples[requested.start * layer..requested.end * layer];
            assert!(
                received.iter().eq(strip.strip_rows(layers).flatten()),
                "{requested:?}"
            );
        }
    }
}
