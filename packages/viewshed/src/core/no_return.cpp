#include "no_return.hpp"

#include <algorithm>
#include <array>
#include <cmath>
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
constexpr float UNKNOWN = std::numeric_limits<float>::quiet_NaN();

// A gap is filled from returns in the same ring at most this many columns away.
constexpr int FILL_COLUMNS = 16;

// A gap between two returns that is narrower than this, measured at the nearer one, lies on what the two lie on if the
// ratio of their ranges is below the second number.
constexpr double GAP_M = 1.5, SIMILAR = 1.25;

// The next return below or above in a column is at most this number of rings away.
constexpr std::size_t NEIGHBOR_RINGS = 8;

// Where a larger share of the ground gives returns, a beam without one did not meet the ground.
constexpr double EXPECTED_SHARE = 0.9;

// The share of a bin of range starts from that of the bin before, as if PRIOR_BEAMS beams had shown it.
constexpr double PRIOR_BEAMS = 20;

// Nearer ground returns at least as often as that of a bin with this share of all returns from ground.
constexpr double WEIGHTY = 0.02;

// Beyond some range lies only this share of the returns: that far the sensor reaches in this air, ...
constexpr double REACH_SHARE = 0.001;

// ... and this times as far a target would still be seen, for it faces the beams, which graze the ground.
constexpr double BEYOND_REACH = 2.0;

// Pixels of a part that is worth a thread.
constexpr std::size_t PART = 8192;

// What is found of the missing beams; those of ring r stand from r · columns on, by ascending column.
struct Candidates {
    explicit Candidates(std::size_t rings, std::size_t columns)
        : count(rings, 0), column(rings * columns), azimuth(rings * columns), slope(rings * columns),
          gap_m(rings * columns), bound_m(rings * columns), ground_m(rings * columns) {}

    Buffer<std::size_t> count;
    Buffer<std::int32_t> column;
    Buffer<float> azimuth, slope;
    Buffer<float> gap_m;     // the nearer end of a narrow gap, NaN for none
    Buffer<float> bound_m;   // the nearest obstacle around
    Buffer<float> ground_m;  // where it would meet the ground
};

using Shares = std::array<double, SHARE_BINS>;

std::size_t share_bin(float range_m) { return std::min(std::size_t(range_m / SHARE_BIN_M), SHARE_BINS - 1); }

// How many rings, from the lowest and at least one, may have a beam below a slope in `level`.
std::size_t count_rings_below(double slope, const RingAims& aims) {
    const double tilt = std::acos(std::clamp(aims.rotation[8], -1.0, 1.0));
    std::size_t rings = aims.elevation.size;
    while (rings > 1 && aims.elevation[rings - 1] - tilt > std::atan(slope)) --rings;
    return rings;
}

// The range beyond which lies REACH_SHARE of the returns.
double reach_of(const DepthImages& images) {
    std::int64_t all = 0, beyond = 0;
    for (const std::int64_t count : images.meter_counts) all += count;
    double meters = 0.0;
    for (std::size_t b = REACH_BINS; b-- > 0;) {
        beyond += images.meter_counts[b];
        meters += double(beyond) > REACH_SHARE * double(all);
    }
    return meters;
}

// Keep the beams of columns that fired, and write the narrow gaps in the ring that they lie in.
std::size_t find_ring_gaps(const MissingBeams& missing, View1<const bool> silent, const Depth* ring,
                           std::int32_t* column, float* gap_m) {
    const auto columns = std::int32_t(silent.size);
    const float step = float(2 * std::numbers::pi / columns);
    std::size_t m = 0;
    for (std::size_t k = 0; k < missing.count; ++k) {
        const std::int32_t c = missing.column[k], before = missing.before[k], after = missing.after[k];
        if (silent[c]) continue;
        const float left = depth_around(ring, columns, c, before), right = depth_around(ring, columns, c, after);
        const float near = std::min(left, right), far = std::max(left, right);
        const bool is_narrow = far < SIMILAR * near && double(after - before) * step * near < GAP_M;
        column[m] = c;
        gap_m[m] = is_narrow ? near : UNKNOWN;
        ++m;
    }
    return m;
}

