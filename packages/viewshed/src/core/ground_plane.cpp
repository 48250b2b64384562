#include "ground_plane.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <numeric>
#include <vector>

#include "vectors.hpp"

namespace viewshed {
namespace {

// Steepest ground plane in the level frame (12°).
constexpr double MAX_SLOPE = 0.21;

// Tolerance of a known sensor height.
constexpr double KNOWN_TO_M = 0.4;

// Range of the nodes that decide which plane carries the sensor, and their required number.
constexpr float NEAR_M = 28.0f;
constexpr std::size_t FEWEST_NODES = 6;

// A node with this many nearer ones in its sector weighs a quarter.
constexpr double CARRIER_NODES = 2.0;
constexpr int CARRIER_SECTORS = 64;

// Penalty weight of a node below a plane: small, since land may fall away from the road, but a roof hides it.
constexpr float BELOW_SHARE = 0.35f;

// Penalty of a plane of slope 1, as a share of the total weight: of similar planes the flatter one wins.
constexpr double LEVEL_SHARE = 0.4;

// Approximate number of points on which planes are scored.
constexpr std::size_t SCORED_POINTS = 400;

constexpr int TRIALS = 256;

// Planes that are scored at once in vectors.
constexpr std::size_t LANES = 16;

// Fewest points for a plane in any attitude, and its penalty weight of area below.
constexpr std::size_t FEWEST_POINTS = 50;
constexpr double BELOW_AREA = 2.0;

// Linear congruential generator (Numerical Recipes' constants).
INLINE std::uint32_t next(std::uint32_t state) {
    return state * 1664525u + 1013904223u;
}

// Points as columns, and the weight of each.
struct Points3 {
    explicit Points3(std::size_t n) : size(n), x(n), y(n), z(n), weight(n) {}
    std::size_t size;
    Buffer<float> x, y, z, weight;

