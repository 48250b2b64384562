#include "ring_recovery.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <numeric>

#include "elevation_clusters.hpp"
#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr float TURN = 2 * PI;
constexpr double UNKNOWN = std::numeric_limits<double>::quiet_NaN();

// Azimuths jitter across the seam by at most BACK radians, within SOON points after it.
constexpr float BACK = 0.35f;
constexpr std::size_t SOON = 8;

// A step of the azimuth against its direction, in radians; its largest share for points that are stored ring by ring.
constexpr float BACKWARD = 0.003f;
constexpr double MAX_BACKWARD = 0.03;

// Limits of the number of rings; more than that are noise.
constexpr std::size_t FEWEST_RINGS = 4, MAX_RINGS = 4096;

// First and last rings smaller than this share of the average ring are merged into their neighbor.
constexpr double STRAY_RING = 0.01;

// Distance in returns from the seam at which the slope is compared: a ring may begin one or two returns off.
constexpr std::size_t BESIDE = 2;

// Required share of steps in one direction (slope rises, or falls) between rings: at their seams, and by medians.
constexpr double ONE_WAY_AT_SEAMS = 0.7, ONE_WAY = 0.9;

// Smaller slope changes count as 0: rounding where a ring was cut in two.
constexpr double MIN_STEP = 1e-5;

// Returns sampled evenly from a ring for its median slope.
constexpr std::size_t RETURNS_OF_RING = 256;

// Largest ratio of the path of the median slopes over rings to the distance from first to last.
constexpr double MAX_PATH = 1.5;

// Accept rings at once if the slope changes within them by less than this share of a step.
constexpr double SMALL_CHANGE = 0.3;

// Fewest points for which a part pays for its thread.
constexpr std::size_t PART = 16384;

// Default columns of a revolution, and number of elevation bins for a cloud without beams.
constexpr std::size_t DEFAULT_COLUMNS = 1024, PSEUDO_RINGS = 64;

// Columns are measured in the fullest rings, by gaps between 3 and 300 bins of 0.01°; FEWEST_GAPS are required.
constexpr std::size_t SAMPLED_RINGS = 6, FEWEST_GAPS = 16;
constexpr double GAP_BIN = 0.01 * std::numbers::pi / 180, MIN_BINS = 3, MAX_BINS = 300;
constexpr long FEWEST_COLUMNS = 4, MAX_COLUMNS = 36'000;

// A step within 5 % of the model's is accepted. Irregular firing has gaps over 1.3 steps, over 90 % of the angle.
constexpr double STEP_KNOWN = 0.05, IRREGULAR = 1.3, COVERED = 0.9;

// A run of consecutive points of one ring, up to the next run.
struct Run {
    std::size_t start;
    std::int32_t ring;
};

// Rings counted by wraps of the azimuth.
struct Order {
    std::vector<Run> runs;
    std::size_t rings = 0;
    double one_way = 0.0;  // share of wraps with rising slope, or falling if more
};

// Flags of the step to a point: it crosses the seam forward, or back.
constexpr std::uint8_t WRAPS = 1, GOES_BACK = 2;

// Return the azimuth of a point past `start` in a direction of rotation, in [0, 2π).
INLINE float angle_past(float x, float y, float start, float sense) {
    const float a = sense * (azimuth_of(y, x) - start);
    return a < 0.0f ? a + TURN : a;
}

// Mark the steps of points (count, 3) that cross the seam; return the number of backward steps. `before` is the angle
// before.
MULTIVERSION std::size_t mark_steps(const float* points, std::size_t count, float start, float sense, float before,
                                    std::uint8_t* marked) {
    float x[BLOCK], y[BLOCK], angle[BLOCK + 1];
    for (std::size_t k = 0; k < count; ++k) {
        x[k] = points[3 * k];
        y[k] = points[3 * k + 1];
    }
    angle[0] = before;
    for (std::size_t k = 0; k < count; ++k) angle[k + 1] = angle_past(x[k], y[k], start, sense);
    std::int32_t backward = 0;
    for (std::size_t k = 0; k < count; ++k) {
        const float step = angle[k + 1] - angle[k];
        backward += (step < -BACKWARD) & (step >= -PI);
        marked[k] = std::uint8_t((step < -PI ? WRAPS : 0) | (step > TURN - BACK ? GOES_BACK : 0));
    }
    return std::size_t(backward);
}

