// Columns of files: rows of float32, points moved between frames, and the packing of PCD.
#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <vector>

#include "stages.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// A point farther than this, or an intensity above the second, is no point of a LiDAR in meters.
constexpr float FARTHEST_M = 1e4f, BRIGHTEST = 1e6f;

// The highest ring of a nuScenes file that is believed.
constexpr float HIGHEST_RING = 127.0f;

// Nearer returns are null returns or the sensor's own housing.
constexpr float NULL_RANGE_M = 0.5f;

// Split rows of x, y, z, intensity into points (3 N,) and intensity (N,).
MULTIVERSION void split_four(const float* rows, std::size_t count, float* points, float* intensity) {
    for (std::size_t n = 0; n < count; ++n) {
        points[3 * n] = rows[4 * n];
        points[3 * n + 1] = rows[4 * n + 1];
        points[3 * n + 2] = rows[4 * n + 2];
        intensity[n] = rows[4 * n + 3];
    }
}

// Split rows of x, y, z, intensity, ring, and return how many rings are no 16-bit whole numbers; those become 0. With
// quarter_turn points are (y, -x, z): nuScenes' x right, y forward becomes x forward, y left.
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

MULTIVERSION std::int32_t split_five(const float* rows, std::size_t count, float* points, float* intensity,
                                     std::int16_t* ring) {
    return split_five_as<false>(rows, count, points, intensity, ring);
}

MULTIVERSION std::int32_t split_five_turned(const float* rows, std::size_t count, float* points, float* intensity,
                                            std::int16_t* ring) {
    return split_five_as<true>(rows, count, points, intensity, ring);
}

// Whether all values are numbers: the exponent of what is none has all its bits set.
MULTIVERSION bool are_finite(const float* values, std::size_t count) {
    std::uint32_t wrong = 0;
    for (std::size_t n = 0; n < count; ++n) {
        const std::uint32_t exponent = std::bit_cast<std::uint32_t>(values[n]) & 0x7f800000u;
        wrong |= exponent == 0x7f800000u;
    }
    return wrong == 0;
}

// Whether rows of 4 or 5 columns read as meters, an intensity and a ring. Rows that are not finite say nothing.
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

// Decode an LZF stream; return the bytes written, or -1 where the stream is damaged. No index leaves either array.
//
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
        // One by one: what is copied may be what was just written.
        for (std::size_t k = 0; k < length; ++k) unpacked[end + k] = unpacked[end - distance + k];
        end += length;
    }
    return std::int64_t(end);
}

// How the rings of returns beside each other differ, seen from the origin, in whatever frame and order.
struct RingSpread {
    std::size_t count;         // returns that were looked at
    double elevation_std;      // their elevations' standard deviation in radians
    double beside, any_two;    // mean difference of rings: of returns beside each other, and of any two
};

// Four narrow sectors, ahead, behind and aside, with all of their returns: those above each other in a degree of azimuth
// are neighbors. half_width is the tangent of half of a sector.
RingSpread spread_of_rings(View2<const float> points, View1<const std::int16_t> ring, float half_width) {
    // Degree of azimuth, elevation and ring of each return there, in one number that sorts by them.
    std::vector<std::uint64_t> returns;
    double sum = 0.0, squares = 0.0;
    for (std::size_t n = 0; n < points.rows; ++n) {
        const float x = std::fabs(points(n, 0)), y = std::fabs(points(n, 1)), z = points(n, 2);
        // Null returns lie at the origin or beside it, thousands of them in one place.
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
    // The mean distance in rings of any two returns: each step from a ring to the next lies between those below and those above it.
    double below = 0.0;
    for (const std::int64_t size : sizes) {
        below += double(size);
        spread.any_two += 2.0 * below * (count - below) / (count * count);
    }
    return spread;
}

}  // namespace

