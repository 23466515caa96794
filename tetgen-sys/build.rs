//! Compiles the C++ shim over libtet, generates the bindings of its plain-C header, and makes of the
//! shim a program besides, `atomesh-tetgen`, whose path dependent build scripts find in `DEP_TET_WORKER`.

use std::env;
use std::path::{Path, PathBuf};

fn main() {
    let manifest = env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    let shim = Path::new(&manifest).join("cpp");
    let (source, header) = (shim.join("tetgen_shim.cpp"), shim.join("tetgen_shim.h"));
    println!("cargo::rerun-if-changed={}", source.display());
    println!("cargo::rerun-if-changed={}", header.display());
    let worker = shim.join("worker.cpp");
    println!("cargo::rerun-if-changed={}", worker.display());
    println!("cargo::rerun-if-changed=build.rs");

    if !Path::new("/usr/include/tetgen.h").exists() && env::var_os("CPLUS_INCLUDE_PATH").is_none() {
        println!(
            "cargo::error=tetgen.h not found: install it (Debian, Ubuntu: apt install libtet1.5-dev) \
             or build without TetGen (--no-default-features)"
        );
        return;
    }

    cc::Build::new()
        .cpp(true)
        .std("c++14")
        .opt_level(2)
        .file(&source)
        .compile("tetgen_shim");
    println!("cargo::rustc-link-lib=dylib=tet");

    let out = PathBuf::from(env::var("OUT_DIR").expect("cargo sets OUT_DIR"));
    let program = out.join("atomesh-tetgen");
    let compiler = cc::Build::new()
        .cpp(true)
        .std("c++14")
        .opt_level(2)
        .get_compiler();
    let linked = compiler
        .to_command()
        .args([&worker, &source])
        .arg("-ltet")
        .arg("-o")
        .arg(&program)
        .status();
    if !linked.is_ok_and(|status| status.success()) {
        println!(
            "cargo::error=the program that runs TetGen by itself cannot be linked with libtet"
        );
        return;
    }
    println!("cargo::metadata=WORKER={}", program.display());

    bindgen::Builder::default()
        .header(header.to_string_lossy())
        .allowlist_item("tetgen_shim_.*|TETGEN_SHIM_.*")
        .default_enum_style(bindgen::EnumVariation::Consts)
        .prepend_enum_name(false)
        .layout_tests(false)
        .generate()
        .expect("the shim's header is plain C")
        .write_to_file(out.join("bindings.rs"))
        .expect("OUT_DIR can be written");
}