// Count rings by wraps of the azimuth past `start` in a direction of rotation; none if too many steps go backward.
//
// A step back over `start` soon after a wrap reverts the wrap. Stray first and last rings are merged.
Order order_rings(View2<const float> points, float start, float sense) {
    const std::size_t count = points.rows;
    Order order;
    // 1. Mark the steps, block by block. Stop early if too many go backward.
    const std::size_t blocks = (count + BLOCK - 1) / BLOCK, parts = count_parts(count, PART);
    const auto too_many = [&](std::size_t backward) { return double(backward) > MAX_BACKWARD * double(count); };
    Buffer<std::uint8_t> marked((count + 7) / 8 * 8);
    std::fill(marked.begin() + count, marked.end(), std::uint8_t{0});
    std::vector<std::size_t> backward(parts, 0);
    for_ranges(blocks, parts, [&](std::size_t part, std::size_t begin, std::size_t end) {
        for (std::size_t block = begin; block < end && !too_many(backward[part]); ++block) {
            const std::size_t first = block * BLOCK, size = std::min(BLOCK, count - first);
            const float* before = points[first > 0 ? first - 1 : 0];
            backward[part] += mark_steps(points[first], size, start, sense,
                                         angle_past(before[0], before[1], start, sense), &marked[first]);
        }
    });
    if (too_many(std::accumulate(backward.begin(), backward.end(), std::size_t{0}))) return {};
    // 2. Follow the marks; most blocks of eight points have none.
    std::size_t last_start = 0;
    std::int32_t wraps = 0, rising = 0, falling = 0;
    double last = 0.0;
    const auto change_over = [&](std::size_t n) {
        const std::size_t before = n > BESIDE ? n - 1 - BESIDE : 0, after = std::min(n + BESIDE, count - 1);
        return double(slope_of(points[after])) - double(slope_of(points[before]));
    };
    std::vector<Run>& runs = order.runs;
    runs.push_back({0, 0});
    for (std::size_t eight = 0; eight < marked.size(); eight += 8) {
        std::uint64_t any;
        std::memcpy(&any, &marked[eight], 8);
        if (any == 0) continue;
        for (std::size_t n = eight; n < eight + 8; ++n) {
            if (marked[n] == 0) continue;
            if (marked[n] == WRAPS) {
                ++wraps;
                last = change_over(n);
                rising += last > MIN_STEP;
                falling += last < -MIN_STEP;
                last_start = n;
            } else if (wraps > 0 && n - last_start < SOON) {
                --wraps;
                rising -= last > MIN_STEP;
                falling -= last < -MIN_STEP;
                last = 0.0;
            } else {
                continue;
            }
            if (wraps >= std::int32_t(MAX_RINGS)) return {};
            runs.push_back({n, wraps});
        }
    }
    if (wraps > 0) order.one_way = double(std::max(rising, falling)) / wraps;
    // 3. Merge stray first and last rings. Points after a reverted last wrap belong to the last ring.
    std::vector<std::size_t> sizes(std::size_t(wraps) + 1, 0);
    for (std::size_t k = 0; k < runs.size(); ++k) {
        runs[k].ring = std::min(runs[k].ring, wraps);
        sizes[std::size_t(runs[k].ring)] += (k + 1 < runs.size() ? runs[k + 1].start : count) - runs[k].start;
    }
    const double stray = STRAY_RING * double(count) / (wraps + 1);
    if (wraps > 0 && double(sizes[std::size_t(wraps)]) < stray) {
        --wraps;
        for (Run& run : runs) run.ring = std::min(run.ring, wraps);
    }
    if (wraps > 0 && double(sizes[0]) < stray) {
        --wraps;
        for (Run& run : runs) run.ring = std::max(run.ring - 1, 0);
    }
    order.rings = std::size_t(wraps) + 1;
    // 4. Merge runs of the same ring.
    runs.erase(std::unique(runs.begin(), runs.end(), [](const Run& a, const Run& b) { return a.ring == b.ring; }),
               runs.end());
    return order;
}

// Map the bits of a float to an integer of the same order, and back.
INLINE std::int32_t number_key(std::int32_t bits) { return bits ^ ((bits >> 31) & 0x7fffffff); }

