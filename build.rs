//! Builds the CGAL bridge when the `cgal` feature is on.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
}
