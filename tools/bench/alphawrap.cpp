// CGAL's alpha wrapping (alpha_wrap_3) of points that bench.py hands over: a closed mesh that strictly encloses them.
//
// Usage: canopy-bench-alphawrap POINTS PART OUT
//   POINTS   doubles x y z x y z ...
//   PART     alpha is the diagonal of the bounding box over PART, the offset alpha / 30, as in CGAL's manual
//   OUT      doubles, 9 a triangle
// Prints the seconds it took, without reading and writing.

#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <exception>
#include <fstream>
#include <vector>

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/alpha_wrap_3.h>
#include <CGAL/bounding_box.h>

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = Kernel::Point_3;
using Mesh = CGAL::Surface_mesh<Point>;

/// Seconds of processor time, as for everything else in the benchmark.
double now() {
    timespec t{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

std::vector<Point> read(const char *path) {
    std::ifstream file(path, std::ios::binary);
    std::vector<Point> points;
    std::array<double, 3> p{};
    while (file.read(reinterpret_cast<char *>(p.data()), sizeof p)) {
        points.emplace_back(p[0], p[1], p[2]);
    }
    return points;
}

bool write(const Mesh &mesh, const char *path) {
    std::ofstream out(path, std::ios::binary);
    for (const Mesh::Face_index face : mesh.faces()) {
        for (const Mesh::Vertex_index vertex : mesh.vertices_around_face(mesh.halfedge(face))) {
            const Point &p = mesh.point(vertex);
            const std::array<double, 3> corner = {p.x(), p.y(), p.z()};
            out.write(reinterpret_cast<const char *>(corner.data()), sizeof corner);
        }
    }
    out.close();
    return static_cast<bool>(out);
}

int run(char **argv) {
    const std::vector<Point> points = read(argv[1]);
    const double part = std::atof(argv[2]);
    if (points.empty() || !(part > 0.0)) {
        std::fprintf(stderr, "canopy-bench-alphawrap: no points in %s, or a wrong number\n", argv[1]);
        return 2;
    }
    const double start = now();
    const Kernel::Iso_cuboid_3 box = CGAL::bounding_box(points.begin(), points.end());
    const double alpha = std::sqrt(CGAL::squared_distance((box.min)(), (box.max)())) / part;
    Mesh wrap;
    CGAL::alpha_wrap_3(points, alpha, alpha / 30.0, wrap);
    std::printf("%.9f\n", now() - start);
    return write(wrap, argv[3]) ? 0 : 2;
}

}  // namespace

int main(int argc, char **argv) {
    if (argc != 4) {
        std::fprintf(stderr, "usage: canopy-bench-alphawrap POINTS PART OUT\n");
        return 64;
    }
    try {
        return run(argv);
    } catch (const std::exception &error) {
        std::fprintf(stderr, "canopy-bench-alphawrap: %s\n", error.what());
        return 2;
    }
}