// Write the keys of floats, the greatest for NaN, and return how many are numbers.
MULTIVERSION std::size_t order_keys(const float* values, std::size_t count, std::int32_t* key) {
    std::int32_t known = 0;
    for (std::size_t k = 0; k < count; ++k) {
        const bool is_number = values[k] == values[k];
        key[k] = is_number ? number_key(std::bit_cast<std::int32_t>(values[k])) : std::numeric_limits<std::int32_t>::max();
        known += is_number;
    }
    return std::size_t(known);
}

MULTIVERSION void find_bounds(const std::int32_t* key, std::size_t count, std::int64_t& low, std::int64_t& high) {
    std::int32_t least = std::numeric_limits<std::int32_t>::max(), most = std::numeric_limits<std::int32_t>::min();
    for (std::size_t k = 0; k < count; ++k) {
        least = key[k] < least ? key[k] : least;
        most = key[k] > most ? key[k] : most;
    }
    low = least;
    high = most;
}

MULTIVERSION std::size_t count_up_to(const std::int32_t* key, std::size_t count, std::int32_t most) {
    std::int32_t below = 0;
    for (std::size_t k = 0; k < count; ++k) below += key[k] <= most;
    return std::size_t(below);
}

// Return the median slopes (rings,) of ordered rings, by a sample of each.
std::vector<double> medians_in_order(const Order& order, View2<const float> points) {
    const std::size_t step = std::max<std::size_t>(points.rows / order.rings / RETURNS_OF_RING, 1);
    std::vector<std::vector<float>> of_ring(order.rings);
    for (std::size_t k = 0; k < order.runs.size(); ++k) {
        const std::size_t end = k + 1 < order.runs.size() ? order.runs[k + 1].start : points.rows;
        std::vector<float>& values = of_ring[std::size_t(order.runs[k].ring)];
        for (std::size_t n = order.runs[k].start; n < end; n += step) values.push_back(slope_of(points[n]));
    }
    std::vector<double> medians;
    for (std::vector<float>& values : of_ring) medians.push_back(lower_median(values.data(), values.size()));
    return medians;
}

// Return the median over runs of the slope change between the first and third quarter of a run.
double change_within(const Order& order, View2<const float> points) {
    std::vector<double> changes;
    for (std::size_t k = 0; k < order.runs.size(); ++k) {
        const std::size_t start = order.runs[k].start;
        const std::size_t size = (k + 1 < order.runs.size() ? order.runs[k + 1].start : points.rows) - start;
        changes.push_back(std::abs(slope_of(points[start + size / 4]) - slope_of(points[start + 3 * size / 4])));
    }
    return median_of(std::move(changes));
}

// Write the ring of each point, ascending with the slope.
Rings fill_rings(const Order& order, std::size_t count, bool rising) {
    Rings rings{Buffer<std::int16_t>(count), order.rings};
    for (std::size_t k = 0; k < order.runs.size(); ++k) {
        const std::size_t end = k + 1 < order.runs.size() ? order.runs[k + 1].start : count;
        const auto ring = std::int16_t(rising ? order.runs[k].ring : std::int32_t(order.rings) - 1 - order.runs[k].ring);
        std::fill(&rings.ring[order.runs[k].start], rings.ring.data() + end, ring);
    }
    return rings;
}

// Rows of the returns, sorted by ring.
class ByRing {
public:
    ByRing(View1<const std::int16_t> ring, std::size_t rings) : starts_(rings + 1, 0) {
        for (const std::int16_t r : ring) {
            if (r >= 0) ++starts_[std::size_t(r) + 1];
        }
        for (std::size_t r = 0; r < rings; ++r) starts_[r + 1] += starts_[r];
        rows_.resize(starts_[rings]);
        std::vector<std::size_t> next(starts_.begin(), starts_.end() - 1);
        for (std::size_t n = 0; n < ring.size; ++n) {
            if (ring[n] >= 0) rows_[next[std::size_t(ring[n])]++] = std::uint32_t(n);
        }
    }

    View1<const std::uint32_t> rows(std::size_t ring) const {
        return {rows_.data() + starts_[ring], starts_[ring + 1] - starts_[ring]};
    }

private:
    std::vector<std::size_t> starts_;
    std::vector<std::uint32_t> rows_;
};

