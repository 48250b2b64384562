#include "isolated_returns.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr float NONE = std::numeric_limits<float>::infinity();

// Two ranges are similar if their ratio is below this.
constexpr double SIMILAR = 1.25;
constexpr float DOWN = float(1.0 / (SIMILAR * SIMILAR)), UP = float(SIMILAR * SIMILAR);

// The neighbor of a return in its ring is the next return, at most this many columns away.
constexpr int NEIGHBOR_COLUMNS = 8;

// A return confirms another one if the ratio of their ranges is below CONFIRMING and it lies in this window of pixels.
constexpr double CONFIRMING = 1.1;
constexpr int WINDOW_RINGS = 1, WINDOW_COLUMNS = 4;
constexpr int WINDOW_PIXELS = (2 * WINDOW_RINGS + 1) * (2 * WINDOW_COLUMNS + 1) - 1;

// A sweep (of FEWEST_RETURNS or more) with a larger share of isolated returns is cluttered: a share CHANCE of its
// random returns may be confirmed by chance, and all others are clutter.
constexpr double CLUTTERED_SHARE = 0.02, CHANCE = 0.01;
constexpr std::size_t FEWEST_RETURNS = 256;
constexpr int MIN_CONFIRMATIONS = 2;

// About this share of random returns is isolated.
constexpr double ISOLATED_OF_RANDOM = 0.6;
constexpr int RANGE_BINS = 128;

// Fewest returns for which a part pays for its thread.
constexpr std::size_t PART = 8192;

INLINE bool is_between(float value, float low, float high) { return (value > low) & (value < high); }

// Write the nearest returns of one ring, negated if an adjacent pixel confirms them. Vectorized: this covers most
// returns.
MULTIVERSION void confirm_ring(const float* below, const float* row, const float* above, std::size_t columns,
                               float* confirmed) {
    confirmed[0] = row[0];
    confirmed[columns - 1] = row[columns - 1];
    for (std::size_t c = 1; c + 1 < columns; ++c) {
        const float low = row[c] * DOWN, high = row[c] * UP;
        const bool in_ring = is_between(row[c - 1], low, high) | is_between(row[c + 1], low, high);
        const bool is_confirmed = in_ring | is_between(below[c], low, high) | is_between(above[c], low, high);
        confirmed[c] = is_confirmed ? -row[c] : row[c];
    }
}

// Return the next return of a ring on one side of a column, +inf if none is near.
float next_in_ring(const float* row, int columns, int c, int step) {
    for (int k = 0; k < NEIGHBOR_COLUMNS; ++k) {
        c += step;
        c = c < 0 ? columns - 1 : (c >= columns ? 0 : c);
        if (row[c] < NONE) return row[c];
    }
    return NONE;
}

// Check that there are returns around (r, c), none of them at a range similar to sqrt(d2). Silent columns need none.
bool is_isolated(View2<const float> nearest_m2, int r, int c, float d2, bool silent) {
    const int rings = int(nearest_m2.rows), columns = int(nearest_m2.columns);
    const float low = d2 * DOWN, high = d2 * UP;
    // The next return on either side in the ring.
    const float left = next_in_ring(nearest_m2[r], columns, c, -1), right = next_in_ring(nearest_m2[r], columns, c, 1);
    if (is_between(left, low, high) || is_between(right, low, high)) return false;
    float nearest = std::min(left, right);
    // Three pixels each of the ring below and above; the image wraps around.
    const int before = c > 0 ? c - 1 : columns - 1, after = c + 1 < columns ? c + 1 : 0;
    for (const int p : {r - 1, r + 1}) {
        if (p < 0 || p >= rings) continue;
        const float one = nearest_m2(p, before), two = nearest_m2(p, c), three = nearest_m2(p, after);
        if (is_between(one, low, high) || is_between(two, low, high) || is_between(three, low, high)) return false;
        nearest = std::min({nearest, one, two, three});
    }
    return silent || nearest < NONE;
}

// Count the pixels in the window around (r, c) that confirm a return there.
int count_confirmations(View2<const float> nearest_m2, int r, int c, float d2) {
    constexpr float down = float(1.0 / (CONFIRMING * CONFIRMING)), up = float(CONFIRMING * CONFIRMING);
    const int rings = int(nearest_m2.rows), columns = int(nearest_m2.columns);
    int count = 0;
    for (int p = std::max(r - WINDOW_RINGS, 0); p < std::min(r + WINDOW_RINGS + 1, rings); ++p) {
        for (int q = c - WINDOW_COLUMNS; q <= c + WINDOW_COLUMNS; ++q) {
            const int at = ((q % columns) + columns) % columns;
            count += (p != r || q != c) && is_between(nearest_m2(p, at), d2 * down, d2 * up);
        }
    }
    return count;
}