// Write how many rings below each pixel (rings, columns) the next one with a return lies, 255 for more than that.
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

// The next ring above with a return in a column; -1 where there is none nearby.
int next_above(View2<const std::uint8_t> counts, std::size_t r, std::size_t c) {
    for (std::size_t p = r + 1; p < std::min(r + 1 + NEIGHBOR_RINGS, counts.rows); ++p) {
        if (counts(p, c) > 0) return int(p);
    }
    return -1;
}

// Lower gap_m to the nearer of the obstacles next below and above in the column, if similar and close.
void find_column_gaps(const DepthImages& images, const std::uint8_t* rings_below, const double* tangent, std::size_t r,
                      std::size_t count, const std::int32_t* column, float* gap_m) {
    for (std::size_t k = 0; k < count; ++k) {
        const std::size_t c = std::size_t(column[k]), below = rings_below[c];
        // Most beams have ground below them: without an obstacle there, none above is looked for.
        if (below > NEIGHBOR_RINGS) continue;
        const float below_m = images.ring(r - below)[c].obstacle_m;
        if (!(below_m < NONE)) continue;
        const int high = next_above(images.all_counts(), r, c);
        if (high < 0) continue;
        const float above_m = images.ring(std::size_t(high))[c].obstacle_m;
        const float near = std::min(below_m, above_m), far = std::max(below_m, above_m);
        if (far < SIMILAR * near && (tangent[std::size_t(high)] - tangent[r - below]) * near < GAP_M) {
            gap_m[k] = gap_m[k] < near ? gap_m[k] : near;  // NaN gives way
        }
    }
}

// Write the nearest obstacle among the two pixels beside each beam and the three above it.
void find_bounds(const DepthImages& images, std::size_t r, std::size_t count, const std::int32_t* column,
                 float* bound_m) {
    const Depth *ring = images.ring(r), *above = r + 1 < images.rings ? images.ring(r + 1) : nullptr;
    const auto columns = std::int32_t(images.columns);
    for (std::size_t k = 0; k < count; ++k) {
        const std::int32_t c = column[k], before = c > 0 ? c - 1 : columns - 1, after = c + 1 < columns ? c + 1 : 0;
        float nearest = std::min(ring[before].obstacle_m, ring[after].obstacle_m);
        if (above != nullptr) {
            nearest = std::min({nearest, above[before].obstacle_m, above[c].obstacle_m, above[after].obstacle_m});
        }
        bound_m[k] = nearest;
    }
}

// Lower bound_m to gap_m of beams in the same gap of the ring that passed closer than GAP_M: once in the order of the
// columns and once against it, as the stopped beam may lie on either side.
void bound_beside_gaps(std::size_t count, std::size_t columns, const std::int32_t* column, const float* gap_m,
                       float* bound_m) {
    const float per_column = float(2 * std::numbers::pi / double(columns));
    for (const int step : {1, -1}) {
        std::int32_t at = 0, last = 0;
        float near = NONE;
        for (std::size_t k = 0; k < count; ++k) {
            const std::size_t n = step > 0 ? k : count - 1 - k;
            // A new gap begins where a return lies between two beams.
            if (k > 0 && std::abs(column[n] - last) > 1) near = NONE;
            last = column[n];
            if (!std::isnan(gap_m[n])) {
                at = column[n], near = gap_m[n];
            } else if (near < NONE && double(std::abs(column[n] - at)) * per_column * near < GAP_M / 2) {
                bound_m[n] = std::min(bound_m[n], near);
            }
        }
    }
}

