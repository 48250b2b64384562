#include "range_image.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "isolated_returns.hpp"
#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// A column with returns in less than this share of the median number of rings is silent.
constexpr double AWAKE_SHARE = 0.5;

// A ring is full if it has at least the first share of one return per column. The median of the full rings may have at
// most the second share, so a few rings with added points do not matter.
constexpr double FULL_RING = 0.9, FULLEST_RING = 1.05;

// Bins of the phase histogram; a histogram makes the phase independent of the order of the points.
constexpr int PHASES = 16;

// Size limits of an image.
constexpr std::size_t MAX_RINGS = 4096, MAX_COLUMNS = 65536;

// Fewest points for which a part pays for its thread.
constexpr std::size_t PART = 8192;

// Write the azimuth of each point in columns from 0, its phase bin, and its squared distance, -1 if out of range.
MULTIVERSION void place_block(const float* points, std::size_t count, float per_rad, float near2, float far2,
                              float* position, std::int32_t* phase, float* squared_m2) {
    float x[BLOCK], y[BLOCK];
    for (std::size_t k = 0; k < count; ++k) {
        x[k] = points[3 * k];
        y[k] = points[3 * k + 1];
        const float z = points[3 * k + 2], d2 = x[k] * x[k] + y[k] * y[k] + z * z;
        squared_m2[k] = ((d2 >= near2) & (d2 <= far2)) ? d2 : -1.0f;
    }
    for (std::size_t k = 0; k < count; ++k) {
        const float columns = (azimuth_of(y[k], x[k]) + PI) * per_rad;
        position[k] = columns >= 0.0f ? columns : 0.0f;  // NaN becomes 0
    }
    for (std::size_t k = 0; k < count; ++k) phase[k] = std::int32_t(position[k] * float(PHASES)) % PHASES;
}

// Return the circular mean of a histogram over [0, 1).
float circular_mean(const std::int32_t* histogram) {
    double x = 0.0, y = 0.0;
    for (int p = 0; p < PHASES; ++p) {
        const double angle = 2 * std::numbers::pi * (p + 0.5) / PHASES;
        x += histogram[p] * std::cos(angle);
        y += histogram[p] * std::sin(angle);
    }
    if (x * x + y * y <= 1e-6) return 0.5f;
    const double mean = std::atan2(y, x) / (2 * std::numbers::pi);
    return float(mean < 0.0 ? mean + 1.0 : mean);
}

// Check that full rings hold about one return per column: the sensor fires as often as the image assumes.
bool are_rings_full(std::vector<std::int64_t> sizes, std::size_t columns) {
    std::erase_if(sizes, [&](std::int64_t size) { return double(size) < FULL_RING * double(columns); });
    std::sort(sizes.begin(), sizes.end());
    if (sizes.empty()) return false;
    const double median = double(sizes[(sizes.size() - 1) / 2] + sizes[sizes.size() / 2]) / 2;
    return median <= FULLEST_RING * double(columns);
}

// Return counts and least squared distances of the pixels, from some of the points.
struct Pixels {
    Pixels(std::size_t size) : counts(size), nearest_m2(size) {
        std::fill(counts.begin(), counts.end(), std::uint8_t{0});
        std::fill(nearest_m2.begin(), nearest_m2.end(), std::numeric_limits<float>::infinity());
    }

    Buffer<std::uint8_t> counts;
    Buffer<float> nearest_m2;
};

// Write the column of each point, -1 without a ring, and fill its pixel. The position plus first (rings,) is at most
// two turns too large; subtracting turns is faster than a modulo.
void fill_pixels(const std::int16_t* __restrict ring, const float* __restrict position, const float* __restrict first,
                 std::size_t begin, std::size_t end, std::int32_t turn, float* __restrict squared_m2,
                 std::int32_t* __restrict column, std::uint8_t* __restrict counts, float* __restrict nearest_m2) {
    constexpr float none = std::numeric_limits<float>::infinity();
    for (std::size_t n = begin; n < end; ++n) {
        const int r = ring[n];
        if (r < 0) {
            column[n] = -1;
            squared_m2[n] = -1.0f;
            continue;
        }
        auto c = std::int32_t(position[n] + first[r]);
        c -= c >= turn ? turn : 0;
        c -= c >= turn ? turn : 0;
        column[n] = c;
        const std::size_t pixel = std::size_t(r) * std::size_t(turn) + std::size_t(c);
        counts[pixel] = std::uint8_t(counts[pixel] + (counts[pixel] < FULL_COUNT));
        const float d2 = squared_m2[n] < 0.0f ? none : squared_m2[n];
        nearest_m2[pixel] = std::min(nearest_m2[pixel], d2);
    }
}

