// ALGLIB's least-squares bicubic spline (spline2dbuilder, BlockLLS) on points that bench.py hands over.
//
// Usage: canopy-bench-alglib POINTS NODES REPEATS OUT
//   POINTS   doubles u v z u v z ..., u and v in [0, NODES - 1]
//   OUT      doubles, 20 a cell, as spline2dunpackv lays them out
// Prints the seconds of each repeat (builder, points and fit; not the unpacking), then the fit's own root mean square error.

#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <vector>

#include <libalglib/interpolation.h>

namespace {

/// Seconds of processor time, as for everything else in the benchmark.
double now() {
    timespec t{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

std::vector<double> read(const char *path) {
    std::ifstream file(path, std::ios::binary | std::ios::ate);
    const std::streamoff bytes = file.tellg();
    std::vector<double> values(bytes > 0 ? static_cast<std::size_t>(bytes) / sizeof(double) : 0);
    file.seekg(0);
    file.read(reinterpret_cast<char *>(values.data()), static_cast<std::streamsize>(values.size() * sizeof(double)));
    return values;
}

double fit(const alglib::real_2d_array &points, alglib::ae_int_t count, int nodes,
           alglib::spline2dinterpolant &spline) {
    alglib::spline2dbuilder builder;
    alglib::spline2dfitreport report;
    alglib::spline2dbuildercreate(1, builder);
    alglib::spline2dbuildersetpoints(builder, points, count);
    alglib::spline2dbuildersetarea(builder, 0.0, nodes - 1.0, 0.0, nodes - 1.0);
    alglib::spline2dbuildersetgrid(builder, nodes, nodes);
    // A trace of smoothing: without it the parts of the grid that hold no points are left to rounding.
    alglib::spline2dbuildersetalgoblocklls(builder, 1e-6);
    alglib::spline2dfit(builder, spline, report);
    return report.rmserror;
}

int run(char **argv) {
    const std::vector<double> values = read(argv[1]);
    const int nodes = std::atoi(argv[2]);
    const int repeats = std::atoi(argv[3]);
    const auto count = static_cast<alglib::ae_int_t>(values.size() / 3);
    if (count == 0 || nodes < 4 || repeats < 1) {
        std::fprintf(stderr, "canopy-bench-alglib: no points in %s, or a wrong number\n", argv[1]);
        return 2;
    }
    alglib::real_2d_array points;
    points.setcontent(count, 3, values.data());
    alglib::spline2dinterpolant spline;
    double error = 0.0;
    for (int repeat = 0; repeat < repeats; repeat++) {
        const double start = now();
        error = fit(points, count, nodes, spline);
        std::printf("%.9f\n", now() - start);
    }
    std::printf("%.17g\n", error);
    alglib::ae_int_t rows = 0;
    alglib::ae_int_t columns = 0;
    alglib::ae_int_t components = 0;
    alglib::real_2d_array table;
    alglib::spline2dunpackv(spline, rows, columns, components, table);
    std::ofstream out(argv[4], std::ios::binary);
    for (alglib::ae_int_t i = 0; i < table.rows(); i++) {
        out.write(reinterpret_cast<const char *>(table[i]), 20 * static_cast<std::streamsize>(sizeof(double)));
    }
    out.close();
    return out ? 0 : 2;
}

}  // namespace

int main(int argc, char **argv) {
    if (argc != 5) {
        std::fprintf(stderr, "usage: canopy-bench-alglib POINTS NODES REPEATS OUT\n");
        return 64;
    }
    try {
        return run(argv);
    } catch (const alglib::ap_error &error) {
        std::fprintf(stderr, "canopy-bench-alglib: %s\n", error.msg.c_str());
        return 2;
    }
}
