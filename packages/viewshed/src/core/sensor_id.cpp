#include "sensor_id.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

#include "elevation_clusters.hpp"
#include "random_rows.hpp"
#include "sensor_motion.hpp"
#include "parallel.hpp"

namespace viewshed {
namespace {

constexpr double INFINITE = std::numeric_limits<double>::infinity();
constexpr double DEGREE = std::numbers::pi / 180;

// Sample sizes: returns for identification, and returns for the elevations of rings.
constexpr std::size_t SAMPLE = 16'384, RING_SAMPLE = 8192;

// The first returns suffice if a share SURE of them matches one table: no other has its beams at the same elevations.
constexpr std::size_t FIRST_RING_SAMPLE = 2048;
constexpr double SURE = 0.9;

// Required share of returns whose ring lies at its beam in the table.
constexpr double AGREEING = 0.8;

// A ring lies at a beam within a quarter of the gap to the next beam, and within 0.25°, ...
constexpr double NEAR_SHARE = 0.25, MAX_OFF = 0.25 * DEGREE;

// ... and the median ring within a tenth of the gap, or 0.03°: otherwise the sensor has a calibration of its own.
constexpr double TYPICAL_SHARE = 0.1, MIN_BEAM_GAP = 0.3 * DEGREE;
constexpr std::size_t MIN_RETURNS = 4;

// Minimum gap between the rings of a layout.
constexpr double MIN_GAP = 0.05 * DEGREE;

// Range of the number of rings, or of clusters, relative to a table's beams ...
constexpr double MIN_RING_SHARE = 0.5, MAX_CLUSTER_SHARE = 1.15;

// ... and required share of rings at consecutive beams: every second beam of a table is another sensor.
constexpr double NEXT_BEAM = 0.8;

// Without rings: required share HIT of beams that are hit, each by at least MIN_HITS returns.
constexpr double HIT = 0.9, MIN_HITS = 2.0, HIT_SHARE = 0.02;

// Clusters that explain this share of the returns are the sensor's beams, even against a table.
constexpr double SHARP = 0.97;

// The same once motion compensation is undone: near the seam a return may belong to either end of the revolution.
constexpr double SHARP_AT_REST = 0.95;

// A table that explains less than CERTAIN must not have CROWDED times more returns per ring than columns.
constexpr double CERTAIN = 0.5, CROWDED = 1.3;

// FEW returns preselect the LIKELY tables, which are then compared on the whole sample.
constexpr std::size_t FEW = 2048, LIKELY = 2;

using BeamTables = std::vector<BeamTable>;

// Return the tables of the inferable sensors, in their order.
const BeamTables& inferable_tables() {
    static const BeamTables tables = [] {
        BeamTables all;
        for (const SensorModel* sensor : inferable_sensors()) all.push_back(sensor->beams);
        return all;
    }();
    return tables;
}

// Rings of a cloud, their source, and their sharpness.
struct ShownRings {
    View1<const std::int16_t> ring;
    std::size_t count;
    RingSource source;
    double sharpness = 1.0;

    bool are_clusters() const { return source == RingSource::ELEVATION_CLUSTERS; }
};

// Returns sorted by ring, to measure the elevations of rings.
struct ReturnsByRing {
    std::vector<std::size_t> starts;
    std::vector<float> slope, nearness;  // 1 / range in 1/m, 0 for returns nearer than 1 m

