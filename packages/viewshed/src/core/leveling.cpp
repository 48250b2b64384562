#include "leveling.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "ego_vehicle.hpp"
#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Lower bound of the range in slopes.
constexpr float MIN_RANGE_M = 1e-3f;

// Fewest points for which a part pays for its thread.
constexpr std::size_t PART = 16384;

// Limits of kept returns: squared ranges; half size (0 without a vehicle) and heading of the vehicle's box.
struct Limits {
    float near2, far2, ego_length_m, ego_width_m, cos, sin;
};

// Coordinates (3, BLOCK) of the points of a block.
struct Block {
    float x[BLOCK], y[BLOCK], z[BLOCK];
};

// Mark the points of a block that are in range and outside the vehicle; return their number.
MULTIVERSION int mark_kept(const float* points, const bool* clutter, std::size_t count, const float* transform,
                           const Limits& limits, std::uint8_t* kept) {
    const Limits l = limits;
    for (std::size_t k = 0; k < count; ++k) {
        const float px = points[3 * k], py = points[3 * k + 1], pz = points[3 * k + 2];
        const float d2 = px * px + py * py + pz * pz;
        const float x = transform[0] * px + transform[1] * py + transform[2] * pz;
        const float y = transform[4] * px + transform[5] * py + transform[6] * pz;
        const bool is_ego = (std::fabs(l.cos * x + l.sin * y) < l.ego_length_m) &
                            (std::fabs(l.cos * y - l.sin * x) < l.ego_width_m);
        kept[k] = (d2 >= l.near2) & (d2 <= l.far2) & !is_ego;
    }
    if (clutter != nullptr) {
        for (std::size_t k = 0; k < count; ++k) kept[k] &= !clutter[k];
    }
    int number = 0;
    for (std::size_t k = 0; k < count; ++k) number += kept[k];
    return number;
}

// Gather the kept points of a block, and their rows.
void gather_kept(const float* points, const std::uint8_t* kept, std::size_t count, std::size_t start, Block& block,
                 std::int32_t* rows) {
    // Compact without branches: each index is written where the next kept one belongs.
    std::size_t m = 0;
    std::int32_t at[BLOCK];
    for (std::size_t k = 0; k < count; ++k) {
        at[m] = std::int32_t(k);
        m += kept[k];
    }
    for (std::size_t k = 0; k < m; ++k) {
        const float* point = points + 3 * std::size_t(at[k]);
        block.x[k] = point[0], block.y[k] = point[1], block.z[k] = point[2];
        rows[k] = std::int32_t(start) + at[k];
    }
}

// Copy a block in which all points are kept.
MULTIVERSION void take_all(const float* points, std::size_t count, std::size_t start, Block& block,
                           std::int32_t* rows) {
    for (std::size_t k = 0; k < count; ++k) {
        block.x[k] = points[3 * k], block.y[k] = points[3 * k + 1], block.z[k] = points[3 * k + 2];
        rows[k] = std::int32_t(start + k);
    }
}

// Transform the points of a block, and write them with range and azimuth.
MULTIVERSION void measure_block(Block& block, std::size_t count, const float* transform, float* points, float* range_m,
                                float* azimuth) {
    // Copy the transform: the compiler cannot know that the loops do not write it.
    std::array<float, 12> t;
    std::copy_n(transform, 12, t.begin());
    for (std::size_t k = 0; k < count; ++k) {
        const float px = block.x[k], py = block.y[k], pz = block.z[k];
        block.x[k] = t[0] * px + t[1] * py + t[2] * pz;
        block.y[k] = t[4] * px + t[5] * py + t[6] * pz;
        block.z[k] = t[8] * px + t[9] * py + t[10] * pz + t[11];
    }
    for (std::size_t k = 0; k < count; ++k) {
        points[3 * k] = block.x[k], points[3 * k + 1] = block.y[k], points[3 * k + 2] = block.z[k];
    }
    for (std::size_t k = 0; k < count; ++k) {
        const float x = block.x[k], y = block.y[k];
        range_m[k] = std::sqrt(x * x + y * y);
        azimuth[k] = azimuth_of(y, x);
    }
}

// Write the heights above the ground of level points (count, 3).
MULTIVERSION void measure_heights(const float* points, std::size_t count, const Ground& ground, float* height_m) {
    // Lattice positions come first: a loop with look-ups does not vectorize as well.
    const auto n = std::int32_t(ground.heights_m.rows);
    const float half_m = ground.half_extent_m, last = float(n - 1.001);
    const float nodes_per_m = float(n / (2.0 * double(half_m)));
    std::int32_t node[BLOCK];
    float right[BLOCK], below[BLOCK];
    for (std::size_t k = 0; k < count; ++k) {
        float u = (points[3 * k] + half_m) * nodes_per_m - 0.5f, v = (points[3 * k + 1] + half_m) * nodes_per_m - 0.5f;
        u = u > 0.0f ? u : 0.0f, v = v > 0.0f ? v : 0.0f;
        u = u < last ? u : last, v = v < last ? v : last;
        const auto i = std::int32_t(u), j = std::int32_t(v);
        below[k] = u - float(i), right[k] = v - float(j);
        node[k] = i * n + j;
    }
    const float* heights = ground.heights_m.data;
    for (std::size_t k = 0; k < count; ++k) {
        const float *at = heights + node[k], *under = at + n;
        const float low = at[0] + (at[1] - at[0]) * right[k], high = under[0] + (under[1] - under[0]) * right[k];
        height_m[k] = points[3 * k + 2] - low - (high - low) * below[k];
    }
}

