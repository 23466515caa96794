// Meshes a label image with CGAL (Mesh_3), for the comparison with atomesh: `make bench-labels` builds and runs it.
//
//   cgal_labels LABELS.raw NX NY NZ CELL_SIZE DISTANCE OUT.mesh
//
// LABELS.raw has a byte per sample, x fastest, with spacing 1. All labels are above 0, so that the whole box is meshed.
// CELL_SIZE bounds the radius of the circumsphere of each tetrahedron and each face, DISTANCE the distance between faces
// and boundary. Other parameters are those of CGAL's manual. The sliver perturber and exuder run to their end.
// Prints the CPU seconds of meshing.

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Image_3.h>
#include <CGAL/ImageIO.h>
#include <CGAL/Labeled_mesh_domain_3.h>
#include <CGAL/Mesh_complex_3_in_triangulation_3.h>
#include <CGAL/Mesh_criteria_3.h>
#include <CGAL/Mesh_triangulation_3.h>
#include <CGAL/make_mesh_3.h>

#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iostream>

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Domain = CGAL::Labeled_mesh_domain_3<Kernel>;
using Triangulation = CGAL::Mesh_triangulation_3<Domain>::type;
using Complex = CGAL::Mesh_complex_3_in_triangulation_3<Triangulation>;
using Criteria = CGAL::Mesh_criteria_3<Triangulation>;
namespace parameters = CGAL::parameters;

int main(int argc, char** argv) {
    if (argc != 8) {
        std::cerr << "cgal_labels LABELS.raw NX NY NZ CELL_SIZE DISTANCE OUT.mesh\n";
        return 2;
    }
    const auto count = [&](int i) { return static_cast<std::size_t>(std::atoi(argv[i])); };
    const std::size_t samples = count(2) * count(3) * count(4);
    _image* read = _createImage(count(2), count(3), count(4), 1, 1, 1, 1, 1, WK_FIXED, SGN_UNSIGNED);
    std::ifstream labels(argv[1], std::ios::binary);
    if (!labels.read(static_cast<char*>(read->data), static_cast<std::streamsize>(samples))) {
        std::cerr << argv[1] << ": fewer than " << samples << " bytes\n";
        return 1;
    }
    const CGAL::Image_3 image(read, CGAL::Image_3::OWN_THE_DATA);
    const double size = std::atof(argv[5]), distance = std::atof(argv[6]);

    const std::clock_t start = std::clock();
    const Domain domain = Domain::create_labeled_image_mesh_domain(image, parameters::relative_error_bound = 1e-6);
    const Criteria criteria(parameters::facet_angle = 30, parameters::facet_size = size,
                            parameters::facet_distance = distance, parameters::cell_radius_edge_ratio = 2,
                            parameters::cell_size = size);
    const Complex mesh = CGAL::make_mesh_3<Complex>(domain, criteria);
    std::cout << double(std::clock() - start) / CLOCKS_PER_SEC << "\n";

    std::ofstream out(argv[7]);
    mesh.output_to_medit(out);
    return out ? 0 : 1;
}