    std::size_t size_of(std::size_t ring) const { return starts[ring + 1] - starts[ring]; }
    std::size_t size() const { return slope.size(); }
};

ReturnsByRing returns_by_ring(const std::vector<std::int16_t>& ring, std::size_t count, const float* slope,
                              const float* range_m) {
    ReturnsByRing returns{std::vector<std::size_t>(count + 1, 0), {}, {}};
    for (const std::int16_t r : ring) {
        if (r >= 0) ++returns.starts[std::size_t(r) + 1];
    }
    for (std::size_t r = 0; r < count; ++r) returns.starts[r + 1] += returns.starts[r];
    returns.slope.resize(returns.starts[count]);
    returns.nearness.resize(returns.starts[count]);
    std::vector<std::size_t> next(returns.starts.begin(), returns.starts.end() - 1);
    for (std::size_t n = 0; n < ring.size(); ++n) {
        if (ring[n] < 0) continue;
        const std::size_t place = next[std::size_t(ring[n])]++;
        returns.slope[place] = slope[n];
        returns.nearness[place] = range_m[n] > NEAR_M ? 1.0f / range_m[n] : 0.0f;
    }
    return returns;
}

// Return the median over each ring of value(ring, slope, nearness) of its returns beyond 1 m; NaN for none.
template <typename Value>
std::vector<double> ring_medians(const ReturnsByRing& returns, const Value& value) {
    std::vector<double> medians(returns.starts.size() - 1);
    std::vector<float> values(returns.size());
    for (std::size_t r = 0; r < medians.size(); ++r) {
        std::size_t count = 0;
        for (std::size_t k = returns.starts[r]; k < returns.starts[r + 1]; ++k) {
            values[count] = value(r, returns.slope[k], returns.nearness[k]);
            count += returns.nearness[k] > 0.0f;
        }
        medians[r] = lower_median(values.data(), count);
    }
    return medians;
}

// Return the median elevation (rings,) of returns beyond 1 m, seen from the origin of each ring.
std::vector<double> ring_elevations(const ReturnsByRing& returns, const std::vector<double>& origin_m) {
    std::vector<double> medians = ring_medians(returns, [&](std::size_t ring, float slope, float nearness) {
        return slope - float(origin_m[ring]) * nearness;
    });
    for (double& median : medians) median = std::atan(median);
    return medians;
}

// Check that the number of rings fits a table.
bool has_similar_count(const ShownRings& rings, const BeamTable& table) {
    const double count = double(rings.count), beams = double(table.rings());
    return MIN_RING_SHARE * beams <= count && count <= (rings.are_clusters() ? MAX_CLUSTER_SHARE : 1.0) * beams;
}

// Median slope and median nearness of a ring.
struct RingMedian {
    std::size_t ring;
    double slope, nearness;
};

// Return the median distance of rings from their beams, in gaps between beams; infinite if the counts do not fit.
//
// Approximation: slope = slope of the beam + origin height · nearness, applied to the medians.
double median_offset(const ShownRings& rings, const std::vector<RingMedian>& medians, const BeamTable& table) {
    if (!has_similar_count(rings, table) || medians.size() < 2) return INFINITE;
    std::vector<double> off;
    if (rings.count == table.rings() && !rings.are_clusters()) {
        for (const auto& [ring, slope, nearness] : medians) {
            const double elevation = std::atan(slope - table.origin_m[ring] * nearness);
            off.push_back(std::abs(table.elevation[ring] - elevation) / table.gap[ring]);
        }
        return median_of(std::move(off));
    }
    std::vector<std::size_t> beam(medians.size());
    for (std::size_t k = 0; k < medians.size(); ++k) {
        const auto& [ring, slope, nearness] = medians[k];
        // Look the beam up again, now from its own origin.
        const std::size_t first = table.nearest_to(std::atan(slope - table.mean_origin_m * nearness));
        const double elevation = std::atan(slope - table.origin_m[first] * nearness);
        beam[k] = table.nearest_to(elevation);
        off.push_back(std::abs(table.elevation[beam[k]] - elevation) / table.gap[beam[k]]);
    }
    // Skipped beams count against a table.
    double left_out = 0.0;
    for (std::size_t k = 1; k < beam.size(); ++k) left_out += beam[k] > beam[k - 1] + 1;
    return median_of(std::move(off)) + left_out / double(beam.size() - 1);
}

// Return the beam (rings,) of the table for each ring, or none if they do not match.
//
// They match if rings have distinct beams in order, with most returns at consecutive beams. Two clusters may share one.
std::optional<std::vector<std::size_t>> beams_of_rings(const ShownRings& rings, const ReturnsByRing& returns,
                                                       const BeamTable& table) {
    if (!has_similar_count(rings, table)) return std::nullopt;
    std::vector<std::size_t> beam(rings.count);
    std::iota(beam.begin(), beam.end(), std::size_t{0});
    if (rings.count == table.rings() && !rings.are_clusters()) return beam;
    // 1. Find the nearest beam of each ring, then again from that beam's origin. Interpolate rings without an
    // elevation.
    std::vector<double> origin_m(rings.count, table.mean_origin_m);
    std::vector<std::size_t> known;
    for (int time = 0; time < 2; ++time) {
        const std::vector<double> medians = ring_elevations(returns, origin_m);
        known.clear();
        for (std::size_t r = 0; r < rings.count; ++r) {
            if (!std::isfinite(medians[r])) continue;
            beam[r] = table.nearest_to(medians[r]);
            known.push_back(r);
        }
        if (known.size() < 2) return std::nullopt;
        for (std::size_t r = 0, next = 0; r < rings.count; ++r) {
            while (next < known.size() && known[next] < r) ++next;
            if (next < known.size() && known[next] == r) continue;
            if (next == 0 || next == known.size()) {
                beam[r] = beam[next == 0 ? known.front() : known.back()];
                continue;
            }
            const double low = double(beam[known[next - 1]]), high = double(beam[known[next]]);
            const double per_ring = (high - low) / double(known[next] - known[next - 1]);
            beam[r] = std::size_t(std::lrint(low + per_ring * double(r - known[next - 1])));
        }
        for (std::size_t r = 0; r < rings.count; ++r) origin_m[r] = table.origin_m[beam[r]];
    }
    // 2. Check the step from each ring to the next one.
    double weights = 0.0, at_next_beam = 0.0;
    for (std::size_t k = 1; k < known.size(); ++k) {
        const auto step = std::ptrdiff_t(beam[known[k]]) - std::ptrdiff_t(beam[known[k - 1]]);
        if (step < (rings.are_clusters() ? 0 : 1)) return std::nullopt;
        const auto weight = double(std::min(returns.size_of(known[k - 1]), returns.size_of(known[k])));
        weights += weight;
        at_next_beam += step == 1 ? weight : 0.0;
    }
    if (at_next_beam / std::max(weights, 1.0) < NEXT_BEAM) return std::nullopt;
    return beam;
}

// Return the share of returns, over rings with a known elevation, whose ring lies at its beam; 0 without a match.
double ring_score(const ShownRings& rings, const ReturnsByRing& returns, const BeamTable& table) {
    const auto beam = beams_of_rings(rings, returns, table);
    if (!beam) return 0.0;
    std::vector<double> origin_m(rings.count), shares;
    for (std::size_t r = 0; r < rings.count; ++r) origin_m[r] = table.origin_m[(*beam)[r]];
    const std::vector<double> elevations = ring_elevations(returns, origin_m);
    double agreeing = 0.0, all = 0.0;
    for (std::size_t r = 0; r < rings.count; ++r) {
        const double gap = table.gap[(*beam)[r]], off = std::abs(elevations[r] - table.elevation[(*beam)[r]]);
        if (!std::isfinite(off)) continue;
        const auto size = double(returns.size_of(r));
        all += size;
        agreeing += off < std::min(NEAR_SHARE * gap, MAX_OFF) ? size : 0.0;
        if (returns.size_of(r) >= MIN_RETURNS) shares.push_back(off / std::max(gap, MIN_BEAM_GAP));
    }
    if (shares.empty() || median_of(std::move(shares)) > TYPICAL_SHARE) return 0.0;
    return agreeing / std::max(all, 1.0);
}

// Index of a table (or NO_SENSOR) and its score.
using Scored = std::pair<int, double>;

// Return the indices of the tables with the highest scores, the first of equal ones.
std::vector<int> likeliest(const std::vector<double>& scores) {
    std::vector<int> order(scores.size());
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return scores[a] > scores[b]; });
    order.resize(std::min(order.size(), LIKELY));
    return order;
}

