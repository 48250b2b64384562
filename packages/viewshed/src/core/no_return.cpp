#include "no_return.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <limits>
#include <numbers>
#include <utility>
#include <vector>

#include "missing_beams.hpp"
#include "parallel.hpp"
#include "polar_ground.hpp"
#include "range_image.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr float NONE = std::numeric_limits<float>::infinity();

typedef float Four __attribute__((vector_size(4 * sizeof(float))));

// Largest distance in columns of returns that fill a gap of their ring.
constexpr int FILL_COLUMNS = 16;

// Largest distance in rings of the next return below or above in a column.
constexpr std::size_t NEIGHBOR_RINGS = 8;

// Weight in beams of the previous range bin's share as a prior.
constexpr double PRIOR_BEAMS = 20;

// Share of the returns that may lie beyond the farthest range.
constexpr double REACH_SHARE = 0.001;

// Depths are limited to this multiple of the farthest range: the sweep shows no evidence that its sensor sees farther.
constexpr float MAX_REACH_RATIO = 1.5f;

// Approximate number of groups of missing beams per turn.
constexpr std::size_t GROUPS = 256;

// Columns of the pooled image.
constexpr std::size_t POOLED = 128;

// Range limits of log2 of meters; LOG_NONE also stands for a missing range.
constexpr float LOG_NONE = 8.0f, LOG_MIN = -1.0f;

// Fewest pixels for which a part pays for its thread.
constexpr std::size_t PART = 8192;

// A batch of groups, feature by feature: features, log2 of candidate ranges, and 1 for unexplained groups.
struct alignas(Lanes) GroupsAtOnce {
    float feature[FEATURES * AT_ONCE], stop[STOPS * AT_ONCE], unexplained[AT_ONCE];
};

// Network parameters: MEAN and SCALE of features, weights and bias of three layers, by `tools/fit_no_return.py fit`.
#include "no_return_network.inc"

constexpr std::size_t MAX_UNITS = std::max(std::size(FIRST_BIAS), std::size(SECOND_BIAS));

// Probabilities that a beam exceeds its early, likely and late depth.
constexpr std::array<float, 3> SURVIVED{0.8f, 0.5f, 0.2f};

// Outputs of the network: logits of each stop, of a free beam, and of an unseen stop; mean and log deviation of the
// latter's log2 range.
enum Output { FREE = STOPS, UNSEEN, UNSEEN_MEAN, UNSEEN_LOG_DEVIATION, OUTPUTS };

static_assert(std::size(MEAN) == FEATURES && std::size(SCALE) == FEATURES && std::size(THIRD_BIAS) == OUTPUTS);
static_assert(std::size(FIRST) == FEATURES * std::size(FIRST_BIAS));
static_assert(std::size(SECOND) == std::size(FIRST_BIAS) * std::size(SECOND_BIAS));
static_assert(std::size(THIRD) == std::size(SECOND_BIAS) * OUTPUTS);

// Fail-safe: if at least this share of the ground returns, a beam without a return neither met the ground nor passed
// it, nor did the beams above. Stops farther away get less weight there: the network saw few absorbing objects.
constexpr double EXPECTED_SHARE = 0.9;
constexpr float NO_LOGIT = -1e9f;  // of a missing stop
constexpr float LOG_UNEXPLAINED_WEIGHT = -3.91202f;  // log of a weight of 0.02

// A gap between two returns of similar range (ratio SIMILAR) that is narrower than this lies on their common surface.
constexpr float GAP_M = 1.5f, SIMILAR = 1.25f;

// Five quantiles of a Laplace distribution that stand for equal parts, in deviations.
constexpr std::array<float, 5> LAPLACE{-1.609f, -0.511f, 0.0f, 0.511f, 1.609f};

INLINE float log_m(float meters) {
    if (!(meters < NONE)) return LOG_NONE;
    return std::clamp(log2_of(meters > 0.25f ? meters : 0.25f), LOG_MIN, LOG_NONE);
}

// A group of adjacent missing beams in one ring, and what surrounds its middle.
struct Group {
    std::uint32_t first, count;   // beams
    std::int32_t column;          // of the middle
    float azimuth, slope;         // of the middle
    float near_m, far_m, bound_m, ground_m;
    float near_turn, far_turn;    // radians to the nearer and the farther return in the ring
    bool is_near_obstacle, is_far_obstacle;
    bool is_unexplained;          // the ground should have returned it, or it lies above such a group
};

// Missing beams of all rings and their groups; those of ring r start at r · columns, by ascending column.
struct Missing {
    Missing(std::size_t rings, std::size_t columns)
        : beams(rings, 0), groups(rings, 0), azimuth(rings * columns), slope(rings * columns), group(rings * columns) {}

