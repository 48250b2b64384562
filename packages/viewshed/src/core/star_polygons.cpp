#include "star_polygons.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>


namespace viewshed {
namespace {

constexpr double PI64 = std::numbers::pi, FAR = 1e18;

// Candidate ranges of a vertex: minima over these windows of wedges on either side, and shares of the adjacent ranges.
constexpr std::array<std::size_t, 6> WINDOWS = {1, 2, 4, 8, 16, 32};
constexpr std::array<double, 3> SHARES = {0.98, 0.95, 0.9};
constexpr std::size_t CANDIDATES = 2 * (WINDOWS.size() + SHARES.size());

// Sides of a box, relative to the apex.
struct Box {
    double left, right, bottom, top;
};

// Set to 0 the wedges that enter a box containing or touching the apex; sides within `tolerance` of it touch it.
void close_towards(const Box& box, double tolerance, View1<double> ranges) {
    const double step = 2.0 * PI64 / double(ranges.size);
    for (std::size_t k = 0; k < ranges.size; ++k) {
        const double c = std::cos((double(k) + 0.5) * step), s = std::sin((double(k) + 0.5) * step);
        if ((box.left < -tolerance || c > 0) && (box.right > tolerance || c < 0) && (box.bottom < -tolerance || s > 0) &&
            (box.top > tolerance || s < 0)) {
            ranges[k] = 0.0;
        }
    }
}

// Limit the wedges that meet a box's face perpendicular to the direction `base`: range d / cos φ at angle φ from it.
void limit_by_face(double near, double far, double low, double high, double base, View1<double> ranges) {
    if (near <= 0.0 && 0.0 <= far) return;
    double distance = near;
    if (far < 0.0) {
        distance = -far;
        base += PI64;
        std::swap(low, high);
        low = -low;
        high = -high;
    }
    const auto bins = std::int64_t(ranges.size);
    const double step = 2.0 * PI64 / double(bins), first = std::atan(low / distance), last = std::atan(high / distance);
    const auto end = std::int64_t(std::ceil((base + last) / step - 1e-9));
    for (auto k = std::int64_t(std::floor((base + first) / step + 1e-9)); k < end; ++k) {
        const double begin_at = std::max(first, double(k) * step - base), end_at = std::min(last, double(k + 1) * step - base);
        const double off = begin_at <= 0.0 && 0.0 <= end_at ? 0.0 : std::min(std::fabs(begin_at), std::fabs(end_at));
        double reach;
        if (off == std::fabs(first)) {  // a corner: 1 / cos is inaccurate for grazing angles
            reach = std::hypot(distance, low);
        } else if (off == std::fabs(last)) {
            reach = std::hypot(distance, high);
        } else {
            reach = distance / std::cos(off);
        }
        double& range = ranges[std::size_t((k % bins + bins) % bins)];
        range = std::min(range, reach);
    }
}

// Ranges, and CANDIDATES ascending candidate ranges of a vertex on each wedge's first border.
struct Profile {
    View1<const double> ranges;
    std::vector<std::array<double, CANDIDATES>> radii;
    std::vector<double> sine, cosine;  // of the angle between borders k apart

    explicit Profile(View1<const double> given) : ranges(given), radii(given.size), sine(given.size), cosine(given.size) {
        const std::size_t bins = ranges.size;
        for (std::size_t k = 0; k < bins; ++k) {
            std::size_t n = 0;
            for (const std::size_t window : WINDOWS) {
                double before = FAR, after = FAR;
                for (std::size_t d = 0; d < window; ++d) {
                    before = std::min(before, ranges[(k + 2 * bins * WINDOWS.back() - 1 - d) % bins]);
                    after = std::min(after, ranges[(k + d) % bins]);
                }
                radii[k][n++] = before;
                radii[k][n++] = after;
            }
            for (const double share : SHARES) {
                radii[k][n++] = ranges[(k + bins - 1) % bins] * share;
                radii[k][n++] = ranges[k] * share;
            }
            std::sort(radii[k].begin(), radii[k].end());
            sine[k] = std::sin(2 * PI64 * double(k) / double(bins));
            cosine[k] = std::cos(2 * PI64 * double(k) / double(bins));
        }
    }

