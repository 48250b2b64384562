#include "object_candidates.hpp"

#include <algorithm>
#include <bitset>
#include <cmath>
#include <numeric>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Height limits of returns that stand on the ground, and the upper limit of returns that overhang them.
constexpr float LOW_M = 0.3f, HIGH_M = 3.0f, OVERHEAD_M = 8.0f;

// Cells in which returns are pooled: cell size, half the side of the grid, cells a side, and most cells used.
constexpr float CELL_M = 0.2f, HALF_EXTENT_M = 80.0f;
constexpr int CELLS = 800;
constexpr std::size_t MAX_CELLS = 40'000;

// Linking distance of each level: at range 0, and more per meter of range.
constexpr std::size_t LEVELS = 4;
constexpr std::array<float, LEVELS> GAP_M{0.3f, 0.45f, 0.7f, 1.0f}, GAP_PER_M{0.0f, 0.006f, 0.012f, 0.02f};

// Limits of a candidate's returns and side length, and of the number of candidates.
constexpr std::int32_t FEWEST_RETURNS = 4;
constexpr float LONGEST_M = 20.0f;
constexpr std::size_t MAX_CANDIDATES = 2'000;

// Most returns used to fit the heading, and to compute the shape.
constexpr std::size_t FIT_RETURNS = 64, SHAPE_RETURNS = 256;

// Heading steps in degrees over a quarter turn: a coarse search, then a fine one around the best.
constexpr int COARSE_DEG = 6, FINE_DEG = 1;
constexpr float RAD_PER_DEG = PI / 180;

// Distances within which a return lies on a side, and near a side: range noise.
constexpr float ON_SIDE_M = 0.1f, NEAR_SIDE_M = 0.15f;

// Azimuth columns of the nearest return, to detect what hides the ends of a candidate, ...
constexpr std::size_t COLUMNS = 1024;
// ... within BESIDE_M beyond the end and BEFORE_M nearer.
constexpr float BESIDE_M = 0.6f, BEFORE_M = 0.7f;

// Elevation layers of returns: their step in slope, and their number.
constexpr float LAYER_SLOPE = 0.004f;
constexpr int LAYERS = 512;

// Candidates of each part.
constexpr std::size_t PART = 24;

struct Cell {
    std::int32_t at;      // row * CELLS + column
    std::int32_t first;   // of its returns in the rows sorted by cell
    std::int32_t count, over;
    float x, y, range_m;  // mean of its returns
};

// Disjoint sets (union-find).
class Sets {
public:
    explicit Sets(std::size_t size) : above_(size) { std::iota(above_.begin(), above_.end(), 0); }

    std::int32_t root(std::int32_t k) {
        while (above_[k] != k) k = above_[k] = above_[above_[k]];
        return k;
    }
    // The lower index stays the root, independent of the order of joining.
    void join(std::int32_t a, std::int32_t b) {
        a = root(a);
        b = root(b);
        if (a < b) above_[b] = a;
        if (b < a) above_[a] = b;
    }

private:
    std::vector<std::int32_t> above_;
};

// Return the cell of a position, -1 outside.
INLINE std::int32_t cell_of(float x, float y) {
    const bool inside = std::fabs(x) < HALF_EXTENT_M && std::fabs(y) < HALF_EXTENT_M;
    if (!inside) return -1;
    const int i = std::min(int((x + HALF_EXTENT_M) / CELL_M), CELLS - 1);
    const int j = std::min(int((y + HALF_EXTENT_M) / CELL_M), CELLS - 1);
    return i * CELLS + j;
}

