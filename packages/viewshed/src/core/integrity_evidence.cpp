#include "integrity_evidence.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr float NONE = std::numeric_limits<float>::infinity();
constexpr float NO_NUMBER = std::numeric_limits<float>::quiet_NaN();

// A ring with returns in no more than this share of its columns is dead.
constexpr double ALIVE_SHARE = 0.02;

// A return lies behind another if it is farther by this factor and this distance.
constexpr float BEHIND = 1.1f, BEHIND_M = 0.3f;

// The eight pixels around one without a return are one surface if the farthest is at most this much farther than the
// nearest: a factor and a distance.
constexpr float SURROUND = 1.06f, SURROUND_M = 0.3f;

// Isolated returns are in line if their ranges have a ratio below IN_LINE, within IN_LINE_RINGS and IN_LINE_COLUMNS.
constexpr float IN_LINE = 1.03f;
constexpr int IN_LINE_RINGS = 2, IN_LINE_COLUMNS = 12;
constexpr int LEAST_NEIGHBORS = 2;

// Noise is what a parabola leaves of this many ranges in a row, every third pixel; no step between them may be larger than
// this distance and share of the range. A quartile needs this many stretches.
constexpr std::size_t STRETCH = 7, STRIDE = 3, LEAST_STRETCHES = 6;
constexpr float STEP_M = 0.4f, STEP_SHARE = 0.02f;

// Ground for noise is lower than this above local ground; surfaces are near up to this range.
constexpr float NOISE_GROUND_M = 0.3f, NEAR_M = 20.0f;

// Ground is what lies within this of the local ground; it is compared across columns up to this range, by the medians of
// three columns, where at least LEAST_RINGS show it. A common jump counts against its spread and this much.
constexpr float GROUND_M = 0.25f, GROUND_RANGE_M = 25.0f, STEP_SPREAD_M = 0.1f;
constexpr std::size_t MEDIAN_COLUMNS = 3, LEAST_RINGS = 4;

// The scale of a normal distribution for a median deviation of one.
constexpr float NORMAL = 1.4826f;

// Rings that must be there for a share of those that break off, and what is added to their number.
constexpr int LEAST_BROKEN = 5, FEW_BROKEN = 2;

// A ring with returns in this share of its columns usually returns; a column is empty if less than half of these do.
constexpr double USUAL_SHARE = 0.6;

// The elevation of a ring is a median of ELEVATION_SAMPLES returns, of LEAST_SAMPLES at least; a return is off it by this many median
// deviations and this slope.
constexpr std::size_t ELEVATION_SAMPLES = 192, LEAST_SAMPLES = 16;
constexpr float OFF_DEVIATIONS = 6.0f, OFF_SLOPE = 0.0008f;

// A neighbor confirms an elevation: CONFIRMING_COLUMNS away at most, of a range with a ratio below this, itself off by as
// much up to this slope or share.
constexpr int CONFIRMING_COLUMNS = 4;
constexpr float CONFIRMING_RATIO = 1.25f, CONFIRMING_SLOPE = 0.0012f, CONFIRMING_SHARE = 0.35f;

// Ground for an offset of range: nearer than OFFSET_HEIGHTS sensor heights, within slopes and distances below and above z = 0.
constexpr float OFFSET_HEIGHTS = 12.0f;
constexpr float BELOW_SLOPE = 0.25f, BELOW_M = 0.5f, ABOVE_SLOPE = 0.08f, ABOVE_M = 0.15f;

// The offset is fitted to about OFFSET_SAMPLES returns a sweep, LEAST_OFFSET_RETURNS a sector at least, in rounds in which returns off
// by this much count half.
constexpr std::size_t OFFSET_SAMPLES = 16384;
constexpr double LEAST_OFFSET_RETURNS = 30.0, OFFSET_SCALE_M = 0.1, LEAST_DETERMINANT = 1e-3;
constexpr int OFFSET_ROUNDS = 3;

// Pixels, or points, of a part that is worth a thread.
constexpr std::size_t PART = 32768;

INLINE bool are_alike(float a, float b, float ratio) { return (a < b * ratio) & (b < a * ratio); }

INLINE bool is_behind(float range_m, float surface_m) { return range_m > surface_m * BEHIND + BEHIND_M; }

INLINE float median_of_three(float a, float b, float c) {
    const float low = a < b ? a : b, high = a < b ? b : a, most = high < c ? high : c;
    return low > most ? low : most;
}