    double before(std::size_t ray) const { return ranges[ray > 0 ? ray - 1 : ranges.size - 1]; }
};

struct Vertex {
    std::size_t ray, candidate;
};

// Best closed chain of vertices from a candidate of a ray around to itself, by dynamic programming over the rays.
class BestChain {
public:
    BestChain(const Profile& profile, double price, Vertex start)
        : profile_(profile), price_(price), start_(start), bins_(profile.ranges.size), nodes_(bins_ + 1) {
        nodes_[0][start.candidate].arrive = 0.0;
        for (std::size_t step = 0; step < bins_; ++step) {
            turn(step);
            for (std::size_t c = 0; c < CANDIDATES; ++c) {
                if (nodes_[step][c].leave > -FAR) spread(step, c);
            }
        }
    }

    // Return the vertices in order; none if no chain closes.
    std::vector<Vertex> vertices() const {
        std::vector<Vertex> chain;
        std::size_t step = bins_, c = start_.candidate;
        while (step > 0) {
            chain.push_back({ray_at(step), c});
            const Node& node = nodes_[step][c];
            if (node.from_step < 0) return {};
            const auto from = std::size_t(node.from_step), left = std::size_t(node.from_candidate);
            c = std::size_t(nodes_[from][left].inward);
            if (radii(from)[c] != radii(from)[left]) chain.push_back({ray_at(from), left});
            step = from;
        }
        std::reverse(chain.begin(), chain.end());
        return chain;
    }

private:
    // DP state of a candidate: best gain of chains that arrive at, or leave from it, and back pointers.
    struct Node {
        double arrive = -FAR, leave = -FAR;
        std::int32_t from_step = -1, from_candidate = -1, inward = -1;
    };

    std::size_t ray_at(std::size_t step) const { return (start_.ray + step) % bins_; }
    const std::array<double, CANDIDATES>& radii(std::size_t step) const { return profile_.radii[ray_at(step)]; }

    // Compute the best gain to leave each candidate: via one vertex, or two with a radial edge between them.
    void turn(std::size_t step) {
        auto& nodes = nodes_[step];
        std::size_t best = 0;
        for (std::size_t c = 1; c < CANDIDATES; ++c) best = nodes[c].arrive > nodes[best].arrive ? c : best;
        if (nodes[best].arrive <= -FAR) return;
        for (std::size_t c = 0; c < CANDIDATES && radii(step)[c] <= profile_.ranges[ray_at(step)]; ++c) {
            nodes[c].leave = nodes[best].arrive - 2.0 * price_;
            nodes[c].inward = std::int32_t(best);
            if (nodes[c].arrive - price_ > nodes[c].leave) {
                nodes[c].leave = nodes[c].arrive - price_;
                nodes[c].inward = std::int32_t(c);
            }
        }
    }

    // Relax every edge from a vertex that stays below the ranges. A line in polar coordinates is 1/r = u cos φ + b sin
    // φ, so the edge is bounded by the largest b required so far.
    void spread(std::size_t step, std::size_t c) {
        const double radius = radii(step)[c], gain = nodes_[step][c].leave;
        double slope = -FAR;
        for (std::size_t d = 1; d <= std::min(bins_ / 3, bins_ - step); ++d) {
            const std::size_t ray = ray_at(step + d);
            const double sine = profile_.sine[d], cosine = profile_.cosine[d], before = profile_.before(ray);
            const double inverse = cosine / radius + slope * sine;
            const double limit = inverse <= 0.0 ? before : std::min(before, (1.0 + 1e-12) / inverse);
            for (std::size_t e = 0; e < CANDIDATES && profile_.radii[ray][e] <= limit; ++e) {
                const double value = gain + 0.5 * radius * profile_.radii[ray][e] * sine;
                Node& node = nodes_[step + d][e];
                if (value > node.arrive) {
                    node.arrive = value;
                    node.from_step = std::int32_t(step);
                    node.from_candidate = std::int32_t(c);
                }
            }
            slope = std::max(slope, (1.0 / std::min(before, profile_.ranges[ray]) - cosine / radius) / sine);
        }
    }

