#include "elevation_clusters.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>

#include "parallel.hpp"
#include "random_rows.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Limits of the number of clusters; fewer are no sensor, more are noise. Fewer returns show no clusters.
constexpr std::size_t FEWEST_RINGS = 4, MAX_RINGS = 256, FEWEST_RETURNS = 256;

// Bin widths of elevation histograms, in the sine: 0.01° and 0.1° at the horizon.
constexpr double DEGREE = std::numbers::pi / 180;
constexpr double BIN = 0.01 * DEGREE, COARSE_BIN = 0.1 * DEGREE;

// Half widths of the windows in fine bins: how far the elevations of a beam may scatter.
constexpr std::array<int, 5> HALF_WIDTHS{1, 2, 4, 8, 16};

constexpr double MIN_CLUSTER_SIZE = 8.0;

// Nearer returns are ignored; low robots see the ground from this horizontal range on.
constexpr float NEAREST_M = 0.4f;

// Margin in explained share by which clusters must be better than others.
constexpr double MARGIN = 0.01;

// Sample sizes to score clusters, and to search their origin.
constexpr std::size_t SAMPLE = 4096, FEW = 2048;

// Tested heights of the beams' origin above the sensor's, in steps from first to last: Ouster has 36 mm below, KITTI
// 0.2 m. Finer steps follow around the best.
constexpr double HEIGHT_STEP_M = 0.03, FINE_STEP_M = 0.005;
constexpr int FIRST_HEIGHT = -5, LAST_HEIGHT = 10, FINE_STEPS = 4;

// Tested radii of the circle on which the beams start: Ouster's are 15.8 and 27.7 mm.
constexpr std::array<double, 3> RADII_M{0.0, 0.0158, 0.0277};

// Two clusters may be one beam if the gap between them is less than this share of the wider neighboring gap, ...
constexpr double SPLIT_GAP = 0.6;

// ... and fewer than DOUBLE_SHARE of their sectors return more than DOUBLE times a full sector of one beam.
constexpr double FULL_SECTOR = 0.95, DOUBLE = 1.3, DOUBLE_SHARE = 0.2;
constexpr int MAX_MERGES = 3;
constexpr std::size_t SECTORS = 360;

// Required share of returns at the clusters' elevations, in excess of chance.
constexpr double SHARPNESS = 0.85;

constexpr std::size_t PART = 32768;

struct Origin {
    double height_m, radius_m;

    bool operator==(const Origin&) const = default;
};

// Write the histogram position of each elevation seen from an origin, -1 for near returns. The sine is cheaper than the
// angle.
MULTIVERSION void place_block(const float* slope, const float* range_m, std::size_t count, float height_m,
                              float radius_m, float per_sine, float most, std::int32_t* position) {
    for (std::size_t k = 0; k < count; ++k) {
        const float r = range_m[k], far = r > NEAREST_M ? r : NEAREST_M;
        const float t = slope[k] - (height_m - radius_m * slope[k]) / far;
        const float at = (t / std::sqrt(1.0f + t * t) + 1.0f) * per_sine;
        const bool inside = (r > NEAREST_M) & (at >= 0.0f) & (at < most);
        position[k] = std::int32_t(inside ? at : -1.0f);
    }
}

// Return the histogram of elevations seen from an origin, over returns beyond 0.4 m, in equal bins of the sine.
std::vector<std::int32_t> count_elevations(View1<const float> slope, View1<const float> range_m, Origin origin,
                                           double bin_sine) {
    const auto bins = std::size_t(std::ceil(2.0 / bin_sine));
    const std::size_t parts = count_parts(slope.size, PART);
    std::vector<std::vector<std::int32_t>> counts(parts, std::vector<std::int32_t>(bins, 0));
    for_ranges(slope.size, parts, [&](std::size_t part, std::size_t begin, std::size_t end) {
        std::int32_t position[BLOCK], *of_part = counts[part].data();
        for (std::size_t start = begin; start < end; start += BLOCK) {
            const std::size_t size = std::min(BLOCK, end - start);
            place_block(slope.data + start, range_m.data + start, size, float(origin.height_m), float(origin.radius_m),
                        float(0.5 * double(bins)), float(bins), position);
            for (std::size_t k = 0; k < size; ++k) {
                if (position[k] >= 0) ++of_part[position[k]];
            }
        }
    });
    for (std::size_t part = 1; part < parts; ++part) {
        for (std::size_t b = 0; b < bins; ++b) counts[0][b] += counts[part][b];
    }
    return std::move(counts[0]);
}