// The median of some numbers, which are put into another order; NaN of none.
float median(std::vector<float>& values) {
    if (values.empty()) return NO_NUMBER;
    const auto middle = values.begin() + std::ptrdiff_t(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
}

float range_of(const float* p) { return std::sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]); }

// The sector of an azimuth in [-π, π).
INLINE std::size_t sector_of(float azimuth, std::size_t sectors) {
    const float position = (azimuth + PI) * float(double(sectors) / (2 * double(PI)));
    const auto sector = std::size_t(position > 0.0f ? position : 0.0f);
    return sector < sectors ? sector : 0;
}

// The columns on either side of one; the image closes around the circle.
INLINE std::size_t before(std::size_t c, std::size_t columns) { return c > 0 ? c - 1 : columns - 1; }
INLINE std::size_t after(std::size_t c, std::size_t columns) { return c + 1 < columns ? c + 1 : 0; }

// Call body(ring, some, all) for the rings [first, last), in parts that count by sector for themselves.
template <typename Body>
void count_rings(const Image& image, std::size_t first, std::size_t last, const Counts& counts, const Body& body) {
    if (first >= last) return;
    const std::size_t sectors = counts.all.size, parts = count_parts((last - first) * image.range_m.columns, PART);
    std::vector<std::vector<std::int32_t>> of_parts(parts, std::vector<std::int32_t>(2 * sectors, 0));
    for_ranges(last - first, parts, [&](std::size_t part, std::size_t begin, std::size_t end) {
        std::int32_t* some = of_parts[part].data();
        for (std::size_t r = first + begin; r < first + end; ++r) body(r, some, some + sectors);
    });
    for (const auto& of_part : of_parts) {
        for (std::size_t s = 0; s < sectors; ++s) {
            counts.some[s] += of_part[s];
            counts.all[s] += of_part[sectors + s];
        }
    }
}

// Write the nearest and the farthest of the three ranges of each column of three rings, without the middle one.
MULTIVERSION void find_column_extremes(const float* below, const float* row, const float* above, std::size_t columns,
                                       float* nearest, float* farthest, float* nearest_around, float* farthest_around) {
    for (std::size_t c = 0; c < columns; ++c) {
        const float low = below[c] < above[c] ? below[c] : above[c], high = below[c] < above[c] ? above[c] : below[c];
        nearest[c] = low, farthest[c] = high;
        nearest_around[c] = low < row[c] ? low : row[c];
        farthest_around[c] = high > row[c] ? high : row[c];
    }
}

// Write whether each pixel of a ring, but the first and last, returned and is surrounded by one surface (1), or lies behind
// it as well (3).
MULTIVERSION void find_surrounded(const float* row, const float* nearest, const float* farthest,
                                  const float* nearest_around, const float* farthest_around, std::size_t columns,
                                  std::uint8_t* found) {
    for (std::size_t c = 1; c + 1 < columns; ++c) {
        const float left = nearest_around[c - 1], right = nearest_around[c + 1];
        float low = left < right ? left : right;
        low = low < nearest[c] ? low : nearest[c];
        const float far_left = farthest_around[c - 1], far_right = farthest_around[c + 1];
        float high = far_left > far_right ? far_left : far_right;
        high = high > farthest[c] ? high : farthest[c];
        const bool surrounded = (high < low * SURROUND + SURROUND_M) & (row[c] < NONE);
        found[c] = std::uint8_t(surrounded) | std::uint8_t((surrounded & is_behind(row[c], high)) << 1);
    }
}

}  // namespace

BeamImage beam_image(View2<const float> points, View1<const std::int16_t> ring, View1<const std::int32_t> column,
                     View1<const std::int32_t> rows, View1<const float> height_m, std::size_t rings,
                     std::size_t columns) {
    // 1. The rings that are alive, and where they are in the image.
    std::vector<std::int32_t> count(rings, 0), place(rings, -1);
    for (const std::int32_t n : rows) {
        if (column[n] >= 0 && ring[n] >= 0) ++count[ring[n]];
    }
    std::int32_t alive = 0;
    for (std::size_t r = 0; r < rings; ++r) {
        if (double(count[r]) > ALIVE_SHARE * double(columns)) place[r] = alive++;
    }
    // 2. The nearest and the farthest return of each pixel, and the height of the nearest.
    const std::size_t size = std::size_t(alive) * columns;
    BeamImage image{std::size_t(alive), columns, Buffer<float>(size, NONE), Buffer<float>(size, NONE),
                    Buffer<float>(size, NO_NUMBER)};
    for (std::size_t m = 0; m < rows.size; ++m) {
        const auto n = std::size_t(rows[m]);
        if (column[n] < 0 || ring[n] < 0 || place[ring[n]] < 0) continue;
        const float range_m = range_of(points[n]);
        const std::size_t pixel = std::size_t(place[ring[n]]) * columns + std::size_t(column[n]);
        float &nearest = image.range_m[pixel], &farthest = image.farthest_m[pixel];
        if (range_m < nearest) image.height_m[pixel] = height_m[m];
        farthest = farthest < NONE ? std::max(farthest, range_m) : range_m;
        nearest = std::min(nearest, range_m);
    }
    return image;
}

