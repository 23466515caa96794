//! Tests with built files: every format, trace order and header fault.

use proptest::prelude::*;

use super::super::file_header::FILE_HEADER_BYTES;
use super::*;
use crate::image::formats::segy;

#[test]
fn every_sample_format_in_both_byte_orders() {
    for little in [false, true] {
        for format in [1, 2, 3, 5, 6, 7, 8, 9] {
            let loaded = SegyBuilder {
                is_little_endian: little,
                format,
                ..survey()
            }
            .read()
            .unwrap();
            assert_values(&loaded.image);
        }
        for (format, wrap) in [
            (10, 2f64.powi(32)),
            (11, 65536.0),
            (15, 2f64.powi(24)),
            (16, 256.0),
        ] {
            let image = SegyBuilder {
                is_little_endian: little,
                format,
                ..survey()
            }
            .read()
            .unwrap()
            .image;
            let v = sample_value(0, 0, 0);
            assert_eq!(image.as_slice()[0], (v + wrap) as f32, "format {format}");
            assert_eq!(f64::from(image.samples[[1, 2, 5]]), sample_value(1, 2, 5));
        }
    }
    let message = SegyBuilder {
        format: 4,
        ..survey()
    }
    .error_message();
    assert!(message.contains("sample format 4"), "{message}");
    let message = SegyBuilder {
        format: 0,
        ..survey()
    }
    .error_message();
    assert!(message.contains("sample format 0"), "{message}");
}

#[test]
fn geometry_of_a_rotated_survey() {
    let loaded = survey().read().unwrap();
    let geometry = &loaded.image.geometry;
    assert_eq!(geometry.names, ["sample", "crossline", "inline"]);
    assert_eq!(geometry.units, ["m", "m", "ms"]);
    for (i, c, k) in [(0, 0, 0), (3, 2, 5), (1, 2, 0)] {
        let position = geometry.to_physical([k as f64, c as f64, i as f64]);
        let [x, y] = trace_position(i, c);
        // Coordinates are rounded to centimetres.
        assert!(
            (position[0] - x).abs() < 0.01 && (position[1] - y).abs() < 0.01,
            "{position:?}"
        );
        assert_eq!(position[2], -(48.0 + 4.0 * k as f64));
    }
    let fit = loaded.survey.unwrap().fit.unwrap();
    assert!(fit.max < 0.01 && fit.rms > 0.0);
    // Down, then to the left of the inlines, then along them: a right-handed system.
    assert!((geometry.determinant() - 4.0 * 12.5 * 25.0).abs() < 1.0);
}

#[test]
fn any_order_of_traces() {
    let mut builder = survey();
    let crossline_first: Vec<TestTrace> = (0..3)
        .flat_map(|c| (0..4).map(move |i| trace(i, c)))
        .collect();
    builder.traces = crossline_first;
    assert_values(&builder.read().unwrap().image);
    builder.traces.reverse();
    assert_values(&builder.read().unwrap().image);
    builder.traces.swap(2, 9);
    assert_values(&builder.read().unwrap().image);
}

#[test]
fn missing_and_duplicate_traces_are_reported() {
    let mut builder = survey();
    builder.traces.remove(4); // inline 1, crossline 1
    let mut duplicate = trace(0, 2);
    duplicate.samples.fill(99.0);
    builder.traces.push(duplicate);
    let loaded = builder.read().unwrap();
    let info = loaded.survey.as_ref().unwrap();
    assert_eq!((info.missing, info.duplicates), (1, 1));
    assert!(has_note(&loaded, "1 of the 12 places"));
    assert!(has_note(&loaded, "1 traces have the inline"));
    assert_eq!(loaded.image.samples[[1, 1, 3]], 0.0);
    // The first of the duplicates is used.
    assert_eq!(
        f64::from(loaded.image.samples[[0, 2, 3]]),
        sample_value(0, 2, 3)
    );
}