// Return the table that matches the rings of a sample and its score, or NO_SENSOR.
Scored agreeing_table(const ShownRings& rings, const ReturnsByRing& returns, const BeamTables& tables) {
    // 1. Preselect by the median slope and the median nearness of each ring.
    std::vector<double> slopes, nearness;
    run_parts(2, [&](std::size_t part) {
        if (part == 0) slopes = ring_medians(returns, [](std::size_t, float slope, float) { return slope; });
        if (part == 1) nearness = ring_medians(returns, [](std::size_t, float, float near) { return near; });
    });
    std::vector<RingMedian> medians;
    for (std::size_t r = 0; r < rings.count; ++r) {
        if (std::isfinite(slopes[r])) medians.push_back({r, slopes[r], nearness[r]});
    }
    std::vector<double> near;
    for (const BeamTable& table : tables) near.push_back(-median_offset(rings, medians, table));
    // 2. Score the likeliest tables, with each ring seen from its beam's origin.
    const std::vector<int> likely = likeliest(near);
    std::vector<double> scores(likely.size(), 0.0);
    run_parts(likely.size(), [&](std::size_t k) {
        if (std::isfinite(near[likely[k]])) scores[k] = ring_score(rings, returns, tables[likely[k]]);
    });
    Scored best{NO_SENSOR, 0.0};
    for (std::size_t k = 0; k < likely.size(); ++k) {
        if (scores[k] > best.second) best = {likely[k], scores[k]};
    }
    return {best.second >= AGREEING ? best.first : NO_SENSOR, best.second};
}