// Write the range at which the beams of a ring first meet the ground, +inf where they do not.
void find_ground(const PolarGround& polar, std::size_t count, const float* azimuth, const float* slope, float rise_m,
                 float* ground_m) {
    std::size_t at = 0;
    for (std::size_t k = 0; k < count; ++k) {
        const std::size_t sector = ground_sector(azimuth[k]);
        ground_m[k] = meet_ground(polar, sector, slope[k], at);
        // A beam that starts higher looks less steep from the sensor's origin: once more with the slope at that range.
        if (rise_m != 0.0f && ground_m[k] < NONE) {
            ground_m[k] = meet_ground(polar, sector, slope[k] + rise_m / ground_m[k], at);
        }
    }
}

// The median of the sectors' shares in a bin, weighted with their beams; 0 without any.
double median_share(const ShareCounts& returned, const ShareCounts& lost, std::size_t bin) {
    std::array<std::pair<double, std::int64_t>, SHARE_SECTORS> shares;  // with their beams
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

// The share of the beams at ground that return, in each bin of range: the median over the sectors.
Shares returning_shares(const ShareCounts& returned, const ShareCounts& lost) {
    // Outwards: each bin starts from the one before.
    Shares share;
    std::array<std::int64_t, SHARE_BINS> returns{};
    std::int64_t all = 0;
    double before = 1.0;
    for (std::size_t k = 0; k < SHARE_BINS; ++k) {
        std::int64_t none = 0;
        for (std::size_t s = 0; s < SHARE_SECTORS; ++s) returns[k] += returned[s][k], none += lost[s][k];
        all += returns[k];
        const double beams = double(returns[k] + none);
        before = (beams * median_share(returned, lost, k) + PRIOR_BEAMS * before) / (beams + PRIOR_BEAMS);
        share[k] = before;
    }
    // Inwards: nearer ground returns at least as often as well observed ground farther away.
    double farther = 0.0;
    for (std::size_t k = SHARE_BINS; k-- > 0;) {
        if (double(returns[k]) > WEIGHTY * double(all)) farther = std::max(farther, share[k]);
        share[k] = std::max(share[k], farther);
    }
    return share;
}

// Count the beams of a ring at open ground that did not return: no gap, and no obstacle before the ground.
void count_lost(const Candidates& beams, std::size_t first, std::size_t count, std::size_t columns, float steep_m,
                ShareCounts& lost) {
    for (std::size_t n = first; n < first + count; ++n) {
        const float ground_m = beams.ground_m[n];
        if (std::isnan(beams.gap_m[n]) && beams.bound_m[n] > ground_m - 1.0 && steep_m < ground_m && ground_m < NONE) {
            ++lost[std::size_t(beams.column[n]) * SHARE_SECTORS / columns][share_bin(ground_m)];
        }
    }
}

bool has_returns(const DepthImages& images, std::size_t r) {
    const std::uint8_t* counts = images.counts.data() + r * images.columns;
    return std::any_of(counts, counts + images.columns, [](std::uint8_t count) { return count > 0; });
}

}  // namespace

