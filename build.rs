//! Builds the CGAL bridge when the `cgal` feature is on.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    #[cfg(feature = "cgal")]
    cgal();
}

#[cfg(feature = "cgal")]
fn cgal() {
    let (source, header) = ("cpp/cgal_bridge.cpp", "cpp/cgal_bridge.h");
    for file in [source, header, "src/delaunay/cgal.rs"] {
        println!("cargo::rerun-if-changed={file}");
    }
    // The interval arithmetic of CGAL's predicates changes the rounding mode: the compiler must not
    // move computations across that. NDEBUG: without it CGAL checks every step of its own.
    cxx_build::bridge("src/delaunay/cgal.rs")
        .file(source)
        .std("c++17")
        .opt_level(2)
        .define("NDEBUG", None)
        .flag_if_supported("-frounding-math")
        .warnings(false)
        .compile("atomesh_cgal");
    println!("cargo::rustc-link-lib=dylib=mpfr");
    println!("cargo::rustc-link-lib=dylib=gmp");
}