// Return `excess` times the share of hit beams, among beams inside the elevations of the returns.
double cluster_score(View1<const float> slope, View1<const float> range_m, const BeamTable& table) {
    const BeamMatch match = match_beams(slope, range_m, table);
    const auto all = double(std::accumulate(match.hits.begin(), match.hits.end(), std::int64_t{0}));
    const double least = std::max(MIN_HITS, HIT_SHARE * all / double(table.rings()));
    const auto is_hit = [&](std::int64_t hits) { return double(hits) > least; };
    const auto first = std::find_if(match.hits.begin(), match.hits.end(), is_hit);
    if (first == match.hits.end()) return 0.0;
    const auto last = std::find_if(match.hits.rbegin(), match.hits.rend(), is_hit).base();
    const double share = double(std::count_if(first, last, is_hit)) / double(last - first);
    return share >= HIT ? match.excess * share : 0.0;
}

// Check if the table's median ring would hold clearly more of `count` returns than a revolution has columns.
bool is_crowded(View1<const float> slope, View1<const float> range_m, const BeamTable& table, std::size_t count) {
    std::vector<double> sizes(table.rings(), 0.0);
    const BeamMatch match = match_beams(slope, range_m, table);
    for (const std::int16_t r : View1<const std::int16_t>(match.ring)) {
        if (r >= 0) sizes[std::size_t(r)] += 1.0;
    }
    return median_of(std::move(sizes)) * double(count) / double(slope.size) > CROWDED * table.columns;
}

// Return the table whose beams are nearest to a sample of `count` returns, or NO_SENSOR if it explains too little.
Scored explaining_table(const Elevations& sample, std::size_t count, const BeamTables& tables) {
    const auto part_of = [](const std::vector<float>& values, std::size_t size) {
        return View1<const float>{values.data(), std::min(size, values.size())};
    };
    std::vector<double> scores;
    for (const BeamTable& table : tables) {
        scores.push_back(cluster_score(part_of(sample.slope, FEW), part_of(sample.range_m, FEW), table));
    }
    const View1<const float> slope = part_of(sample.slope, SAMPLE), range_m = part_of(sample.range_m, SAMPLE);
    Scored best{NO_SENSOR, 0.0};
    for (const int likely : likeliest(scores)) {
        const double score = cluster_score(slope, range_m, tables[likely]);
        if (score > best.second) best = {likely, score};
    }
    const auto [table, score] = best;
    if (table == NO_SENSOR || score < EXPLAINED) return {NO_SENSOR, score};
    if (score < CERTAIN && is_crowded(slope, range_m, tables[table], count)) return {NO_SENSOR, score};
    return best;
}

// Return random rows of a cloud; a small cloud is shuffled instead, so that no row repeats.
std::vector<std::uint32_t> sample_rows(std::size_t count, std::size_t size) {
    if (count > SAMPLE) return random_rows(count, size);
    std::vector<std::uint32_t> rows = shuffled_rows(count);
    rows.resize(std::min(count, size));
    return rows;
}

