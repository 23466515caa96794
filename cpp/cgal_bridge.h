// What Rust sees of CGAL: two functions on slices. CGAL's own headers stay in cgal_bridge.cpp.
// The other side is src/mesh/delaunay/cgal.rs.
#pragma once

#include <cstdint>

#include "rust/cxx.h"

namespace atomesh {

struct CgalVerdict; // shared with Rust

// The finite cells of the Delaunay triangulation, four point numbers each, positively oriented.
// Points are x, y, z each and finite. Throws if two coincide.
rust::Vec<std::uint32_t> cgal_triangulate(rust::Slice<const double> points);

// Judges tetrahedra (four point numbers each, all in range) as a triangulation.
CgalVerdict cgal_validate(rust::Slice<const double> points, rust::Slice<const std::uint32_t> tets);

} // namespace atomesh
