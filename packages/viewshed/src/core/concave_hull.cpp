#include "concave_hull.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "vectors.hpp"

namespace viewshed {
namespace {

// Largest side of the thinning lattice, in cells.
constexpr double MAX_LATTICE = 1024.0;

// Points with a smaller sum of squares about their line count as collinear.
constexpr double MIN_SPREAD_M2 = 1e-4;

// Mean number of points per bucket.
constexpr double POINTS_PER_BUCKET = 4.0;

double squared_distance(PlanePoint a, PlanePoint b) { return (a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y); }

// Return the squared distance of p from segment ab.
INLINE double segment_distance(double px, double py, PlanePoint a, PlanePoint b) {
    const double dx = b.x - a.x, dy = b.y - a.y, square = dx * dx + dy * dy;
    double t = ((px - a.x) * dx + (py - a.y) * dy) / square;
    const double x = t > 1 ? b.x : (t > 0 ? a.x + dx * t : a.x), y = t > 1 ? b.y : (t > 0 ? a.y + dy * t : a.y);
    return (px - x) * (px - x) + (py - y) * (py - y);
}

MULTIVERSION void find_segment_distances(const double* x, const double* y, std::size_t count, PlanePoint a, PlanePoint b,
                                         double* squared) {
    for (std::size_t k = 0; k < count; ++k) squared[k] = segment_distance(x[k], y[k], a, b);
}

// Return a positive number if c is to the right of line ab.
double turn(PlanePoint a, PlanePoint b, PlanePoint c) { return (b.y - a.y) * (c.x - b.x) - (b.x - a.x) * (c.y - b.y); }

bool is_same(PlanePoint a, PlanePoint b) { return a.x == b.x && a.y == b.y; }

// Check if segments ab and cd cross.
bool do_cross(PlanePoint a, PlanePoint b, PlanePoint c, PlanePoint d) {
    return !is_same(a, d) && !is_same(b, c) && (turn(a, b, c) > 0) != (turn(a, b, d) > 0) &&
           (turn(c, d, a) > 0) != (turn(c, d, b) > 0);
}

// Return the convex hull, clockwise from the point of least x, then y (Andrew's monotone chain).
std::vector<std::size_t> convex_hull(const std::vector<PlanePoint>& points) {
    std::vector<std::size_t> order(points.size());
    for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
    std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
        return points[a].x < points[b].x || (points[a].x == points[b].x && points[a].y < points[b].y);
    });
    std::vector<std::size_t> hull;
    const auto add_chain = [&](auto begin, auto end) {
        const std::size_t before = hull.size();
        for (auto at = begin; at != end; ++at) {
            while (hull.size() >= before + 2 && turn(points[hull[hull.size() - 2]], points[hull.back()], points[*at]) <= 0) {
                hull.pop_back();
            }
            hull.push_back(*at);
        }
        hull.pop_back();  // the other chain starts with it
    };
    add_chain(order.begin(), order.end());
    add_chain(order.rbegin(), order.rend());
    return hull;
}

// Spatial hash of points, row by row, so that points along a segment are contiguous. Points can be removed.
class Buckets {
public:
    explicit Buckets(const std::vector<PlanePoint>& points) : x_(points.size()), y_(points.size()), place_(points.size()) {
        PlanePoint high = points[0];
        low_ = points[0];
        for (const PlanePoint& p : points) {
            low_ = {std::min(low_.x, p.x), std::min(low_.y, p.y)};
            high = {std::max(high.x, p.x), std::max(high.y, p.y)};
        }
        const double width = high.x - low_.x, height = high.y - low_.y;
        side_ = std::sqrt(width * height * POINTS_PER_BUCKET / double(points.size()));
        side_ = std::max(side_, std::max(width, height) / 1000.0);
        columns_ = std::size_t(width / side_) + 1;
        rows_ = std::size_t(height / side_) + 1;
        // Counting sort by bucket.
        start_.assign(rows_ * columns_ + 1, 0);
        for (const PlanePoint& p : points) ++start_[bucket_of(p) + 1];
        for (std::size_t b = 0; b < rows_ * columns_; ++b) start_[b + 1] += start_[b];
        std::vector<std::size_t> next(start_.begin(), start_.end() - 1);
        for (std::size_t k = 0; k < points.size(); ++k) {
            place_[k] = next[bucket_of(points[k])]++;
            x_[place_[k]] = points[k].x;
            y_[place_[k]] = points[k].y;
        }
    }