    Buffer<std::size_t> beams, groups;  // number in each ring
    Buffer<float> azimuth, slope;
    Buffer<Group> group;
};

using Shares = std::array<double, SHARE_BINS>;

std::size_t share_bin(float range_m) { return std::min(std::size_t(range_m / SHARE_BIN_M), SHARE_BINS - 1); }

// Return the number of lowest rings (at least one) that may have a beam below a slope in `level`.
std::size_t count_rings_below(double slope, const RingAims& aims) {
    const double tilt = std::acos(std::clamp(aims.rotation[8], -1.0, 1.0));
    std::size_t rings = aims.elevation.size;
    while (rings > 1 && aims.elevation[rings - 1] - tilt > std::atan(slope)) --rings;
    return rings;
}

// Return the range beyond which a share REACH_SHARE of the returns lies.
float farthest_of(const DepthImages& images) {
    std::int64_t all = 0, beyond = 0;
    for (const std::int64_t count : images.meter_counts) all += count;
    double meters = 0.0;
    for (std::size_t b = REACH_BINS; b-- > 0;) {
        beyond += images.meter_counts[b];
        meters += double(beyond) > REACH_SHARE * double(all);
    }
    return float(meters);
}

// Write the distance in rings (rings, columns) to the next return below each pixel, 255 for none.
MULTIVERSION void find_rings_below(const std::uint8_t* counts, std::size_t rings, std::size_t columns,
                                   std::uint8_t* rings_below) {
    std::fill_n(rings_below, columns, std::uint8_t(255));
    for (std::size_t r = 1; r < rings; ++r) {
        const std::uint8_t *row = counts + (r - 1) * columns, *before = rings_below + (r - 1) * columns;
        std::uint8_t* below = rings_below + r * columns;
        for (std::size_t c = 0; c < columns; ++c) {
            const std::uint8_t farther = before[c] < 255 ? std::uint8_t(before[c] + 1) : std::uint8_t(255);
            below[c] = row[c] > 0 ? std::uint8_t(1) : farther;
        }
    }
}

// Return the next ring above with a return in a column; -1 if none is near.
int next_above(View2<const std::uint8_t> counts, std::size_t r, std::size_t c) {
    for (std::size_t p = r + 1; p < std::min(r + 1 + NEIGHBOR_RINGS, counts.rows); ++p) {
        if (counts(p, c) > 0) return int(p);
    }
    return -1;
}

// Return the depths of a pixel. If all its returns are left out (too near, on the own vehicle), the beam ended at once.
INLINE Depth depth_of(const DepthImages& images, std::size_t r, std::size_t c) {
    const Depth depth = images.ring(r)[c];
    return images.all_counts()(r, c) > 0 && !(depth.nearest_m < NONE) ? Depth{0.5f, NONE} : depth;
}

// Return the range of the nearest obstacle in the two pixels beside a beam and the three above it.
float bound_of(const DepthImages& images, std::size_t r, std::int32_t c) {
    const Depth *ring = images.ring(r), *above = r + 1 < images.rings ? images.ring(r + 1) : nullptr;
    const auto columns = std::int32_t(images.columns);
    const std::int32_t before = c > 0 ? c - 1 : columns - 1, after = c + 1 < columns ? c + 1 : 0;
    float nearest = std::min(ring[before].obstacle_m, ring[after].obstacle_m);
    if (above != nullptr) {
        nearest = std::min({nearest, above[before].obstacle_m, above[c].obstacle_m, above[after].obstacle_m});
    }
    return nearest;
}

// Window sums over the image, pooled to POOLED columns, by cumulative sums: pixels, returns, log2 ranges, obstacles.
// Also the farthest return of each pooled column.
class PooledImage {
public:
    PooledImage(const DepthImages& images, const Buffer<bool>& silent)
        : rings(images.rings), before_((images.rings + 1) * (POOLED + 1)), farthest(POOLED, LOG_MIN) {
        const std::size_t columns = images.columns;
        for (std::size_t c = 0; c <= POOLED; ++c) before_[c] = Four{};
        for (std::size_t r = 0; r < rings; ++r) {
            const Depth* ring = images.ring(r);
            Four row = {};
            before_[(r + 1) * (POOLED + 1)] = Four{};
            for (std::size_t p = 0; p < POOLED; ++p) {
                for (std::size_t c = p * columns / POOLED; c < (p + 1) * columns / POOLED; ++c) {
                    if (silent[c]) continue;
                    const float depth_m = depth_of(images, r, c).nearest_m;
                    if (!(depth_m < NONE)) {
                        row += Four{1, 0, 0, 0};
                        continue;
                    }
                    const float log = log_m(depth_m);
                    row += Four{1, 1, log, ring[c].obstacle_m < NONE ? 1.0f : 0.0f};
                    farthest[p] = std::max(farthest[p], log);
                }
                before_[(r + 1) * (POOLED + 1) + p + 1] = before_[r * (POOLED + 1) + p + 1] + row;
            }
        }
    }