void split_no_return_beams(const DepthImages& images, const RingAims& aims, const Ground& ground, float sensor_height_m,
                           double top_m, float steep_m, BeamColumns& inferred, BeamColumns& unresolved) {
    const std::size_t columns = images.columns;
    // 1. The ground as the sensor sees it, and the rings with beams that may reach a target.
    PolarGround polar;
    find_polar_ground(ground, sensor_height_m, top_m, polar);
    const std::size_t rings = count_rings_below(*std::max_element(polar.top.begin(), polar.top.end()), aims);
    Buffer<bool> silent(columns);
    find_silent_columns({images.counts.data(), rings, columns}, silent);
    std::vector<double> tangent(images.rings);
    for (std::size_t r = 0; r < images.rings; ++r) tangent[r] = std::tan(aims.elevation[r]);

    // 2. In each ring, the missing beams, where they aimed, and what is around them. Rings without returns have none.
    const Turn turn(columns);
    Buffer<std::uint8_t> rings_below(rings * columns);
    find_rings_below(images.counts.data(), rings, columns, rings_below.data());
    Candidates beams(rings, columns);
    const std::size_t parts = std::min(count_parts(rings * columns, PART), rings);
    std::vector<ShareCounts> lost(parts, ShareCounts{});
    run_parts(parts, [&](std::size_t part) {
        MissingBeams missing(columns);
        for (std::size_t r = part; r < rings; r += parts) {
            if (!has_returns(images, r)) continue;
            const std::size_t first = r * columns;
            std::int32_t* column = &beams.column[first];
            float *gap_m = &beams.gap_m[first], *bound_m = &beams.bound_m[first];
            find_missing({images.counts.data() + first, columns}, missing);
            const std::size_t count = find_ring_gaps(missing, silent, images.ring(r), column, gap_m);
            aim_beams(turn, {column, count}, aims.phase[r], tangent[r], aims.rotation, &beams.azimuth[first],
                      &beams.slope[first]);
            find_column_gaps(images, &rings_below[first], tangent.data(), r, count, column, gap_m);
            find_bounds(images, r, count, column, bound_m);
            bound_beside_gaps(count, columns, column, gap_m, bound_m);
            find_ground(polar, count, &beams.azimuth[first], &beams.slope[first], float(aims.origin_m[r]),
                        &beams.ground_m[first]);
            count_lost(beams, first, count, columns, steep_m, lost[part]);
            beams.count[r] = count;
        }
    });
    for (std::size_t part = 1; part < parts; ++part) {
        for (std::size_t s = 0; s < SHARE_SECTORS; ++s) {
            for (std::size_t b = 0; b < SHARE_BINS; ++b) lost[0][s][b] += lost[part][s][b];
        }
    }

    // 3. How far each beam went: by its gap; else as far as the ground where few beams return from there, unless nothing
    //    explains the beam below it. From the lowest ring upwards, since each says something of the one above.
    const Shares share = returning_shares(images.ground_counts, lost[0]);
    const float reach_m = float(BEYOND_REACH * reach_of(images));
    Buffer<std::int32_t> unexplained_at(columns, -2);  // the last ring of each column that nothing explains
    std::int32_t below = -1;                           // the next lower ring that has returns
    for (std::size_t r = 0; r < rings; ++r) {
        const float rise_m = float(aims.origin_m[r]);
        for (std::size_t n = r * columns; n < r * columns + beams.count[r]; ++n) {
            const float gap_m = beams.gap_m[n], ground_m = beams.ground_m[n];
            std::int32_t& unexplained = unexplained_at[std::size_t(beams.column[n])];
            bool is_lost = ground_m == NONE;
            if (steep_m < ground_m && ground_m < NONE) is_lost = share[share_bin(ground_m)] < EXPECTED_SHARE;
            float depth_m = UNKNOWN;
            if (!std::isnan(gap_m)) {
                depth_m = gap_m;
            } else if (is_lost && unexplained != below) {
                depth_m = std::min({ground_m, beams.bound_m[n], reach_m});
            } else {
                unexplained = std::int32_t(r);
            }
            // Slopes are seen from the sensor's origin. Beams above all targets are in neither set.
            const float slope = beams.slope[n] + rise_m / (depth_m > steep_m ? depth_m : steep_m);
            if (slope > polar.top[ground_sector(beams.azimuth[n])]) continue;
            if (std::isnan(depth_m)) {
                unresolved.add(beams.azimuth[n], slope, NONE);
            } else {
                inferred.add(beams.azimuth[n], slope, depth_m);
            }
        }
        if (has_returns(images, r)) below = std::int32_t(r);
    }
}

BeamColumns no_return_beams(const DepthImages& images, const RingAims& aims, bool fill) {
    const std::size_t rings = images.rings, columns = images.columns;
    BeamColumns beams(rings * columns);
    const Turn turn(columns);
    MissingBeams missing(columns);
    for (std::size_t r = 0; r < rings; ++r) {
        find_missing({images.counts.data() + r * columns, columns}, missing);
        // The depth of each, and those that have one.
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
