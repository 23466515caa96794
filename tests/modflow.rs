//! Tests `atomesh export --to disv`: the files as MODFLOW 6 reads them.

use std::path::Path;

use crate::common::{run, write_npy_2d};

/// Reads a block of numbers as MODFLOW does: each layer begins on a new line, and the remainder of
/// its last line is skipped.
fn read_layers(text: &str, name: &str, layer_count: usize, columns: usize) -> Vec<Vec<f64>> {
    let start = text.find(&format!("  {name}\n")).unwrap();
    let mut lines = text[start..].lines().skip(2);
    let layer = |_| {
        let mut values: Vec<f64> = Vec::new();
        while values.len() < columns {
            let words = lines.next().unwrap().split_whitespace();
            values.extend(words.map(|word| word.parse::<f64>().unwrap()));
        }
        values.truncate(columns);
        values
    };
    (0..layer_count).map(layer).collect()
}

fn read_count(text: &str, name: &str) -> usize {
    let words: Vec<&str> = text.split_whitespace().collect();
    let index = words.iter().position(|word| *word == name).unwrap();
    words[index + 1].parse().unwrap()
}

/// Exports columns of a number of layers and checks their depths, which are level planes, so that
/// each layer has one bottom. Returns the number of columns.
fn check_export(folder: &Path, layer_count: usize) -> usize {
    run(
        folder,
        &format!(
            "columns map.vtu --horizon 100 --horizon 130 --layers {layer_count} -o cells.vtu --quiet"
        ),
    );
    run(
        folder,
        "export cells.vtu --to disv -o model --down z --permeability 100 --permeability-unit mD --quiet",
    );
    let text = std::fs::read_to_string(folder.join("model/model.disv")).unwrap();
    let columns = read_count(&text, "NCPL");
    assert_eq!(read_count(&text, "NLAY"), layer_count);
    let bottoms = read_layers(&text, "BOTM", layer_count, columns);
    for (layer, bottoms) in bottoms.iter().enumerate() {
        let expected = -100.0 - 30.0 * (layer + 1) as f64 / layer_count as f64;
        assert!(
            bottoms.iter().all(|z| (z - expected).abs() < 1e-6),
            "{layer}: {bottoms:?}"
        );
    }
    let domain = read_layers(&text, "IDOMAIN", layer_count, columns);
    assert!(domain.iter().flatten().all(|domain| *domain == 1.0));
    columns
}

#[test]
fn every_layer_begins_on_a_new_line() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_npy_2d(&folder.join("map.npy"), [40, 30], |[x, _]| {
        (-((x as f32 - 20.0) / 1.5).powi(2)).exp()
    });
    let mut remainders = Vec::new();
    for distance in [5, 6, 7, 8, 9] {
        run(
            folder,
            &format!(
                "mesh map.npy --feature ridges --cells voronoi --distance {distance} --quiet -o map.vtu"
            ),
        );
        remainders.push(check_export(folder, 3) % 5);
    }
    assert!(
        remainders.iter().any(|remainder| *remainder != 0),
        "{remainders:?}"
    );
    for layer_count in [1, 2, 7] {
        check_export(folder, layer_count);
    }
}
