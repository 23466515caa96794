//! `atomesh export --to disv`: files as MODFLOW 6 reads them.

use std::path::Path;

use crate::common::{write_npy_2d, run};

/// Reads a block of numbers as MODFLOW does: layer by layer, each with a read of its own, which begins on a
/// new line and leaves what is left of its last one.
fn layers(text: &str, name: &str, layers: usize, columns: usize) -> Vec<Vec<f64>> {
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
    (0..layers).map(layer).collect()
}

fn count(text: &str, name: &str) -> usize {
    let words: Vec<&str> = text.split_whitespace().collect();
    let at = words.iter().position(|word| *word == name).unwrap();
    words[at + 1].parse().unwrap()
}

/// The depths of layers are level planes, so that each layer has one bottom.
fn check(folder: &Path, number: usize) -> usize {
    run(
        folder,
        &format!(
            "columns map.vtu --horizon 100 --horizon 130 --layers {number} -o cells.vtu --quiet"
        ),
    );
    run(
        folder,
        "export cells.vtu --to disv -o model --down z --permeability 100 --permeability-unit mD --quiet",
    );
    let text = std::fs::read_to_string(folder.join("model/model.disv")).unwrap();
    let columns = count(&text, "NCPL");
    assert_eq!(count(&text, "NLAY"), number);
    let bottoms = layers(&text, "BOTM", number, columns);
    for (layer, bottoms) in bottoms.iter().enumerate() {
        let want = -100.0 - 30.0 * (layer + 1) as f64 / number as f64;
        assert!(
            bottoms.iter().all(|z| (z - want).abs() < 1e-6),
            "{layer}: {bottoms:?}"
        );
    }
    let domain = layers(&text, "IDOMAIN", number, columns);
    assert!(domain.iter().flatten().all(|domain| *domain == 1.0));
    columns
}

#[test]
fn every_layer_begins_on_a_line_of_its_own() {
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
        remainders.push(check(folder, 3) % 5);
    }
    assert!(remainders.iter().any(|rest| *rest != 0), "{remainders:?}");
    for number in [1, 2, 7] {
        check(folder, number);
    }
}