#[test]
fn coordinates_are_checked_against_the_line_numbers() {
    // Line numbers are at the bytes of X and Y, and the coordinates are in source X, Y.
    let mut builder = survey();
    for t in 0..12 {
        let (i, c) = (t / 3, t % 3);
        let [x, y] = trace_position(i, c).map(|v| (v * 100.0).round() as i64);
        builder.set_field(t, 181, 4, 10 + 2 * i as i64);
        builder.set_field(t, 185, 4, 100 + 5 * c as i64);
        builder.set_field(t, 73, 4, x);
        builder.set_field(t, 77, 4, y);
    }
    let loaded = builder.read().unwrap();
    assert!(has_note(
        &loaded,
        "bytes 181 and 185 are not used: they only repeat the line numbers"
    ));
    assert!(has_note(&loaded, "placed by X, Y at bytes 73 and 77"));
    assert!((loaded.image.geometry.origin[0] - 620_000.0).abs() < 0.01);

    // No coordinates can be used if all of them are scattered.
    for t in 0..12 {
        for byte in [73, 77, 181, 185] {
            builder.set_field(t, byte, 4, ((t * 7919 + byte * 31) % 1009) as i64);
        }
    }
    let loaded = builder.read().unwrap();
    assert!(has_note(&loaded, "do not follow the line numbers"));
    assert!(has_note(&loaded, "no usable X, Y"));
    let geometry = &loaded.image.geometry;
    assert_eq!(geometry.to_physical([0.0, 2.0, 3.0])[..2], [16.0, 110.0]);
    assert_eq!(geometry.units, ["line", "line", "ms"]);
}

#[test]
fn scalars_multiply_divide_or_do_nothing() {
    for (scalar, factor) in [(-10, 0.1), (10, 10.0), (0, 1.0), (1, 1.0)] {
        let mut builder = survey();
        for t in 0..12 {
            builder.set_field(t, 71, 2, scalar);
        }
        let origin = builder.read().unwrap().image.geometry.origin[0];
        assert!(
            (origin - 62_000_000.0 * factor).abs() < factor,
            "{scalar}: {origin}"
        );
    }
    // Byte 0 means that there is no scalar.
    let ignored = survey()
        .read_with(&"scalar=0,delay=0".parse().unwrap())
        .unwrap();
    let origin = ignored.image.geometry.origin;
    assert!((origin[0] - 62_000_000.0).abs() < 1.0);
    assert_eq!(origin[2], 0.0);
}

#[test]
fn line_numbers_at_other_bytes_are_found() {
    let mut builder = survey();
    for t in 0..12 {
        for (from_byte, to_byte) in [(189, 9), (193, 21)] {
            let number = builder.traces[t]
                .fields
                .iter()
                .find(|f| f.0 == from_byte)
                .unwrap()
                .2;
            builder.set_field(t, to_byte, 4, number);
            builder.set_field(t, from_byte, 4, 0);
        }
    }
    let loaded = builder.read().unwrap();
    assert_values(&loaded.image);
    assert!(has_note(&loaded, "bytes 9 and 21 do, and are used instead"));
    let with_bytes = builder
        .read_with(&"inline=9,crossline=21".parse().unwrap())
        .unwrap();
    assert_eq!(with_bytes.image, loaded.image);
    assert!(!has_note(&with_bytes, "instead"));
    // Wrong bytes that the user gives are not replaced by others.
    let wrong = builder
        .read_with(&"inline=13,crossline=17".parse().unwrap())
        .unwrap_err();
    assert!(
        wrong.to_string().contains("inline and crossline numbers"),
        "{wrong}"
    );
    assert_eq!(wrong.cause().parameter, Some("inline-byte"));
}

