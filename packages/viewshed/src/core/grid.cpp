#include "grid.hpp"

#include <algorithm>
#include <cmath>

#include "vectors.hpp"

namespace viewshed {
namespace {

// Write the flat cell index of each point of a block, -1 if it does not count; branch-free, so that it vectorizes.
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

void count_points(View2<const float> points, const float* rotation, const float* translation, const Counted& counted,
                  View1<std::int32_t> counts) {
    std::fill(counts.begin(), counts.end(), 0);
    std::int32_t of_block[BLOCK];
    for (std::size_t start = 0; start < points.rows; start += BLOCK) {
        const std::size_t size = std::min(BLOCK, points.rows - start);
        find_cells(points[start], size, rotation, translation, counted, of_block);
        for (std::size_t k = 0; k < size; ++k) {
            if (of_block[k] >= 0) ++counts[std::size_t(of_block[k])];
        }
    }
}

void polar_of_cells(const CellCenters& grid, View1<float> range_m, View1<float> azimuth) {
    for (std::size_t i = 0; i < grid.cells; ++i) {
        const double x = grid.x0_m + (double(i) + 0.5) * grid.cell_m;
        for (std::size_t j = 0; j < grid.cells; ++j) {
            const double y = grid.y0_m + (double(j) + 0.5) * grid.cell_m;
            const std::size_t n = i * grid.cells + j;
            range_m[n] = float(std::hypot(x, y));
            const float angle = float(std::atan2(y, x));
            azimuth[n] = angle >= PI ? -PI : angle;
        }
    }
}

}  // namespace viewshed
