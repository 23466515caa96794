//! Builds the CGAL bridge if the feature `cgal` is on.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    #[cfg(feature = "cgal")]
    cgal();
}

#[cfg(feature = "cgal")]
fn cgal() {
    let bridge = "src/mesh/delaunay/bridge.rs";
    let sources = ["cpp/cgal_bridge.cpp", "cpp/exude.cpp"];
    for file in [bridge, "cpp/cgal_bridge.h"].iter().chain(&sources) {
        println!("cargo::rerun-if-changed={file}");
    }
    // The interval arithmetic of CGAL's predicates changes the rounding mode, so the compiler must
    // not move computations across such a change. NDEBUG switches CGAL's internal checks off.
    let mut build = cxx_build::bridge(bridge);
    build
        .files(sources)
        .std("c++17")
        .opt_level(2)
        .define("NDEBUG", None)
        .flag_if_supported("-frounding-math")
        .warnings(false);
    let compiler = build.get_compiler().to_command();
    if let Some(missing) = missing(compiler) {
        println!(
            "cargo::error=atomesh: {missing}; on Debian and Ubuntu: apt install g++ libtet1.5-dev \
             libcgal-dev libclang-dev; without both: --no-default-features --features cli"
        );
        return;
    }
    build.compile("atomesh_cgal");
    println!("cargo::rustc-link-lib=dylib=mpfr");
    println!("cargo::rustc-link-lib=dylib=gmp");
}

/// Returns what the bridge needs but the system does not have, if anything.
#[cfg(feature = "cgal")]
fn missing(mut compiler: std::process::Command) -> Option<&'static str> {
    use std::process::Stdio;
    let out = std::env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    let probe = std::path::Path::new(&out).join("probe.cpp");
    let text = "#include <CGAL/version.h>\n#include <gmp.h>\n#include <mpfr.h>\n";
    std::fs::write(&probe, text).expect("OUT_DIR can be written");
    compiler.arg("-fsyntax-only").arg(&probe);
    match compiler.stderr(Stdio::null()).status() {
        Ok(status) if status.success() => None,
        Ok(_) => Some("CGAL's headers, or those of GMP and MPFR, are missing"),
        Err(_) => Some("there is no C++ compiler"),
    }
}