// Assign elevation bins: the table's nearest beams, else bins with equally many returns.
Rings elevation_bins(const Directions& directions, const BeamTable* table) {
    std::vector<double> edges;
    if (table != nullptr) {
        for (std::size_t k = 0; k + 1 < table->rings(); ++k) {
            edges.push_back(std::tan((table->elevation[k + 1] + table->elevation[k]) / 2));
        }
    } else {
        std::vector<float> ascending;
        for (std::size_t n = 0; n < directions.size(); ++n) {
            if (directions.range_m[n] > 0.0f) ascending.push_back(directions.slope[n]);
        }
        std::sort(ascending.begin(), ascending.end());
        for (std::size_t k = 1; k < PSEUDO_RINGS && !ascending.empty(); ++k) {
            edges.push_back(ascending[k * ascending.size() / PSEUDO_RINGS]);
        }
        edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
    }
    Rings rings{Buffer<std::int16_t>(directions.size()), edges.size() + 1};
    for (std::size_t n = 0; n < directions.size(); ++n) {
        const auto bin = std::upper_bound(edges.begin(), edges.end(), double(directions.slope[n])) - edges.begin();
        rings.ring[n] = std::int16_t(directions.range_m[n] > 0.0f ? bin : -1);
    }
    return rings;
}

// Return the azimuth step from the gaps within rings (`own`) and in several rings together (`pooled`); NaN for too few.
//
// The step is the mean of the gaps within a quarter of the most frequent one. For irregular firing (CARLA's overlaid
// revolutions leave gaps in all rings at once) it is the gap that covers 90 % of the angle, so that no columns stay
// empty between firings, unless the model's step is within 5 %.
double firing_step(std::vector<double> own, std::vector<double> pooled, const BeamTable* table) {
    for (std::vector<double>* gaps : {&own, &pooled}) {
        std::erase_if(*gaps, [](double gap) { return !(gap > MIN_BINS * GAP_BIN && gap < MAX_BINS * GAP_BIN); });
    }
    if (own.size() < FEWEST_GAPS) return UNKNOWN;
    // 1. Find the most frequent gap, and the mean of similar gaps.
    std::array<int, std::size_t(MAX_BINS) + 3> counts{};
    for (const double gap : own) ++counts[std::size_t(gap / GAP_BIN) + 1];
    std::size_t peak = 1;
    const auto around = [&](std::size_t b) { return counts[b - 1] + counts[b] + counts[b + 1]; };
    for (std::size_t b = 1; b + 1 < counts.size(); ++b) peak = around(b) > around(peak) ? b : peak;
    std::vector<double> usual;
    for (const double gap : own) {
        if (std::abs(gap - (double(peak) - 0.5) * GAP_BIN) <= 1.5 * GAP_BIN) usual.push_back(gap);
    }
    const double mode = median_of(std::move(usual));
    double sum = 0.0;
    std::size_t like_it = 0;
    for (const double gap : own) {
        const bool is_like = std::abs(gap - mode) < mode / 4;
        sum += is_like ? gap : 0.0;
        like_it += is_like;
    }
    const double step = sum / double(like_it);
    // 2. Irregular firing.
    if (table != nullptr && std::abs(step / (2 * std::numbers::pi / table->columns) - 1) < STEP_KNOWN) return step;
    std::sort(pooled.begin(), pooled.end());
    const double angle = std::accumulate(pooled.begin(), pooled.end(), 0.0);
    double so_far = 0.0;
    for (const double gap : pooled) {
        so_far += gap;
        if (so_far >= COVERED * angle) return gap > IRREGULAR * step ? gap : step;
    }
    return step;
}

