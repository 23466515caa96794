//! Tests `scripts/reservoir.py`, the workflow from a seismic volume to a simulation, with larger
//! cells than `make reservoir`.

use std::path::Path;
use std::process::Command;

use crate::common::{is_close, numbers};
use serde_json::Value;

#[test]
#[ignore = "needs OPM Flow, resfo and open-DARTS: make test-all"]
fn all_solvers_agree_on_the_reservoir_of_a_seismic_volume() {
    let folder = tempfile::tempdir().unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let python = root.join(".venv/bin/python");
    let mut script = Command::new(python);
    script.arg(root.join("scripts/reservoir.py"));
    script.arg(crate::PROGRAM).arg(folder.path());
    let output = script.args(["--distance", "10"]).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    let figures = std::fs::read_to_string(folder.path().join("figures.json")).unwrap();
    let figures: Value = serde_json::from_str(&figures).unwrap();

    // There is one fault with horizons on both sides. The layers fill the whole box.
    let surfaces = figures["surfaces"].as_array().unwrap();
    let steep = |s: &&Value| s["dip"].as_f64().unwrap() > 75.0;
    assert_eq!(surfaces[0]["kind"], "fault");
    assert!(surfaces.iter().filter(steep).count() < surfaces.len() - 3);
    let layers = figures["layers"].as_object().unwrap();
    let layers: f64 = layers.values().map(|v| v.as_f64().unwrap()).sum();
    let volume = 63.0 * 6.0 * (99.0 * 12.5) * (79.0 * 12.5);
    assert!(is_close(layers, volume, 0.05), "{layers} of {volume}");
    let model = &figures["model"];
    assert!(is_close(model["volume"].as_f64().unwrap(), volume, 1e-9));
    assert!(model["angle"][0].as_f64().unwrap() < 0.1, "{model}");

    let iterations = figures["iterations"].as_object().unwrap();
    assert_eq!(iterations.len(), 3);
    let counts = iterations.values().map(|n| n.as_u64().unwrap());
    assert!(counts.max().unwrap() < 2000, "{iterations:?}");
    // The oil that is no longer in place was produced.
    let years = &figures["ten years"];
    let number = |name: &str| years[name].as_f64().unwrap();
    let produced = number("oil in place, sm3") - number("oil left, sm3");
    assert!(produced > 0.01 * number("oil in place, sm3"));
    assert!(
        is_close(produced, number("oil produced, sm3"), 1e-3),
        "{years}"
    );
    assert!(is_close(
        number("pore volume, m3"),
        model["pore_volume"].as_f64().unwrap(),
        1e-6
    ));
    let pressure = numbers(&years["mean pressure, bar"]);
    assert!((150.0..300.0).contains(&pressure[1]), "{pressure:?}");
    for name in ["layers", "pressure", "swat"] {
        let bytes = std::fs::read(folder.path().join(format!("{name}.png"))).unwrap();
        assert!(bytes.len() > 10_000, "{name}");
    }

    let differences = figures["apart"].as_object().unwrap();
    assert_eq!(differences.len(), 3);
    for (solver, difference) in differences {
        assert!(
            difference.as_f64().unwrap() < 1e-3,
            "{solver}: {difference}"
        );
    }
}