#[test]
fn files_without_an_image_are_refused_and_described() {
    let cut = |traces: usize| {
        let mut builder = survey();
        builder.traces.truncate(traces);
        builder
    };
    for (builder, expected) in [(cut(0), "has no traces"), (cut(1), "has a single trace")] {
        let message = builder.error_message();
        assert!(message.contains(expected), "{message}");
        let info = builder.scan();
        assert_eq!(info.traces, builder.traces.len());
        assert!(info.problem.unwrap().contains(expected));
    }

    let mut gathers = survey();
    for c in 0..12 {
        let mut far_offset = gathers.traces[c].clone();
        far_offset.fields.push((37, 4, 500));
        gathers.traces.push(far_offset);
    }
    assert!(gathers.error_message().contains("pre-stack"));

    let mut shifted = survey();
    shifted.set_field(7, 109, 2, 52);
    assert!(shifted.error_message().contains("from 48 to 52 ms"));
    assert!(shifted.read_with(&"delay=0".parse().unwrap()).is_ok());
    shifted.set_field(7, 29, 2, 2); // a dead trace
    assert!(shifted.read().is_ok());
}

#[test]
fn cut_off_files() {
    let bytes = survey().to_bytes();
    let error_of_first = |length: usize| {
        with_file(&bytes[..length], |path| {
            segy::read(path, &SegyBytes::default())
        })
        .unwrap_err()
        .to_string()
    };
    assert!(error_of_first(0).contains("is cut off"));
    assert!(error_of_first(FILE_HEADER_BYTES - 1).contains("a SEG-Y header alone has 3600"));
    assert!(error_of_first(FILE_HEADER_BYTES).contains("has no traces"));
    assert!(error_of_first(bytes.len() - 1).contains("left over after 11 traces"));
    // The file claims extended headers that it does not have.
    let mut builder = survey();
    builder.fields.extend([(3501, 1, 1), (3505, 2, 3000)]);
    assert!(
        builder
            .error_message()
            .contains("3000 extended textual headers")
    );
}

#[test]
fn headers_of_later_revisions() {
    let mut builder = survey();
    builder.extended_text = vec!["((OTHER: STANZA))", "((SEG: EndText))"];
    assert_values(&builder.read().unwrap().image);
    builder.fields.push((3505, 2, -1));
    assert_values(&builder.read().unwrap().image);

    // Revision 2 has the sample count and interval at other bytes, and marks the byte order.
    let mut builder = survey();
    builder.is_little_endian = true;
    builder.fields.extend([
        (3221, 2, 0),
        (3269, 4, SAMPLES_PER_TRACE as i64),
        (3273, 8, 2500f64.to_bits() as i64),
        (3297, 4, 0x0102_0304),
    ]);
    let loaded = builder.read().unwrap();
    assert_values(&loaded.image);
    assert_eq!(loaded.survey.unwrap().dt_ms, Some(2.5));
    // Revision 1 has a scalar for the delay, here tenths of a millisecond.
    let mut builder = survey();
    builder.fields.push((3501, 1, 1));
    for t in 0..12 {
        builder.set_field(t, 215, 2, -10);
    }
    assert_eq!(builder.read().unwrap().image.geometry.origin[2], -4.8);
}

#[test]
fn intervals_and_counts_that_disagree_are_reported() {
    let mut builder = survey();
    builder.set_field(0, 117, 2, 2000);
    builder.set_field(0, 115, 2, 99);
    let loaded = builder.read().unwrap();
    assert!(has_note(
        &loaded,
        "4000 us by the file header and 2000 us by the first trace"
    ));
    assert!(has_note(&loaded, "99 samples by the first trace"));
    // The value of the first trace is used if that of the file header cannot be right.
    builder.fields.extend([(3217, 2, -4000), (3221, 2, 17)]);
    builder.set_field(0, 115, 2, SAMPLES_PER_TRACE as i64);
    let loaded = builder.read().unwrap();
    assert_values(&loaded.image);
    assert_eq!(loaded.survey.unwrap().dt_ms, Some(2.0));
    // The vertical axis counts samples if there is no interval at all.
    builder.set_field(0, 117, 2, 0);
    builder.fields.push((3217, 2, 0));
    let loaded = builder.read().unwrap();
    assert!(has_note(&loaded, "counts samples"));
    assert_eq!(loaded.image.geometry.units[2], "sample");
}