// Return the smallest number of confirmations that a share CHANCE of random returns reaches at most, given the mean.
int required_confirmations(double mean) {
    double term = 1.0, sum = 0.0;
    int required = 1;
    for (int number = 1; number <= WINDOW_PIXELS + 1; ++number) {
        sum += term;  // P(N < number) / exp(-mean)
        term *= mean / number;
        required += 1.0 - std::exp(-mean) * sum > CHANCE;
    }
    return std::max(required, MIN_CONFIRMATIONS);
}

}  // namespace

void find_isolated_returns(View1<const std::int16_t> ring, View1<const std::int32_t> column,
                           View1<const float> squared_m2, View2<const float> nearest_m2, View1<const bool> silent,
                           View1<bool> isolated, View1<bool> behind) {
    const std::size_t rings = nearest_m2.rows, columns = nearest_m2.columns;
    const Buffer<float> none(columns, NONE);
    Buffer<float> confirmed(nearest_m2.size());
    for_ranges(rings, count_parts(nearest_m2.size(), PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t r = begin; r < end; ++r) {
            confirm_ring(r > 0 ? nearest_m2[r - 1] : none.data(), nearest_m2[r],
                         r + 1 < rings ? nearest_m2[r + 1] : none.data(), columns, &confirmed[r * columns]);
        }
    });
    for_ranges(ring.size, count_parts(ring.size, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t n = begin; n < end; ++n) {
            isolated[n] = behind[n] = false;
            const float d2 = squared_m2[n];
            if (d2 < 0.0f) continue;
            // Shortcut: most returns are the nearest of a pixel that is confirmed already.
            const int r = ring[n], c = column[n];
            const float nearest = confirmed[std::size_t(r) * columns + std::size_t(c)];
            if (d2 != -nearest && is_isolated(nearest_m2, r, c, d2, silent[c])) {
                isolated[n] = true;
                behind[n] = d2 > std::fabs(nearest);
            }
        }
    });
}

bool is_cluttered(View1<const bool> isolated) {
    const auto count = std::count(isolated.begin(), isolated.end(), true);
    return isolated.size >= FEWEST_RETURNS && double(count) > CLUTTERED_SHARE * double(isolated.size);
}

void find_clutter(View1<const std::int16_t> ring, View1<const std::int32_t> column, View1<const float> squared_m2,
                  View2<const float> nearest_m2, View1<const bool> isolated, float near_m, View1<bool> clutter) {
    // 1. Count isolated returns in logarithmic range bins, as wide as two confirming returns may differ.
    std::array<double, RANGE_BINS> isolated_in{};
    Buffer<std::uint8_t> bin(ring.size);
    const float per_log = float(1.0 / std::log(CONFIRMING));
    for (std::size_t n = 0; n < ring.size; ++n) {
        const float range_m = squared_m2[n] < 0.0f ? 0.0f : std::sqrt(squared_m2[n]);
        const float step = std::log(std::max(range_m, near_m) / near_m) * per_log;
        bin[n] = std::uint8_t(step > 0.0f ? std::min(step, float(RANGE_BINS - 1)) : 0.0f);
        isolated_in[bin[n]] += isolated[n];
    }
    // 2. Compute the mean number of random returns of similar range in a window, and the confirmations required.
    std::array<int, RANGE_BINS> required;
    for (int k = 0; k < RANGE_BINS; ++k) {
        const double before = k > 0 ? isolated_in[k - 1] : 0.0, after = k + 1 < RANGE_BINS ? isolated_in[k + 1] : 0.0;
        const double similar = isolated_in[k] + 0.5 * (before + after);
        required[k] = required_confirmations(similar * WINDOW_PIXELS / (ISOLATED_OF_RANDOM * double(nearest_m2.size())));
    }
    // 3. Count the confirmations of each return.
    for_ranges(ring.size, count_parts(ring.size, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t n = begin; n < end; ++n) {
            clutter[n] = column[n] >= 0 && squared_m2[n] >= 0.0f &&
                         count_confirmations(nearest_m2, ring[n], column[n], squared_m2[n]) < required[bin[n]];
        }
    });
}

}  // namespace viewshed
