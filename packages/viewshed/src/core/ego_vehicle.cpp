#include "ego_vehicle.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <numbers>
#include <vector>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Returns of hood and trunk: beyond this horizontal range, this far below the sensor, and above any ground.
constexpr float NEAR_M = 1.2f, BELOW_M = 0.05f;
constexpr int MIN_RETURNS = 40;

// Required concentration of the doubled azimuths of these returns: they lie ahead and behind, not all around.
constexpr double ALONG = 0.4;

// Required shares in the turned box, and at each of its ends (a parked car lies at one end only), ...
constexpr double INSIDE = 0.9, BOTH_ENDS = 0.15;

// ... unless at least ROOF returns are nearer still, i.e. the sensor sees the roof it stands on, ...
constexpr int ROOF = 200;

// ... and the returns spread this far across (RMS), unlike a person beside the vehicle.
constexpr double WIDE_M = 0.3;

// Largest share of equally near but higher returns: a wall rises above the sensor, a hood does not.
constexpr double MAX_ABOVE = 0.2;

// Headings within this angle of the sensor's x axis are set to 0.
constexpr double ALIGNED = 20.0 * std::numbers::pi / 180.0;

// Fewest points for which a part pays for its thread.
constexpr std::size_t PART = 16384;

// Points (3, BLOCK) in a level frame, and a mask of near ones.
struct Block {
    float x[BLOCK], y[BLOCK], z[BLOCK];
    std::uint8_t is_near[BLOCK];
};

// Rotate the points of a block and mark those near the sensor and above any ground.
MULTIVERSION void turn_block(const float* points, std::size_t count, const float* rotation, Block& block) {
    constexpr float far2 = float(EGO_LENGTH_M * EGO_LENGTH_M), lowest = float(-MIN_EGO_HEIGHT_M);
    // Copy the rotation: the compiler cannot know that the loops do not write it.
    std::array<float, 9> r;
    std::copy_n(rotation, 9, r.begin());
    for (std::size_t k = 0; k < count; ++k) {
        const float px = points[3 * k], py = points[3 * k + 1], pz = points[3 * k + 2];
        block.x[k] = r[0] * px + r[1] * py + r[2] * pz;
        block.y[k] = r[3] * px + r[4] * py + r[5] * pz;
        block.z[k] = r[6] * px + r[7] * py + r[8] * pz;
    }
    for (std::size_t k = 0; k < count; ++k) {
        const float r2 = block.x[k] * block.x[k] + block.y[k] * block.y[k];
        block.is_near[k] = (r2 < far2) & (block.z[k] > lowest);
    }
}

// Returns near the sensor: on the roof, higher than a hood, and on hood or trunk.
struct NearReturns {
    int roof = 0, above = 0;
    std::vector<std::array<float, 2>> hood;  // x and y
};

void collect_near(const Block& block, std::size_t count, NearReturns& found) {
    // Most blocks have few marks: test eight at once.
    for (std::size_t start = 0; start < count; start += 8) {
        std::uint64_t eight;
        std::memcpy(&eight, block.is_near + start, 8);
        if (eight == 0) continue;
        for (std::size_t k = start; k < std::min(start + 8, count); ++k) {
            if (!block.is_near[k]) continue;
            const float x = block.x[k], y = block.y[k], z = block.z[k];
            if (x * x + y * y < NEAR_M * NEAR_M) {
                found.roof += z < -BELOW_M;
            } else if (z >= -BELOW_M) {
                ++found.above;
            } else {
                found.hood.push_back({x, y});
            }
        }
    }
}

NearReturns find_near(View2<const float> points, View2<const float> rotation) {
    const std::size_t parts = count_parts(points.rows, PART);
    std::vector<NearReturns> found(parts);
    for_ranges(points.rows, parts, [&](std::size_t part, std::size_t begin, std::size_t end) {
        Block block{};
        for (std::size_t start = begin; start < end; start += BLOCK) {
            const std::size_t count = std::min(BLOCK, end - start);
            turn_block(points[start], count, rotation.data, block);
            collect_near(block, count, found[part]);
        }
    });
    // Concatenate in the order of the points.
    for (std::size_t part = 1; part < parts; ++part) {
        found[0].roof += found[part].roof;
        found[0].above += found[part].above;
        found[0].hood.insert(found[0].hood.end(), found[part].hood.begin(), found[part].hood.end());
    }
    return std::move(found[0]);
}

}  // namespace

double vehicle_heading(View2<const float> points, View2<const float> rotation) {
    // 1. Mean of the doubled azimuths of hood and trunk: cos 2a = (x² - y²) / r², sin 2a = 2 x y / r².
    const NearReturns near = find_near(points, rotation);
    const double count = double(near.hood.size());
    double cosine = 0.0, sine = 0.0;
    for (const auto [x, y] : near.hood) {
        const float r2 = x * x + y * y;
        cosine += double((x * x - y * y) / r2);
        sine += double(2.0f * x * y / r2);
    }
    if (count < MIN_RETURNS || std::hypot(cosine, sine) < ALONG * count) return 0.0;
    const double heading = 0.5 * std::atan2(sine, cosine);
    if (std::fabs(heading) < ALIGNED) return 0.0;
    // 2. They must fill a box with that heading, at both ends or below a roof.
    const float cos = float(std::cos(heading)), sin = float(std::sin(heading));
    int ahead = 0, behind = 0;
    double across2 = 0.0;
    for (const auto [x, y] : near.hood) {
        const float along = cos * x + sin * y, across = cos * y - sin * x;
        across2 += double(across * across);
        if (std::fabs(across) < float(EGO_WIDTH_M)) ++(along > 0.0f ? ahead : behind);
    }
    const bool is_hood = near.roof >= ROOF && across2 >= WIDE_M * WIDE_M * count;
    const bool has_ends = is_hood || std::min(ahead, behind) >= BOTH_ENDS * count;
    const bool is_vehicle = has_ends && ahead + behind >= INSIDE * count && near.above <= MAX_ABOVE * count;
    return is_vehicle ? heading : 0.0;
}

}  // namespace viewshed
