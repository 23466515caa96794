// Delaunay refinement in space, by CGAL. The other side is src/mesh/delaunay/refine.rs.
#pragma once

#include <cstddef>
#include <cstdint>

#include "rust/cxx.h"

namespace atomesh {

// Adds circumcentres of tetrahedra to `points` (x, y, z each, finite) until none inside the box from
// the origin to `extent` has a circumradius of more than `limit` d, largest ratio first. d is
// interpolated linearly between `samples` on a grid of `dims` points (x fastest) that spans the box.
// Returns the points added.
rust::Vec<double> cgal_refine(rust::Slice<const double> points, rust::Slice<const double> extent,
                              rust::Slice<const float> samples, rust::Slice<const std::size_t> dims,
                              double limit);

} // namespace atomesh
