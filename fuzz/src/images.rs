//! Any bytes as an image, of any format.

use std::fs;
use std::path::Path;

use atomesh::image::formats::{self, AnyImage, ReadOptions};

const ENDINGS: [&str; 13] = [
    "npy", "vti", "nrrd", "mha", "nii", "tif", "png", "sgy", "inr", "nii.gz", "vtk", "mhd", "nhdr",
];

/// The first byte names the format, the others are the file: it is refused in one line, or it is an image
/// that is written and reads back as the same.
///
/// # Panics
/// If a promise is broken.
pub fn any_image(folder: &Path, bytes: &[u8]) {
    let Some((&first, bytes)) = bytes.split_first() else {
        return;
    };
    let path = folder.join(format!(
        "image.{}",
        ENDINGS[usize::from(first) % ENDINGS.len()]
    ));
    fs::write(&path, bytes).expect("a file");
    let read = formats::read_any(&path, &ReadOptions::default());
    fs::remove_file(&path).expect("the file");
    let image = match read {
        Err(error) => {
            let said = error.to_string();
            assert!(said.contains("; ") && !said.contains('\n'), "{said}");
            return;
        }
        Ok(AnyImage::Plane(loaded)) => loaded.image.to_3d(),
        Ok(AnyImage::Space(loaded)) => loaded.image,
    };
    assert_eq!(
        image.as_slice().len(),
        image.dims().iter().product::<usize>()
    );
    if image.as_slice().len() > 1 << 16 {
        return;
    }
    let copy = folder.join("copy.npy");
    if formats::write(&copy, &image).is_ok() {
        let again = formats::read_any(&copy, &ReadOptions::default());
        fs::remove_file(&copy).expect("the file");
        let again = match again.expect("what was written is read") {
            AnyImage::Plane(loaded) => loaded.image.to_3d(),
            AnyImage::Space(loaded) => loaded.image,
        };
        let bits = |samples: &[f32]| samples.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(again.as_slice()), bits(image.as_slice()));
    }
}