namespace {

// Write the sector of each point of a block.
MULTIVERSION void find_sectors(const float* points, std::size_t count, float per_rad, float last, std::int32_t* sector) {
    for (std::size_t k = 0; k < count; ++k) {
        const float position = (azimuth_of(points[3 * k + 1], points[3 * k]) + PI) * per_rad;
        sector[k] = std::int32_t(position > 0.0f ? (position < last ? position : last) : 0.0f);
    }
}

}  // namespace

void count_chosen(View2<const float> points, View1<const bool> chosen, const Counts& counts) {
    const std::size_t sectors = counts.all.size;
    const float per_rad = float(double(sectors) / (2 * double(PI))), last = float(sectors - 1);
    // Neighboring points mostly lie in one sector: each fourth one is counted apart, so that counts need not wait for each
    // other.
    constexpr std::size_t TURNS = 4;
    std::vector<std::int32_t> all(TURNS * sectors, 0), some(TURNS * sectors, 0);
    std::int32_t sector[BLOCK];
    for (std::size_t start = 0; start < points.rows; start += BLOCK) {
        const std::size_t size = std::min(BLOCK, points.rows - start);
        find_sectors(points[start], size, per_rad, last, sector);
        for (std::size_t k = 0; k < size; ++k) {
            const std::size_t at = k % TURNS * sectors + std::size_t(sector[k]);
            ++all[at];
            if (chosen[start + k]) ++some[at];
        }
    }
    for (std::size_t k = 0; k < TURNS * sectors; ++k) {
        counts.all[k % sectors] += all[k];
        counts.some[k % sectors] += some[k];
    }
}

void count_holes(const Image& image, const Counts& counts) {
    const auto& range_m = image.range_m;
    const std::size_t columns = range_m.columns;
    if (range_m.rows < 3) return;
    count_rings(image, 1, range_m.rows - 1, counts, [&](std::size_t r, std::int32_t* holes, std::int32_t* surrounded) {
        Buffer<float> nearest(columns), farthest(columns), nearest_around(columns), farthest_around(columns);
        Buffer<std::uint8_t> found(columns, 0);
        find_column_extremes(range_m[r - 1], range_m[r], range_m[r + 1], columns, nearest.data(), farthest.data(),
                             nearest_around.data(), farthest_around.data());
        find_surrounded(range_m[r], nearest.data(), farthest.data(), nearest_around.data(), farthest_around.data(),
                        columns, found.data());
        for (std::size_t c = 1; c + 1 < columns; ++c) {
            surrounded[image.sector[c]] += found[c] & 1;
            holes[image.sector[c]] += found[c] >> 1;
        }
    });
}

void count_specks(const Image& image, const Counts& counts) {
    const auto& range_m = image.range_m;
    const int rings = int(range_m.rows), columns = int(range_m.columns);
    if (rings < 3) return;
    // 1. Where a beam returned before those around it.
    Buffer<float> speck_m(range_m.size());
    std::fill(speck_m.begin(), speck_m.end(), NONE);
    count_rings(image, 1, range_m.rows - 1, counts, [&](std::size_t r, std::int32_t*, std::int32_t* all) {
        const float *row = range_m[r], *below = range_m[r - 1], *above = range_m[r + 1];
        for (std::size_t c = 0; c < range_m.columns; ++c) {
            if (!(row[c] < NONE)) continue;
            ++all[image.sector[c]];
            const float left = row[before(c, range_m.columns)], right = row[after(c, range_m.columns)];
            const int around = (left < NONE) + (right < NONE) + (below[c] < NONE) + (above[c] < NONE);
            const float nearest = std::min(std::min(left, right), std::min(below[c], above[c]));
            if (around >= LEAST_NEIGHBORS && is_behind(nearest, row[c])) speck_m[r * range_m.columns + c] = row[c];
        }
    });
    // 2. Those in line with another one.
    const auto is_in_line = [&](int r, int c, float here) {
        for (int p = std::max(r - IN_LINE_RINGS, 1); p <= std::min(r + IN_LINE_RINGS, rings - 2); ++p) {
            for (int q = c - IN_LINE_COLUMNS; q <= c + IN_LINE_COLUMNS; ++q) {
                const int at = ((q % columns) + columns) % columns;
                if ((p != r || at != c) && are_alike(speck_m[std::size_t(p * columns + at)], here, IN_LINE)) return true;
            }
        }
        return false;
    };
    count_rings(image, 1, range_m.rows - 1, counts, [&](std::size_t r, std::int32_t* specks, std::int32_t*) {
        for (int c = 0; c < columns; ++c) {
            const float here = speck_m[r * range_m.columns + std::size_t(c)];
            if (here < NONE) specks[image.sector[c]] += is_in_line(int(r), c, here);
        }
    });
}