// Return a random sample of points, sorted by ring.
ReturnsByRing sample_by_ring(View2<const float> points, const ShownRings& rings, std::size_t size) {
    const std::vector<std::uint32_t> rows = sample_rows(points.rows, size);
    const Elevations sample = elevations_of(points, rows);
    std::vector<std::int16_t> ring(rows.size());
    for (std::size_t k = 0; k < ring.size(); ++k) ring[k] = rings.ring[rows[k]];
    return returns_by_ring(ring, rings.count, sample.slope.data(), sample.range_m.data());
}

// Renumber rings (N,) as the table's beamsif there are fewer; none if that is not needed or possible.
std::optional<Buffer<std::int16_t>> counted_as_beams(const ShownRings& rings, const float* slope, const float* range_m,
                                                     const BeamTable& table) {
    if (rings.count == table.rings()) return std::nullopt;
    const std::vector<std::int16_t> all(rings.ring.begin(), rings.ring.end());
    const auto beam = beams_of_rings(rings, returns_by_ring(all, rings.count, slope, range_m), table);
    if (!beam) return std::nullopt;
    Buffer<std::int16_t> counted(rings.ring.size);
    for (std::size_t n = 0; n < counted.size(); ++n) {
        counted[n] = std::int16_t(rings.ring[n] < 0 ? -1 : int((*beam)[std::size_t(rings.ring[n])]));
    }
    return counted;
}

// Rings that own their memory.
struct OwnRings {
    Buffer<std::int16_t> ring;
    std::size_t count;
    RingSource source;
    double sharpness = 1.0;
    std::optional<BeamTable> clusters = std::nullopt;  // the elevations of clusters

    ShownRings shown() const { return {ring, count, source, sharpness}; }
};

std::optional<OwnRings> rings_shown_by_order(View2<const float> points) {
    std::optional<Rings> rings = rings_by_order(points);
    if (!rings) return std::nullopt;
    return OwnRings{std::move(rings->ring), rings->count, RingSource::FILE_ORDER};
}

std::optional<OwnRings> rings_shown_by_clusters(const Directions& directions) {
    std::optional<ClusteredRings> found = rings_by_clusters(directions);
    if (!found) return std::nullopt;
    return OwnRings{std::move(found->rings.ring), found->rings.count, RingSource::ELEVATION_CLUSTERS,
                    found->clusters.sharpness, BeamTable(found->clusters.elevation, found->clusters.origin_m, 0)};
}

// Return the nearest beam of each return (N,), or none if the returns do not cluster at the beams.
std::optional<Buffer<std::int16_t>> nearest_beams(const Directions& directions, const BeamTable& table) {
    BeamMatch match = match_beams(directions.slope, directions.range_m, table);
    if (match.excess < EXPLAINED) return std::nullopt;
    return std::move(match.ring);
}

// Points (N, 3) with their motion compensation undone, their directions, and the rings of sharp clusters among them.
struct AtRest {
    Buffer<float> measured;
    Directions directions;
    std::optional<OwnRings> rings;
};

std::optional<AtRest> undo_motion_of(View2<const float> points) {
    const std::optional<SensorMotion> motion = find_motion(points);
    if (!motion) return std::nullopt;
    Buffer<float> measured(points.size());
    undo_motion(points, *motion, measured.view(points.rows, 3));
    Directions directions = directions_of({measured.data(), points.rows, 3});
    AtRest at_rest{std::move(measured), std::move(directions), std::nullopt};
    at_rest.rings = rings_shown_by_clusters(at_rest.directions);
    if (at_rest.rings && at_rest.rings->sharpness < SHARP_AT_REST) at_rest.rings.reset();
    return at_rest;
}

// Identification of a bare cloud without undoing motion: table, score, and rings of the first or second source.
struct Identified {
    int table = NO_SENSOR;
    double score = 0.0;
    std::optional<OwnRings> rings;
    std::optional<Directions> directions;  // directions of the points, if they were computed
    std::optional<Buffer<std::int16_t>> counted;  // rings by the expected layout, if it matched
};

