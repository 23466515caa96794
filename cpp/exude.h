// Sliver exudation by CGAL. The other side is src/mesh/delaunay/exude.rs.
#pragma once

#include <cstdint>

#include "rust/cxx.h"

namespace atomesh {

// CGAL's regular triangulation of `points` (x, y, z each, finite), all of weight zero, that is a
// Delaunay triangulation: four point numbers a cell, positively oriented. Throws if two coincide.
rust::Vec<std::uint32_t> cgal_unweighted(rust::Slice<const double> points);

// The same after the points' weights were raised so that as few dihedral angles as possible are
// below `angle` degrees. The hull and `faces` (three point numbers each) are kept; those that are
// not faces of the unweighted triangulation are passed over.
rust::Vec<std::uint32_t> cgal_exude(rust::Slice<const double> points,
                                    rust::Slice<const std::uint32_t> faces, double angle);

} // namespace atomesh