    float above(std::size_t k, const Plane& p) const { return z[k] - p[0] * x[k] - p[1] * y[k] - p[2]; }
    bool is_on(std::size_t k, const Plane& p) const {
        return std::fabs(above(k, p)) < 0.10 + 0.006 * double(std::fabs(x[k]) + std::fabs(y[k]));
    }
};

// Return the sector of a point. The library's arctangent is used only near a border, where the fast one might be wrong.
int sector_of(float x, float y) {
    constexpr float PER_RAD = float(CARRIER_SECTORS / (2 * std::numbers::pi)), NEAR_BORDER = 1e-3f;
    float at = (azimuth_of(y, x) + PI) * PER_RAD;
    const float beyond = at - std::floor(at);
    if (beyond < NEAR_BORDER || beyond > 1.0f - NEAR_BORDER) at = (std::atan2(y, x) + PI) * PER_RAD;
    return int(at) % CARRIER_SECTORS;
}

// Return the low points within NEAR_M of the sensor. Weights fall with the number of nearer ones in a sector.
Points3 near_points(const Lows& lows) {
    Points3 near(lows.occupied.size());
    Buffer<float> square_m2(near.size);
    Buffer<std::uint8_t> sector(near.size);
    std::array<std::uint32_t, CARRIER_SECTORS + 1> begin{};
    std::size_t count = 0;
    for (const std::int32_t node : lows.occupied) {
        const float x = lows.x_m[node], y = lows.y_m[node], d2 = x * x + y * y;
        if (!(d2 < NEAR_M * NEAR_M)) continue;
        near.x[count] = x;
        near.y[count] = y;
        near.z[count] = lows.z_m[node];
        square_m2[count] = d2;
        sector[count] = std::uint8_t(sector_of(x, y));
        ++begin[sector[count] + 1u];
        ++count;
    }
    near.size = count;
    // Sort points by sector and range, stable, by insertion: a sector has few.
    std::partial_sum(begin.begin(), begin.end(), begin.begin());
    std::array<std::uint32_t, CARRIER_SECTORS> end;
    std::copy_n(begin.begin(), CARRIER_SECTORS, end.begin());
    Buffer<std::uint32_t> sorted(count);
    for (std::uint32_t k = 0; k < count; ++k) {
        std::uint32_t place = end[sector[k]]++;
        for (; place > begin[sector[k]] && square_m2[sorted[place - 1]] > square_m2[k]; --place) {
            sorted[place] = sorted[place - 1];
        }
        sorted[place] = k;
    }
    for (std::size_t s = 0; s < CARRIER_SECTORS; ++s) {
        for (std::uint32_t k = begin[s]; k < end[s]; ++k) {
            const double nearer = double(k - begin[s]), share = 1.0 / (1.0 + nearer / CARRIER_NODES);
            near.weight[sorted[k]] = float(share * share);
        }
    }
    return near;
}

// Random numbers in [0, 1) for the three points of each trial, ascending, with the position of each in the sequence.
struct SortedNumbers {
    std::array<float, 3 * TRIALS> part;
    std::array<std::uint16_t, 3 * TRIALS> place;
};

const SortedNumbers& random_numbers() {
    static const SortedNumbers sorted = [] {
        std::array<float, 3 * TRIALS> parts;
        std::uint32_t state = 12345;
        for (float& part : parts) {
            state = next(state);
            part = float(state >> 8) * 0x1p-24f;
        }
        SortedNumbers made;
        std::iota(made.place.begin(), made.place.end(), std::uint16_t{0});
        std::sort(made.place.begin(), made.place.end(), [&](auto a, auto b) { return parts[a] < parts[b]; });
        for (std::size_t k = 0; k < parts.size(); ++k) made.part[k] = parts[made.place[k]];
        return made;
    }();
    return sorted;
}

// Sample the points of all trials by weight.
std::array<std::uint32_t, 3 * TRIALS> sample_points(const Points3& points) {
    std::array<std::uint32_t, 3 * TRIALS> sampled;
    Buffer<float> sums(points.size);
    std::partial_sum(points.weight.data(), points.weight.data() + points.size, sums.data());
    const std::size_t last = points.size - 1;
    const SortedNumbers& sequence = random_numbers();
    std::size_t at = 0;
    for (std::size_t k = 0; k < sampled.size(); ++k) {
        const float part = sequence.part[k] * sums[last];
        while (at < last && sums[at] < part) ++at;
        sampled[sequence.place[k]] = std::uint32_t(at);
    }
    return sampled;
}

// Fit a plane through three points; false if they are degenerate or the plane cannot be ground.
bool plane_through(const Points3& points, const std::uint32_t* three, Plane& plane) {
    const std::uint32_t p = three[0], q = three[1], r = three[2];
    const float x1 = points.x[q] - points.x[p], y1 = points.y[q] - points.y[p];
    const float x2 = points.x[r] - points.x[p], y2 = points.y[r] - points.y[p];
    const float area = x1 * y2 - x2 * y1;
    if (std::fabs(area) < 1e-3 * double(x1 * x1 + y1 * y1 + x2 * x2 + y2 * y2) + 1e-6) return false;
    const float z1 = points.z[q] - points.z[p], z2 = points.z[r] - points.z[p];
    plane[0] = (z1 * y2 - z2 * y1) / area;
    plane[1] = (x1 * z2 - x2 * z1) / area;
    plane[2] = points.z[p] - plane[0] * points.x[p] - plane[1] * points.y[p];
    return plane[0] * plane[0] + plane[1] * plane[1] <= MAX_SLOPE * MAX_SLOPE && plane[2] < 0.0f;
}

// Write for LANES planes the weight of the points on each, minus a share of that of points clearly below.
MULTIVERSION void score_planes(const float* x, const float* y, const float* z, const float* weight,
                               const float* tolerance, std::size_t count, const float* a, const float* b,
                               const float* c, float* scores) {
    float score[LANES] = {};
    for (std::size_t k = 0; k < count; ++k) {
        const float on = weight[k], below = -weight[k] * BELOW_SHARE, within = tolerance[k], deep = -2.0f * within;
        for (std::size_t l = 0; l < LANES; ++l) {
            const float above = z[k] - a[l] * x[k] - b[l] * y[k] - c[l];
            score[l] += std::fabs(above) < within ? on : (above < deep ? below : 0.0f);
        }
    }
    for (std::size_t l = 0; l < LANES; ++l) scores[l] = score[l];
}

// Find the best plane through three points, and return its score; 0 for none.
double best_plane(const Points3& points, double height_m, Plane& best) {
    // 1. Generate planes that may be ground.
    std::array<float, TRIALS> a{}, b{}, c{}, score{};
    std::size_t planes = 0;
    const auto sampled = sample_points(points);
    for (int trial = 0; trial < TRIALS; ++trial) {
        Plane plane;
        if (!plane_through(points, &sampled[std::size_t(3 * trial)], plane)) continue;
        const bool near = std::isfinite(height_m) ? std::fabs(double(plane[2]) + height_m) <= KNOWN_TO_M
                                                  : double(plane[2]) <= -MIN_HEIGHT_M;
        if (!near) continue;
        a[planes] = plane[0];
        b[planes] = plane[1];
        c[planes] = plane[2];
        ++planes;
    }

    // 2. Score the planes on a subset of the points.
    const std::size_t stride = std::max<std::size_t>(points.size / SCORED_POINTS, 1);
    Points3 subset((points.size + stride - 1) / stride);
    Buffer<float> tolerance(subset.size);
    float total = 0.0f;
    for (std::size_t k = 0; k < subset.size; ++k) {
        subset.x[k] = points.x[k * stride];
        subset.y[k] = points.y[k * stride];
        subset.z[k] = points.z[k * stride];
        subset.weight[k] = points.weight[k * stride];
        tolerance[k] = 0.10f + 0.006f * (std::fabs(subset.x[k]) + std::fabs(subset.y[k]));
        total += subset.weight[k];
    }
    for (std::size_t l = 0; l < planes; l += LANES) {
        score_planes(subset.x.data(), subset.y.data(), subset.z.data(), subset.weight.data(), tolerance.data(),
                     subset.size, &a[l], &b[l], &c[l], &score[l]);
    }

    // 3. Prefer flatter planes among similar ones: roads are rarely steep.
    double max_score = 0.0;
    for (std::size_t l = 0; l < planes; ++l) {
        const double slope = double(std::sqrt(a[l] * a[l] + b[l] * b[l]));
        const double value = double(score[l]) - LEVEL_SHARE * slope * double(total);
        if (value > max_score) {
            max_score = value;
            best = {a[l], b[l], c[l]};
        }
    }
    return max_score;
}

// Solve m x = b (3 × 3) by Gaussian elimination with partial pivoting, in place.
void solve(double (&m)[3][4]) {
    for (int k = 0; k < 3; ++k) {
        int pivot = k;
        for (int r = k + 1; r < 3; ++r) pivot = std::fabs(m[r][k]) > std::fabs(m[pivot][k]) ? r : pivot;
        if (pivot != k) std::swap(m[k], m[pivot]);
        for (int r = k + 1; r < 3; ++r) {
            const double factor = m[r][k] / m[k][k];
            for (int c = k; c < 4; ++c) m[r][c] -= factor * m[k][c];
        }
    }
    for (int k = 2; k >= 0; --k) {
        for (int c = k + 1; c < 3; ++c) m[k][3] -= m[k][c] * m[c][3];
        m[k][3] /= m[k][k];
    }
}

// Refit a plane by weighted least squares to the points on it.
Plane refit(const Points3& points, const Plane& plane) {
    double xx = 0, xy = 0, x1 = 0, yy = 0, y1 = 0, w1 = 0, xz = 0, yz = 0, z1 = 0;
    for (std::size_t k = 0; k < points.size; ++k) {
        if (!points.is_on(k, plane)) continue;
        const double w = double(points.weight[k]), x = double(points.x[k]), y = double(points.y[k]);
        const double z = double(points.z[k]);
        xx += w * x * x;
        xy += w * x * y;
        x1 += w * x;
        yy += w * y * y;
        y1 += w * y;
        w1 += w;
        xz += w * x * z;
        yz += w * y * z;
        z1 += w * z;
    }
    double m[3][4] = {{xx + 1e-6, xy, x1, xz + 1e-6 * double(plane[0])},
                      {xy, yy + 1e-6, y1, yz + 1e-6 * double(plane[1])},
                      {x1, y1, w1 + 1e-6, z1 + 1e-6 * double(plane[2])}};
    solve(m);
    return {float(m[0][3]), float(m[1][3]), float(m[2][3])};
}

// Sum the area of the points on, and below, LANES planes with `normal` (3, LANES).
MULTIVERSION void sum_areas(const float* points, const float* area, const double* tolerance, std::size_t count,
                            const float (*normal)[LANES], const float* offset, double* on, double* below) {
    double sum_on[LANES] = {}, sum_below[LANES] = {};
    for (std::size_t k = 0; k < count; ++k) {
        const float x = points[3 * k], y = points[3 * k + 1], z = points[3 * k + 2];
        const double within = tolerance[k], here = double(area[k]);
        for (std::size_t l = 0; l < LANES; ++l) {
            const double away = double(normal[0][l] * x + normal[1][l] * y + normal[2][l] * z - offset[l]);
            sum_on[l] += std::fabs(away) < within ? here : 0.0;
            sum_below[l] += away < -2 * within ? here : 0.0;
        }
    }
    for (std::size_t l = 0; l < LANES; ++l) {
        on[l] = sum_on[l];
        below[l] = sum_below[l];
    }
}

}  // namespace

CarrierPlane carrier_plane(const Lows& lows, double height_m) {
    CarrierPlane carrier{};
    const Points3 points = near_points(lows);
    if (points.size < FEWEST_NODES) return carrier;
    if (!(best_plane(points, height_m, carrier.plane) > 0.0)) return carrier;
    for (int turn = 0; turn < 3; ++turn) carrier.plane = refit(points, carrier.plane);
    double on = 0.0, all = 0.0;
    for (std::size_t k = 0; k < points.size; ++k) {
        on += points.is_on(k, carrier.plane) ? double(points.weight[k]) : 0.0;
        all += double(points.weight[k]);
    }
    carrier.support = on / all;
    return carrier;
}

FreePlane free_plane(View2<const float> points) {
    FreePlane best{{0.0f, 0.0f, 1.0f}, 0.0};
    const std::size_t count = points.rows;
    if (count < FEWEST_POINTS) return best;
    Buffer<float> area(count);
    Buffer<double> tolerance(count);
    float all = 0.0f;
    for (std::size_t k = 0; k < count; ++k) {
        const float* p = points[k];
        area[k] = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
        tolerance[k] = 0.1 + 0.005 * double(std::sqrt(area[k]));
        all += area[k];
    }
    // 1. Generate planes through three points that may be ground.
    float normal[3][TRIALS] = {}, offset[TRIALS] = {};
    std::size_t planes = 0;
    std::uint32_t state = 777;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const float* p[3];
        for (const float*& one : p) {
            state = next(state);
            one = points[(state >> 8) % count];
        }
        const float u[3] = {p[1][0] - p[0][0], p[1][1] - p[0][1], p[1][2] - p[0][2]};
        const float v[3] = {p[2][0] - p[0][0], p[2][1] - p[0][1], p[2][2] - p[0][2]};
        float n[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
        const float length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        if (!(double(length) >= 1e-3)) continue;
        const float upwards = n[2] > 0 ? length : -length;
        for (float& part : n) part /= upwards;
        const float below = n[0] * p[0][0] + n[1] * p[0][1] + n[2] * p[0][2];
        if (n[2] < 0.5f || !(double(below) <= -0.1)) continue;
        for (int axis = 0; axis < 3; ++axis) normal[axis][planes] = n[axis];
        offset[planes++] = below;
    }
    // 2. Choose the plane with the most area on it, and little below.
    double max_score = 0.0, most_on = 0.0;
    for (std::size_t l = 0; l < planes; l += LANES) {
        float subset[3][LANES];
        for (int axis = 0; axis < 3; ++axis) std::copy_n(&normal[axis][l], LANES, subset[axis]);
        double on[LANES], below[LANES];
        sum_areas(points.data, area.data(), tolerance.data(), count, subset, &offset[l], on, below);
        for (std::size_t k = 0; k < std::min(LANES, planes - l); ++k) {
            if (on[k] - BELOW_AREA * below[k] > max_score) {
                max_score = on[k] - BELOW_AREA * below[k];
                most_on = on[k];
                best.normal = {subset[0][k], subset[1][k], subset[2][k]};
            }
        }
    }
    if (most_on > 0.0) best.support = most_on / double(all);
    return best;
}

}  // namespace viewshed