void count_double_returns(const Image& image, View2<const float> farthest_m, const Counts& counts) {
    const auto& range_m = image.range_m;
    const std::size_t columns = range_m.columns;
    count_rings(image, 0, range_m.rows, counts, [&](std::size_t r, std::int32_t* doubles, std::int32_t* all) {
        const float* row = range_m[r];
        for (std::size_t c = 0; c < columns; ++c) {
            if (!(row[c] < NONE)) continue;
            ++all[image.sector[c]];
            // A neighbor that fired a little early or late leaves its own pixel empty.
            if (!is_behind(farthest_m(r, c), row[c])) continue;
            doubles[image.sector[c]] += (row[before(c, columns)] < NONE) & (row[after(c, columns)] < NONE);
        }
    });
}

namespace {

// Write the root of the mean square that a parabola leaves of the ranges from each column on; by orthogonal polynomials.
MULTIVERSION void find_noise(const float* range_m, std::size_t stretches, float* noise_m) {
    for (std::size_t c = 0; c < stretches; ++c) {
        const float* r = range_m + c;
        const float mean = (r[0] + r[1] + r[2] + r[3] + r[4] + r[5] + r[6]) / 7.0f;
        const float a = r[0] - mean, b = r[1] - mean, d = r[2] - mean, e = r[3] - mean, f = r[4] - mean, g = r[5] - mean,
                    h = r[6] - mean;
        const float line = 3.0f * (h - a) + 2.0f * (g - b) + (f - d);
        const float parabola = 5.0f * (a + h) - 3.0f * (d + f) - 4.0f * e;
        const float squares = a * a + b * b + d * d + e * e + f * f + g * g + h * h;
        // 28 and 84 are the squared lengths of the polynomials; of 7 ranges 4 are free.
        const float left = squares - line * line / 28.0f - parabola * parabola / 84.0f;
        noise_m[c] = std::sqrt((left > 0.0f ? left : 0.0f) / 4.0f);
    }
}

// The lower quartile of the noise of stretches, which are put into another order; NaN for too few.
float lower_quartile(std::vector<float>& noise) {
    if (noise.size() < LEAST_STRETCHES) return NO_NUMBER;
    const auto quartile = noise.begin() + std::ptrdiff_t((noise.size() - 1) / 4);
    std::nth_element(noise.begin(), quartile, noise.end());
    return *quartile;
}

// Write for each column of a ring whether the step to the next is that of one surface.
MULTIVERSION void find_connected(const float* range_m, std::size_t columns, std::uint8_t* connected) {
    for (std::size_t c = 0; c + 1 < columns; ++c) {
        connected[c] = std::fabs(range_m[c + 1] - range_m[c]) < STEP_M + STEP_SHARE * range_m[c];
    }
}

}  // namespace