    // Write the share of pixels with returns, the mean log2 range, and the share of returns on obstacles, over rings
    // [low, high) and `wide` pooled columns to either side.
    void describe(std::size_t low, std::size_t high, std::size_t column, std::size_t wide, float* out) const {
        const std::size_t first = column + POOLED - wide, last = column + POOLED + wide + 1;
        const Four sum = until(high, last) - until(high, first) - until(low, last) + until(low, first);
        out[0] = sum[0] > 0.0f ? sum[1] / sum[0] : 0.0f;
        out[1] = sum[1] > 0.5f ? sum[2] / sum[1] : LOG_NONE;
        out[2] = sum[1] > 0.5f ? sum[3] / sum[1] : 0.0f;
    }

    float farthest_around(std::size_t column, std::size_t wide) const {
        float most = LOG_MIN;
        for (std::size_t k = column + POOLED - wide; k <= column + POOLED + wide; ++k) {
            most = std::max(most, farthest[k % POOLED]);
        }
        return most;
    }

    std::size_t rings;

private:
    // Cumulative sum of the rings below `ring` and the columns before `column`, counted from one turn before.
    Four until(std::size_t ring, std::size_t column) const {
        const Four* row = &before_[ring * (POOLED + 1)];
        return row[column % POOLED] + float(column / POOLED) * row[POOLED];
    }

    Buffer<Four> before_;
    Buffer<float> farthest;
};

// Return the median over sectors of the returning share in a bin, weighted by beams; 0 without any.
double median_share(const ShareCounts& returned, const ShareCounts& lost, std::size_t bin) {
    std::array<std::pair<double, std::int64_t>, SHARE_SECTORS> shares;  // share and number of beams
    std::size_t count = 0;
    std::int64_t all = 0, seen = 0;
    for (std::size_t s = 0; s < SHARE_SECTORS; ++s) {
        const std::int64_t beams = returned[s][bin] + lost[s][bin];
        if (beams > 0) shares[count++] = {double(returned[s][bin]) / double(beams), beams};
        all += beams;
    }
    std::sort(shares.begin(), shares.begin() + std::ptrdiff_t(count));
    for (std::size_t k = 0; k < count; ++k) {
        seen += shares[k].second;
        if (double(seen) > double(all) / 2) return shares[k].first;
    }
    return 0.0;
}

// Return the returning share of ground beams by range bin: median over sectors, with the nearer bin as prior.
Shares returning_shares(const ShareCounts& returned, const ShareCounts& lost) {
    Shares share;
    double before = 1.0;
    for (std::size_t k = 0; k < SHARE_BINS; ++k) {
        std::int64_t beams = 0;
        for (std::size_t s = 0; s < SHARE_SECTORS; ++s) beams += returned[s][k] + lost[s][k];
        before = (double(beams) * median_share(returned, lost, k) + PRIOR_BEAMS * before) / (double(beams) + PRIOR_BEAMS);
        share[k] = before;
    }
    return share;
}

bool has_returns(const DepthImages& images, std::size_t r) {
    const std::uint8_t* counts = images.counts.data() + r * images.columns;
    return std::any_of(counts, counts + images.columns, [](std::uint8_t count) { return count > 0; });
}

PolarGround polar_ground(const Ground& ground, float sensor_height_m, double top_m) {
    PolarGround polar;
    find_polar_ground(ground, sensor_height_m, top_m, polar);
    return polar;
}

// The missing beams of a sweep, and the network inputs for their groups.
class NoReturnScene {
public:
    NoReturnScene(const DepthImages& images_, const RingAims& aims_, const Ground& ground, float sensor_height_m_,
                  double top_m, float steep_m_)
        : images(images_), aims(aims_), sensor_height_m(sensor_height_m_), steep_m(steep_m_),
          farthest_m(farthest_of(images_)), polar(polar_ground(ground, sensor_height_m_, top_m)),
          rings(count_rings_below(*std::max_element(polar.top.begin(), polar.top.end()), aims_)),
          silent(silent_columns({images_.counts.data(), rings, images_.columns})), missing(rings, images_.columns),
          rings_below(rings * images_.columns), pooled(images_, silent) {
        find_rings_below(images.counts.data(), rings, images.columns, rings_below.data());
        for (std::size_t r = 0; r < images.rings; ++r) tangent.push_back(std::tan(aims.elevation[r]));
        of_sweep = {log_m(farthest_m), log_m(sensor_height_m),
                    std::log2(float(tangent[images.rings - 1] - tangent[0]) / float(images.rings) + 1e-3f),
                    std::log2(float(images.columns))};
        // Find the missing beams and their groups in each ring; rings and columns without returns have none.
        const Turn turn(images.columns);
        const std::size_t parts = std::min(count_parts(rings * images.columns, PART), rings);
        std::vector<ShareCounts> lost(parts, ShareCounts{});
        run_parts(parts, [&](std::size_t part) {
            MissingBeams found(images.columns);
            for (std::size_t r = part; r < rings; r += parts) {
                if (has_returns(images, r)) find_groups(r, turn, found, lost[part]);
            }
        });
        for (std::size_t part = 1; part < parts; ++part) {
            for (std::size_t s = 0; s < SHARE_SECTORS; ++s) {
                for (std::size_t b = 0; b < SHARE_BINS; ++b) lost[0][s][b] += lost[part][s][b];
            }
        }
        share = returning_shares(images.ground_counts, lost[0]);
        find_unexplained();
    }

