//! Builds the CGAL bridge when the `cgal` feature is on, and says where the TetGen worker is.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // For tests: the program that runs TetGen by itself.
    if let Ok(worker) = std::env::var("DEP_TET_WORKER") {
        println!("cargo::rustc-env=ATOMESH_TETGEN_WORKER={worker}");
    }
    #[cfg(feature = "cgal")]
    cgal();
}

#[cfg(feature = "cgal")]
fn cgal() {
    let bridges = [
        "src/mesh/delaunay/cgal.rs",
        "src/mesh/delaunay/exude.rs",
        "src/mesh/delaunay/refine.rs",
    ];
    let sources = ["cpp/cgal_bridge.cpp", "cpp/exude.cpp", "cpp/refine.cpp"];
    let headers = ["cpp/cgal_bridge.h", "cpp/exude.h", "cpp/refine.h"];
    for file in [bridges, sources, headers].as_flattened() {
        println!("cargo::rerun-if-changed={file}");
    }
    // The interval arithmetic of CGAL's predicates changes the rounding mode: the compiler must not
    // move computations across that. NDEBUG: without it CGAL checks every step of its own.
    cxx_build::bridges(bridges)
        .files(sources)
        .std("c++17")
        .opt_level(2)
        .define("NDEBUG", None)
        .flag_if_supported("-frounding-math")
        .warnings(false)
        .compile("atomesh_cgal");
    println!("cargo::rustc-link-lib=dylib=mpfr");
    println!("cargo::rustc-link-lib=dylib=gmp");
}