// Return the cells that hold returns, and sort the rows of the points by cell. `number` (CELLS²) maps to them, -1 for
// none.
std::vector<Cell> cells_of(View2<const float> points, View1<const float> height_m, Buffer<std::int32_t>& number,
                           std::vector<std::int32_t>& rows) {
    const std::size_t count = points.rows;
    std::fill(number.begin(), number.end(), -1);
    // 1. Count the standing returns in each cell.
    std::vector<Cell> cells;
    std::vector<std::int32_t> cell_of_point(count);
    std::size_t standing = 0;
    for (std::size_t n = 0; n < count; ++n) {
        cell_of_point[n] = -1;
        if (!(height_m[n] >= LOW_M && height_m[n] < HIGH_M)) continue;
        const std::int32_t at = cell_of(points(n, 0), points(n, 1));
        if (at < 0) continue;
        std::int32_t& k = number[at];
        if (k < 0) {
            k = std::int32_t(cells.size());
            cells.push_back({at, 0, 0, 0, 0.0f, 0.0f, 0.0f});
        }
        ++cells[k].count;
        cell_of_point[n] = k;
        ++standing;
    }
    // 2. Keep the nearest cells if there are too many, by whole meters of range.
    if (cells.size() > MAX_CELLS) {
        std::array<std::size_t, std::size_t(2 * HALF_EXTENT_M)> within{};
        const auto ring_of = [](const Cell& cell) {
            const float x = float(cell.at / CELLS) * CELL_M - HALF_EXTENT_M, y = float(cell.at % CELLS) * CELL_M - HALF_EXTENT_M;
            return std::min(std::size_t(std::hypot(x, y)), std::size_t(2 * HALF_EXTENT_M) - 1);
        };
        for (const Cell& cell : cells) ++within[ring_of(cell)];
        std::size_t rings = 0, total = 0;
        while (rings < within.size() && total + within[rings] <= MAX_CELLS) total += within[rings++];
        std::vector<std::int32_t> kept(cells.size(), -1);
        std::size_t next = 0;
        for (std::size_t k = 0; k < cells.size(); ++k) {
            if (ring_of(cells[k]) < rings) {
                kept[k] = std::int32_t(next);
                cells[next++] = cells[k];
            } else {
                number[cells[k].at] = -1;
            }
        }
        cells.resize(next);
        for (std::size_t k = 0; k < next; ++k) number[cells[k].at] = std::int32_t(k);
        standing = 0;
        for (std::int32_t& k : cell_of_point) {
            k = k < 0 ? -1 : kept[k];
            standing += k >= 0;
        }
    }
    // 3. Sort the rows by cell, and average each cell.
    std::int32_t next = 0;
    for (Cell& cell : cells) {
        cell.first = next;
        next += cell.count;
        cell.count = 0;
    }
    rows.resize(standing);
    for (std::size_t n = 0; n < count; ++n) {
        if (cell_of_point[n] >= 0) {
            Cell& cell = cells[cell_of_point[n]];
            rows[cell.first + cell.count++] = std::int32_t(n);
            cell.x += points(n, 0);
            cell.y += points(n, 1);
        } else if (height_m[n] >= HIGH_M && height_m[n] < OVERHEAD_M) {
            const std::int32_t at = cell_of(points(n, 0), points(n, 1));
            if (at >= 0 && number[at] >= 0) ++cells[number[at]].over;
        }
    }
    for (Cell& cell : cells) {
        cell.x /= float(cell.count);
        cell.y /= float(cell.count);
        cell.range_m = std::hypot(cell.x, cell.y);
    }
    return cells;
}

// Call visit(k, other, squared distance) once for each pair of cells within a level's distance.
template <typename Visit>
INLINE void for_pairs(const std::vector<Cell>& cells, const Buffer<std::int32_t>& number, std::size_t level, const Visit& visit) {
    for (std::size_t k = 0; k < cells.size(); ++k) {
        const Cell& one = cells[k];
        const float gap_m = GAP_M[level] + GAP_PER_M[level] * one.range_m, gap_m2 = gap_m * gap_m;
        const int steps = int(gap_m / CELL_M) + 1, i = one.at / CELLS, j = one.at % CELLS;
        // Half of the neighborhood, so that each pair occurs once.
        for (int p = i; p <= std::min(i + steps, CELLS - 1); ++p) {
            const int from = p == i ? j + 1 : std::max(j - steps, 0), to = std::min(j + steps, CELLS - 1);
            const std::int32_t* row = number.data() + std::size_t(p) * CELLS;
            for (int q = from; q <= to; ++q) {
                if (row[q] < 0) continue;
                const float dx = cells[row[q]].x - one.x, dy = cells[row[q]].y - one.y, apart_m2 = dx * dx + dy * dy;
                if (apart_m2 <= gap_m2) visit(k, row[q], apart_m2);
            }
        }
    }
}