    // Surroundings shared by the groups of one ring in one pooled column, in the order of the features.
    struct Surroundings {
        std::size_t ring, column;
        float near[3], near_farthest;       // a few rings and columns around
        float wide[3], above[3], below[2];  // a sixth of the rings and eleven columns; the rings above; those below
        float own_ring[2], wide_farthest, everything[3];
    };

    // Update the surroundings if the group lies in another ring or pooled column than the one before.
    void look_around(std::size_t r, const Group& group, Surroundings& around) const {
        const std::size_t p = std::size_t(group.column) * POOLED / images.columns;
        const std::size_t wide = std::max<std::size_t>(pooled.rings / 6, 2);
        if (around.ring == r && around.column == p) return;
        around.ring = r, around.column = p;
        float values[3];
        pooled.describe(r > 2 ? r - 2 : 0, std::min(r + 3, pooled.rings), p, 1, around.near);
        around.near_farthest = pooled.farthest_around(p, 1);
        pooled.describe(r > wide ? r - wide : 0, std::min(r + wide + 1, pooled.rings), p, 5, around.wide);
        pooled.describe(std::min(r + 1, pooled.rings), pooled.rings, p, 2, around.above);
        pooled.describe(r > 4 ? r - 4 : 0, r, p, 1, values);
        std::copy_n(values, 2, around.below);
        pooled.describe(r, r + 1, p, POOLED / 2 - 1, values);
        std::copy_n(values, 2, around.own_ring);
        around.wide_farthest = pooled.farthest_around(p, 5);
        pooled.describe(0, pooled.rings, p, POOLED / 2 - 1, around.everything);
    }

    // Write the features of a group and its log2 candidate ranges; consecutive values are `stride` apart.
    void describe(const Group& group, const Surroundings& around, std::size_t stride, float* feature, float* stop) const {
        const std::size_t r = around.ring, c = std::size_t(group.column);
        const std::size_t below = rings_below[r * images.columns + c];
        const bool has_below = below <= NEIGHBOR_RINGS;
        const Depth low = has_below ? depth_of(images, r - below, c) : Depth{NONE, NONE};
        const int high = next_above(images.all_counts(), r, c);
        const Depth upper = high >= 0 ? depth_of(images, std::size_t(high), c) : Depth{NONE, NONE};
        std::size_t k = 0;
        const auto add = [&](float value) { feature[stride * k++] = value; };
        const auto add_all = [&](const auto& values) { for (const float value : values) add(value); };
        const float stops[STOPS] = {log_m(group.near_m), log_m(group.far_m), log_m(low.nearest_m), log_m(upper.nearest_m),
                                    log_m(group.ground_m), around.near[1], around.near_farthest};
        for (std::size_t n = 0; n < STOPS; ++n) stop[stride * n] = stops[n];
        add_all(stops);
        // Distances in meters to the returns beside, below and above.
        const auto apart = [](double rise, float meters) {
            return meters < NONE ? log_m(float(rise) * meters) : LOG_NONE;
        };
        add(apart(group.near_turn, group.near_m));
        add(apart(group.far_turn, group.far_m));
        add(has_below ? apart(tangent[r] - tangent[r - below], low.nearest_m) : LOG_NONE);
        add(high >= 0 ? apart(tangent[std::size_t(high)] - tangent[r], upper.nearest_m) : LOG_NONE);
        add(log2_of(group.near_turn + 1e-3f));
        add(log2_of(group.far_turn + 1e-3f));
        add(group.is_near_obstacle);
        add(group.is_far_obstacle);
        add(low.obstacle_m < NONE);
        add(upper.obstacle_m < NONE);
        add(log_m(group.bound_m));
        add(group.ground_m < NONE && group.ground_m > steep_m ? float(share[share_bin(group.ground_m)]) : 1.0f);
        add(std::clamp(group.slope, -1.0f, 1.0f));
        add(std::clamp(sensor_height_m + group.slope * (group.near_m < NONE ? group.near_m : 64.0f), -8.0f, 16.0f));
        add(around.near[0]);
        add(around.near[2]);
        add_all(around.wide);
        add_all(around.above);
        add_all(around.below);
        add_all(around.own_ring);
        add(around.wide_farthest);
        add_all(around.everything);
        // Features of the sweep.
        add_all(of_sweep);
        add(float(r) / float(images.rings));
    }