// Merge the pixels of other points.
MULTIVERSION void add_pixels(const std::uint8_t* counts, const float* nearest_m2, std::size_t size,
                             std::uint8_t* all_counts, float* all_nearest_m2) {
    for (std::size_t k = 0; k < size; ++k) {
        const unsigned sum = unsigned(counts[k]) + all_counts[k];
        all_counts[k] = std::uint8_t(sum < FULL_COUNT ? sum : FULL_COUNT);
        all_nearest_m2[k] = nearest_m2[k] < all_nearest_m2[k] ? nearest_m2[k] : all_nearest_m2[k];
    }
}

// Write the nearest return of each pixel, over the points that have one.
void find_nearest(View1<const std::int16_t> ring, View1<const std::int32_t> column, View1<float> squared_m2,
                  View2<float> nearest_m2) {
    std::fill_n(nearest_m2.data, nearest_m2.size(), std::numeric_limits<float>::infinity());
    for (std::size_t n = 0; n < ring.size; ++n) {
        if (column[n] < 0) squared_m2[n] = -1.0f;
        if (squared_m2[n] < 0.0f) continue;
        float& nearest = nearest_m2(ring[n], column[n]);
        nearest = std::min(nearest, squared_m2[n]);
    }
}

}  // namespace

RangeImage range_image(View2<const float> points, View1<const std::int16_t> ring, std::size_t columns,
                       std::size_t rings, float near_m, float far_m) {
    const std::size_t count = points.rows, pixels = rings * columns;
    RangeImage image{rings,           columns,             Buffer<std::int32_t>(count), Buffer<std::uint8_t>(0),
                     Buffer<float>(0), Buffer<float>(rings), Buffer<bool>(count),         Buffer<bool>(count),
                     std::nullopt,    false};
    Buffer<float> position(count), squared_m2(count);

    // 1. Azimuth in columns and squared distance of each return; phase histogram of each ring.
    const std::size_t parts = count_parts(count, PART);
    std::vector<std::vector<std::int32_t>> phases(parts, std::vector<std::int32_t>(rings * PHASES, 0));
    for_ranges(count, parts, [&](std::size_t part, std::size_t begin, std::size_t end) {
        std::array<std::int32_t, BLOCK> phase;
        for (std::size_t start = begin; start < end; start += BLOCK) {
            const std::size_t size = std::min(BLOCK, end - start);
            place_block(points[start], size, float(double(columns) / (2 * std::numbers::pi)), near_m * near_m,
                        far_m * far_m, &position[start], phase.data(), &squared_m2[start]);
            for (std::size_t k = 0; k < size; ++k) {
                if (ring[start + k] >= 0) ++phases[part][ring[start + k] * PHASES + phase[k]];
            }
        }
    });
    std::vector<std::int64_t> ring_sizes(rings, 0);
    for (std::size_t r = 0; r < rings; ++r) {
        std::array<std::int32_t, PHASES> histogram{};
        for (const auto& histograms : phases) {
            for (int p = 0; p < PHASES; ++p) histogram[p] += histograms[r * PHASES + p];
        }
        for (const std::int32_t size : histogram) ring_sizes[r] += size;
        image.phase[r] = circular_mean(histogram.data());
    }
    image.has_full_rings = are_rings_full(ring_sizes, columns);

    // 2. The pixel of each return. A column reaches half a step around its firing: + 0.5 - phase, plus one turn.
    const auto turn = std::int32_t(columns);
    std::vector<Pixels> pixels_of;
    for (std::size_t part = 0; part < parts; ++part) pixels_of.emplace_back(pixels);
    Buffer<float> first(rings);
    for (std::size_t r = 0; r < rings; ++r) first[r] = float(columns) + 0.5f - image.phase[r];
    for_ranges(count, parts, [&](std::size_t part, std::size_t begin, std::size_t end) {
        fill_pixels(ring.data, position.data(), first.data(), begin, end, turn, squared_m2.data(), image.column.data(),
                    pixels_of[part].counts.data(), pixels_of[part].nearest_m2.data());
    });
    for (std::size_t part = 1; part < parts; ++part) {
        add_pixels(pixels_of[part].counts.data(), pixels_of[part].nearest_m2.data(), pixels, pixels_of[0].counts.data(),
                   pixels_of[0].nearest_m2.data());
    }
    image.counts = std::move(pixels_of[0].counts);
    image.nearest_m2 = std::move(pixels_of[0].nearest_m2);

    // 3. Isolated returns: no neighboring pixel has a similar range.
    const auto find_isolated = [&] {
        find_isolated_returns(ring, image.column, squared_m2, {image.nearest_m2.data(), rings, columns},
                              silent_columns({image.counts.data(), rings, columns}), image.isolated, image.behind);
    };
    find_isolated();

    // 4. With many isolated returns, random returns look similar by chance. Returns that too few neighbors confirm are
    // clutter
    //    and leave the image; then isolated returns are determined again.
    if (is_cluttered(image.isolated)) {
        Buffer<bool> clutter(count);
        find_clutter(ring, image.column, squared_m2, {image.nearest_m2.data(), rings, columns}, image.isolated, near_m,
                     clutter);
        take_out(ring, clutter, image.column, image.counts.view(rings, columns));
        find_nearest(ring, image.column, squared_m2, image.nearest_m2.view(rings, columns));
        find_isolated();
        for (std::size_t n = 0; n < count; ++n) image.isolated[n] |= clutter[n];
        image.clutter = std::move(clutter);
    }
    return image;
}