// Return the columns of a revolution: measured in the fullest rings, else the table's, else the default.
std::size_t measure_columns(const Directions& directions, const Rings& rings, RingSource source, const BeamTable* table) {
    const std::size_t fallback = table != nullptr ? std::size_t(table->columns) : DEFAULT_COLUMNS;
    if (source == RingSource::ELEVATION_BINS) return fallback;
    // 1. Collect the azimuths of the fullest rings.
    std::vector<std::size_t> sizes(rings.count, 0), fullest(rings.count);
    const auto is_used = [&](std::size_t n) { return rings.ring[n] >= 0 && directions.range_m[n] > NEAR_M; };
    for (std::size_t n = 0; n < directions.size(); ++n) {
        if (is_used(n)) ++sizes[std::size_t(rings.ring[n])];
    }
    std::iota(fullest.begin(), fullest.end(), std::size_t{0});
    std::stable_sort(fullest.begin(), fullest.end(), [&](auto a, auto b) { return sizes[a] > sizes[b]; });
    fullest.resize(std::min(fullest.size(), SAMPLED_RINGS));
    std::vector<std::vector<double>> sampled(fullest.size());
    for (std::size_t n = 0; n < directions.size(); ++n) {
        if (!is_used(n)) continue;
        const auto place = std::find(fullest.begin(), fullest.end(), std::size_t(rings.ring[n])) - fullest.begin();
        if (place < std::ptrdiff_t(fullest.size())) sampled[std::size_t(place)].push_back(directions.azimuth[n]);
    }
    // 2. Collect gaps within each ring, and in all together.
    std::vector<double> own, all, pooled;
    const auto add_gaps = [](std::vector<double>& azimuths, std::vector<double>& gaps) {
        std::sort(azimuths.begin(), azimuths.end());
        for (std::size_t k = 1; k < azimuths.size(); ++k) gaps.push_back(azimuths[k] - azimuths[k - 1]);
    };
    for (std::vector<double>& azimuths : sampled) {
        add_gaps(azimuths, own);
        all.insert(all.end(), azimuths.begin(), azimuths.end());
    }
    add_gaps(all, pooled);
    const double step = firing_step(std::move(own), std::move(pooled), table);
    if (!(step > 0.0)) return fallback;
    return std::size_t(std::clamp(std::lrint(2 * std::numbers::pi / step), FEWEST_COLUMNS, MAX_COLUMNS));
}

// Return the median elevations (rings,); the table's, or interpolated, for rings without a return beyond 1 m.
Buffer<double> median_elevations(const Directions& directions, const Rings& rings, const BeamTable* table) {
    const ByRing by_ring(rings.ring, rings.count);
    Buffer<double> elevation(rings.count);
    std::vector<std::size_t> known;
    std::vector<float> values;
    for (std::size_t r = 0; r < rings.count; ++r) {
        values.clear();
        for (const std::uint32_t n : by_ring.rows(r)) {
            if (directions.range_m[n] > NEAR_M) values.push_back(directions.slope[n]);
        }
        elevation[r] = std::atan(lower_median(values.data(), values.size()));
        if (!values.empty()) known.push_back(r);
    }
    if (table != nullptr && table->rings() == rings.count) {
        for (std::size_t r = 0; r < rings.count; ++r) {
            if (std::isnan(elevation[r])) elevation[r] = table->elevation[r];
        }
        return elevation;
    }
    if (known.empty()) return Buffer<double>(rings.count, 0.0);
    for (std::size_t r = 0; r < rings.count; ++r) {
        if (!std::isnan(elevation[r])) continue;
        const auto above = std::lower_bound(known.begin(), known.end(), r);
        if (above == known.begin() || above == known.end()) {
            elevation[r] = elevation[above == known.begin() ? known.front() : known.back()];
            continue;
        }
        const std::size_t low = *(above - 1), high = *above;
        const double per_ring = (elevation[high] - elevation[low]) / double(high - low);
        elevation[r] = elevation[low] + per_ring * double(r - low);
    }
    return elevation;
}

// Return the ring of each return, and the source of the rings.
std::pair<Rings, RingSource> find_rings(View2<const float> points, const Directions& directions,
                                        std::optional<View1<const std::int16_t>> known, const BeamTable* table) {
    if (known) {
        Rings rings{Buffer<std::int16_t>(known->size), table != nullptr ? table->rings() : 1};
        std::copy(known->begin(), known->end(), rings.ring.data());
        for (const std::int16_t r : *known) rings.count = std::max(rings.count, std::size_t(std::max<int>(r, 0)) + 1);
        return {std::move(rings), RingSource::FILE};
    }
    std::optional<Rings> ordered = rings_by_order(points);
    if (ordered && (table == nullptr || ordered->count <= table->rings())) {
        return {std::move(*ordered), RingSource::FILE_ORDER};
    }
    if (table != nullptr) {
        BeamMatch match = match_beams(directions.slope, directions.range_m, *table);
        if (match.excess >= EXPLAINED) return {Rings{std::move(match.ring), table->rings()}, RingSource::BEAM_TABLE};
    } else if (std::optional<ClusteredRings> clustered = rings_by_clusters(directions)) {
        return {std::move(clustered->rings), RingSource::ELEVATION_CLUSTERS};
    }
    return {elevation_bins(directions, table), RingSource::ELEVATION_BINS};
}

}  // namespace