    // Check that all beams of a group pass above all targets, by a margin.
    bool passes_above(std::size_t r, const Group& group) const {
        const float margin = 0.02f + std::fabs(float(aims.origin_m[r])) / std::max(steep_m, 0.1f);
        return group.slope - margin > polar.top[ground_sector(group.azimuth)];
    }

    const DepthImages& images;
    const RingAims& aims;
    float sensor_height_m, steep_m, farthest_m;
    PolarGround polar;
    std::size_t rings;  // with beams that may reach a target
    Buffer<bool> silent;
    Missing missing;

private:
    // Find the missing beams of a ring, their directions and groups; count those that should have met open ground.
    void find_groups(std::size_t r, const Turn& turn, MissingBeams& found, ShareCounts& lost) {
        const std::size_t columns = images.columns, begin = r * columns;
        const auto wide = std::int32_t(std::max<std::size_t>(columns / GROUPS, 1));
        const float step = float(2 * std::numbers::pi / double(columns));
        find_missing({images.counts.data() + begin, columns}, found);
        std::size_t count = 0;
        for (std::size_t k = 0; k < found.count; ++k) {
            if (silent[std::size_t(found.column[k])]) continue;
            found.column[count] = found.column[k], found.before[count] = found.before[k], found.after[count] = found.after[k];
            ++count;
        }
        float *azimuth = &missing.azimuth[begin], *slope = &missing.slope[begin];
        aim_beams(turn, {found.column.data(), count}, aims.phase[r], tangent[r], aims.rotation, azimuth, slope);
        const auto depth_at = [&](std::int32_t c, std::int32_t at) {
            if (at == c) return Depth{NONE, NONE};
            const std::int32_t turn = std::int32_t(columns);
            return depth_of(images, r, std::size_t(at < 0 ? at + turn : (at < turn ? at : at - turn)));
        };
        std::size_t groups = 0, at = 0;
        for (std::size_t k = 0, end = 0; k < count; k = end) {
            for (end = k + 1; end < count && found.column[end] - found.column[k] < wide && found.after[end] == found.after[k];) {
                ++end;
            }
            const std::size_t middle = (k + end) / 2;
            const std::int32_t c = found.column[middle], before = found.before[middle], after = found.after[middle];
            Group group{std::uint32_t(k), std::uint32_t(end - k), c, azimuth[middle], slope[middle], 0, 0, 0, 0, 0, 0, 0, 0, 0};
            Depth near = depth_at(c, before), far = depth_at(c, after);
            group.near_turn = float(c - before) * step, group.far_turn = float(after - c) * step;
            if (far.nearest_m < near.nearest_m) std::swap(near, far), std::swap(group.near_turn, group.far_turn);
            group.near_m = near.nearest_m, group.far_m = far.nearest_m;
            group.is_near_obstacle = near.obstacle_m < NONE, group.is_far_obstacle = far.obstacle_m < NONE;
            group.bound_m = bound_of(images, r, c);
            // A higher beam origin makes the beam appear less steep: repeat with the slope at that range.
            const std::size_t sector = ground_sector(group.azimuth);
            group.ground_m = meet_ground(polar, sector, group.slope, at);
            const float rise_m = float(aims.origin_m[r]);
            if (rise_m != 0.0f && group.ground_m < NONE) {
                group.ground_m = meet_ground(polar, sector, group.slope + rise_m / group.ground_m, at);
            }
            if (group.bound_m > group.ground_m - 1.0f && steep_m < group.ground_m && group.ground_m < NONE) {
                lost[std::size_t(c) * SHARE_SECTORS / columns][share_bin(group.ground_m)] += group.count;
            }
            missing.group[begin + groups++] = group;
        }
        missing.beams[r] = count, missing.groups[r] = groups;
    }