// Link cells at each level; sets of a larger distance contain those of a smaller one.
std::vector<Sets> link_cells(const std::vector<Cell>& cells, const Buffer<std::int32_t>& number) {
    // 1. The smallest distance, with most pairs.
    Sets smallest(cells.size());
    for_pairs(cells, number, 0, [&](std::size_t k, std::int32_t other, float) { smallest.join(std::int32_t(k), other); });
    std::vector<std::int32_t> part(cells.size());
    for (std::size_t k = 0; k < cells.size(); ++k) part[k] = smallest.root(std::int32_t(k));
    // 2. Larger distances, only between different parts.
    std::vector<Sets> sets(LEVELS, smallest);
    for_pairs(cells, number, LEVELS - 1, [&](std::size_t k, std::int32_t other, float apart_m2) {
        if (part[k] == part[other]) return;
        for (std::size_t l = LEVELS; l-- > 1;) {
            const float gap_m = GAP_M[l] + GAP_PER_M[l] * cells[k].range_m;
            if (apart_m2 > gap_m * gap_m) return;
            sets[l].join(part[k], part[other]);
        }
    });
    return sets;
}

// A span of sorted cells that are linked at one level.
struct Span {
    std::int32_t first, last, parent, returns;
    std::size_t level;
};

// Sort cells so that every set of every level is a span; return the spans that are larger than their parts.
std::vector<Span> spans_of(std::vector<Cell>& cells, std::vector<Sets>& sets) {
    const std::size_t count = cells.size();
    std::vector<std::array<std::int32_t, LEVELS>> roots(count);
    for (std::size_t k = 0; k < count; ++k) {
        for (std::size_t l = 0; l < LEVELS; ++l) roots[k][l] = sets[l].root(std::int32_t(k));
    }
    // 1. Radix sort by the roots, from the smallest distance to the largest; each pass is stable.
    std::vector<std::int32_t> order(count), sorted(count), next(count + 1);
    std::iota(order.begin(), order.end(), 0);
    for (std::size_t l = 0; l < LEVELS; ++l) {
        std::fill(next.begin(), next.end(), 0);
        for (std::size_t k = 0; k < count; ++k) ++next[roots[k][l] + 1];
        std::partial_sum(next.begin(), next.end(), next.begin());
        for (const std::int32_t k : order) sorted[next[roots[k][l]]++] = k;
        order.swap(sorted);
    }
    std::vector<Cell> in_order(count);
    for (std::size_t k = 0; k < count; ++k) in_order[k] = cells[order[k]];
    cells.swap(in_order);
    // 2. Build spans from the largest distance down; a span equal to its parent replaces the parent's level.
    std::vector<Span> spans;
    std::vector<std::int32_t> holder(count, -1);
    for (std::size_t l = LEVELS; l-- > 0;) {
        for (std::size_t k = 0; k < count;) {
            std::size_t end = k + 1;
            while (end < count && roots[order[end]][l] == roots[order[k]][l]) ++end;
            const std::int32_t parent = holder[k];
            if (parent >= 0 && spans[parent].first == std::int32_t(k) && spans[parent].last == std::int32_t(end)) {
                spans[parent].level = l;
            } else {
                std::int32_t returns = 0;
                for (std::size_t c = k; c < end; ++c) returns += cells[c].count;
                if (returns >= FEWEST_RETURNS) {
                    std::fill(holder.begin() + k, holder.begin() + end, std::int32_t(spans.size()));
                    spans.push_back({std::int32_t(k), std::int32_t(end), parent, returns, l});
                }
            }
            k = end;
        }
    }
    return spans;
}