// Check on the first sample if the rings are surely those of an expected table.
bool is_surely(const BeamTable& table, const ShownRings& rings, View2<const float> points) {
    return rings.count == table.rings() &&
           ring_score(rings, sample_by_ring(points, rings, FIRST_RING_SAMPLE), table) >= SURE;
}

// Return the table that matches the rings, and its score.
Scored table_by_rings(View2<const float> points, const ShownRings& rings, const BeamTables& tables) {
    const Scored first = agreeing_table(rings, sample_by_ring(points, rings, FIRST_RING_SAMPLE), tables);
    return first.second >= SURE ? first : agreeing_table(rings, sample_by_ring(points, rings, RING_SAMPLE), tables);
}

// Renumber rings (N,) found by order to match a layout; none if they do not match.
//
// Where a beam meets the vehicle near the seam, the order misses a ring or counts an extra one, and the rings above are
// shifted. The best shift is the one at which most rings lie at the layout's elevations.
std::optional<Buffer<std::int16_t>> counted_by_layout(View2<const float> points, const ShownRings& rings,
                                                      const BeamTable& layout) {
    const std::vector<double> origin_m(rings.count, 0.0);
    const std::vector<double> elevation = ring_elevations(sample_by_ring(points, rings, FIRST_RING_SAMPLE), origin_m);
    const auto count = std::ptrdiff_t(rings.count), beams = std::ptrdiff_t(layout.rings());
    std::ptrdiff_t most = 0, best = 0;
    for (const std::ptrdiff_t shift : {0, -1, 1, -2, 2}) {
        std::ptrdiff_t agreeing = 0;
        for (std::ptrdiff_t r = std::max<std::ptrdiff_t>(0, -shift); r < std::min(count, beams - shift); ++r) {
            const auto beam = std::size_t(r + shift);
            agreeing += std::abs(elevation[std::size_t(r)] - layout.elevation[beam]) < NEAR_SHARE * layout.gap[beam];
        }
        if (agreeing > most) {
            most = agreeing;
            best = shift;
        }
    }
    if (double(most) < MIN_RING_SHARE * double(std::max(count, beams))) return std::nullopt;
    Buffer<std::int16_t> counted(rings.ring.size);
    for (std::size_t n = 0; n < counted.size(); ++n) {
        const std::ptrdiff_t beam = rings.ring[n] + best;
        counted[n] = std::int16_t(rings.ring[n] < 0 ? -1 : std::clamp<std::ptrdiff_t>(beam, 0, beams - 1));
    }
    return counted;
}

Identified identify(View2<const float> points, const BeamTables& tables, Expected expected) {
    Identified found;
    const auto agrees = [&](std::optional<OwnRings>& rings) {
        const auto [table, score] = table_by_rings(points, rings->shown(), tables);
        found.score = table == NO_SENSOR ? std::max(score, found.score) : score;
        found.table = table;
        if (table != NO_SENSOR || !found.rings) found.rings = std::move(rings);
        return table != NO_SENSOR;
    };
    // 1. Rings by the order of the points.
    std::optional<OwnRings> ordered = rings_shown_by_order(points);
    if (ordered && expected.sensor != NO_SENSOR && is_surely(tables[expected.sensor], ordered->shown(), points)) {
        return {expected.sensor, SURE, std::move(ordered), std::nullopt, std::nullopt};
    }
    if (ordered && agrees(ordered)) return found;
    if (found.rings && expected.layout) {
        found.counted = counted_by_layout(points, found.rings->shown(), *expected.layout);
        if (found.counted) return found;
    }
    // 2. Rings by elevation, first at the expected layout.
    found.directions = directions_of(points);
    if (!found.rings && expected.layout) {
        BeamMatch match = match_beams(found.directions->slope, found.directions->range_m, *expected.layout);
        if (match.excess >= SHARP) {
            std::optional<OwnRings> gathered = OwnRings{std::move(match.ring), expected.layout->rings(),
                                                        RingSource::ELEVATION_CLUSTERS, match.excess, *expected.layout};
            if (!agrees(gathered)) found.counted = std::move(found.rings->ring);
            return found;
        }
    }
    std::optional<OwnRings> clustered = rings_shown_by_clusters(*found.directions);
    if (clustered && agrees(clustered)) return found;
    // 3. Without rings, or with blurred clusters, match tables directly: they know the origins of their beams.
    if (!found.rings || (found.rings->shown().are_clusters() && found.rings->sharpness < SHARP)) {
        const Elevations sample = elevations_of(points, sample_rows(points.rows, SAMPLE));
        const auto [table, score] = explaining_table(sample, points.rows, tables);
        if (!found.rings || score > found.rings->sharpness) {
            found.table = table;
            found.score = score;
            found.rings.reset();
        }
    }
    return found;
}