void bind_files(nb::module_& m) {
    m.def(
        "split_xyzi",
        [](In1<float> rows, InOut1<float> points, InOut1<float> intensity) {
            const std::size_t count = intensity.shape(0);
            require(rows.shape(0) >= 4 * count && points.shape(0) == 3 * count, "sizes of columns must agree");
            nb::gil_scoped_release unlocked;
            split_four(rows.data(), count, points.data(), intensity.data());
        },
        "rows"_a.noconvert(), "points"_a.noconvert(), "intensity"_a.noconvert(),
        "Split rows of x, y, z, intensity into points (3 N,) and intensity (N,).");
    m.def(
        "split_xyzir",
        [](In1<float> rows, InOut1<float> points, InOut1<float> intensity, InOut1<std::int16_t> ring,
           bool quarter_turn) {
            const std::size_t count = intensity.shape(0);
            require(rows.shape(0) >= 5 * count && points.shape(0) == 3 * count && ring.shape(0) == count,
                    "sizes of columns must agree");
            nb::gil_scoped_release unlocked;
            return (quarter_turn ? split_five_turned : split_five)(rows.data(), count, points.data(), intensity.data(),
                                                                   ring.data());
        },
        "rows"_a.noconvert(), "points"_a.noconvert(), "intensity"_a.noconvert(), "ring"_a.noconvert(),
        "quarter_turn"_a,
        "Split rows of x, y, z, intensity, ring; how many rings are no whole numbers. With quarter_turn points are "
        "(y, -x, z).");
    m.def(
        "spread_of_rings",
        [](Points points, In1<std::int16_t> ring, float half_width) {
            require(ring.shape(0) == points.shape(0), "ring must have one row for each point");
            const RingSpread spread = spread_of_rings(view(points), view(ring), half_width);
            return nb::make_tuple(spread.count, spread.elevation_std, spread.beside, spread.any_two);
        },
        "points"_a.noconvert(), "ring"_a.noconvert(), "half_width"_a,
        "Returns in four narrow sectors, their elevations' standard deviation, and the mean difference of the rings of "
        "neighbors and of any two.");
    m.def(
        "all_finite",
        [](In2<float> values) {
            nb::gil_scoped_release unlocked;
            return are_finite(values.data(), values.size());
        },
        "values"_a.noconvert(), "Whether all of the values (N, K) are finite.");
    m.def(
        "plausible_rows",
        [](In1<float> rows, std::size_t columns) {
            require(columns == 4 || columns == 5, "columns must be 4 or 5");
            return is_plausible(rows.data(), rows.shape(0) / columns, columns);
        },
        "rows"_a.noconvert(), "columns"_a,
        "Whether rows (N · columns,) read as meters within 10 km, an intensity and, if five, a ring in 0…127.");
    m.def(
        "move_points",
        [](nb::ndarray<float, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu> points, In2<double> rotation,
           In1<double> shift) {
            require(rotation.shape(0) == 3 && rotation.shape(1) == 3 && shift.shape(0) == 3,
                    "a transform must be a rotation (3, 3) and a shift (3,)");
            const double* r = rotation.data();
            for (std::size_t n = 0; n < points.shape(0); ++n) {
                float* point = points.data() + 3 * n;
                const double x = point[0], y = point[1], z = point[2];
                for (std::size_t k = 0; k < 3; ++k) {
                    point[k] = float(r[3 * k] * x + r[3 * k + 1] * y + r[3 * k + 2] * z + shift.data()[k]);
                }
            }
        },
        "points"_a.noconvert(), "rotation"_a.noconvert(), "shift"_a.noconvert(),
        "Replace points (N, 3) by rotation @ point + shift, computed in float64.");
    m.def(
        "unpack_lzf",
        [](In1<std::uint8_t> packed, InOut1<std::uint8_t> unpacked) { return unpack_lzf(view(packed), view(unpacked)); },
        "packed"_a.noconvert(), "unpacked"_a.noconvert(),
        "Decode an LZF stream; the bytes written, or -1 where it is damaged.");
}

}  // namespace viewshed