// Minimum and maximum of added values.
struct Interval {
    float low = 1e30f, high = -1e30f;

    void add(float value) {
        low = value < low ? value : low;
        high = value > high ? value : high;
    }
    float length() const { return high > low ? high - low : 0.0f; }
};

// Return the closeness criterion of Zhang et al. 2017: how well returns (n,) lie on the sides of their rotated box.
MULTIVERSION float closeness(const float* x, const float* y, std::size_t count, float c, float s) {
    float a_low = 1e30f, a_high = -1e30f, b_low = 1e30f, b_high = -1e30f;
    for (std::size_t n = 0; n < count; ++n) {
        const float a = x[n] * c + y[n] * s, b = y[n] * c - x[n] * s;
        a_low = a < a_low ? a : a_low;
        a_high = a > a_high ? a : a_high;
        b_low = b < b_low ? b : b_low;
        b_high = b > b_high ? b : b_high;
    }
    float sum = 0.0f;
    for (std::size_t n = 0; n < count; ++n) {
        const float a = x[n] * c + y[n] * s, b = y[n] * c - x[n] * s;
        const float one = a - a_low < a_high - a ? a - a_low : a_high - a;
        const float other = b - b_low < b_high - b ? b - b_low : b_high - b;
        const float away_m = one < other ? one : other;
        sum += 1.0f / (away_m > ON_SIDE_M ? away_m : ON_SIDE_M);
    }
    return sum;
}

// Return the heading in [0, π/2) with the best closeness.
float heading_of(const float* x, const float* y, std::size_t count) {
    const auto value = [&](int degrees) {
        return closeness(x, y, count, std::cos(float(degrees) * RAD_PER_DEG), std::sin(float(degrees) * RAD_PER_DEG));
    };
    int best = 0;
    float max_closeness = -1.0f;
    const auto try_heading = [&](int degrees) {
        const float now = value(degrees);
        if (now > max_closeness) {
            max_closeness = now;
            best = degrees;
        }
    };
    for (int degrees = 0; degrees < 90; degrees += COARSE_DEG) try_heading(degrees);
    const int middle = best;
    for (int away = FINE_DEG; away < COARSE_DEG; away += FINE_DEG) {
        try_heading(middle - away);
        try_heading(middle + away);
    }
    return float((best + 90) % 90) * RAD_PER_DEG;
}

std::size_t column_of(float azimuth) {
    const float turns = (azimuth + PI) / (2 * PI);
    return std::min(std::size_t((turns - std::floor(turns)) * float(COLUMNS)), COLUMNS - 1);
}

// Check if something nearer than range_m stands within BESIDE_M beyond an azimuth, on the side of `step`.
bool is_hidden_beside(const std::vector<float>& nearest_m, float azimuth, float range_m, int step) {
    const int columns = 1 + int(BESIDE_M / std::max(range_m, 1.0f) * float(COLUMNS) / (2 * PI));
    const int at = int(column_of(azimuth));
    for (int k = 1; k <= columns; ++k) {
        const int column = ((at + step * k) % int(COLUMNS) + int(COLUMNS)) % int(COLUMNS);
        if (nearest_m[column] < range_m - BEFORE_M) return true;
    }
    return false;
}

// Inputs shared by all candidates.
struct Sweep {
    View2<const float> points;
    View1<const float> height_m;
    float sensor_height_m;
    const std::vector<std::int32_t>& rows;
    const std::vector<float>& nearest_m;  // (COLUMNS,) by azimuth
};