// Return the elevations in radians of the peaks of a histogram, ascending.
//
// The histogram is smoothed by a triangle of `half_width` bins to either side and scanned once. A maximum of at least
// `least` is a peak once the curve has fallen to half of it; the next one starts once the curve has risen to twice the
// lowest value since. A peak lies at the mean of the returns in its window.
std::vector<double> find_peaks(const std::vector<std::int32_t>& counts, int half_width, double least) {
    const int bins = int(counts.size());
    std::vector<double> smooth(counts.size(), 0.0);
    for (int b = 0; b < bins; ++b) {
        if (counts[b] == 0) continue;
        for (int k = std::max(b - half_width, 0); k < std::min(b + half_width + 1, bins); ++k) {
            smooth[k] += counts[b] * (1.0 - std::abs(k - b) / (half_width + 1.0));
        }
    }
    std::vector<double> peaks;
    bool rising = true;
    double highest = 0.0, lowest = 0.0;
    int at = 0;
    for (int b = 0; b < bins; ++b) {
        const double v = smooth[b];
        if (rising && v > highest) {
            highest = v;
            at = b;
        } else if (rising && highest >= least && v <= 0.5 * highest) {
            double mass = 0.0, moment = 0.0;
            for (int k = std::max(at - half_width, 0); k < std::min(at + half_width + 1, bins); ++k) {
                mass += counts[k];
                moment += counts[k] * (k + 0.5);
            }
            peaks.push_back(std::asin(std::clamp(moment / mass * (2.0 / bins) - 1.0, -1.0, 1.0)));
            rising = false;
            lowest = v;
        } else if (!rising) {
            lowest = std::min(lowest, v);
            if (v >= least && v >= 2.0 * lowest) {
                rising = true;
                highest = v;
                at = b;
            }
        }
    }
    return peaks;
}

// Return the clusters at the best window width, scored on a sample; none if no width is sharp.
std::optional<ElevationClusters> clusters_seen_from(Origin origin, const Directions& directions, const Elevations& few) {
    const std::vector<std::int32_t> counts = count_elevations(directions.slope, directions.range_m, origin, BIN);
    std::optional<ElevationClusters> best;
    double best_share = SHARPNESS;
    for (const int half_width : HALF_WIDTHS) {
        std::vector<double> elevation = find_peaks(counts, half_width, MIN_CLUSTER_SIZE);
        if (elevation.size() < FEWEST_RINGS || elevation.size() > MAX_RINGS) continue;
        std::vector<double> origin_m;
        for (const double e : elevation) origin_m.push_back(origin.height_m - origin.radius_m * std::tan(e));
        const BeamTable table(std::move(elevation), std::move(origin_m), 0);
        const double share = match_beams({few.slope.data(), few.slope.size()}, {few.range_m.data(), few.range_m.size()},
                                         table).excess;
        if (share > best_share + (best ? MARGIN : 0.0)) {
            best = ElevationClusters{table.elevation, table.origin_m, share};
            best_share = share;
        }
        if (best_share > 1.0 - MARGIN) break;
    }
    return best;
}

// Return the origin from which the elevations cluster most: its height, and its radius in meters. A beam that starts on
// a circle of this radius meets the axis lower by radius · tan(elevation).
Origin find_origin(View1<const float> slope, View1<const float> range_m) {
    const auto concentration = [&](Origin origin) {
        std::int64_t squares = 0;
        for (const std::int64_t count : count_elevations(slope, range_m, origin, COARSE_BIN)) squares += count * count;
        return std::pair(squares, -std::abs(origin.height_m) - origin.radius_m);
    };
    const auto best_of = [&](const std::vector<Origin>& origins) {
        auto best = origins.front();
        auto most = concentration(best);
        for (std::size_t k = 1; k < origins.size(); ++k) {
            const auto here = concentration(origins[k]);
            if (here > most) {
                most = here;
                best = origins[k];
            }
        }
        return best;
    };
    std::vector<Origin> heights, around;
    for (int k = FIRST_HEIGHT; k <= LAST_HEIGHT; ++k) heights.push_back({HEIGHT_STEP_M * k, 0.0});
    const double height_m = best_of(heights).height_m;
    for (const double radius_m : RADII_M) {
        for (int k = -FINE_STEPS; k <= FINE_STEPS; ++k) around.push_back({height_m + FINE_STEP_M * k, radius_m});
    }
    return best_of(around);
}

// Count returns (rings × 360) by ring and degree of azimuth.
Buffer<std::int32_t> count_sectors(View1<const std::int16_t> ring, View1<const float> azimuth, std::size_t rings) {
    Buffer<std::int32_t> counts(rings * SECTORS, 0);
    constexpr float PER_RAD = float(180.0 / std::numbers::pi);
    for (std::size_t n = 0; n < ring.size; ++n) {
        if (ring[n] < 0) continue;
        const float degree = (azimuth[n] + PI) * PER_RAD;
        ++counts[std::size_t(ring[n]) * SECTORS + (degree > 0.0f ? std::min(std::size_t(degree), SECTORS - 1) : 0)];
    }
    return counts;
}

// Return the number of returns of one beam in a full sector: a quantile over non-empty sectors.
double full_sector(const Buffer<std::int32_t>& counts) {
    std::vector<std::int32_t> nonempty;
    std::copy_if(counts.data(), counts.data() + counts.size(), std::back_inserter(nonempty),
                 [](std::int32_t count) { return count > 0; });
    if (nonempty.empty()) return 0.0;
    std::sort(nonempty.begin(), nonempty.end());
    const double at = FULL_SECTOR * double(nonempty.size() - 1);
    const auto below = std::size_t(at);
    const double a = nonempty[below], b = nonempty[std::min(below + 1, nonempty.size() - 1)], part = at - double(below);
    return part >= 0.5 ? b - (b - a) * (1.0 - part) : a + (b - a) * part;
}

