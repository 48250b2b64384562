#include "beam_matching.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Size of the table from slope to nearest beam.
constexpr std::size_t CELLS = 4096;

// Largest distance of a return from its beam, in radians and in meters; below, of a close return.
constexpr double OFF_RAD = 0.0026, OFF_M = 0.05;
constexpr double CLOSE_RAD = 0.00175, CLOSE_M = 0.015;

// Fewest returns for which a part pays for its thread; returns per chunk of summed chances (independent of the parts).
constexpr std::size_t PART = 16384, CHUNK = 4096;

MULTIVERSION void directions_of_block(const float* points, std::size_t count, float* azimuth, float* slope, float* range_m) {
    float x[BLOCK], y[BLOCK];
    for (std::size_t k = 0; k < count; ++k) {
        x[k] = points[3 * k];
        y[k] = points[3 * k + 1];
        const float z = points[3 * k + 2], r = std::sqrt(x[k] * x[k] + y[k] * y[k]);
        const float ratio = z / (r > 0.0f ? r : 1.0f);
        range_m[k] = r;
        slope[k] = r > 0.0f ? ratio : 0.0f;
    }
    for (std::size_t k = 0; k < count; ++k) azimuth[k] = azimuth_of(y[k], x[k]);
}

// Lookup of beams by their slope at infinite range.
struct BySlope {
    std::vector<double> tangent;
    std::array<std::int16_t, CELLS> first_beam;  // nearest beam of each slope cell

    explicit BySlope(const std::vector<double>& elevation) {
        for (const double angle : elevation) tangent.push_back(std::tan(angle));
        std::size_t beam = 0;
        for (std::size_t c = 0; c < CELLS; ++c) {
            const double t = tangent[0] + (tangent.back() - tangent[0]) * (double(c) + 0.5) / double(CELLS);
            while (beam + 1 < tangent.size() && std::abs(tangent[beam + 1] - t) < std::abs(tangent[beam] - t)) ++beam;
            first_beam[c] = std::int16_t(beam);
        }
    }
};

// Match the returns of one chunk; add to `hits`, and return the numbers of tested returns and of close ones by chance.
std::pair<std::int64_t, double> match_chunk(View1<const float> slope, View1<const float> range_m, const BeamTable& table,
                                            const BySlope& by_slope, std::int16_t* ring, std::int64_t* hits) {
    const std::size_t rings = table.rings();
    const double *tangent = by_slope.tangent.data(), *origin_m = table.origin_m.data();
    const double lowest = tangent[0], per_slope = double(CELLS) / std::max(tangent[rings - 1] - lowest, 1e-6);
    std::int64_t tested = 0;
    double chance = 0.0;
    for (std::size_t n = 0; n < slope.size; ++n) {
        ring[n] = -1;
        const double r = range_m[n], t = slope[n];
        if (!(r > 0.0)) continue;
        // 1. Find the nearest beam: look up a first guess, then walk while the next one is nearer.
        const double per_m = 1.0 / r;
        const double cell = (t - table.mean_origin_m * per_m - lowest) * per_slope;
        auto best = std::size_t(by_slope.first_beam[cell > 0.0 ? std::size_t(std::min(cell, double(CELLS) - 1.0)) : 0]);
        const auto off = [&](std::size_t beam) { return std::abs(tangent[beam] + origin_m[beam] * per_m - t); };
        double error = off(best);
        while (best > 0) {
            const double neighbor_error = off(best - 1);
            if (neighbor_error >= error) break;
            --best;
            error = neighbor_error;
        }
        while (best + 1 < rings) {
            const double neighbor_error = off(best + 1);
            if (neighbor_error >= error) break;
            ++best;
            error = neighbor_error;
        }
        // 2. Test if it is near enough, and if it is close.
        error /= 1.0 + t * t;
        if (error < OFF_RAD + OFF_M * per_m) ring[n] = std::int16_t(best);
        if (r > double(NEAR_M)) {
            const double quarter = table.gap[best] / 4, close = std::min(quarter, CLOSE_RAD + CLOSE_M * per_m);
            ++tested;
            chance += 0.5 * close / quarter;
            hits[best] += error <= close;
        }
    }
    return {tested, chance};
}

}  // namespace