    // Mark unexplained groups, from the lowest ring upward: each affects the one above.
    void find_unexplained() {
        const std::size_t columns = images.columns;
        const auto wide = std::max<std::size_t>(columns / GROUPS, 1);
        std::vector<std::int32_t> last(columns, -2);  // last ring with an unexplained group, by column
        std::int32_t below = -1;                      // next lower ring with returns
        for (std::size_t r = 0; r < rings; ++r) {
            for (std::size_t g = r * columns; g < r * columns + missing.groups[r]; ++g) {
                Group& group = missing.group[g];
                const float gap_m = (group.near_turn + group.far_turn) * group.near_m;
                const bool is_narrow = group.far_m < SIMILAR * group.near_m && gap_m < GAP_M;
                bool is_expected = group.ground_m < NONE;
                if (is_expected && group.ground_m > steep_m) is_expected = share[share_bin(group.ground_m)] >= EXPECTED_SHARE;
                const std::size_t c = std::size_t(group.column);
                group.is_unexplained = !is_narrow && (is_expected || last[c] == below);
                if (!group.is_unexplained) continue;
                for (std::size_t k = columns + c - wide / 2; k <= columns + c + wide / 2; ++k) last[k % columns] = std::int32_t(r);
            }
            if (has_returns(images, r)) below = std::int32_t(r);
        }
    }

    std::vector<double> tangent;
    std::array<float, 4> of_sweep;  // features of the sweep: reach, sensor height, ring gap, columns
    Buffer<std::uint8_t> rings_below;
    PooledImage pooled;
    Shares share;
};

// Standardize features (FEATURES, AT_ONCE) and clip them to ±MAX_DEVIATIONS.
MULTIVERSION void standardize(const float* feature, float* out) {
    for (std::size_t k = 0; k < FEATURES; ++k) {
        for (std::size_t n = k * AT_ONCE; n < (k + 1) * AT_ONCE; ++n) {
            const float value = (feature[n] - MEAN[k]) * SCALE[k], high = value < MAX_DEVIATIONS ? value : MAX_DEVIATIONS;
            out[n] = high > -MAX_DEVIATIONS ? high : -MAX_DEVIATIONS;
        }
    }
}

// Compute out = weights (inputs, units) · in + bias for all groups at once, four units at a time so that the sums stay
// in registers. Sums follow the order of the inputs.
MULTIVERSION void apply_layer(const float* weights, const float* bias, std::size_t inputs, std::size_t units, const Lanes* in,
                              bool is_hidden, Lanes* out) {
    std::size_t u = 0;
    for (; u + 4 <= units; u += 4) {
        Lanes a = Lanes{} + bias[u], b = Lanes{} + bias[u + 1], c = Lanes{} + bias[u + 2], d = Lanes{} + bias[u + 3];
        for (std::size_t k = 0; k < inputs; ++k) {
            const float* const row = weights + k * units + u;
            a += in[k] * row[0];
            b += in[k] * row[1];
            c += in[k] * row[2];
            d += in[k] * row[3];
        }
        out[u] = a, out[u + 1] = b, out[u + 2] = c, out[u + 3] = d;
    }
    for (; u < units; ++u) {
        Lanes a = Lanes{} + bias[u];
        for (std::size_t k = 0; k < inputs; ++k) a += in[k] * weights[k * units + u];
        out[u] = a;
    }
    if (!is_hidden) return;
    auto* const number = reinterpret_cast<float*>(out);
    for (std::size_t n = 0; n < units * AT_ONCE; ++n) number[n] = number[n] > 0.0f ? number[n] : 0.0f;
}