double median_of(std::vector<double> values) {
    if (values.empty()) return UNKNOWN;
    const std::size_t half = values.size() / 2;
    std::nth_element(values.begin(), values.begin() + std::ptrdiff_t(half), values.end());
    if (values.size() % 2) return values[half];
    return (*std::max_element(values.begin(), values.begin() + std::ptrdiff_t(half)) + values[half]) / 2;
}

double lower_median(const float* values, std::size_t count) {
    std::vector<std::int32_t> key(count);
    const std::size_t known = order_keys(values, count, key.data());
    if (known == 0) return UNKNOWN;
    // Floats and keys have the same order: bisect the key range, counting keys up to the middle.
    const std::size_t rank = (known - 1) / 2;
    std::int64_t low = 0, high = 0;
    find_bounds(key.data(), count, low, high);
    while (low < high) {
        const std::int64_t middle = low + (high - low) / 2;
        if (count_up_to(key.data(), count, std::int32_t(middle)) > rank) {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    return std::bit_cast<float>(number_key(std::int32_t(low)));
}

std::optional<Rings> rings_by_order(View2<const float> points) {
    if (points.rows == 0) return std::nullopt;
    std::optional<Rings> best;
    double least = std::numeric_limits<double>::infinity();
    for (const float start : {0.0f, PI}) {
        for (const float sense : {1.0f, -1.0f}) {
            const Order order = order_rings(points, start, sense);
            if (order.rings < FEWEST_RINGS || order.one_way < ONE_WAY_AT_SEAMS) continue;
            std::vector<double> medians = medians_in_order(order, points);
            std::erase_if(medians, [](double median) { return !std::isfinite(median); });
            if (medians.size() < 2) continue;
            double path = 0.0, rising = 0.0, falling = 0.0;
            std::vector<double> steps;
            for (std::size_t k = 1; k < medians.size(); ++k) {
                const double step = medians[k] - medians[k - 1];
                rising += step > MIN_STEP;
                falling += step < -MIN_STEP;
                path += std::abs(step);
                steps.push_back(std::abs(step));
            }
            const bool one_way = std::max(rising, falling) >= ONE_WAY * double(steps.size());
            // Two sensors in one cloud rise twice.
            const bool is_single = path <= MAX_PATH * std::abs(medians.back() - medians.front());
            const double change = change_within(order, points) / median_of(std::move(steps));
            if (change < least && is_single && one_way) {
                best = fill_rings(order, points.rows, rising > falling);
                least = change;
                if (change < SMALL_CHANGE) return best;
            }
        }
    }
    return best;
}

RingAssignment recover_rings(View2<const float> points, std::optional<View1<const std::int16_t>> known,
                             const BeamTable* table) {
    const Directions directions = directions_of(points);
    auto found = find_rings(points, directions, known, table);
    Rings& rings = found.first;
    const RingSource source = found.second;
    const std::size_t count = points.rows, columns = measure_columns(directions, rings, source, table);
    // Assign columns, and count the returns that are alone in their pixel.
    Buffer<std::int32_t> column(count);
    Buffer<std::uint8_t> counts(rings.count * columns, 0);
    const auto pixel = [&](std::size_t n) -> std::uint8_t& {
        return counts[std::size_t(rings.ring[n]) * columns + std::size_t(column[n])];
    };
    const double per_rad = double(columns) / (2 * std::numbers::pi);
    for (std::size_t n = 0; n < count; ++n) {
        const double at = (double(directions.azimuth[n]) + std::numbers::pi) * per_rad;
        column[n] = std::int32_t(at > 0.0 ? std::min(at, double(columns - 1)) : 0.0);
        if (rings.ring[n] >= 0) pixel(n) = std::uint8_t(std::min(pixel(n) + 1, 2));
    }
    std::size_t placed = 0, alone = 0;
    for (std::size_t n = 0; n < count; ++n) {
        placed += rings.ring[n] >= 0;
        alone += rings.ring[n] >= 0 && pixel(n) == 1;
    }
    Buffer<double> elevation = median_elevations(directions, rings, table);
    return {std::move(rings.ring), std::move(column), columns, std::move(elevation), placed, alone, source};
}

}  // namespace viewshed