    const Profile& profile_;
    double price_;
    Vertex start_;
    std::size_t bins_;
    std::vector<std::array<Node, CANDIDATES>> nodes_;
};

}  // namespace

void find_free_ranges(View2<const bool> mask, const SquareGrid& grid, PlanePoint apex, double half_m, bool is_solid,
                      View1<double> ranges) {
    const auto cells = std::int64_t(grid.cells);
    const auto is_true = [&](std::int64_t i, std::int64_t j) {
        return 0 <= i && i < cells && 0 <= j && j < cells && mask(std::size_t(i), std::size_t(j));
    };
    const double side_m = double(cells) * grid.cell_m, right = apex.x - grid.x_m, up = apex.y - grid.y_m;
    const bool is_on_grid = right >= 0.0 && right <= side_m && up >= 0.0 && up <= side_m;
    const double tolerance = 1e-9 * grid.cell_m;  // where cell_m is not exact in binary, sides at the apex are off
    std::fill(ranges.begin(), ranges.end(), is_on_grid ? FAR : 0.0);
    for (std::int64_t i = -1; i <= cells; ++i) {
        for (std::int64_t j = -1; j <= cells; ++j) {
            if (is_true(i, j)) continue;
            const double x = grid.x_m + (double(i) + 0.5) * grid.cell_m - apex.x;
            const double y = grid.y_m + (double(j) + 0.5) * grid.cell_m - apex.y;
            const Box box{x - half_m, x + half_m, y - half_m, y + half_m};
            if (std::max(box.left, box.bottom) <= tolerance && std::min(box.right, box.top) >= -tolerance) {
                close_towards(box, tolerance, ranges);
            } else if (!is_solid || is_true(i - 1, j) || is_true(i + 1, j) || is_true(i, j - 1) || is_true(i, j + 1)) {
                limit_by_face(box.left, box.right, box.bottom, box.top, 0.0, ranges);
                limit_by_face(box.bottom, box.top, -box.right, -box.left, 0.5 * PI64, ranges);
            }
        }
    }
    if (is_solid) std::replace(ranges.begin(), ranges.end(), FAR, 0.0);  // solid cells bound every wedge on the grid
}

std::vector<StarVertex> star_vertices(View1<const double> ranges, double price_m2) {
    if (*std::min_element(ranges.begin(), ranges.end()) <= 0.0) return {};
    const Profile profile(ranges);
    // 1. Draft: start at the shortest range, with its largest candidate.
    Vertex start{std::size_t(std::min_element(ranges.begin(), ranges.end()) - ranges.begin()), 0};
    const auto& first = profile.radii[start.ray];
    const double max_radius = std::min(profile.before(start.ray), ranges[start.ray]) * (1 + 1e-9);
    const auto found = std::lower_bound(first.begin(), first.end(), max_radius) - first.begin();
    start.candidate = found > 0 ? std::size_t(found - 1) : CANDIDATES - 1;
    std::vector<Vertex> chain = BestChain(profile, price_m2, start).vertices();
    if (chain.size() < 3) return {};
    // 2. Find the best chain through a vertex of the draft.
    start = chain[chain.size() / 2];
    if (profile.radii[start.ray][start.candidate] <= profile.before(start.ray)) {
        std::vector<Vertex> better = BestChain(profile, price_m2, start).vertices();
        if (better.size() >= 3) chain = std::move(better);
    }
    std::vector<StarVertex> vertices;
    for (const Vertex& v : chain) {
        vertices.push_back({double(v.ray) * (2 * PI64 / double(ranges.size)), profile.radii[v.ray][v.candidate]});
    }
    return vertices;
}

}  // namespace viewshed