// Write the cell of each point within the height limits above the ground, cells · cells for others.
MULTIVERSION void find_cells(const float* points, const float* height_m, std::size_t count, float x0_m, float y0_m,
                             float cells_per_m, float low_m, float high_m, std::int32_t cells, std::int32_t* cell) {
    for (std::size_t k = 0; k < count; ++k) {
        const float u = (points[3 * k] - x0_m) * cells_per_m, v = (points[3 * k + 1] - y0_m) * cells_per_m;
        const bool counts = (height_m[k] > low_m) & (height_m[k] < high_m) & (u >= 0.0f) & (v >= 0.0f) &
                            (u < float(cells)) & (v < float(cells));
        const auto i = std::int32_t(counts ? u : 0.0f), j = std::int32_t(counts ? v : 0.0f);
        cell[k] = counts ? i * cells + j : cells * cells;
    }
}

// Write the slopes of a block of level points.
MULTIVERSION void slopes_of_block(const float* points, const float* range_m, std::size_t count, float sensor_height_m,
                                  float* slope) {
    for (std::size_t k = 0; k < count; ++k) {
        const float range = range_m[k] > MIN_RANGE_M ? range_m[k] : MIN_RANGE_M;
        slope[k] = (points[3 * k + 2] - sensor_height_m) / range;
    }
}

}  // namespace

LevelPoints level_points(View2<const float> points, View1<const bool> clutter, View2<const float> level_from_sensor,
                         float near_m, float far_m, double heading) {
    const std::size_t count = points.rows, blocks = (count + BLOCK - 1) / BLOCK;
    const float *transform = level_from_sensor.data, height_m = level_from_sensor(2, 3);
    const bool has_ego = float(MIN_EGO_HEIGHT_M) <= height_m && height_m <= float(MAX_EGO_HEIGHT_M);
    const Limits limits{near_m * near_m,
                        far_m * far_m,
                        has_ego ? float(EGO_LENGTH_M) : 0.0f,
                        has_ego ? float(EGO_WIDTH_M) : 0.0f,
                        float(std::cos(heading)),
                        float(std::sin(heading))};
    const std::size_t parts = std::min(count_parts(count, PART), std::max<std::size_t>(blocks, 1));

    // 1. Mark the kept points and count them by block, so that each block knows its first output index.
    Buffer<std::uint8_t> kept(count);
    std::vector<std::size_t> first(blocks + 1, 0);
    for_ranges(blocks, parts, [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t b = begin; b < end; ++b) {
            const std::size_t start = b * BLOCK, size = std::min(BLOCK, count - start);
            const bool* mask = clutter.size ? &clutter[start] : nullptr;
            first[b + 1] = std::size_t(mark_kept(points[start], mask, size, transform, limits, &kept[start]));
        }
    });
    for (std::size_t b = 0; b < blocks; ++b) first[b + 1] += first[b];

    // 2. Level and measure the kept points, block by block.
    const std::size_t room = first[blocks];
    LevelPoints level{room, Buffer<float>(3 * room), Buffer<float>(room), Buffer<float>(room), Buffer<float>(room),
                      Buffer<std::int32_t>(room)};
    for_ranges(blocks, parts, [&](std::size_t, std::size_t begin, std::size_t end) {
        Block block;
        for (std::size_t b = begin; b < end; ++b) {
            const std::size_t start = b * BLOCK, size = std::min(BLOCK, count - start), at = first[b];
            const std::size_t number = first[b + 1] - at;
            std::int32_t* rows = level.rows.data() + at;
            if (number == size) {
                take_all(points[start], size, start, block, rows);
            } else {
                gather_kept(points[start], &kept[start], size, start, block, rows);
            }
            measure_block(block, number, transform, level.points.data() + 3 * at, level.range_m.data() + at,
                          level.azimuth.data() + at);
        }
    });
    return level;
}

void measure_heights(LevelPoints& level, const Ground& ground) {
    for_ranges(level.count, count_parts(level.count, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t start = begin; start < end; start += BLOCK) {
            measure_heights(level.points.data() + 3 * start, std::min(BLOCK, end - start), ground,
                            level.height_m.data() + start);
        }
    });
}

void mark_cells(View2<const float> points, View1<const float> height_m, const SquareCells& of, View1<bool> mask) {
    std::fill(mask.begin(), mask.end(), false);
    std::int32_t cell[BLOCK];
    for (std::size_t start = 0; start < points.rows; start += BLOCK) {
        const std::size_t size = std::min(BLOCK, points.rows - start);
        find_cells(points[start], &height_m[start], size, of.x0_m, of.y0_m, of.cells_per_m, of.low_m, of.high_m, of.cells, cell);
        for (std::size_t k = 0; k < size; ++k) mask[cell[k]] = true;
    }
}

void beam_slopes(View2<const float> points, View1<const float> range_m, float sensor_height_m,
                 View1<const bool> left_out, View1<const std::int32_t> rows, View1<float> slope) {
    for_ranges(rows.size, count_parts(rows.size, 2 * PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        slopes_of_block(points[begin], &range_m[begin], end - begin, sensor_height_m, &slope[begin]);
        if (left_out.size == 0) return;
        for (std::size_t k = begin; k < end; ++k) {
            slope[k] = left_out[rows[k]] ? std::numeric_limits<float>::infinity() : slope[k];
        }
    });
}

}  // namespace viewshed