Directions directions_of(View2<const float> points) {
    Directions directions(points.rows);
    for_ranges(points.rows, count_parts(points.rows, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t start = begin; start < end; start += BLOCK) {
            directions_of_block(points[start], std::min(BLOCK, end - start), &directions.azimuth[start], &directions.slope[start],
                          &directions.range_m[start]);
        }
    });
    return directions;
}

Elevations elevations_of(View2<const float> points, const std::vector<std::uint32_t>& rows) {
    Elevations directions{std::vector<float>(rows.size()), std::vector<float>(rows.size())};
    float xyz[3 * BLOCK], azimuth[BLOCK];
    for (std::size_t start = 0; start < rows.size(); start += BLOCK) {
        const std::size_t size = std::min(BLOCK, rows.size() - start);
        for (std::size_t k = 0; k < size; ++k) std::copy_n(points[rows[start + k]], 3, xyz + 3 * k);
        directions_of_block(xyz, size, azimuth, &directions.slope[start], &directions.range_m[start]);
    }
    return directions;
}

BeamTable::BeamTable(std::vector<double> elevation_, std::vector<double> origin_m_, int columns_)
    : elevation(std::move(elevation_)), origin_m(std::move(origin_m_)), gap(elevation.size()), columns(columns_) {
    const std::size_t count = rings();
    mean_origin_m = std::accumulate(origin_m.begin(), origin_m.end(), 0.0) / double(count);
    for (std::size_t k = 0; k < count; ++k) {
        const double below = elevation[k] - (k > 0 ? elevation[k - 1] : -std::numbers::pi);
        const double above = (k + 1 < count ? elevation[k + 1] : std::numbers::pi) - elevation[k];
        gap[k] = std::min(below, above);
    }
}

std::size_t BeamTable::nearest_to(double angle) const {
    const auto above = std::size_t(std::lower_bound(elevation.begin(), elevation.end(), angle) - elevation.begin());
    if (above == 0) return 0;
    if (above == rings()) return rings() - 1;
    return angle - elevation[above - 1] <= elevation[above] - angle ? above - 1 : above;
}

BeamMatch match_beams(View1<const float> slope, View1<const float> range_m, const BeamTable& table) {
    const std::size_t count = slope.size, chunks = (count + CHUNK - 1) / CHUNK, rings = table.rings();
    const BySlope by_slope(table.elevation);
    BeamMatch match{Buffer<std::int16_t>(count), std::vector<std::int64_t>(rings, 0), 0.0};
    const std::size_t parts = count_parts(count, PART);
    std::vector<std::vector<std::int64_t>> hits(parts, std::vector<std::int64_t>(rings, 0));
    std::vector<std::pair<std::int64_t, double>> found(chunks);
    for_ranges(chunks, parts, [&](std::size_t part, std::size_t begin, std::size_t end) {
        for (std::size_t c = begin; c < end; ++c) {
            const std::size_t start = c * CHUNK, size = std::min(CHUNK, count - start);
            found[c] = match_chunk({slope.data + start, size}, {range_m.data + start, size}, table, by_slope,
                                   &match.ring[start], hits[part].data());
        }
    });
    std::int64_t tested = 0, close = 0;
    double chance = 0.0;
    for (const auto& [of_chunk, by_chance] : found) {
        tested += of_chunk;
        chance += by_chance;
    }
    for (const auto& of_part : hits) {
        for (std::size_t k = 0; k < rings; ++k) {
            match.hits[k] += of_part[k];
            close += of_part[k];
        }
    }
    if (tested > 0 && chance < double(tested)) {
        match.excess = std::max(0.0, (double(close) - chance) / (double(tested) - chance));
    }
    return match;
}

}  // namespace viewshed
