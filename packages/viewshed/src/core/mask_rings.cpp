#include "mask_rings.hpp"

#include <algorithm>
#include <cmath>


namespace viewshed {
namespace {

// Headings 0…3 are +i, +j, -i, -j; the mask is on the left.
constexpr int STEP_I[4] = {1, 0, -1, 0}, STEP_J[4] = {0, 1, 0, -1};
// Offsets of the cells ahead on the left and on the right of a corner.
constexpr int AHEAD_I[4] = {0, -1, -1, 0}, AHEAD_J[4] = {0, 0, -1, -1};
constexpr int RIGHT_I[4] = {0, 0, -1, -1}, RIGHT_J[4] = {-1, 0, 0, -1};

// A mask with a border of false cells.
class Cells {
public:
    explicit Cells(View2<const bool> mask) : mask_(mask) {}
    bool operator()(int i, int j) const {
        return i >= 0 && j >= 0 && i < int(mask_.rows) && j < int(mask_.columns) && mask_(std::size_t(i), std::size_t(j));
    }

private:
    View2<const bool> mask_;
};

struct Corner {
    int i, j, heading;
};

// Check if an edge along +i starts at a corner.
bool begins(const Cells& cells, int i, int j) {
    const bool here = cells(i, j) && !cells(i, j - 1), before = cells(i - 1, j) && !cells(i - 1, j - 1);
    return here && !before;
}

// Follow an edge to its end; return that corner and the next heading.
Corner next_corner(const Cells& cells, Corner at) {
    while (true) {
        at.i += STEP_I[at.heading];
        at.j += STEP_J[at.heading];
        if (!cells(at.i + AHEAD_I[at.heading], at.j + AHEAD_J[at.heading])) return {at.i, at.j, (at.heading + 1) % 4};
        if (cells(at.i + RIGHT_I[at.heading], at.j + RIGHT_J[at.heading])) return {at.i, at.j, (at.heading + 3) % 4};
    }
}

// Return the region of the cell left of a loop's first edge, negated if the loop is clockwise.
std::int32_t signed_region(const Corner* begin, const Corner* end, View2<const std::int32_t> regions) {
    std::int64_t doubled_area = 0;
    for (const Corner* k = begin; k != end; ++k) {
        const Corner* m = k + 1 != end ? k + 1 : begin;
        doubled_area += std::int64_t(k->i) * m->j - std::int64_t(m->i) * k->j;
    }
    constexpr int LEFT_I[4] = {0, -1, -1, 0}, LEFT_J[4] = {0, 0, -1, -1};
    const std::int32_t region =
        regions(std::size_t(begin->i + LEFT_I[begin->heading]), std::size_t(begin->j + LEFT_J[begin->heading]));
    return doubled_area > 0 ? region : -region;
}

std::size_t cut(double at, std::size_t cells) { return at > 0.0 ? std::size_t(std::min(at, double(cells))) : 0; }

}  // namespace

MaskRings trace_rings(View2<const bool> mask, View2<const std::int32_t> regions) {
    const Cells cells(mask);
    const int side = int(mask.rows), width = side + 1;
    MaskRings rings;
    std::vector<bool> is_done(std::size_t(width) * width);
    std::vector<std::int32_t> met(std::size_t(width) * width, -1);  // stack index of each corner
    std::vector<Corner> stack;
    const auto place = [&](int i, int j) { return std::size_t(i) * std::size_t(width) + std::size_t(j); };
    for (int i0 = 0; i0 < side; ++i0) {
        for (int j0 = 0; j0 < side; ++j0) {
            if (is_done[place(i0, j0)] || !begins(cells, i0, j0)) continue;
            // Walk along the cell edges and prefer left turns, so that diagonal cells stay separate.
            Corner at{i0, j0, 0};
            while (true) {
                const std::int32_t before = met[place(at.i, at.j)];
                if (before >= 0) {
                    // The walk returns to one of its corners: split off a loop.
                    rings.begin.push_back(std::int64_t(rings.corners.size() / 2));
                    rings.region.push_back(signed_region(&stack[std::size_t(before)], stack.data() + stack.size(), regions));
                    for (std::size_t k = std::size_t(before); k < stack.size(); ++k) {
                        rings.corners.push_back(std::int16_t(stack[k].i));
                        rings.corners.push_back(std::int16_t(stack[k].j));
                        met[place(stack[k].i, stack[k].j)] = -1;
                    }
                    stack.resize(std::size_t(before));
                    if (stack.empty() && at.i == i0 && at.j == j0 && at.heading == 0) break;
                }
                met[place(at.i, at.j)] = std::int32_t(stack.size());
                stack.push_back(at);
                if (at.heading == 0) is_done[place(at.i, at.j)] = true;
                at = next_corner(cells, at);
            }
        }
    }
    rings.begin.push_back(std::int64_t(rings.corners.size() / 2));
    return rings;
}

void fill_closed_rings(const ClosedRings& rings, View2<bool> inside) {
    const std::size_t cells = inside.rows;
    std::fill_n(inside.data, inside.size(), false);
    for (std::size_t r = 0; r + 1 < rings.begin.size; ++r) {
        for (auto k = std::size_t(rings.begin[r]); k + 1 < std::size_t(rings.begin[r + 1]); ++k) {
            // Relative to cell centers: toggle the first center at or beyond each crossing.
            const double x0 = rings.points(k, 0) - 0.5, y0 = rings.points(k, 1) - 0.5;
            const double x1 = rings.points(k + 1, 0) - 0.5, y1 = rings.points(k + 1, 1) - 0.5;
            const std::size_t end = cut(std::ceil(std::max(x0, x1)), cells);
            for (std::size_t i = cut(std::ceil(std::min(x0, x1)), cells); i < end; ++i) {
                const std::size_t j = cut(std::ceil(y0 + (double(i) - x0) * (y1 - y0) / (x1 - x0)), cells);
                if (j < cells) inside(i, j) = !inside(i, j);
            }
        }
    }
    for (std::size_t i = 0; i < cells; ++i) {
        for (std::size_t j = 1; j < cells; ++j) inside(i, j) = inside(i, j) != inside(i, j - 1);
    }
}

void find_cells_met(const ClosedRings& rings, View2<bool> met) {
    constexpr double EDGE = 1e-9;
    const std::size_t cells = met.rows;
    std::fill_n(met.data, met.size(), false);
    for (std::size_t r = 0; r + 1 < rings.begin.size; ++r) {
        for (auto k = std::size_t(rings.begin[r]); k + 1 < std::size_t(rings.begin[r + 1]); ++k) {
            const bool ascends = rings.points(k, 0) <= rings.points(k + 1, 0);
            const double *a = rings.points[ascends ? k : k + 1], *b = rings.points[ascends ? k + 1 : k];
            const double x0 = a[0], y0 = a[1], x1 = b[0], y1 = b[1], slope = x1 > x0 ? (y1 - y0) / (x1 - x0) : 0.0;
            const std::size_t end = cut(std::floor(x1 + EDGE) + 1, cells);
            for (std::size_t i = cut(std::floor(x0 - EDGE), cells); i < end; ++i) {
                const double from = y0 + (std::max(x0, double(i)) - x0) * slope;
                const double to = x1 > x0 ? y0 + (std::min(x1, double(i) + 1.0) - x0) * slope : y1;
                const std::size_t low = cut(std::floor(std::min(from, to) - EDGE), cells);
                const std::size_t high = cut(std::floor(std::max(from, to) + EDGE) + 1, cells);
                std::fill(&met(i, low), &met(i, low) + (high > low ? high - low : 0), true);
            }
        }
    }
}

}  // namespace viewshed
