#include "level_sweep.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "ego_vehicle.hpp"
#include "ground.hpp"
#include "height_map.hpp"
#include "unseen_ground.hpp"

namespace viewshed {
namespace {

// Trust a plane about the tilt if this share of the near ground (or of the seen area) lies on it, or this share of the
// returns within ON_PLANE_M of one height: far walls outweigh the ground below a sensor that looks down.
constexpr double TILT_SUPPORT = 0.35, TILT_RETURNS = 0.5;
constexpr float ON_PLANE_M = 0.2f;

// Number of returns sampled to fit a steep plane.
constexpr std::size_t TILT_SAMPLE = 2500;

// Lower bound of an estimated sensor height.
constexpr double MIN_ESTIMATED_HEIGHT_M = 0.05;

// Lattice nodes a side for a large and a small extent; nodes and standard deviation of assumed ground.
constexpr double LARGE_M = 32.0;
constexpr std::size_t LARGE_NODES = 128, SMALL_NODES = 64, FLAT_NODES = 64;
constexpr float UNSEEN_STD_M = 1.0f;

constexpr Rotation UPRIGHT{1, 0, 0, 0, 1, 0, 0, 0, 1};

using Vector = std::array<double, 3>;

Vector unit(const Vector& v) {
    const double length = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    return {v[0] / length, v[1] / length, v[2] / length};
}

std::array<float, 9> in_float(const Rotation& rotation) {
    std::array<float, 9> turn;
    std::copy(rotation.begin(), rotation.end(), turn.begin());
    return turn;
}

// Return the largest share of heights (n,) that lie below the sensor and within ON_PLANE_M of each other.
double share_at_one_height(const std::vector<float>& heights_m) {
    std::vector<float> low;
    std::copy_if(heights_m.begin(), heights_m.end(), std::back_inserter(low),
                 [](float z) { return z < -float(MIN_ESTIMATED_HEIGHT_M); });
    std::sort(low.begin(), low.end());
    std::ptrdiff_t max_count = 0;
    for (auto from = low.begin(); from != low.end(); ++from) {
        max_count = std::max(max_count, std::lower_bound(from, low.end(), *from + ON_PLANE_M) - from);
    }
    return double(max_count) / double(std::max<std::size_t>(heights_m.size(), 1));
}

// Return the ground normal in the sensor's frame if the sensor is clearly tilted.
std::optional<Vector> tilted_normal(View2<const float> points, float far_m, const GroundMap& ground) {
    Vector normal{-ground.plane[0], -ground.plane[1], 1.0};
    if (ground.support < TILT_SUPPORT) {
        // Too few near nodes lie on that plane: fit a steeper one, up to 60°, to a sample of the returns in range.
        const std::size_t step = std::max<std::size_t>(points.rows / TILT_SAMPLE, 1);
        std::vector<float> sample;
        for (std::size_t n = 0; n < points.rows; n += step) {
            const float* p = points[n];
            if (p[0] * p[0] + p[1] * p[1] + p[2] * p[2] <= far_m * far_m) sample.insert(sample.end(), p, p + 3);
        }
        const std::size_t count = sample.size() / 3;
        const FreePlane steep = free_plane({sample.data(), count, 3});
        if (steep.support < TILT_SUPPORT) {
            std::vector<float> heights_m(count);
            for (std::size_t k = 0; k < count; ++k) {
                const float* p = &sample[3 * k];
                heights_m[k] = p[0] * steep.normal[0] + p[1] * steep.normal[1] + p[2] * steep.normal[2];
            }
            if (share_at_one_height(heights_m) < TILT_RETURNS) return std::nullopt;
        }
        normal = {steep.normal[0], steep.normal[1], steep.normal[2]};
    }
    normal = unit(normal);
    if (!(std::acos(std::min(normal[2], 1.0)) > LEVEL_TILT)) return std::nullopt;
    return normal;
}

// Return the rotation that maps a normal to z and keeps the heading of x.
Rotation upright(const Vector& n) {
    const Vector f = unit({1.0 - n[0] * n[0], -n[0] * n[1], -n[0] * n[2]});
    return {f[0], f[1], f[2],
            n[1] * f[2] - n[2] * f[1], n[2] * f[0] - n[0] * f[2], n[0] * f[1] - n[1] * f[0],
            n[0], n[1], n[2]};
}

// Find the ground below the returns, its unseen nodes left open, z relative to the sensor; isolated returns (N,) are ignored.
GroundMap walked_ground(const UnleveledSweep& sweep, View1<const bool> isolated, const Rotation& rotation, double heading) {
    const double half_m = sweep.half_extent_m;
    const std::size_t n = half_m > LARGE_M ? LARGE_NODES : SMALL_NODES;
    require_lattice(n, half_m);
    const std::array<float, 9> turn = in_float(rotation);
    const auto lattice = lattice_of(n, half_m);
    const Lows lows = lowest_returns(sweep.points, isolated, {turn.data(), 3, 3}, sweep.near_m, sweep.far_m, heading,
                                     float(half_m), n);
    FoundGround found =
        estimate_ground(*lattice, lows, sweep.height_m.value_or(std::numeric_limits<double>::quiet_NaN()));
    if (!std::isnan(found.level_m)) {  // the ground is not seen
        const std::size_t nodes = FLAT_NODES, size = nodes * nodes;
        return {nodes, half_m, Buffer<float>(size, float(found.level_m)), Buffer<float>(size, UNSEEN_STD_M),
                Buffer<bool>(size, false), {0.0, 0.0, found.level_m}, 0.0};
    }
    const auto& [a, b, c] = found.carrier.plane;
    return {n, half_m, std::move(found.heights_m), Buffer<float>(n * n, SEEN_STD_M), std::move(found.seen), {a, b, c},
            found.carrier.support};
}

}  // namespace

SweepLevel level_sweep(const UnleveledSweep& sweep) {
    const std::size_t count = sweep.points.rows;
    // 1. Range image. Isolated returns are ignored for the ground; clutter is dropped entirely.
    std::optional<RangeImage> image;
    if (sweep.ring && count > 0) {
        image = range_image(sweep.points, *sweep.ring, sweep.columns, sweep.rings, sweep.near_m, sweep.far_m);
    }
    const Buffer<bool> none(image ? 0 : count, false);
    const View1<const bool> isolated = image ? View1<const bool>(image->isolated) : View1<const bool>(none);
    // 2. Attitude and ground in the sensor's frame. With an unknown attitude, a steep ground plane gives the tilt, and
    // the
    //    ground is estimated again in the upright frame.
    Rotation rotation = sweep.attitude.value_or(UPRIGHT);
    double heading = 0.0;
    const auto estimate = [&] {
        const std::array<float, 9> turn = in_float(rotation);
        heading = sweep.yaw ? *sweep.yaw : vehicle_heading(sweep.points, {turn.data(), 3, 3});
        return walked_ground(sweep, isolated, rotation, heading);
    };
    GroundMap ground = estimate();
    if (!sweep.attitude) {
        if (const auto normal = tilted_normal(sweep.points, sweep.far_m, ground)) {
            rotation = upright(*normal);
            ground = estimate();
        }
    }
    // 3. Shift ground and plane so that the ground below the sensor is at z = 0.
    const double height_m = sweep.height_m ? *sweep.height_m : std::max(-ground.plane[2], MIN_ESTIMATED_HEIGHT_M);
    for (float& z : ground.heights_m) z += float(height_m);
    ground.plane[2] += height_m;
    // 4. Level the points, with range and azimuth; predict the ground without returns; measure heights above the ground.
    const std::array<float, 9> t = in_float(rotation);
    const float transform[12] = {t[0], t[1], t[2], 0.0f, t[3], t[4], t[5], 0.0f, t[6], t[7], t[8], float(height_m)};
    const View1<const bool> clutter = image && image->clutter ? View1<const bool>(*image->clutter) : View1<const bool>{nullptr, 0};
    LevelPoints level = level_points(sweep.points, clutter, {transform, 3, 4}, sweep.near_m, sweep.far_m, heading);
    if (ground.support > 0.0) {
        Buffer<std::uint8_t> left_out(level.count);
        for (std::size_t k = 0; k < level.count; ++k) left_out[k] = isolated[std::size_t(level.rows[k])];
        complete_ground({{level.points.data(), level.count, 3}, level.azimuth, level.range_m, left_out, float(height_m)},
                        *lattice_of(ground.nodes, ground.half_m), ground.seen, ground.heights_m, ground.std_m);
    }
    measure_heights(level, ground.view());
    return {std::move(image), rotation, height_m, std::move(ground), std::move(level)};
}

}  // namespace viewshed