    double side() const { return side_; }
    PlanePoint at(std::size_t place) const { return {x_[place], y_[place]}; }
    std::size_t place(std::size_t point) const { return place_[point]; }
    void take_out(std::size_t place) { x_[place] = std::numeric_limits<double>::infinity(); }

    // Append (squared distance, index) of points whose distance from segment ab lies in (beyond, within].
    void find_near(PlanePoint a, PlanePoint b, double beyond2, double within, double within2,
                   std::vector<std::pair<double, std::size_t>>& found) {
        const auto [lower, upper] = a.y <= b.y ? std::pair(a, b) : std::pair(b, a);
        const double slope = upper.y > lower.y ? (upper.x - lower.x) / (upper.y - lower.y) : 0.0;
        const std::size_t first = row_of(lower.y - within), last = row_of(upper.y + within);
        for (std::size_t row = first; row <= last; ++row) {
            // Part of the segment near enough to this row of buckets.
            const double bottom = low_.y + double(row) * side_ - within, top = bottom + side_ + 2 * within;
            const double from = lower.y >= bottom ? lower.x : lower.x + (bottom - lower.y) * slope;
            const double to = upper.y <= top ? upper.x : lower.x + (top - lower.y) * slope;
            const std::size_t left = column_of(std::min(from, to) - 1.001 * within);
            const std::size_t right = column_of(std::max(from, to) + 1.001 * within);
            const std::size_t begin = start_[row * columns_ + left], end = start_[row * columns_ + right + 1];
            if (squared_.size() < end - begin) squared_.resize(end - begin);
            find_segment_distances(&x_[begin], &y_[begin], end - begin, a, b, squared_.data());
            for (std::size_t k = 0; k < end - begin; ++k) {
                if (squared_[k] > beyond2 && squared_[k] <= within2) found.emplace_back(squared_[k], begin + k);
            }
        }
    }

private:
    static std::size_t cut(double at, std::size_t count) {
        return at > 0.0 ? std::size_t(std::min(at, double(count - 1))) : 0;
    }
    std::size_t row_of(double y) const { return cut((y - low_.y) / side_, rows_); }
    std::size_t column_of(double x) const { return cut((x - low_.x) / side_, columns_); }
    std::size_t bucket_of(PlanePoint p) const { return row_of(p.y) * columns_ + column_of(p.x); }

    PlanePoint low_;
    double side_;
    std::size_t columns_, rows_;
    std::vector<std::size_t> start_;
    std::vector<double> x_, y_;
    std::vector<std::size_t> place_;
    std::vector<double> squared_;
};

MULTIVERSION void find_overlaps(const double* low_x, const double* low_y, const double* high_x, const double* high_y,
                                std::size_t count, PlanePoint low, PlanePoint high, std::uint8_t* overlaps) {
    for (std::size_t k = 0; k < count; ++k) {
        overlaps[k] = (low_x[k] <= high.x) & (high_x[k] >= low.x) & (low_y[k] <= high.y) & (high_y[k] >= low.y);
    }
}

// Linked ring of nodes; each owns the edge to the next one and its bounding box.
class Ring {
public:
    std::size_t size() const { return at_.size(); }
    std::size_t next(std::size_t node) const { return next_[node]; }
    std::size_t previous(std::size_t node) const { return previous_[node]; }
    PlanePoint at(std::size_t node) const { return at_[node]; }

    explicit Ring(const std::vector<PlanePoint>& points) : at_(points) {
        const std::size_t count = points.size();
        for (std::size_t k = 0; k < count; ++k) {
            next_.push_back((k + 1) % count);
            previous_.push_back((k + count - 1) % count);
            grow();
        }
        for (std::size_t k = 0; k < count; ++k) bound(k);
    }

    // Insert a point after a node, and return its node.
    std::size_t insert(std::size_t node, PlanePoint point) {
        const std::size_t added = size();
        at_.push_back(point);
        previous_.push_back(node);
        next_.push_back(next_[node]);
        previous_[next_[node]] = added;
        next_[node] = added;
        grow();
        bound(node);
        bound(added);
        return added;
    }

