//! Tests `atomesh script` on the command line.

use std::fs;

use crate::common::{expect_refusal, planar_fault, run, run_args, write_npy};

/// Actions on a mesh that is edited, painted, and edited again. The mesh has the number of the action in
/// its name where it stands as `OLD` and `NEW`.
const ACTIONS: [&str; 5] = [
    "mesh image.npy -o NEW --distance 6 --feature ridges",
    "edit OLD image.npy -o NEW --add 10.5,12,8 --move 100:16.5,9,20",
    "paint OLD -o NEW --seed 5,5,5=2 --seed 30,20,20",
    "edit OLD image.npy -o NEW --remove 90",
    "flow OLD -o NEW --source 5,5,5 --sink 30,20,20 --faults 0.01",
];

#[test]
fn a_script_makes_the_same_bytes_as_its_commands() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let dims = [40, 32, 28];
    write_npy(&dir.join("image.npy"), dims, planar_fault(dims));
    let mut script = String::from("# a mesh, and what is done with it\n\n");
    for (number, action) in ACTIONS.iter().enumerate() {
        let name = |number: usize| format!("mesh-{number}.vtu");
        let old = name(number.saturating_sub(1));
        run(
            dir,
            &action.replace("OLD", &old).replace("NEW", &name(number)),
        );
        let line = action.replace("OLD", "mesh.vtu").replace("NEW", "mesh.vtu");
        script += &format!("{line}\n");
    }
    script += "export mesh.vtu --to msh -o mesh.msh\n";
    fs::write(dir.join("steps.txt"), script).unwrap();
    let report = run_args(dir, &["script", "steps.txt", "--json", "--quiet"]);
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    let last = ACTIONS.len() - 1;
    let expected = fs::read(dir.join(format!("mesh-{last}.vtu"))).unwrap();
    assert!(fs::read(dir.join("mesh.vtu")).unwrap() == expected);
    assert!(dir.join("mesh.msh").exists());
    assert_eq!(report["files"], serde_json::json!(["mesh.vtu"]));
    let lines = report["lines"].as_array().unwrap();
    assert_eq!(lines.len(), ACTIONS.len() + 1);
    assert_eq!(
        (&lines[1]["line"], &lines[1]["report"]["file"]),
        (&4.into(), &"mesh.vtu".into())
    );
    let change = &lines[1]["change"];
    assert!(change["changed_nodes"].as_u64() > Some(1), "{change}");
    assert!(lines[5]["change"].is_null());
}

#[test]
fn a_script_that_fails_writes_no_mesh_and_names_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let dims = [20, 18, 16];
    write_npy(&dir.join("image.npy"), dims, planar_fault(dims));
    for (line, expected) in [
        (
            "edit mesh.vtu image.npy -o mesh.vtu --add 99,1,1",
            "steps.txt:3: --add 99,1,1: ",
        ),
        (
            "edits mesh.vtu",
            "steps.txt:3: edits mesh.vtu: unrecognized subcommand",
        ),
        (
            "quality 'mesh.vtu",
            "steps.txt:3: quality 'mesh.vtu: has no '",
        ),
    ] {
        let script = format!("mesh image.npy -o mesh.vtu --distance 6\n\n{line}\n");
        fs::write(dir.join("steps.txt"), script).unwrap();
        let error = expect_refusal(dir, &["script", "steps.txt"]);
        assert!(error.contains(expected), "{error}");
    }
    let error = expect_refusal(dir, &["script", "absent.txt"]);
    assert!(error.contains("absent.txt"), "{error}");
}