// Merge clusters of the same beam: together they return no more than one beam would. Return whether any were merged.
//
// A beam that starts away from the origin appears at two elevations if it meets surfaces at two ranges. Two beams
// return from the same sector; one beam returns from either of its clusters.
bool join_split_beams(ElevationClusters& clusters, const Directions& directions) {
    const std::vector<double>& elevation = clusters.elevation;
    const std::size_t count = elevation.size();
    std::vector<double> gap(count - 1);
    for (std::size_t k = 0; k + 1 < count; ++k) gap[k] = elevation[k + 1] - elevation[k];
    std::vector<std::size_t> close;
    for (std::size_t k = 0; k + 1 < count; ++k) {
        const double below = k > 0 ? gap[k - 1] : 0.0, above = k + 2 < count ? gap[k + 1] : 0.0;
        if (gap[k] < SPLIT_GAP * std::max(below, above)) close.push_back(k);
    }
    if (close.empty()) return false;
    // 1. Count the returns of each cluster by sector, and of one beam in a full sector.
    const BeamMatch match = match_beams(directions.slope, directions.range_m, BeamTable(elevation, clusters.origin_m, 0));
    const Buffer<std::int32_t> counts = count_sectors(match.ring, directions.azimuth, count);
    const double full = full_sector(counts);
    // 2. Keep close pairs that do not return twice as much. Merge them from the closest on, each cluster at most once.
    std::erase_if(close, [&](std::size_t k) {
        std::int64_t doubled = 0, filled = 0;
        for (std::size_t s = 0; s < SECTORS; ++s) {
            const double both = counts[k * SECTORS + s] + counts[(k + 1) * SECTORS + s];
            doubled += both > DOUBLE * full;
            filled += both > 0.5 * full;
        }
        return double(doubled) / double(std::max<std::int64_t>(filled, 1)) >= DOUBLE_SHARE;
    });
    std::stable_sort(close.begin(), close.end(), [&](std::size_t a, std::size_t b) { return gap[a] < gap[b]; });
    std::vector<char> taken(count, false), left(count, true);
    std::vector<double> mean = elevation;
    for (const std::size_t k : close) {
        if (taken[k] || taken[k + 1]) continue;
        taken[k] = taken[k + 1] = true;
        left[k + 1] = false;
        const auto size_of = [&](std::size_t ring) {
            const std::int32_t* sectors = counts.data() + ring * SECTORS;
            return double(std::max<std::int64_t>(std::accumulate(sectors, sectors + SECTORS, std::int64_t{0}), 1));
        };
        const double one = size_of(k), other = size_of(k + 1);
        mean[k] = (elevation[k] * one + elevation[k + 1] * other) / (one + other);
    }
    ElevationClusters joined{{}, {}, clusters.sharpness};
    for (std::size_t k = 0; k < count; ++k) {
        if (!left[k]) continue;
        joined.elevation.push_back(mean[k]);
        joined.origin_m.push_back(clusters.origin_m[k]);
    }
    const bool any_merged = joined.elevation.size() < count;
    clusters = std::move(joined);
    return any_merged;
}

}  // namespace

std::optional<ElevationClusters> find_clusters(const Directions& directions) {
    if (directions.size() < FEWEST_RETURNS) return std::nullopt;
    Elevations few;
    for (const std::uint32_t row : random_rows(directions.size(), SAMPLE)) {
        few.slope.push_back(directions.slope[row]);
        few.range_m.push_back(directions.range_m[row]);
    }
    // Most sensors' beams start at the origin. If clusters are not sharp there, search for another origin.
    constexpr Origin SENSOR{0.0, 0.0};
    std::optional<ElevationClusters> best = clusters_seen_from(SENSOR, directions, few);
    if (!best || best->sharpness < 1.0 - MARGIN) {
        const Origin origin = find_origin({few.slope.data(), FEW}, {few.range_m.data(), FEW});
        if (origin != SENSOR) {
            std::optional<ElevationClusters> other = clusters_seen_from(origin, directions, few);
            if (other && (!best || other->sharpness > best->sharpness)) best = std::move(other);
        }
    }
    if (!best) return best;
    for (int k = 0; k < MAX_MERGES && join_split_beams(*best, directions); ++k) {
    }
    return best;
}

std::optional<ClusteredRings> rings_by_clusters(const Directions& directions) {
    std::optional<ElevationClusters> clusters = find_clusters(directions);
    if (!clusters) return std::nullopt;
    BeamMatch match = match_beams(directions.slope, directions.range_m, BeamTable(clusters->elevation, clusters->origin_m, 0));
    const std::size_t count = clusters->elevation.size();
    return ClusteredRings{{std::move(match.ring), count}, std::move(*clusters)};
}

}  // namespace viewshed