void measure_noise(const Image& image, View2<const float> height_m, View3<float> noise_m) {
    const auto& range_m = image.range_m;
    const std::size_t columns = range_m.columns, sectors = noise_m.rows, bands = noise_m.columns;
    std::fill_n(noise_m.data, noise_m.size(), NO_NUMBER);
    const std::size_t parts = std::min(count_parts(range_m.size(), PART), bands);
    for_ranges(bands, parts, [&](std::size_t, std::size_t begin, std::size_t end) {
        Buffer<std::uint8_t> connected(columns, 0);
        Buffer<float> noise_of(columns);
        std::vector<std::vector<float>> all(sectors), near(sectors), ground(sectors);
        for (std::size_t band = begin; band < end; ++band) {
            // 1. The noise of each stretch of the band's rings, by sector.
            for (std::size_t s = 0; s < sectors; ++s) all[s].clear(), near[s].clear(), ground[s].clear();
            for (std::size_t r = range_m.rows * band / bands; r < range_m.rows * (band + 1) / bands; ++r) {
                find_connected(range_m[r], columns, connected.data());
                if (columns >= STRETCH) find_noise(range_m[r], columns - STRETCH + 1, noise_of.data());
                std::size_t length = 1;
                for (std::size_t c = 1; c < columns; ++c) {
                    length = connected[c - 1] ? length + 1 : 1;
                    if (length < STRETCH || c % STRIDE != 0) continue;
                    const std::size_t middle = c - STRETCH / 2, s = std::size_t(image.sector[middle]);
                    const float noise = noise_of[c + 1 - STRETCH];
                    all[s].push_back(noise);
                    if (range_m(r, middle) < NEAR_M) near[s].push_back(noise);
                    if (height_m(r, middle) < NOISE_GROUND_M) ground[s].push_back(noise);
                }
            }
            // 2. Its lower quartile: rough surfaces among smooth ones do not matter.
            for (std::size_t s = 0; s < sectors; ++s) {
                noise_m(0, s, band) = lower_quartile(ground[s]);
                noise_m(1, s, band) = lower_quartile(near[s]);
                noise_m(2, s, band) = lower_quartile(all[s]);
            }
        }
    });
}

namespace {

// Write the median of three columns from each on, +inf for too few returns, and whether all that returned is ground.
MULTIVERSION void find_ground_medians(const float* range_m, const float* height_m, std::size_t columns, float* median_m,
                                      std::uint8_t* ground) {
    for (std::size_t c = 0; c < columns; ++c) {
        median_m[c] = median_of_three(range_m[c], range_m[c + 1], range_m[c + 2]);
        // No height, of no return, is no obstacle.
        const bool off = (std::fabs(height_m[c]) >= GROUND_M) | (std::fabs(height_m[c + 1]) >= GROUND_M) |
                         (std::fabs(height_m[c + 2]) >= GROUND_M);
        ground[c] = !off & (median_m[c] < GROUND_RANGE_M);
    }
}

// The first of the columns before one whose median stands to its left.
INLINE std::size_t left_of(std::size_t c, std::size_t columns) {
    return (c + MEDIAN_COLUMNS * columns - MEDIAN_COLUMNS) % columns;
}

// Whether a ring returned on both sides, and is ground on one.
INLINE bool is_jump(float left_m, float right_m, std::uint8_t is_ground) {
    return (is_ground != 0) & (left_m < NONE) & (right_m < NONE);
}

// Add a ring to the jumps between columns: whether there is one (columns,), and whether it goes clearly up or down.
MULTIVERSION void add_jumps(const float* left_m, const float* right_m, const std::uint8_t* left_ground,
                            const std::uint8_t* right_ground, std::size_t count, std::uint16_t* rings, std::uint16_t* up,
                            std::uint16_t* down) {
    for (std::size_t c = 0; c < count; ++c) {
        const bool jumps = is_jump(left_m[c], right_m[c], left_ground[c] | right_ground[c]);
        rings[c] = std::uint16_t(rings[c] + jumps);
        up[c] = std::uint16_t(up[c] + (jumps & (right_m[c] > left_m[c] + STEP_SPREAD_M)));
        down[c] = std::uint16_t(down[c] + (jumps & (left_m[c] > right_m[c] + STEP_SPREAD_M)));
    }
}

// The same for a whole ring: the first columns have theirs to the left at its end.
void count_jumps(const float* median_m, const std::uint8_t* ground, std::size_t columns, std::uint16_t* rings,
                 std::uint16_t* up, std::uint16_t* down) {
    const std::size_t first = std::min(MEDIAN_COLUMNS, columns);
    for (std::size_t c = 0; c < first; ++c) {
        const std::size_t left = left_of(c, columns);
        add_jumps(median_m + left, median_m + c, ground + left, ground + c, 1, rings + c, up + c, down + c);
    }
    if (columns <= MEDIAN_COLUMNS) return;
    add_jumps(median_m, median_m + MEDIAN_COLUMNS, ground, ground + MEDIAN_COLUMNS, columns - MEDIAN_COLUMNS,
              rings + MEDIAN_COLUMNS, up + MEDIAN_COLUMNS, down + MEDIAN_COLUMNS);
}

// A ring, closed around the circle: its first columns once more at its end.
void close_ring(const float* row, std::size_t columns, Buffer<float>& closed) {
    std::copy_n(row, columns, closed.begin());
    for (std::size_t k = 0; k + 1 < MEDIAN_COLUMNS; ++k) closed[columns + k] = row[k % columns];
}

}  // namespace