#[test]
fn ieee_floats_labelled_ibm_are_reported() {
    let mut builder = survey();
    builder.format = 5;
    for (t, trace) in builder.traces.iter_mut().enumerate() {
        trace.samples = (0..200)
            .map(|k| ((t * 200 + k) as f64 * 0.7).sin() * 1000.0)
            .collect();
    }
    builder.fields.push((3221, 2, 200));
    assert!(!has_note(&builder.read().unwrap(), "unusual for IBM"));
    let mut bytes = builder.to_bytes();
    bytes[3225] = 1;
    let loaded = with_file(&bytes, |path| segy::read(path, &SegyBytes::default())).unwrap();
    assert!(has_note(&loaded, "unusual for IBM"));
    let mut ibm = builder.clone();
    ibm.format = 1;
    assert!(!has_note(&ibm.read().unwrap(), "unusual for IBM"));
}

#[test]
fn segy_is_recognised_by_its_content() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("no-ending");
    std::fs::write(&path, survey().to_bytes()).unwrap();
    let loaded = formats::read(&path, &ReadOptions::default()).unwrap();
    assert_eq!(loaded.format, formats::ImageFormat::Segy);
    // A mask of zeros and ones has a plausible sample format, but no text.
    std::fs::write(&path, [0u8, 1].repeat(5000)).unwrap();
    let error = formats::read(&path, &ReadOptions::default()).unwrap_err();
    assert!(
        error.to_string().contains("not in a known image format"),
        "{error}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..Default::default() })]
    /// Any damaged file gives an image that fits into it, or an error.
    #[test]
    fn damaged_files_never_panic(
        changes in prop::collection::vec((3200usize..4000, any::<u8>()), 0..12),
        cut in 0usize..7000,
        little: bool,
    ) {
        let mut bytes = SegyBuilder { is_little_endian: little, ..survey() }.to_bytes();
        for (at, byte) in changes {
            bytes[at] = byte;
        }
        bytes.truncate(cut.max(1));
        with_file(&bytes, |path| {
            if let Ok(loaded) = segy::read(path, &SegyBytes::default()) {
                assert!(loaded.image.samples.len() <= 10 * bytes.len());
            }
            let _ = formats::describe(path, &ReadOptions::default());
        });
    }
}

/// Builds traces along a path. `position_of` gives the position of each trace, and `numbers_of` the
/// numbers at bytes 189, 193 and 21.
fn line(
    position_of: impl Fn(usize) -> [f64; 2],
    numbers_of: impl Fn(usize) -> [i64; 3],
) -> SegyBuilder {
    let mut builder = survey();
    builder.traces = (0..5)
        .map(|t| {
            let [x, y] = position_of(t).map(|v| (100.0 * v).round() as i64);
            let [inline, crossline, cdp] = numbers_of(t);
            TestTrace {
                fields: vec![
                    (189, 4, inline),
                    (193, 4, crossline),
                    (21, 4, cdp),
                    (181, 4, x),
                    (185, 4, y),
                    (71, 2, -100),
                    (109, 2, 48),
                ],
                samples: (0..SAMPLES_PER_TRACE)
                    .map(|k| sample_value(0, t, k))
                    .collect(),
            }
        })
        .collect();
    builder
}