// Write the ranges (3, AT_ONCE) that shares SURVIVED of the beams of each group exceed, from the network's outputs
// (OUTPUTS, AT_ONCE). Loops over groups vectorize, so nothing is sorted.
MULTIVERSION void write_depths(const float* __restrict output, const GroupsAtOnce& groups, std::size_t count,
                               float* __restrict depth_m) {
    constexpr std::size_t ENDS = STOPS + LAPLACE.size(), LOGITS = UNSEEN + 1;
    const float *const stop = groups.stop, *const unexplained = groups.unexplained;
    // 1. Softmax weights of the possible ends of a beam.
    float logit[LOGITS][AT_ONCE], most[AT_ONCE], total[AT_ONCE], log_m[ENDS][AT_ONCE], weight[ENDS][AT_ONCE];
    for (std::size_t k = 0; k < LOGITS; ++k) {
        const float held_back = k == FREE || k == ON_GROUND || k == FARTHEST ? LOG_UNEXPLAINED_WEIGHT : 0.0f;
        for (std::size_t n = 0; n < count; ++n) {
            const float own = output[k * AT_ONCE + n] + unexplained[n] * held_back;
            logit[k][n] = k >= STOPS || stop[k * AT_ONCE + n] < LOG_NONE ? own : NO_LOGIT;
        }
    }
    std::copy_n(logit[0], AT_ONCE, most);
    for (std::size_t k = 1; k < LOGITS; ++k) {
        for (std::size_t n = 0; n < count; ++n) most[n] = logit[k][n] > most[n] ? logit[k][n] : most[n];
    }
    for (std::size_t k = 0; k < STOPS; ++k) {
        for (std::size_t n = 0; n < count; ++n) {
            log_m[k][n] = stop[k * AT_ONCE + n];
            weight[k][n] = log_m[k][n] < LOG_NONE ? exp_of(logit[k][n] - most[n]) : 0.0f;
        }
    }
    for (std::size_t n = 0; n < count; ++n) {
        // What stopped an unexplained beam is assumed no farther than the return below it.
        const float mean = output[UNSEEN_MEAN * AT_ONCE + n], below = stop[BELOW * AT_ONCE + n];
        const float bound = unexplained[n] > 0.0f && below < LOG_NONE ? below : NONE, center = mean < bound ? mean : bound;
        const float log_deviation = output[UNSEEN_LOG_DEVIATION * AT_ONCE + n];
        const float least = log_deviation > -3.0f ? log_deviation : -3.0f, deviation = exp_of(least < 1.5f ? least : 1.5f);
        const float part = exp_of(logit[UNSEEN][n] - most[n]) / float(LAPLACE.size());
        for (std::size_t k = 0; k < LAPLACE.size(); ++k) {
            log_m[STOPS + k][n] = center + LAPLACE[k] * deviation;
            weight[STOPS + k][n] = part;
        }
        total[n] = exp_of(logit[FREE][n] - most[n]);
    }
    for (std::size_t k = 0; k < ENDS; ++k) {
        for (std::size_t n = 0; n < count; ++n) total[n] += weight[k][n];
    }
    // 2. Find the nearest end up to which a share above 1 - SURVIVED of the beams ended.
    float found[SURVIVED.size()][AT_ONCE];
    std::fill_n(found[0], SURVIVED.size() * AT_ONCE, NONE);
    for (std::size_t k = 0; k < ENDS; ++k) {
        float ended[AT_ONCE] = {};
        for (std::size_t j = 0; j < ENDS; ++j) {
            for (std::size_t n = 0; n < count; ++n) ended[n] += log_m[j][n] <= log_m[k][n] ? weight[j][n] : 0.0f;
        }
        for (std::size_t level = 0; level < SURVIVED.size(); ++level) {
            for (std::size_t n = 0; n < count; ++n) {
                const bool is_end = (ended[n] > (1.0f - SURVIVED[level]) * total[n]) & (log_m[k][n] < found[level][n]);
                found[level][n] = is_end ? log_m[k][n] : found[level][n];
            }
        }
    }
    for (std::size_t level = 0; level < SURVIVED.size(); ++level) {
        for (std::size_t n = 0; n < count; ++n) {
            const float low = found[level][n] > -20.0f ? found[level][n] : -20.0f, in_range = low < 20.0f ? low : 20.0f;
            depth_m[level * AT_ONCE + n] = found[level][n] < NONE ? exp2_of(in_range) : NONE;
        }
    }
}

// Write the depths (3, AT_ONCE) of a batch of groups by the network.
void guess_depths(const GroupsAtOnce& groups, float* depth_m) {
    Lanes first[FEATURES], second[MAX_UNITS], third[MAX_UNITS], output[OUTPUTS];
    standardize(groups.feature, reinterpret_cast<float*>(first));
    apply_layer(FIRST, FIRST_BIAS, FEATURES, std::size(FIRST_BIAS), first, true, second);
    apply_layer(SECOND, SECOND_BIAS, std::size(FIRST_BIAS), std::size(SECOND_BIAS), second, true, third);
    apply_layer(THIRD, THIRD_BIAS, std::size(SECOND_BIAS), OUTPUTS, third, false, output);
    write_depths(reinterpret_cast<const float*>(output), groups, AT_ONCE, depth_m);
}

}  // namespace

NoReturnGroups describe_no_return_beams(const DepthImages& images, const RingAims& aims, const Ground& ground,
                                       float sensor_height_m, double top_m, float steep_m) {
    const NoReturnScene scene(images, aims, ground, sensor_height_m, top_m, steep_m);
    const Missing& missing = scene.missing;
    std::size_t size = 0, n = 0;
    for (std::size_t r = 0; r < scene.rings; ++r) size += missing.groups[r];
    NoReturnGroups groups{Buffer<float>(size), Buffer<float>(size), Buffer<std::int32_t>(size), Buffer<float>(size * FEATURES),
                          Buffer<float>(size * STOPS)};
    NoReturnScene::Surroundings around{scene.rings, 0, {}, 0, {}, {}, {}, {}, 0, {}};
    for (std::size_t r = 0; r < scene.rings; ++r) {
        for (std::size_t g = r * images.columns; g < r * images.columns + missing.groups[r]; ++g, ++n) {
            const Group& group = missing.group[g];
            groups.azimuth[n] = group.azimuth, groups.slope[n] = group.slope;
            groups.beams[n] = group.slope > scene.polar.top[ground_sector(group.azimuth)] ? 0 : std::int32_t(group.count);
            scene.look_around(r, group, around);
            scene.describe(group, around, 1, &groups.feature[n * FEATURES], &groups.stop[n * STOPS]);
        }
    }
    return groups;
}