void measure_steps(const Image& image, View2<const float> height_m, View1<float> steps) {
    const auto& range_m = image.range_m;
    const std::size_t rings = range_m.rows, columns = range_m.columns;
    // 1. Medians of three columns, and whether they are ground.
    Buffer<float> median_m(range_m.size());
    Buffer<std::uint8_t> ground(range_m.size());
    for_ranges(rings, count_parts(range_m.size(), PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        Buffer<float> row(columns + MEDIAN_COLUMNS), heights(columns + MEDIAN_COLUMNS);
        for (std::size_t r = begin; r < end; ++r) {
            close_ring(range_m[r], columns, row);
            close_ring(height_m[r], columns, heights);
            find_ground_medians(row.data(), heights.data(), columns, &median_m[r * columns], &ground[r * columns]);
        }
    });
    // 2. Between each two columns: how many rings that are ground on one side at least jump clearly, up and down.
    std::vector<std::uint16_t> rings_of(columns, 0), up(columns, 0), down(columns, 0);
    for (std::size_t r = 0; r < rings; ++r) {
        const std::size_t at = r * columns;
        count_jumps(&median_m[at], &ground[at], columns, rings_of.data(), up.data(), down.data());
    }
    // 3. Where most of them do: the median of their jumps, and how far they differ.
    Buffer<float> step(columns, 0.0f);
    std::vector<float> jumps;
    for (std::size_t c = 0; c < columns; ++c) {
        if (rings_of[c] < LEAST_RINGS || 2 * std::max(up[c], down[c]) < rings_of[c]) continue;
        const std::size_t left = left_of(c, columns);
        jumps.clear();
        for (std::size_t r = 0; r < rings; ++r) {
            const std::size_t a = r * columns + left, b = r * columns + c;
            if (is_jump(median_m[a], median_m[b], ground[a] | ground[b])) jumps.push_back(median_m[b] - median_m[a]);
        }
        const float common = median(jumps);
        for (float& jump : jumps) jump = std::fabs(jump - common);
        step[c] = std::fabs(common) / (NORMAL * median(jumps) + STEP_SPREAD_M);
    }
    std::fill(steps.begin(), steps.end(), 0.0f);
    for (std::size_t c = 0; c < columns; ++c) {
        float& most = steps[std::size_t(image.sector[c])];
        most = std::max(most, step[c]);
    }
}

void measure_breaks(const Image& image, View1<float> breaks) {
    const auto& range_m = image.range_m;
    const std::size_t columns = range_m.columns;
    // Rings that return on both sides of a column's beginning, and those of them that jump.
    std::vector<std::int32_t> both(columns, 0), broken(columns, 0);
    for (std::size_t r = 0; r < range_m.rows; ++r) {
        const float* row = range_m[r];
        for (std::size_t c = 0; c < columns; ++c) {
            const float left = row[before(c, columns)], right = row[c];
            const bool returned = (left < NONE) & (right < NONE);
            both[c] += returned;
            broken[c] += returned & (is_behind(left, right) | is_behind(right, left));
        }
    }
    std::fill(breaks.begin(), breaks.end(), 0.0f);
    for (std::size_t c = 0; c < columns; ++c) {
        if (both[c] < LEAST_BROKEN) continue;
        float& most = breaks[std::size_t(image.sector[c])];
        most = std::max(most, float(broken[c]) / float(both[c] + FEW_BROKEN));
    }
}

void measure_empty_runs(const Image& image, View1<float> runs) {
    const auto& range_m = image.range_m;
    const std::size_t columns = range_m.columns;
    // 1. How many of the rings that usually return are silent in each column.
    std::vector<std::int32_t> silent(columns, 0);
    std::int32_t usual = 0;
    for (std::size_t r = 0; r < range_m.rows; ++r) {
        const float* row = range_m[r];
        const auto returned = std::count_if(row, row + columns, [](float here) { return here < NONE; });
        if (double(returned) < USUAL_SHARE * double(columns)) continue;
        ++usual;
        for (std::size_t c = 0; c < columns; ++c) silent[c] += !(row[c] < NONE);
    }
    std::fill(runs.begin(), runs.end(), usual > 0 ? 0.0f : NO_NUMBER);
    if (usual == 0) return;
    // 2. Runs of empty columns around the circle, from after a column that is not.
    const auto is_empty = [&](std::size_t c) { return 2 * silent[c] > usual; };
    std::size_t first = 0;
    while (first < columns && is_empty(first)) ++first;
    std::size_t length = 0;
    for (std::size_t k = 1; k <= columns; ++k) {
        if (is_empty((first + k) % columns)) {
            ++length;
            continue;
        }
        const float run = float(double(length) * 2 * double(PI) / double(columns));
        for (; length > 0; --length) {
            float& longest = runs[std::size_t(image.sector[(first + k - length) % columns])];
            longest = std::max(longest, run);
        }
    }
}