// Fit a box to the returns of a span and compute its shape.
void describe(const Sweep& sweep, const std::vector<Cell>& cells, const Span& span, std::int32_t first, std::int32_t last,
              std::array<float, 6>& sides, std::array<float, SHAPES>& shape) {
    // 1. Sample its returns evenly.
    std::array<float, SHAPE_RETURNS> x, y, z;
    const auto total = std::size_t(last - first), count = std::min(total, SHAPE_RETURNS);
    for (std::size_t n = 0; n < count; ++n) {
        const std::int32_t row = sweep.rows[std::size_t(first) + n * total / count];
        x[n] = sweep.points(row, 0);
        y[n] = sweep.points(row, 1);
        z[n] = sweep.height_m[row];
    }
    // 2. Fit the heading on fewer returns.
    std::array<float, FIT_RETURNS> fit_x, fit_y;
    const std::size_t fitted = std::min(count, FIT_RETURNS);
    for (std::size_t n = 0; n < fitted; ++n) {
        fit_x[n] = x[n * count / fitted];
        fit_y[n] = y[n * count / fitted];
    }
    float heading = heading_of(fit_x.data(), fit_y.data(), fitted);
    float c = std::cos(heading), s = std::sin(heading);
    Interval along, across;
    for (std::size_t n = 0; n < count; ++n) {
        along.add(x[n] * c + y[n] * s);
        across.add(y[n] * c - x[n] * s);
    }
    if (across.length() > along.length()) {  // use the heading of the long side
        heading += PI / 2;
        const float turned = c;
        c = -s;
        s = turned;
        const Interval before = along;
        along = across;
        across = {-before.high, -before.low};
    }
    // 3. Heights, distances to the sides, and extents of the upper and the lower part.
    const bool near_low_a = std::fabs(along.low) < std::fabs(along.high), near_low_b = std::fabs(across.low) < std::fabs(across.high);
    const bool beside_a = along.low > 0 || along.high < 0, beside_b = across.low > 0 || across.high < 0;
    float top = 0.0f, bottom = 1e30f, z1 = 0.0f, z2 = 0.0f, x1 = 0.0f, y1 = 0.0f;
    for (std::size_t n = 0; n < count; ++n) {
        top = std::max(top, z[n]);
        bottom = std::min(bottom, z[n]);
        z1 += z[n];
        z2 += z[n] * z[n];
        x1 += x[n];
        y1 += y[n];
    }
    const float per = 1.0f / float(count);
    z1 *= per;
    x1 *= per;
    y1 *= per;
    const float range_m = std::max(std::hypot(x1, y1), 0.1f);
    Interval upper_a, upper_b, lower_a, lower_b, turn;
    std::array<float, 4> bands{};
    std::array<float, 3> thirds{};
    std::bitset<LAYERS> layers;
    float left_m = range_m, right_m = range_m;  // ranges of its ends
    float edge = 0.0f, on_edge = 0.0f, face = 0.0f, on_face = 0.0f, xx = 0.0f, xy = 0.0f, yy = 0.0f;
    for (std::size_t n = 0; n < count; ++n) {
        const float a = x[n] * c + y[n] * s, b = y[n] * c - x[n] * s;
        const float da = std::min(a - along.low, along.high - a), db = std::min(b - across.low, across.high - b);
        const float away_m = std::min(da, db);
        edge += away_m;
        on_edge += away_m < NEAR_SIDE_M;
        // Sides that face the sensor: one or two.
        const float fa = beside_a ? (near_low_a ? a - along.low : along.high - a) : 1e30f;
        const float fb = beside_b ? (near_low_b ? b - across.low : across.high - b) : 1e30f;
        const float before_m = std::min({fa, fb, 10.0f});
        face += before_m;
        on_face += before_m < NEAR_SIDE_M;
        (z[n] > 0.6f * top ? upper_a : lower_a).add(a);
        (z[n] > 0.6f * top ? upper_b : lower_b).add(b);
        ++bands[z[n] < 0.6f ? 0 : z[n] < 1.2f ? 1 : z[n] < 1.8f ? 2 : 3];
        const auto third = std::min(std::size_t((a - along.low) / std::max(along.length(), 0.01f) * 3.0f), std::size_t{2});
        thirds[third] = std::max(thirds[third], z[n]);
        xx += (x[n] - x1) * (x[n] - x1);
        xy += (x[n] - x1) * (y[n] - y1);
        yy += (y[n] - y1) * (y[n] - y1);
        const float own_m = std::max(std::sqrt(x[n] * x[n] + y[n] * y[n]), 0.1f);
        const float layer = std::trunc((z[n] - sweep.sensor_height_m) / own_m / LAYER_SLOPE) + LAYERS / 2;
        layers[std::size_t(std::clamp(layer, 0.0f, float(LAYERS - 1)))] = true;
        // Azimuth relative to the center: a candidate may surround the sensor.
        const float away = azimuth_of(y[n] * x1 - x[n] * y1, x[n] * x1 + y[n] * y1);
        left_m = away >= turn.high ? own_m : left_m;
        right_m = away <= turn.low ? own_m : right_m;
        turn.add(away);
    }
    // 4. Check what hides its ends.
    const float azimuth = std::atan2(y1, x1);
    const float hidden_left = is_hidden_beside(sweep.nearest_m, azimuth + turn.high, left_m, 1);
    const float hidden_right = is_hidden_beside(sweep.nearest_m, azimuth + turn.low, right_m, -1);
    float over = 0.0f;
    for (std::int32_t k = span.first; k < span.last; ++k) over += float(cells[k].over);
    const float middle = 0.5f * (xx + yy) * per, spread = std::hypot(0.5f * (xx - yy) * per, xy * per);
    const float cells_of_box = (along.length() / CELL_M + 1.0f) * (across.length() / CELL_M + 1.0f);
    const float sight = (x1 * c + y1 * s) / range_m;
    const float hidden_end = (hidden_left > 0) == (hidden_right > 0) ? 0.0f : hidden_left > 0 ? 1.0f : 2.0f;
    sides = {heading, along.low, along.high, across.low, across.high, hidden_end};
    shape[LOG_RETURNS] = std::log(float(total));
    shape[LOG_RANGE] = std::log(range_m);
    shape[LEVEL] = float(span.level);
    shape[LONG_M] = along.length();
    shape[SHORT_M] = across.length();
    shape[TOP_M] = top;
    shape[BOTTOM_M] = bottom;
    shape[MEAN_M] = z1;
    shape[DEVIATION_M] = std::sqrt(std::max(z2 * per - z1 * z1, 0.0f));
    shape[OVERHEAD] = std::log1p(over) - std::log1p(float(total));
    shape[SHARE_LOW] = bands[0] * per;
    shape[SHARE_MIDDLE] = bands[1] * per;
    shape[SHARE_HIGH] = bands[2] * per;
    shape[SHARE_TALL] = bands[3] * per;
    shape[UPPER_LONG_M] = upper_a.length();
    shape[UPPER_SHORT_M] = upper_b.length();
    shape[LOWER_LONG_M] = lower_a.length();
    shape[LOWER_SHORT_M] = lower_b.length();
    shape[EDGE_M] = edge * per;
    shape[EDGE_SHARE] = on_edge * per;
    shape[FACE_M] = face * per;
    shape[FACE_SHARE] = on_face * per;
    shape[ALIGNMENT] = sight * sight;
    shape[FILL] = float(span.last - span.first) / cells_of_box;
    shape[MIDDLE_RISE_M] = thirds[1] - 0.5f * (thirds[0] + thirds[2]);
    shape[MAJOR_M] = std::sqrt(std::max(middle + spread, 0.0f));
    shape[MINOR_M] = std::sqrt(std::max(middle - spread, 0.0f));
    shape[LOG_LAYERS] = std::log(float(layers.count()));
    shape[HIDDEN_LEFT] = hidden_left;
    shape[HIDDEN_RIGHT] = hidden_right;
}

}  // namespace