NoReturnBeams guess_no_return_beams(const DepthImages& images, const RingAims& aims, const Ground& ground,
                                    float sensor_height_m, double top_m, float steep_m) {
    const NoReturnScene scene(images, aims, ground, sensor_height_m, top_m, steep_m);
    const std::size_t columns = images.columns;
    const Missing& missing = scene.missing;
    // 1. Estimate the depths of each group.
    Buffer<std::array<float, 3>> depths(scene.rings * columns);
    const std::size_t parts = std::min(count_parts(scene.rings * columns, PART), scene.rings);
    run_parts(parts, [&](std::size_t part) {
        for (std::size_t r = part; r < scene.rings; r += parts) {
            const std::size_t end = r * columns + missing.groups[r];
            GroupsAtOnce groups{};
            NoReturnScene::Surroundings around{scene.rings, 0, {}, 0, {}, {}, {}, {}, 0, {}};
            for (std::size_t g = r * columns; g < end; g += AT_ONCE) {
                const std::size_t count = std::min(AT_ONCE, end - g);
                std::size_t place[AT_ONCE], kept = 0;
                for (std::size_t k = g; k < g + count; ++k) {
                    depths[k] = {0.0f, 0.0f, 0.0f};
                    if (scene.passes_above(r, missing.group[k])) continue;
                    scene.look_around(r, missing.group[k], around);
                    scene.describe(missing.group[k], around, AT_ONCE, &groups.feature[kept], &groups.stop[kept]);
                    groups.unexplained[kept] = missing.group[k].is_unexplained;
                    place[kept++] = k;
                }
                if (kept == 0) continue;
                float found[3][AT_ONCE];
                guess_depths(groups, found[0]);
                const auto depth_m = [&](std::size_t d, std::size_t k) {
                    return std::min(found[d][k], MAX_REACH_RATIO * scene.farthest_m);
                };
                for (std::size_t k = 0; k < kept; ++k) depths[place[k]] = {depth_m(0, k), depth_m(1, k), depth_m(2, k)};
            }
        }
    });
    // 2. Write its beams, with slopes seen from the sensor's origin. Beams above all targets are dropped.
    NoReturnBeams beams(scene.rings * columns);
    for (std::size_t r = 0; r < scene.rings; ++r) {
        const float rise_m = float(aims.origin_m[r]);
        for (std::size_t g = r * columns; g < r * columns + missing.groups[r]; ++g) {
            const Group& group = missing.group[g];
            for (std::size_t n = r * columns + group.first; n < r * columns + group.first + group.count; ++n) {
                const float slope = missing.slope[n] + rise_m / std::max(depths[g][1], steep_m);
                if (slope > scene.polar.top[ground_sector(missing.azimuth[n])]) continue;
                beams.add(missing.azimuth[n], slope, depths[g]);
            }
        }
    }
    return beams;
}

BeamColumns no_return_beams(const DepthImages& images, const RingAims& aims, bool fill) {
    const std::size_t rings = images.rings, columns = images.columns;
    BeamColumns beams(rings * columns);
    const Turn turn(columns);
    MissingBeams missing(columns);
    for (std::size_t r = 0; r < rings; ++r) {
        find_missing({images.counts.data() + r * columns, columns}, missing);
        // Fill the depth of each beam, and keep those with one.
        std::size_t count = 0;
        for (std::size_t k = 0; k < missing.count; ++k) {
            const std::int32_t c = missing.column[k];
            float depth_m = NONE;
            for (const std::int32_t at : {missing.before[k], missing.after[k]}) {
                if (fill && std::abs(at - c) <= FILL_COLUMNS) {
                    depth_m = std::min(depth_m, depth_around(images.ring(r), std::int32_t(columns), c, at));
                }
            }
            if (fill && !(depth_m < NONE)) continue;
            missing.column[count] = c;
            beams.depth_m[beams.count + count] = depth_m;
            ++count;
        }
        aim_beams(turn, {missing.column.data(), count}, aims.phase[r], std::tan(aims.elevation[r]), aims.rotation,
                  &beams.azimuth[beams.count], &beams.slope[beams.count]);
        beams.count += count;
    }
    return beams;
}

}  // namespace viewshed