// Check if there are no rings, only blurred clusters, or an order that no table confirms.
bool is_doubtful(const Identified& found) {
    if (!found.rings) return true;
    if (found.rings->shown().are_clusters()) return found.rings->sharpness < SHARP;
    return found.table == NO_SENSOR;
}

// Check if sharp clusters are better than the rings: sharper, or more than an order that skips rings.
bool is_better(const OwnRings& clusters, const std::optional<OwnRings>& rings) {
    if (!rings) return true;
    if (rings->source == RingSource::FILE_ORDER) return clusters.count > rings->count;
    return clusters.sharpness >= rings->sharpness;
}

ShownRings rings_of_file(View1<const std::int16_t> ring) {
    std::int16_t most = 0;
    for (const std::int16_t r : ring) most = std::max(most, r);
    return {ring, std::size_t(most) + 1, RingSource::FILE};
}

// Identify points (N, 3) with known rings (N,).
SensorId identify_by_rings(View2<const float> points, View1<const std::int16_t> ring, const BeamTables& tables,
                           int expected) {
    const ShownRings rings = rings_of_file(ring);
    if (expected != NO_SENSOR && is_surely(tables[expected], rings, points)) return {std::nullopt, expected};
    const auto [table, score] = table_by_rings(points, rings, tables);
    if (table == NO_SENSOR || rings.count == tables[table].rings()) return {std::nullopt, table};
    const Directions directions = directions_of(points);
    return {counted_as_beams(rings, directions.slope.data(), directions.range_m.data(), tables[table]), table};
}

// Return the layout of rings without a matching table: the elevations of clusters, or the median elevation of each
// ring. The lowest rings by order may meet the vehicle and be out of order: each is forced below the next one.
BeamTable layout_of(View2<const float> points, const OwnRings& rings) {
    if (rings.clusters) return *rings.clusters;
    std::vector<double> origin_m(rings.count, 0.0);
    std::vector<double> elevation = ring_elevations(sample_by_ring(points, rings.shown(), RING_SAMPLE), origin_m);
    double above = std::numbers::pi / 2;
    for (std::size_t r = rings.count; r-- > 0;) {
        above = elevation[r] < above - MIN_GAP ? elevation[r] : above - MIN_GAP;
        elevation[r] = above;
    }
    return BeamTable(std::move(elevation), std::move(origin_m), 0);
}

// Identify bare points (N, 3): their rings and table, if found.
SensorId identify_by_points(View2<const float> points, const BeamTables& tables, Expected expected) {
    // 1. Find rings and a matching table.
    Identified found = identify(points, tables, expected);
    // 2. If in doubt, assume a moving sensor: undo the motion compensation, which blurs elevations, and look again.
    if (!found.counted && is_doubtful(found)) {
        std::optional<AtRest> at_rest = undo_motion_of(points);
        if (at_rest && at_rest->rings && is_better(*at_rest->rings, found.rings)) {
            found.directions = std::move(at_rest->directions);
            found.rings = std::move(at_rest->rings);
            const View2<const float> measured{at_rest->measured.data(), points.rows, 3};
            const int table = table_by_rings(measured, found.rings->shown(), tables).first;
            if (table != NO_SENSOR) found.table = table;
        }
    }
    // 3. Renumber rings as the table's beams. Clusters miss empty beams: use the nearest beams.
    if (found.counted) {
        // On sloping ground the median elevations drift slowly: update the layout.
        const std::size_t count = found.rings->count;
        BeamTable layout = count == expected.layout->rings() ? layout_of(points, *found.rings) : *expected.layout;
        return {std::move(found.counted), NO_SENSOR, std::move(layout), count, true};
    }
    if (found.table == NO_SENSOR) {
        if (!found.rings) return {};
        BeamTable layout = layout_of(points, *found.rings);
        return {std::move(found.rings->ring), NO_SENSOR, std::move(layout), found.rings->count};
    }
    const BeamTable& table = tables[found.table];
    if (found.rings && found.rings->count == table.rings() && !found.rings->shown().are_clusters()) {
        return {std::move(found.rings->ring), found.table};
    }
    const Directions directions = found.directions ? std::move(*found.directions) : directions_of(points);
    if (!found.rings || found.rings->shown().are_clusters()) return {nearest_beams(directions, table), found.table};
    auto counted = counted_as_beams(found.rings->shown(), directions.slope.data(), directions.range_m.data(), table);
    return {counted ? std::move(*counted) : std::move(found.rings->ring), found.table};
}