#[test]
fn a_line_is_an_image_of_the_plane_with_time_down() {
    // Traces are 12.5 m apart in an oblique direction, and numbered by CDP alone or by one inline.
    let position_on_line = |t: usize| [600_000.0 + 7.5 * t as f64, 6_000_000.0 - 10.0 * t as f64];
    for (numbers, name) in [
        ([0, 0, 1], "trace"),
        ([0, 1, 0], "crossline"),
        ([2, 0, 0], "inline"),
        ([1, 1, 1], "trace"),
    ] {
        let numbers: [i64; 3] = numbers;
        let builder = line(position_on_line, |t| numbers.map(|n| 100 + n * t as i64));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("line.sgy");
        std::fs::write(&path, builder.to_bytes()).unwrap();
        let loaded = match formats::read_any(&path, &ReadOptions::default()).unwrap() {
            formats::AnyImage::Plane(loaded) => loaded,
            formats::AnyImage::Space(_) => panic!("{name} is no plane"),
        };
        let geometry = &loaded.image.geometry;
        assert_eq!(geometry.names, ["sample", name]);
        assert_eq!(geometry.units, ["m", "ms"]);
        assert_eq!(loaded.image.dims(), [SAMPLES_PER_TRACE, 5], "{name}");
        let [x, t] = geometry.to_physical([2.0, 3.0]);
        assert!((x - 37.5).abs() < 1e-6 && t == -56.0, "{name}: {x} {t}");
        assert_eq!(
            f64::from(loaded.image.samples[[3, 2]]),
            sample_value(0, 3, 2)
        );
        let note = |part: &str| loaded.notes.iter().any(|note| note.contains(part));
        assert!(note("a 2-D line: 5 traces over 50.0"), "{:?}", loaded.notes);
    }
}

#[test]
fn traces_that_jump_between_lines_are_refused() {
    // Three lines follow one another, and no header gives their numbers.
    let rows = |t: usize| [1000.0 * (t / 2) as f64, 25.0 * (t % 2) as f64];
    let message = line(rows, |t| [0, 0, 100 + t as i64]).error_message();
    assert!(message.contains("do not form a survey"), "{message}");
    // Without coordinates the numbers must be consecutive.
    let message = line(|_| [0.0; 2], |t| [0, 0, [1, 5, 2, 8, 3][t]]).error_message();
    assert!(message.contains("do not form a survey"), "{message}");
    let builder = line(|_| [0.0; 2], |t| [0, 0, 7 + t as i64]);
    let notes = builder.read().unwrap().notes;
    assert!(
        notes
            .iter()
            .any(|note| note.contains("without usable X, Y")),
        "{notes:?}"
    );
}

#[test]
fn a_survey_without_line_numbers_gets_lines_from_its_coordinates() {
    for bytes in [[181, 185], [73, 77]] {
        let mut builder = survey();
        for trace in &mut builder.traces {
            trace.fields.retain(|field| !matches!(field.0, 189 | 193));
            for field in &mut trace.fields {
                field.0 = match field.0 {
                    181 => bytes[0],
                    185 => bytes[1],
                    other => other,
                };
            }
        }
        let loaded = builder.read().unwrap();
        assert!(has_note(
            &loaded,
            "4 x 3 lines, numbered from 1, follow from X, Y"
        ));
        let [inlines, crosslines] = loaded.line_numbers.unwrap();
        assert_eq!((inlines.first, inlines.count), (1, 4));
        assert_eq!((crosslines.first, crosslines.count), (1, 3));
        // Every sample is at the place of its trace, whichever line is the first.
        let image = &loaded.image;
        for i in 0..4 {
            for c in 0..3 {
                let [x, y] = trace_position(i, c);
                let index = image.geometry.to_index([x, y, -48.0]).unwrap();
                let [k, c_index, i_index] = index.map(|n| n.round() as usize);
                let value = image.samples[[i_index, c_index, k]];
                assert_eq!(f64::from(value), sample_value(i, c, 0));
                assert!((index[1] - c_index as f64).abs() < 1e-2);
            }
        }
    }
}

