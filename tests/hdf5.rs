//! Tests images in HDF5 files that other programs wrote.

use std::path::Path;

use atomesh::image::formats::{AnyImage, ReadOptions, read_any};
use serde_json::Value;

use crate::common::{expect_refusal, run, run_python};

#[test]
#[ignore = "needs h5py, SimpleITK and VTK: make test-all"]
fn images_in_hdf5_have_the_samples_and_the_place_that_their_writers_gave_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/images/hdf5.py");
    let written = run_python("h5py", &[script.as_os_str(), folder.as_os_str()]);
    let expected: Value = serde_json::from_str(&written).unwrap();
    for (name, expected) in expected.as_object().unwrap() {
        let image = read_any(&folder.join(name), &ReadOptions::default());
        let AnyImage::Space(loaded) = image.unwrap_or_else(|e| panic!("{name}: {e}")) else {
            panic!("{name} is not 3-D");
        };
        let image = loaded.image;
        assert_eq!(serde_json::json!(image.dims()), expected["dims"], "{name}");
        let indexed = (1i32..).zip(&image.samples);
        let sum: f64 = indexed.map(|(i, v)| f64::from(i) * f64::from(*v)).sum();
        let right = expected["sum"].as_f64().unwrap();
        assert!(
            (sum - right).abs() <= 1e-3 * right.abs(),
            "{name}: {sum}, not {right}"
        );
        let [origin, spacing] = ["origin", "spacing"]
            .map(|key| -> [f64; 3] { serde_json::from_value(expected[key].clone()).unwrap() });
        assert_eq!(image.geometry.origin, origin, "{name}");
        assert_eq!(image.geometry.spacing(), spacing, "{name}");
    }
    // A file with two data sets asks which is meant.
    let error = expect_refusal(folder, &["info", "two.h5"]);
    assert!(error.contains("/labels, /raw"), "{error}");
    let error = expect_refusal(folder, &["info", "two.h5:/none"]);
    assert!(error.contains("give one of /labels"), "{error}");
    run(folder, "convert two.h5:/raw raw.vti --quiet");
}
