//! Compiles the C++ shim over libtet, and generates the bindings of its plain-C header.

use std::env;
use std::panic;
use std::path::{Path, PathBuf};
use std::process::Stdio;

/// Remedy if a system library or tool is missing.
const REMEDY: &str = "on Debian and Ubuntu: apt install g++ libtet1.5-dev libcgal-dev libclang-dev; \
                      without TetGen and CGAL: --no-default-features --features cli";

fn main() {
    let manifest = env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    let shim = Path::new(&manifest).join("cpp");
    let (source, header) = (shim.join("tetgen_shim.cpp"), shim.join("tetgen_shim.h"));
    println!("cargo::rerun-if-changed={}", source.display());
    println!("cargo::rerun-if-changed={}", header.display());
    println!("cargo::rerun-if-changed=build.rs");
    let out = PathBuf::from(env::var("OUT_DIR").expect("cargo sets OUT_DIR"));
    let mut build = cc::Build::new();
    build.cpp(true).std("c++14").opt_level(2);

    if let Some(missing) = missing_dependency(&build, &out) {
        println!("cargo::error=tetgen-sys: {missing}; {REMEDY}");
        return;
    }
    build.file(&source).compile("tetgen_shim");
    println!("cargo::rustc-link-lib=dylib=tet");

    // bindgen panics if libclang is missing.
    panic::set_hook(Box::new(|_| {}));
    let bindings = panic::catch_unwind(|| {
        bindgen::Builder::default()
            .header(header.to_string_lossy())
            .allowlist_item("tetgen_shim_.*|TETGEN_SHIM_.*")
            .default_enum_style(bindgen::EnumVariation::Consts)
            .prepend_enum_name(false)
            .layout_tests(false)
            .generate()
    });
    let _ = panic::take_hook();
    match bindings {
        Ok(bindings) => bindings
            .expect("the shim's header is plain C")
            .write_to_file(out.join("bindings.rs"))
            .expect("OUT_DIR can be written"),
        Err(_) => println!("cargo::error=tetgen-sys: libclang is missing; {REMEDY}"),
    }
}

/// Returns what the shim needs but the system does not have, if anything.
fn missing_dependency(build: &cc::Build, out: &Path) -> Option<&'static str> {
    let probe = out.join("probe.cpp");
    let compiles = |text: &str| -> bool {
        std::fs::write(&probe, text).expect("OUT_DIR can be written");
        let Ok(compiler) = build.try_get_compiler() else {
            return false;
        };
        let mut command = compiler.to_command();
        let quiet = command
            .arg("-fsyntax-only")
            .arg(&probe)
            .stderr(Stdio::null());
        quiet.status().is_ok_and(|status| status.success())
    };
    if !compiles("#include <vector>\n") {
        return Some("there is no C++ compiler");
    }
    if !compiles("#include <tetgen.h>\n") {
        return Some("TetGen's header, tetgen.h, is missing");
    }
    None
}
