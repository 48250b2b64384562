#include "history.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "vectors.hpp"

namespace viewshed {
namespace {

// Obstacle pixels of similar depth within GAP_ROWS (8°) or GAP_COLUMNS (2°) belong to one obstacle.
constexpr int GAP_ROWS = 40, GAP_COLUMNS = 8;
constexpr float SIMILAR = 1.25f;

// A gap in which something farther was seen is closed if it is narrower than this: that was seen from another position.
constexpr double MAX_GAP_M = 1.0;

// Obstacle map around the sensor. An obstacle is confirmed if two sweeps saw it in the same or neighboring cells.
constexpr float MAP_CELL_M = 0.5f;
constexpr std::int32_t MAP_CELLS = 512;

// Map values: no sweep, and several sweeps; a single sweep is stored by its number, from 1.
constexpr std::int32_t NOBODY = 0, SEVERAL = -1;

// Nearer obstacles are ignored: too near for a direction, and often the vehicle itself.
constexpr float NEAREST_M = 1.0f;

// A line of sight is open if more than this share of a target is visible past the remembered obstacles.
constexpr float MIN_VIEW_SHARE = 0.05f;

// Short names of the header's constants.
constexpr std::size_t ROWS = SLOPE_ROWS, COLUMNS = AZIMUTHS;

constexpr float NONE = std::numeric_limits<float>::infinity();

}  // namespace

std::vector<Point> obstacle_points(View2<const float> points, View1<const float> height_m, View2<const float> transform,
                                   float least_m) {
    std::vector<Point> moved;
    for (std::size_t n = 0; n < points.rows; ++n) {
        if (!(height_m[n] > least_m)) continue;
        const float *p = points[n], *x = transform[0], *y = transform[1], *z = transform[2];
        moved.push_back({x[0] * p[0] + x[1] * p[1] + x[2] * p[2] + x[3], y[0] * p[0] + y[1] * p[1] + y[2] * p[2] + y[3],
                         z[0] * p[0] + z[1] * p[1] + z[2] * p[2] + z[3]});
    }
    return moved;
}

namespace {

// Return the map cell of a point, at least one from the edge; -1 outside.
std::int32_t map_cell(float x, float y) {
    const float u = std::floor(x * (1.0f / MAP_CELL_M)) + MAP_CELLS / 2;
    const float v = std::floor(y * (1.0f / MAP_CELL_M)) + MAP_CELLS / 2;
    const bool inside = u >= 1 && v >= 1 && u < MAP_CELLS - 1 && v < MAP_CELLS - 1;
    return inside ? std::int32_t(u) * MAP_CELLS + std::int32_t(v) : -1;
}

// Return the pixel of a direction, -1 outside.
INLINE std::int32_t pixel_of(float azimuth, float slope) {
    const float row = (slope - float(MIN_SLOPE)) * float(ROWS / (MAX_SLOPE - MIN_SLOPE));
    float column = (azimuth + PI) * float(COLUMNS / (2 * std::numbers::pi));
    column = column > 0.0f ? column : 0.0f;
    column = column < float(COLUMNS - 1) ? column : float(COLUMNS - 1);
    const bool inside = (row >= 0.0f) & (row < float(ROWS));
    return inside ? std::int32_t(row) * std::int32_t(COLUMNS) + std::int32_t(column) : -1;
}

// Write a sweep's number into the cells of its obstacles; SEVERAL where another sweep's is.
void mark_cells(const std::vector<Point>& points, std::int32_t number, std::vector<std::int32_t>& seen_by) {
    for (const Point& p : points) {
        const std::int32_t cell = map_cell(p.x, p.y);
        if (cell < 0) continue;
        const bool is_free = seen_by[cell] == NOBODY || seen_by[cell] == number;
        seen_by[cell] = is_free ? number : SEVERAL;
    }
}

// Draw a sweep's obstacles that another sweep saw as well. `own` is the sweep's number; NOBODY draws all.
void draw_obstacles(const std::vector<Point>& points, float sensor_height_m, const std::vector<std::int32_t>& seen_by,
                    std::int32_t own, View2<float> image) {
    for (const Point& p : points) {
        const float range_m = std::sqrt(p.x * p.x + p.y * p.y);
        const std::int32_t cell = map_cell(p.x, p.y);
        if (cell < 0 || range_m < NEAREST_M) continue;
        // Look for another sweep's mark in the cell and its eight neighbors.
        bool confirmed = false;
        for (const std::int32_t row : {cell - MAP_CELLS, cell, cell + MAP_CELLS}) {
            for (const std::int32_t at : {row - 1, row, row + 1}) {
                confirmed |= (seen_by[at] != NOBODY) & (seen_by[at] != own);
            }
        }
        if (!confirmed) continue;
        const std::int32_t pixel = pixel_of(azimuth_of(p.y, p.x), (p.z - sensor_height_m) / range_m);
        if (pixel >= 0) image.data[pixel] = std::min(image.data[pixel], range_m);
    }
}

// Fill gaps of at most `gap` steps between pixels of similar depth in a line, e.g. between rings. A line has `size`
// pixels, `step` apart. Gaps with farther pixels, which were seen from another position, are filled only if they are
// narrower than `narrow` steps at one meter.
void fill_gaps(float* line, int size, std::size_t step, int gap, float narrow) {
    for (int at = 0; at < size; ++at) {
        const float depth = line[at * step];
        if (depth == NONE) continue;
        // Go back to the nearest pixel that is no farther: the same obstacle, or no gap of this one.
        int before = at - 1;
        bool seen_through = false;
        while (before >= 0 && at - before <= gap && line[before * step] >= depth * SIMILAR) {
            seen_through |= line[before * step] < NONE;
            --before;
        }
        if (before < 0 || at - before <= 1 || at - before > gap || depth >= line[before * step] * SIMILAR) continue;
        const float fill = std::max(depth, line[before * step]);
        if (!seen_through || float(at - before) * fill < narrow) {
            for (int between = before + 1; between < at; ++between) line[between * step] = fill;
        }
    }
}

// Close the gaps between rings and between columns of an obstacle.
void close_gaps(View2<float> image) {
    constexpr double ROW_STEP = (MAX_SLOPE - MIN_SLOPE) / ROWS, COLUMN_STEP = 2 * std::numbers::pi / COLUMNS;
    for (std::size_t c = 0; c < COLUMNS; ++c) {
        fill_gaps(image[0] + c, int(ROWS), COLUMNS, GAP_ROWS, float(MAX_GAP_M / ROW_STEP));
    }
    for (std::size_t r = 0; r < ROWS; ++r) {
        fill_gaps(image[r], int(COLUMNS), 1, GAP_COLUMNS, float(MAX_GAP_M / COLUMN_STEP));
    }
}

// Remove pixels at the left, right and upper edges of obstacles: a beam in an edge pixel may pass beside the obstacle.
// Obstacles narrower than three pixels vanish.
void leave_out_edges(View2<float> image) {
    std::vector<float> above(COLUMNS, NONE), row(COLUMNS);
    for (std::size_t r = ROWS; r-- > 0;) {  // from the top, so that the row above is unmodified
        std::copy_n(image[r], COLUMNS, row.data());
        for (std::size_t c = 0; c < COLUMNS; ++c) {
            const float farthest = std::max({row[(c + COLUMNS - 1) % COLUMNS], row[(c + 1) % COLUMNS], above[c]});
            if (farthest > row[c] * SIMILAR) image[r][c] = NONE;
        }
        above.swap(row);
    }
}

}  // namespace

void draw_image(const std::vector<std::vector<Point>>& sweeps, float sensor_height_m, View2<float> image) {
    // 1. Mark which sweeps saw an obstacle in each map cell.
    std::vector<std::int32_t> seen_by(std::size_t(MAP_CELLS) * MAP_CELLS, NOBODY);
    for (std::size_t k = 0; k < sweeps.size(); ++k) mark_cells(sweeps[k], std::int32_t(k) + 1, seen_by);
    // 2. Draw confirmed obstacles; all of a single sweep.
    std::fill_n(image.data, image.size(), NONE);
    for (std::size_t k = 0; k < sweeps.size(); ++k) {
        const std::int32_t own = sweeps.size() > 1 ? std::int32_t(k) + 1 : NOBODY;
        draw_obstacles(sweeps[k], sensor_height_m, seen_by, own, image);
    }
    // 3. Close the gaps between returns, and remove edges.
    close_gaps(image);
    leave_out_edges(image);
}

MULTIVERSION void end_at_obstacles(const float* image, const float* azimuth, const float* slope, const float* depth_m,
                                   std::size_t size, float* out) {
    for (std::size_t n = 0; n < size; ++n) {
        const std::int32_t pixel = pixel_of(azimuth[n], slope[n]);
        const float obstacle_m = pixel >= 0 ? image[pixel] : NONE;
        out[n] = obstacle_m < depth_m[n] ? obstacle_m : depth_m[n];
    }
}

void confirm_cells(View2<const bool> seen, View2<const float> earlier_from_now, const float* origin_m, float cell_m,
                   const float* open, const float* whole, bool* confirmed) {
    const std::size_t cells = seen.rows;
    const float per_m = 1.0f / cell_m, side = float(cells);
    const float *to_x = earlier_from_now[0], *to_y = earlier_from_now[1];
    for (std::size_t i = 0; i < cells; ++i) {
        const float x = origin_m[0] + (float(i) + 0.5f) * cell_m;
        for (std::size_t j = 0; j < cells; ++j) {
            const float y = origin_m[1] + (float(j) + 0.5f) * cell_m;
            const float u = (to_x[0] * x + to_x[1] * y + to_x[2] - origin_m[0]) * per_m;
            const float v = (to_y[0] * x + to_y[1] * y + to_y[2] - origin_m[1]) * per_m;
            const bool there = u >= 0 && v >= 0 && u < side && v < side && seen(std::size_t(u), std::size_t(v));
            const std::size_t n = i * cells + j;
            confirmed[n] = there && open[n] > MIN_VIEW_SHARE * whole[n];
        }
    }
}

void sight_lines(View1<float> azimuth, View1<float> slope) {
    constexpr std::size_t rows = ROWS / SIGHT_STEP, columns = COLUMNS / SIGHT_STEP;
    for (std::size_t r = 0; r < rows; ++r) {
        for (std::size_t c = 0; c < columns; ++c) {
            azimuth[r * columns + c] =
                float((double(c * SIGHT_STEP) + 0.5) * (2 * std::numbers::pi / COLUMNS) - std::numbers::pi);
            slope[r * columns + c] =
                float(MIN_SLOPE + (double(r * SIGHT_STEP) + 0.5) * ((MAX_SLOPE - MIN_SLOPE) / ROWS));
        }
    }
}

}  // namespace viewshed