#[test]
fn samples_in_depth_are_in_metres_or_feet() {
    let bytes = SegyBytes {
        is_depth: Some(true),
        ..SegyBytes::default()
    };
    for (interval, system, step, unit) in [(5000, 1, 5.0, "m"), (20, 2, 20.0, "ft")] {
        let builder = SegyBuilder {
            fields: vec![(3217, 2, interval), (3255, 2, system)],
            ..survey()
        };
        let loaded = builder.read_with(&bytes).unwrap();
        let geometry = &loaded.image.geometry;
        assert_eq!(geometry.units[2], unit);
        assert_eq!((geometry.origin[2], geometry.axes[0][2]), (-48.0, -step));
        assert!(loaded.survey.unwrap().is_depth);
    }
}

#[test]
fn a_textual_header_may_say_that_samples_are_in_depth() {
    let builder = SegyBuilder {
        fields: vec![(3217, 2, 5000), (3255, 2, 1)],
        ..survey()
    };
    let mut file = builder.to_bytes();
    let line = format!("{:80}", "C 1 DOMAIN: DEPTH");
    file[..80].copy_from_slice(line.as_bytes());
    let read = |is_depth| {
        let bytes = SegyBytes {
            is_depth,
            ..SegyBytes::default()
        };
        with_file(&file, |path| segy::read(path, &bytes).unwrap())
    };
    let loaded = read(None);
    assert_eq!(loaded.image.geometry.units[2], "m");
    assert_eq!(loaded.image.geometry.axes[0][2], -5.0);
    assert!(has_note(&loaded, "(C 1 DOMAIN: DEPTH); --domain time"));
    let loaded = read(Some(false));
    assert_eq!(loaded.image.geometry.units[2], "ms");
    assert!(!has_note(&loaded, "DOMAIN"));
}

#[test]
fn a_volume_is_written_with_the_headers_of_its_survey() {
    for (format, little) in [(1, false), (5, true), (6, false), (3, false)] {
        let mut builder = SegyBuilder {
            format,
            is_little_endian: little,
            extended_text: vec!["((SEG: EndText))"],
            ..survey()
        };
        // Traces in another order, and one missing.
        builder.traces.reverse();
        builder.traces.remove(4);
        let template = builder.to_bytes();
        for float in [None, Some(SegyFloat::Ibm), Some(SegyFloat::Ieee)] {
            with_file(&template, |path| {
                let image = segy::read(path, &SegyBytes::default()).unwrap().image;
                let values: Vec<f32> = image.as_slice().iter().map(|v| 0.5 - 3.0 * v).collect();
                let values = Image::new(image.dims(), values, image.geometry.clone());
                let out = path.with_file_name("out.sgy");
                let bytes = SegyBytes::default();
                segy::write_like(&out, &values, path, &bytes, float).unwrap();
                let loaded = segy::read(&out, &bytes).unwrap();
                let encoding = match (float, format) {
                    (Some(SegyFloat::Ibm), _) | (None, 1) => "IBM",
                    (None, 6) => "64-bit",
                    _ => "32-bit",
                };
                assert!(loaded.encoding.contains(encoding), "{}", loaded.encoding);
                assert_eq!(loaded.image.geometry, image.geometry);
                let pairs = loaded.image.as_slice().iter().zip(values.as_slice());
                for ((a, b), old) in pairs.zip(image.as_slice()) {
                    // The cell without a trace is not in the file.
                    assert!(a == b || *old == 0.0 && *a == 0.0, "{a} {b}");
                }
                // All other bytes are those of the template.
                let written = std::fs::read(&out).unwrap();
                let head = FILE_HEADER_BYTES + 3200;
                assert_eq!(written[..3224], template[..3224]);
                assert_eq!(written[3226..head + 240], template[3226..head + 240]);
                let narrow = Image::new([1, 3, 4], vec![0.0; 12], image.geometry.clone());
                let error = segy::write_like(&out, &narrow, path, &bytes, float).unwrap_err();
                assert!(
                    error.to_string().contains("has [6, 3, 4] samples"),
                    "{error}"
                );
            });
        }
    }
}