Candidates find_candidates(View2<const float> points, View1<const float> height_m, View1<const float> range_m,
                           float sensor_height_m) {
    Candidates found;
    // 1. Pool standing returns in cells.
    Buffer<std::int32_t> number(std::size_t(CELLS) * CELLS);
    std::vector<std::int32_t> by_cell;
    std::vector<Cell> cells = cells_of(points, height_m, number, by_cell);
    // 2. Link cells at every level.
    std::vector<Sets> sets = link_cells(cells, number);
    std::vector<Span> spans = spans_of(cells, sets);
    // 3. Sort rows by component; store where each cell begins.
    std::vector<std::int32_t> begins(cells.size() + 1, 0);
    found.rows.reserve(by_cell.size());
    for (std::size_t k = 0; k < cells.size(); ++k) {
        found.rows.insert(found.rows.end(), by_cell.begin() + cells[k].first, by_cell.begin() + cells[k].first + cells[k].count);
        begins[k + 1] = std::int32_t(found.rows.size());
    }
    // 4. Drop spans that are too long, and the smallest if there are too many.
    std::vector<std::int32_t> kept;
    for (std::size_t k = 0; k < spans.size(); ++k) {
        Interval x, y;
        for (std::int32_t c = spans[k].first; c < spans[k].last; ++c) {
            x.add(cells[c].x);
            y.add(cells[c].y);
        }
        if (std::hypot(x.length(), y.length()) <= LONGEST_M) kept.push_back(std::int32_t(k));
    }
    if (kept.size() > MAX_CANDIDATES) {
        const auto more = [&](std::int32_t a, std::int32_t b) {
            return spans[a].returns != spans[b].returns ? spans[a].returns > spans[b].returns : a < b;
        };
        std::nth_element(kept.begin(), kept.begin() + MAX_CANDIDATES, kept.end(), more);
        kept.resize(MAX_CANDIDATES);
        std::sort(kept.begin(), kept.end());
    }
    std::vector<std::int32_t> place(spans.size(), -1);
    for (std::size_t k = 0; k < kept.size(); ++k) place[kept[k]] = std::int32_t(k);
    // 5. Find the nearest return in each azimuth column.
    std::vector<float> nearest_m(COLUMNS, 1e30f);
    for (const std::int32_t row : found.rows) {
        float& nearest = nearest_m[column_of(azimuth_of(points(row, 1), points(row, 0)))];
        nearest = std::min(nearest, range_m[row]);
    }
    // 6. Fit boxes and compute shapes.
    const std::size_t count = kept.size();
    found.first.resize(count);
    found.last.resize(count);
    found.parent.resize(count);
    found.sides.resize(count);
    found.shapes.resize(count);
    const Sweep sweep{points, height_m, sensor_height_m, found.rows, nearest_m};
    const std::size_t parts = (count + PART - 1) / PART;
    const auto part = [&](std::size_t p) {
        for (std::size_t k = p * PART; k < std::min((p + 1) * PART, count); ++k) {
            const Span& span = spans[kept[k]];
            found.first[k] = begins[span.first];
            found.last[k] = begins[span.last];
            describe(sweep, cells, span, found.first[k], found.last[k], found.sides[k], found.shapes[k]);
        }
    };
    run_parts(parts, part);
    // 7. Link each candidate to the next larger one.
    for (std::size_t k = 0; k < count; ++k) {
        const Span& span = spans[kept[k]];
        const std::int32_t parent = span.parent < 0 ? -1 : place[span.parent];
        found.parent[k] = parent;
        // A part of a span that was too long keeps it as parent, although that is no candidate.
        found.shapes[k][PARENT_SHARE] = span.parent < 0 ? 1.0f : float(span.returns) / float(spans[span.parent].returns);
        found.shapes[k][PARENT_M] = span.parent < 0 ? 0.0f : parent < 0 ? LONGEST_M : found.shapes[parent][LONG_M];
    }
    return found;
}

}  // namespace viewshed