namespace {

// Write one over the horizontal distance of each point of a block, and its squared range.
MULTIVERSION void measure_reach(const float* points, std::size_t count, float* per_flat, float* squared_m2) {
    for (std::size_t k = 0; k < count; ++k) {
        const float x = points[3 * k], y = points[3 * k + 1], z = points[3 * k + 2], flat2 = x * x + y * y;
        squared_m2[k] = flat2 + z * z;
        per_flat[k] = 1.0f / std::sqrt(flat2 + 1e-6f);
    }
}

// The slope of each ring (rings,) and how far a return may be off it, +inf for too few returns.
struct RingSlopes {
    std::vector<float> middle, tolerance;
};

// By the median and the median deviation of the slopes (M,) of returns on rings (M,), spread evenly.
RingSlopes measure_rings(const Buffer<float>& slope, const Buffer<std::int16_t>& ring, std::size_t rings) {
    std::vector<std::uint32_t> size(rings, 0), wait(rings, 0);
    for (const std::int16_t r : View1<const std::int16_t>(ring)) {
        if (r >= 0) ++size[std::size_t(r)];
    }
    std::vector<std::vector<float>> sample(rings);
    for (std::size_t m = 0; m < slope.size(); ++m) {
        if (ring[m] < 0) continue;
        const auto r = std::size_t(ring[m]);
        if (wait[r]-- > 0) continue;
        wait[r] = size[r] / std::uint32_t(ELEVATION_SAMPLES);
        sample[r].push_back(slope[m]);
    }
    RingSlopes slopes{std::vector<float>(rings, 0.0f), std::vector<float>(rings, NONE)};
    for (std::size_t r = 0; r < rings; ++r) {
        if (sample[r].size() < LEAST_SAMPLES) continue;
        slopes.middle[r] = median(sample[r]);
        for (float& s : sample[r]) s = std::fabs(s - slopes.middle[r]);
        slopes.tolerance[r] = OFF_DEVIATIONS * median(sample[r]) + OFF_SLOPE;
    }
    return slopes;
}

}  // namespace

void find_off_beam(View2<const float> points, View1<const std::int16_t> ring, View1<const std::int32_t> column,
                   View1<const double> origin_m, View1<const std::int32_t> rows, std::size_t columns,
                   View1<bool> off_beam) {
    const std::size_t rings = origin_m.size;
    // 1. The slope of each leveled return, its squared range and its ring, -1 without a pixel.
    Buffer<float> per_flat(points.rows), squared(points.rows), slope(rows.size);
    for (std::size_t start = 0; start < points.rows; start += BLOCK) {
        measure_reach(points[start], std::min(BLOCK, points.rows - start), &per_flat[start], &squared[start]);
    }
    Buffer<std::int16_t> ring_of(rows.size);
    const std::vector<float> origin(origin_m.begin(), origin_m.end());
    for (std::size_t m = 0; m < rows.size; ++m) {
        const auto n = std::size_t(rows[m]);
        const std::int16_t r = column[n] < 0 ? std::int16_t(-1) : ring[n];
        ring_of[m] = r;
        slope[m] = r < 0 ? 0.0f : (points(n, 2) - origin[std::size_t(r)]) * per_flat[n];
    }
    // 2. The slope of each ring; which returns are off it.
    const RingSlopes slopes = measure_rings(slope, ring_of, rings);
    bool some = false;
    for (std::size_t m = 0; m < rows.size; ++m) {
        off_beam[m] = ring_of[m] >= 0 && std::fabs(slope[m] - slopes.middle[std::size_t(ring_of[m])]) >
                                             slopes.tolerance[std::size_t(ring_of[m])];
        some |= off_beam[m];
    }
    if (!some) return;
    // 3. How far off each pixel is, and its squared range.
    Buffer<float> off(rings * columns), squared_m2(rings * columns);
    std::fill(squared_m2.begin(), squared_m2.end(), NONE);
    for (std::size_t m = 0; m < rows.size; ++m) {
        if (ring_of[m] < 0) continue;
        const auto n = std::size_t(rows[m]), r = std::size_t(ring_of[m]), pixel = r * columns + std::size_t(column[n]);
        off[pixel] = slope[m] - slopes.middle[r];
        squared_m2[pixel] = squared[n];
    }
    // 4. Of these, the returns that no neighbor confirms: where the sensor moved, neighbors are off alike.
    const auto is_confirmed = [&](std::size_t r, std::int32_t c, float here_m2, float mine) {
        const float apart = std::max(CONFIRMING_SLOPE, CONFIRMING_SHARE * std::fabs(mine));
        for (int k = -CONFIRMING_COLUMNS; k <= CONFIRMING_COLUMNS; ++k) {
            if (k == 0) continue;
            const auto at = std::size_t(((c + k) % int(columns) + int(columns)) % int(columns));
            for (std::size_t p = r > 0 ? r - 1 : 0; p < std::min(r + 2, rings); ++p) {
                const std::size_t pixel = p * columns + at;
                const bool is_near = are_alike(squared_m2[pixel], here_m2, CONFIRMING_RATIO * CONFIRMING_RATIO);
                if (is_near && std::fabs(off[pixel] - mine) < apart) return true;
            }
        }
        return false;
    };
    for (std::size_t m = 0; m < rows.size; ++m) {
        if (!off_beam[m]) continue;
        const auto n = std::size_t(rows[m]), r = std::size_t(ring_of[m]);
        off_beam[m] = !is_confirmed(r, column[n], squared[n], slope[m] - slopes.middle[r]);
    }
}

