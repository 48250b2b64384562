// Points by cell of a bird's-eye-view grid.
#include <cmath>

#include "stages.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Where points are counted and which of them; lengths in meters, heights in the level frame.
struct Counted {
    float origin_x, origin_y, cells_per_m, side;
    float low, high, most_range2, least_distance2;
};

// The flat cell of each point of a block, -1 where it does not count: without branches, so that it vectorizes.
MULTIVERSION void find_cells(const float* points, std::size_t count, const float* rotation, const float* translation,
                             const Counted& counted, std::int32_t* cells) {
    const float xx = rotation[0], xy = rotation[1], xz = rotation[2], x0 = translation[0];
    const float yx = rotation[3], yy = rotation[4], yz = rotation[5], y0 = translation[1];
    const float zx = rotation[6], zy = rotation[7], zz = rotation[8], z0 = translation[2];
    const Counted of = counted;
    const auto side = std::int32_t(of.side);
    for (std::size_t k = 0; k < count; ++k) {
        const float px = points[3 * k], py = points[3 * k + 1], pz = points[3 * k + 2];
        const float x = xx * px + xy * py + xz * pz + x0;
        const float y = yx * px + yy * py + yz * pz + y0;
        const float z = zx * px + zy * py + zz * pz + z0;
        const float u = (x - of.origin_x) * of.cells_per_m, v = (y - of.origin_y) * of.cells_per_m;
        bool inside = (u >= 0) & (v >= 0) & (u < of.side) & (v < of.side) & (z >= of.low) & (z <= of.high);
        inside &= (x * x + y * y <= of.most_range2) & (px * px + py * py + pz * pz >= of.least_distance2);
        const auto i = std::int32_t(inside ? u : 0.0f), j = std::int32_t(inside ? v : 0.0f);
        cells[k] = inside ? i * side + j : -1;
    }
}

}  // namespace

void bind_grid(nb::module_& m) {
    m.def(
        "count_points",
        [](Points points, In2<float> rotation, In1<float> translation, std::size_t cells, double cell_m,
           double origin_x_m, double origin_y_m, float low_m, float high_m, double max_range_m, double null_range_m) {
            require(rotation.shape(0) == 3 && rotation.shape(1) == 3, "rotation must have shape (3, 3)");
            require(translation.shape(0) == 3, "translation must have shape (3,)");
            require(cells >= 1 && cells <= 16384, "cells must lie in [1, 16384]");
            require(cell_m > 0, "cell_m must be positive");
            const float most_m2 = float(max_range_m * max_range_m), null_m2 = float(null_range_m * null_range_m);
            const Counted counted{float(origin_x_m), float(origin_y_m), float(1.0 / cell_m), float(cells),
                                  low_m,             high_m,            most_m2,             null_m2};
            Buffer<std::int32_t> counts(cells * cells, 0);
            {
                nb::gil_scoped_release unlocked;
                std::int32_t of_block[BLOCK];
                for (std::size_t start = 0; start < points.shape(0); start += BLOCK) {
                    const std::size_t size = std::min(BLOCK, points.shape(0) - start);
                    find_cells(points.data() + 3 * start, size, rotation.data(), translation.data(), counted, of_block);
                    for (std::size_t k = 0; k < size; ++k) {
                        if (of_block[k] >= 0) ++counts[std::size_t(of_block[k])];
                    }
                }
            }
            return std::move(counts).array({cells, cells});
        },
        "points"_a.noconvert(), "rotation"_a.noconvert(), "translation"_a.noconvert(), nb::kw_only(), "cells"_a,
        "cell_m"_a, "origin_x_m"_a, "origin_y_m"_a, "low_m"_a, "high_m"_a, "max_range_m"_a, "null_range_m"_a,
        "Counts (cells, cells) int32 of points (N, 3) after a transform to level, by height there and by range.");
}

}  // namespace viewshed