    // Check if an edge of the ring crosses segment ab.
    bool is_crossed(PlanePoint a, PlanePoint b) {
        const PlanePoint low{std::min(a.x, b.x), std::min(a.y, b.y)}, high{std::max(a.x, b.x), std::max(a.y, b.y)};
        find_overlaps(low_x_.data(), low_y_.data(), high_x_.data(), high_y_.data(), size(), low, high, overlaps_.data());
        for (auto hit = overlaps_.begin(); (hit = std::find(hit, overlaps_.end(), 1)) != overlaps_.end(); ++hit) {
            const auto node = std::size_t(hit - overlaps_.begin());
            if (do_cross(at_[node], at_[next_[node]], a, b)) return true;
        }
        return false;
    }

private:
    void grow() {
        for (auto* values : {&low_x_, &low_y_, &high_x_, &high_y_}) values->push_back(0.0);
        overlaps_.push_back(0);
    }
    void bound(std::size_t node) {
        const PlanePoint a = at_[node], b = at_[next_[node]];
        low_x_[node] = std::min(a.x, b.x);
        low_y_[node] = std::min(a.y, b.y);
        high_x_[node] = std::max(a.x, b.x);
        high_y_[node] = std::max(a.y, b.y);
    }

    std::vector<PlanePoint> at_;
    std::vector<std::size_t> next_, previous_;
    std::vector<double> low_x_, low_y_, high_x_, high_y_;
    std::vector<std::uint8_t> overlaps_;
};

constexpr std::size_t NONE = std::numeric_limits<std::size_t>::max();

// Return the index of the point to which a node's edge is bent: the nearest one that is nearer to it than to the two
// adjacent edges and visible from its ends; NONE if there is none within the distance.
std::size_t find_candidate(Buckets& buckets, Ring& ring, std::size_t node, double max2,
                           std::vector<std::pair<double, std::size_t>>& near) {
    const PlanePoint a = ring.at(ring.previous(node)), b = ring.at(node), c = ring.at(ring.next(node));
    const PlanePoint d = ring.at(ring.next(ring.next(node)));
    // Search ever wider strips along the edge.
    double beyond2 = -1.0;
    for (double within = buckets.side();; within *= 2.0) {
        const double within2 = std::min(within * within, max2);
        near.clear();
        buckets.find_near(b, c, beyond2, std::sqrt(within2), within2, near);
        std::sort(near.begin(), near.end());
        for (const auto& [distance2, place] : near) {
            const PlanePoint p = buckets.at(place);
            if (distance2 < segment_distance(p.x, p.y, a, b) && distance2 < segment_distance(p.x, p.y, c, d) &&
                !ring.is_crossed(b, p) && !ring.is_crossed(c, p)) {
                return place;
            }
        }
        if (within2 >= max2) return NONE;
        beyond2 = within2;
    }
}

}  // namespace

std::vector<PlanePoint> thin_returns(View2<const float> points, View1<const float> range_m, const SquareGrid& grid) {
    std::vector<PlanePoint> thinned;
    if (points.rows == 0) return thinned;
    // 1. Align the lattice with the cells of the grid.
    float low_x = points(0, 0), low_y = points(0, 1), high_x = low_x, high_y = low_y;
    for (std::size_t n = 0; n < points.rows; ++n) {
        low_x = std::min(low_x, points(n, 0));
        low_y = std::min(low_y, points(n, 1));
        high_x = std::max(high_x, points(n, 0));
        high_y = std::max(high_y, points(n, 1));
    }
    const double spread_m = std::max(double(high_x) - low_x, double(high_y) - low_y);
    const double cell_m = std::max(grid.cell_m, spread_m / (MAX_LATTICE - 2));
    const double x0 = grid.x_m + std::floor((low_x - grid.x_m) / cell_m) * cell_m;
    const double y0 = grid.y_m + std::floor((low_y - grid.y_m) / cell_m) * cell_m;
    const double rows = std::floor((high_x - x0) / cell_m) + 1, columns = std::floor((high_y - y0) / cell_m) + 1;
    require(rows >= 1 && rows <= MAX_LATTICE + 2 && columns >= 1 && columns <= MAX_LATTICE + 2,
            "returns must lie within 1e12 cells of the grid");
    // 2. Keep the farthest return of each cell; ties go to the greater x, then y.
    Buffer<std::int32_t> farthest(std::size_t(rows * columns), -1);
    const double per_m = 1.0 / cell_m;
    for (std::size_t n = 0; n < points.rows; ++n) {
        const float* p = points[n];
        const double u = (double(p[0]) - x0) * per_m, v = (double(p[1]) - y0) * per_m;
        const std::size_t i = std::size_t(std::clamp(u, 0.0, rows - 1)), j = std::size_t(std::clamp(v, 0.0, columns - 1));
        std::int32_t& m = farthest[i * std::size_t(columns) + j];
        if (m >= 0 && range_m[n] <= range_m[std::size_t(m)]) {
            const float* q = points[std::size_t(m)];
            const bool is_greater = p[0] > q[0] || (p[0] == q[0] && p[1] > q[1]);
            if (range_m[n] < range_m[std::size_t(m)] || !is_greater) continue;
        }
        m = std::int32_t(n);
    }
    for (const std::int32_t n : farthest.view()) {
        if (n >= 0) thinned.push_back({double(points(std::size_t(n), 0)), double(points(std::size_t(n), 1))});
    }
    return thinned;
}

