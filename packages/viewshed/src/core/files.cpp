#include "files.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <vector>

#include "vectors.hpp"

namespace viewshed {
namespace {

// Largest plausible range in meters, and intensity.
constexpr float FARTHEST_M = 1e4f, BRIGHTEST = 1e6f;

// Largest plausible ring of a nuScenes file.
constexpr float HIGHEST_RING = 127.0f;

// Nearer returns are null returns or the sensor's own housing.
constexpr float NULL_RANGE_M = 0.5f;

}  // namespace

MULTIVERSION void split_four(const float* rows, std::size_t count, float* points, float* intensity) {
    for (std::size_t n = 0; n < count; ++n) {
        points[3 * n] = rows[4 * n];
        points[3 * n + 1] = rows[4 * n + 1];
        points[3 * n + 2] = rows[4 * n + 2];
        intensity[n] = rows[4 * n + 3];
    }
}

namespace {

// As split_five; quarter_turn maps nuScenes' x right, y forward to x forward, y left.
template <bool quarter_turn>
INLINE std::int32_t split_five_as(const float* rows, std::size_t count, float* points, float* intensity,
                                  std::int16_t* ring) {
    std::int32_t bad = 0;
    for (std::size_t n = 0; n < count; ++n) {
        const float* row = rows + 5 * n;
        points[3 * n] = quarter_turn ? row[1] : row[0];
        points[3 * n + 1] = quarter_turn ? -row[0] : row[1];
        points[3 * n + 2] = row[2];
        intensity[n] = row[3];
        const float value = row[4], fits = ((value >= -32768.0f) & (value <= 32767.0f)) ? value : 0.0f;
        const auto whole = std::int16_t(std::int32_t(fits));
        ring[n] = whole;
        bad += float(whole) != value;
    }
    return bad;
}

MULTIVERSION std::int32_t split_five_plain(const float* rows, std::size_t count, float* points, float* intensity,
                                           std::int16_t* ring) {
    return split_five_as<false>(rows, count, points, intensity, ring);
}

MULTIVERSION std::int32_t split_five_turned(const float* rows, std::size_t count, float* points, float* intensity,
                                            std::int16_t* ring) {
    return split_five_as<true>(rows, count, points, intensity, ring);
}

}  // namespace

std::int32_t split_five(const float* rows, std::size_t count, bool quarter_turn, float* points, float* intensity,
                        std::int16_t* ring) {
    return (quarter_turn ? split_five_turned : split_five_plain)(rows, count, points, intensity, ring);
}

MULTIVERSION bool are_finite(const float* values, std::size_t count) {
    std::uint32_t wrong = 0;
    for (std::size_t n = 0; n < count; ++n) {
        const std::uint32_t exponent = std::bit_cast<std::uint32_t>(values[n]) & 0x7f800000u;
        wrong |= exponent == 0x7f800000u;
    }
    return wrong == 0;
}

bool is_plausible(const float* rows, std::size_t count, std::size_t columns) {
    for (const float* row = rows; row < rows + count * columns; row += columns) {
        bool finite = true;
        for (std::size_t k = 0; k < columns; ++k) finite &= bool(std::isfinite(row[k]));
        if (!finite) continue;
        const float far = std::max({std::fabs(row[0]), std::fabs(row[1]), std::fabs(row[2])});
        if (far > FARTHEST_M || row[3] < 0 || row[3] > BRIGHTEST) return false;
        if (columns == 5 && (row[4] < 0 || row[4] > HIGHEST_RING || row[4] != std::floor(row[4]))) return false;
    }
    return true;
}

// Stream of M. Lehmann's liblzf: control < 32 is a run of control + 1 literals, else a back reference of length
// (control >> 5) + 2 (+ one more byte if that field is 7) at distance ((control & 31) << 8 | byte) + 1.
std::int64_t unpack_lzf(View1<const std::uint8_t> packed, View1<std::uint8_t> unpacked) {
    std::size_t at = 0, end = 0;
    while (at < packed.size) {
        const std::size_t control = packed[at++];
        if (control < 32) {
            const std::size_t length = control + 1;
            if (at + length > packed.size || end + length > unpacked.size) return -1;
            std::copy_n(packed.data + at, length, unpacked.data + end);
            at += length;
            end += length;
            continue;
        }
        std::size_t length = control >> 5;
        if (length == 7) {
            if (at >= packed.size) return -1;
            length += packed[at++];
        }
        length += 2;
        if (at >= packed.size) return -1;
        const std::size_t distance = ((control & 31) << 8) + packed[at++] + 1;
        if (distance > end || end + length > unpacked.size) return -1;
        // Byte by byte, since source and target may overlap.
        for (std::size_t k = 0; k < length; ++k) unpacked[end + k] = unpacked[end - distance + k];
        end += length;
    }
    return std::int64_t(end);
}

RingSpread spread_of_rings(View2<const float> points, View1<const std::int16_t> ring, float half_width) {
    // Pack degree of azimuth, elevation and ring of each return into one sortable number.
    std::vector<std::uint64_t> returns;
    double sum = 0.0, squares = 0.0;
    for (std::size_t n = 0; n < points.rows; ++n) {
        const float x = std::fabs(points(n, 0)), y = std::fabs(points(n, 1)), z = points(n, 2);
        // Skip null returns, which lie at or near the origin in thousands.
        if (!(std::min(x, y) < half_width * std::max(x, y)) || std::max(x, y) < NULL_RANGE_M) continue;
        if (!std::isfinite(x + y + z)) continue;
        const double elevation = azimuth_of(z, std::sqrt(x * x + y * y));
        const double degree = std::floor(azimuth_of(points(n, 1), points(n, 0)) * (180.0 / std::numbers::pi));
        sum += elevation;
        squares += elevation * elevation;
        const auto height = std::uint64_t((elevation + std::numbers::pi) * double(1ull << 28));
        returns.push_back(std::uint64_t(degree + 181.0) << 48 | height << 16 | std::uint64_t(std::uint16_t(ring[n])));
    }
    RingSpread spread{returns.size(), 0.0, 0.0, 0.0};
    if (returns.size() < 2) return spread;
    std::sort(returns.begin(), returns.end());
    const double count = double(returns.size()), mean = sum / count;
    spread.elevation_std = std::sqrt(std::max(squares / count - mean * mean, 0.0));
    std::vector<std::int64_t> sizes(1 << 16, 0);
    for (std::size_t k = 0; k < returns.size(); ++k) {
        const auto here = std::int64_t(returns[k] & 0xffff);
        ++sizes[here];
        if (k > 0) spread.beside += double(std::abs(here - std::int64_t(returns[k - 1] & 0xffff)));
    }
    spread.beside /= count - 1.0;
    // Mean ring distance of any two returns: each step between rings separates the returns below from those above.
    double below = 0.0;
    for (const std::int64_t size : sizes) {
        below += double(size);
        spread.any_two += 2.0 * below * (count - below) / (count * count);
    }
    return spread;
}

void move_points(View2<float> points, const double* rotation, const double* shift) {
    for (std::size_t n = 0; n < points.rows; ++n) {
        float* point = points[n];
        const double x = point[0], y = point[1], z = point[2];
        for (std::size_t k = 0; k < 3; ++k) {
            point[k] = float(rotation[3 * k] * x + rotation[3 * k + 1] * y + rotation[3 * k + 2] * z + shift[k]);
        }
    }
}

}  // namespace viewshed