// Return the rings (N,) of bare points, by order or else by elevation.
std::optional<Buffer<std::int16_t>> rings_of_points(View2<const float> points) {
    std::optional<OwnRings> rings = rings_shown_by_order(points);
    if (!rings) rings = rings_shown_by_clusters(directions_of(points));
    return rings ? std::optional(std::move(rings->ring)) : std::nullopt;
}

// Return the beam of each point (N, 3) of a known sensor; none if the points do not cluster at its beams.
std::optional<Buffer<std::int16_t>> beams_of_sensor(View2<const float> points, const BeamTable& table) {
    // 1. Rings by the order of the points, if there are no more than the sensor has.
    std::optional<OwnRings> ordered = rings_shown_by_order(points);
    if (ordered && ordered->count <= table.rings()) return std::move(ordered->ring);
    // 2. Else the nearest beams. If the table matches poorly, the sensor moved or has a calibration of its own: then
    // try
    //    clusters without motion compensation, renumbered as the table's beams.
    const Directions directions = directions_of(points);
    BeamMatch match = match_beams(directions.slope, directions.range_m, table);
    std::optional<AtRest> at_rest = match.excess < SHARP ? undo_motion_of(points) : std::nullopt;
    if (at_rest && at_rest->rings) {
        const float *slope = at_rest->directions.slope.data(), *range_m = at_rest->directions.range_m.data();
        if (at_rest->rings->count == table.rings()) return std::move(at_rest->rings->ring);
        if (auto counted = counted_as_beams(at_rest->rings->shown(), slope, range_m, table)) return counted;
    }
    if (at_rest) {
        BeamMatch moved = match_beams(at_rest->directions.slope, at_rest->directions.range_m, table);
        if (moved.excess > match.excess) match = std::move(moved);
    }
    if (match.excess < EXPLAINED) return std::nullopt;
    return std::move(match.ring);
}

}  // namespace

const std::vector<const SensorModel*>& inferable_sensors() {
    static const std::vector<const SensorModel*> sensors = [] {
        std::vector<const SensorModel*> some;
        for (const SensorModel& sensor : shipped_sensors()) {
            if (sensor.is_inferred) some.push_back(&sensor);
        }
        return some;
    }();
    return sensors;
}

SensorId identify_sensor(View2<const float> points, std::optional<View1<const std::int16_t>> ring, const BeamTable* table,
                         bool is_inferred, Expected expected) {
    if (points.rows == 0 || (ring && (table != nullptr || !is_inferred))) return {};
    if (table != nullptr) {
        if (auto beams = beams_of_sensor(points, *table)) return {std::move(beams), NO_SENSOR};
        return {identify_by_points(points, BeamTables{}, Expected{}).ring, OTHER_BEAMS};
    }
    if (!is_inferred) return {rings_of_points(points), NO_SENSOR};
    return ring ? identify_by_rings(points, *ring, inferable_tables(), expected.sensor)
                : identify_by_points(points, inferable_tables(), expected);
}

std::pair<int, double> infer_sensor(View2<const float> points, std::optional<View1<const std::int16_t>> ring) {
    const BeamTables& tables = inferable_tables();
    if (ring) return table_by_rings(points, rings_of_file(*ring), tables);
    const Identified found = identify(points, tables, {});
    return {found.table, found.score};
}

}  // namespace viewshed