Buffer<bool> silent_columns(View2<const std::uint8_t> counts) {
    std::vector<std::int32_t> rings(counts.columns, 0);
    for (std::size_t r = 0; r < counts.rows; ++r) {
        for (std::size_t c = 0; c < counts.columns; ++c) rings[c] += counts(r, c) > 0;
    }
    std::vector<std::int32_t> nonempty;
    std::copy_if(rings.begin(), rings.end(), std::back_inserter(nonempty), [](std::int32_t n) { return n > 0; });
    double min_rings = 0.0;
    if (!nonempty.empty()) {
        std::nth_element(nonempty.begin(), nonempty.begin() + std::ptrdiff_t(nonempty.size() / 2), nonempty.end());
        min_rings = AWAKE_SHARE * nonempty[nonempty.size() / 2];
    }
    Buffer<bool> silent(counts.columns);
    for (std::size_t c = 0; c < counts.columns; ++c) silent[c] = rings[c] == 0 || rings[c] < min_rings;
    return silent;
}

void take_out(View1<const std::int16_t> ring, View1<const bool> left_out, View1<std::int32_t> column,
              View2<std::uint8_t> counts) {
    const std::vector<std::uint8_t> before(counts.data, counts.data + counts.size());
    for (std::size_t n = 0; n < left_out.size; ++n) {
        if (!left_out[n] || column[n] < 0 || ring[n] < 0) continue;
        const std::size_t pixel = ring[n] * counts.columns + column[n];
        counts.data[pixel] = std::uint8_t(counts.data[pixel] - (before[pixel] != FULL_COUNT && counts.data[pixel] > 0));
        column[n] = -1;
    }
}

void require_image(std::size_t rings, std::size_t columns) {
    require(rings >= 1 && rings <= MAX_RINGS, "an image must have 1 to 4096 rings");
    require(columns >= 1 && columns <= MAX_COLUMNS, "an image must have 1 to 65536 columns");
}

}  // namespace viewshed