bool span_area(const std::vector<PlanePoint>& points) {
    if (points.size() < 3) return false;
    double x = 0.0, y = 0.0;
    for (const PlanePoint& p : points) {
        x += p.x;
        y += p.y;
    }
    x /= double(points.size());
    y /= double(points.size());
    // Smaller eigenvalue of the scatter matrix.
    double xx = 0.0, xy = 0.0, yy = 0.0;
    for (const PlanePoint& p : points) {
        xx += (p.x - x) * (p.x - x);
        xy += (p.x - x) * (p.y - y);
        yy += (p.y - y) * (p.y - y);
    }
    const double larger = 0.5 * (xx + yy) + std::hypot(0.5 * (xx - yy), xy);
    return (xx * yy - xy * xy) / larger > MIN_SPREAD_M2;
}

std::vector<PlanePoint> concave_hull(const std::vector<PlanePoint>& points, double concavity, double length_m) {
    // 1. Start with the convex hull; its points are no candidates.
    Buckets buckets(points);
    std::vector<PlanePoint> corners;
    for (const std::size_t k : convex_hull(points)) {
        corners.push_back(points[k]);
        buckets.take_out(buckets.place(k));
    }
    Ring ring(corners);
    // 2. Bend each edge inward to its best point, in the order of creation, if concave enough; queue both halves.
    std::vector<std::size_t> queue(ring.size());
    for (std::size_t k = 0; k < queue.size(); ++k) queue[k] = k;
    std::vector<std::pair<double, std::size_t>> near;
    for (std::size_t head = 0; head < queue.size(); ++head) {
        const std::size_t node = queue[head];
        const PlanePoint b = ring.at(node), c = ring.at(ring.next(node));
        const double length2 = squared_distance(b, c);
        if (length2 < length_m * length_m) continue;
        const double max2 = length2 / (concavity * concavity);
        const std::size_t place = find_candidate(buckets, ring, node, max2, near);
        if (place == NONE) continue;
        const PlanePoint p = buckets.at(place);
        if (std::min(squared_distance(p, b), squared_distance(p, c)) > max2) continue;
        buckets.take_out(place);
        queue.push_back(node);
        queue.push_back(ring.insert(node, p));
    }
    std::vector<PlanePoint> hull;
    std::size_t node = 0;
    do {
        hull.push_back(ring.at(node));
        node = ring.next(node);
    } while (node != 0);
    return hull;
}

void fill_rings(const std::vector<Edge>& edges, const SquareGrid& grid, View2<bool> inside) {
    const std::size_t cells = grid.cells;
    std::fill_n(inside.data, inside.size(), false);
    // First cell whose center is at or beyond a coordinate.
    const auto cell_from = [&](double at_m, double corner_m) {
        const double at = (at_m - corner_m) / grid.cell_m - 0.5;
        return at > 0.0 ? std::size_t(std::ceil(std::min(at, double(cells)))) : 0;
    };
    // 1. Toggle each row where an edge crosses it; half-open in x, so that shared corners count once.
    for (const Edge& edge : edges) {
        PlanePoint a = edge.from, b = edge.to;
        if (a.x > b.x) std::swap(a, b);
        const std::size_t end = cell_from(b.x, grid.x_m);
        for (std::size_t i = cell_from(a.x, grid.x_m); i < end; ++i) {
            const double x = grid.x_m + (double(i) + 0.5) * grid.cell_m;
            const std::size_t j = cell_from(a.y + (b.y - a.y) * ((x - a.x) / (b.x - a.x)), grid.y_m);
            if (j < cells) inside(i, j) = !inside(i, j);
        }
    }
    // 2. Cells after an odd number of crossings are inside.
    for (std::size_t i = 0; i < cells; ++i) {
        for (std::size_t j = 1; j < cells; ++j) inside(i, j) = inside(i, j) != inside(i, j - 1);
    }
}

}  // namespace viewshed