void measure_range_offset(View2<const float> points, float sensor_height_m, View1<float> offset_m) {
    // 1. Samples of what may be ground: distance x, height z, and the descent q of its beam a meter.
    struct Ground {
        float x, z, q;
        std::size_t sector;
    };
    std::vector<Ground> grounds;
    const float h = sensor_height_m;
    for (std::size_t m = 0; m < points.rows; m += points.rows / OFFSET_SAMPLES + 1) {
        const float* p = points[m];
        const float x = std::sqrt(p[0] * p[0] + p[1] * p[1]), z = p[2];
        if (!(x < OFFSET_HEIGHTS * h && z > -BELOW_SLOPE * x - BELOW_M && z < ABOVE_SLOPE * x + ABOVE_M)) continue;
        const float q = (h - z) / std::max(std::sqrt(x * x + (h - z) * (h - z)), 1e-3f);
        grounds.push_back({x, z, q, sector_of(azimuth_of(p[1], p[0]), offset_m.size)});
    }
    // 2. z = slope · x - offset · q by least squares in each sector; returns far from the fit count less each round.
    struct Fit {
        double xx, xq, qq, xz, qz, slope, drop, count;
    };
    std::vector<Fit> fits(offset_m.size, Fit{});
    for (int round = 0; round < OFFSET_ROUNDS; ++round) {
        std::vector<Fit> sums(offset_m.size, Fit{});
        for (const Ground& g : grounds) {
            const Fit& fit = fits[g.sector];
            const double apart = (double(g.z) - fit.slope * double(g.x) - fit.drop * double(g.q)) / OFFSET_SCALE_M;
            const double weight = round == 0 ? 1.0 : 1.0 / (1.0 + apart * apart);
            const double x = double(g.x), q = double(g.q), z = double(g.z);
            Fit& sum = sums[g.sector];
            sum.xx += weight * x * x, sum.xq += weight * x * q, sum.qq += weight * q * q;
            sum.xz += weight * x * z, sum.qz += weight * q * z;
            sum.count += 1.0;
        }
        for (Fit& sum : sums) {
            const double determinant = sum.xx * sum.qq - sum.xq * sum.xq;
            if (sum.count < LEAST_OFFSET_RETURNS || determinant < LEAST_DETERMINANT) {
                sum.count = 0.0;
                continue;
            }
            sum.slope = (sum.xz * sum.qq - sum.qz * sum.xq) / determinant;
            sum.drop = (sum.xx * sum.qz - sum.xq * sum.xz) / determinant;
        }
        fits = std::move(sums);
    }
    for (std::size_t s = 0; s < offset_m.size; ++s) offset_m[s] = fits[s].count > 0.0 ? float(-fits[s].drop) : NO_NUMBER;
}

}  // namespace viewshed
