#include "sensor_motion.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "parallel.hpp"
#include "random_rows.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Longest tested displacement in one revolution: 35 m/s at 10 Hz.
constexpr double FARTHEST_M = 3.5;

// Tested azimuths at which a revolution begins and ends, ...
constexpr std::array<double, 4> SEAMS{-std::numbers::pi, std::numbers::pi / 2, 0.0, -std::numbers::pi / 2};

// ... and tested fractions of the turn, counter-clockwise, at which the sensor was at the origin.
constexpr std::array<double, 3> REFERENCES{0.5, 0.0, 1.0};

// Coarse search grid: steps of this size, forward and backward along this number of headings.
constexpr double STEP_M = 0.4;
constexpr int HEADINGS = 8;

// A pitched sensor moves up or down in its own frame: also test this share of the displacement as climb.
constexpr double CLIMB = 0.1;

// Refinement halves the steps down to this size; vertical steps are a quarter.
constexpr double FINEST_M = 0.004, RISE = 0.25;
constexpr int IMPROVEMENTS = 4;

// Sample sizes of the coarse search and of the refinement; fewest returns that determine a motion.
constexpr std::size_t FEW = 384, SAMPLE = 2048, FEWEST_RETURNS = 256;

// Nearer returns are ignored: the azimuth at which they were measured differs from that of the point.
constexpr float NEAREST_M = 2.0f;

// Bin widths of the elevation histogram, in the sine: for steps above 10 cm, above 5 cm, and below.
constexpr double DEGREE = std::numbers::pi / 180;
constexpr double COARSE_BIN = 0.2 * DEGREE, FINE_BIN = 0.1 * DEGREE, FINEST_BIN = 0.03 * DEGREE;
constexpr double COARSE_STEP_M = 0.1, FINE_STEP_M = 0.05;

// Sharpness: concentration in the finest bins relative to the widest ones; 1 is sharp, about 0.15 is smooth. A motion
// above SHARP is accepted at once. If all motions of the first seam are below SMOOTH, there are no rings, or the points
// are in another frame.
constexpr double SHARP = 0.8, SMOOTH = 0.26;

// Fixed-point iterations between the azimuth at which a point was measured and the sensor's position at that time.
constexpr int ITERATIONS = 3;

constexpr std::size_t PART = 16384;

using Vector = std::array<double, 3>;

// Return the fraction of a turn from the sensor at the origin to an azimuth.
INLINE float turn_at(float azimuth, float seam, float reference) {
    const float part = (azimuth - seam) * float(0.5 / std::numbers::pi);
    return part - std::floor(part) - reference;
}

// Write the fraction of the turn at which points were measured, by their azimuth, and then their measured x and y.
MULTIVERSION void step_back(const float* x, const float* y, std::size_t count, const float* shift_m, float seam,
                            float reference, float* u, float* v, float* turn) {
    for (std::size_t k = 0; k < count; ++k) {
        const float part = turn_at(azimuth_of(v[k], u[k]), seam, reference);
        turn[k] = part;
        u[k] = x[k] - part * shift_m[0];
        v[k] = y[k] - part * shift_m[1];
    }
}

// Sampled returns, and the fraction of the turn at which each was measured.
struct Returns {
    std::vector<float> x, y, z, turn;
};

// Write the histogram bin of the sine of each elevation with a motion undone.
MULTIVERSION void place_elevations(const float* x, const float* y, const float* z, const float* turn, std::size_t count,
                                   const float* shift_m, float half, float last, std::int32_t* position) {
    const float dx = shift_m[0], dy = shift_m[1], dz = shift_m[2];
    for (std::size_t k = 0; k < count; ++k) {
        const float u = x[k] - turn[k] * dx, v = y[k] - turn[k] * dy, w = z[k] - turn[k] * dz;
        const float at = (w / std::sqrt(u * u + v * v + w * w) + 1.0f) * half;
        // Clamp to the histogram, even after underflow.
        const float inside = at > 0.0f ? at : 0.0f;
        position[k] = std::int32_t(inside < last ? inside : last);
    }
}

// Return the concentration of the elevations of the first `count` returns with a motion undone: the histogram's sum of
// squares.
std::int64_t concentration(const Returns& returns, std::size_t count, const Vector& shift_m, double bin_sine) {
    constexpr auto MAX_BINS = std::size_t(2.0 / FINEST_BIN) + 1;
    const auto bins = std::size_t(2.0 / bin_sine) + 1;
    const std::array<float, 3> shift{float(shift_m[0]), float(shift_m[1]), float(shift_m[2])};
    std::int32_t position[SAMPLE];
    place_elevations(returns.x.data(), returns.y.data(), returns.z.data(), returns.turn.data(), count, shift.data(),
                     float(0.5 * double(bins - 1)), float(bins - 1), position);
    std::uint16_t counts[MAX_BINS];
    std::fill_n(counts, bins, std::uint16_t{0});
    std::int64_t squares = 0;
    for (std::size_t k = 0; k < count; ++k) squares += 2 * counts[position[k]]++ + 1;  // (n + 1)² - n²
    return squares;
}

// The best displacement, and its concentration in the finest and in the widest bins.
struct BestShift {
    Vector shift_m;
    std::int64_t gathered, widely;
};

BestShift search(const Returns& returns) {
    // 1. Coarse search on a few of the returns.
    const std::size_t count = returns.x.size();
    const std::size_t few = std::min(FEW, count);
    Vector shift_m{};
    std::int64_t best = concentration(returns, few, shift_m, COARSE_BIN);
    constexpr int STEPS = int(FARTHEST_M / STEP_M);
    for (int heading = 0; heading < HEADINGS; ++heading) {
        const double angle = heading * std::numbers::pi / HEADINGS;
        for (int k = -STEPS; k <= STEPS; ++k) {
            for (int climb = -1; climb <= 1; ++climb) {
                const Vector candidate{k * STEP_M * std::cos(angle), k * STEP_M * std::sin(angle), k * STEP_M * climb * CLIMB};
                const std::int64_t gathered = concentration(returns, few, candidate, COARSE_BIN);
                if (gathered > best) {
                    best = gathered;
                    shift_m = candidate;
                }
            }
        }
    }
    // 2. Coordinate search on all of them, with ever smaller steps and bins.
    for (double step = STEP_M / 2; step > FINEST_M; step /= 2) {
        const double bin_sine = step > COARSE_STEP_M ? COARSE_BIN : step > FINE_STEP_M ? FINE_BIN : FINEST_BIN;
        best = concentration(returns, count, shift_m, bin_sine);
        for (int time = 0; time < IMPROVEMENTS; ++time) {
            const std::int64_t before = best;
            for (std::size_t k = 0; k < 6; ++k) {
                Vector candidate = shift_m;
                candidate[k / 2] += (k % 2 ? step : -step) * (k / 2 == 2 ? RISE : 1.0);
                const std::int64_t gathered = concentration(returns, count, candidate, bin_sine);
                if (gathered > best) {
                    best = gathered;
                    shift_m = candidate;
                }
            }
            if (best == before) break;
        }
    }
    return {shift_m, best, concentration(returns, count, shift_m, COARSE_BIN)};
}

// Return a random sample of the returns beyond 2 m.
Returns sample_of(View2<const float> points) {
    Returns returns;
    for (const std::uint32_t row : random_rows(points.rows, 2 * SAMPLE)) {
        const float x = points(row, 0), y = points(row, 1);
        if (!(x * x + y * y > NEAREST_M * NEAREST_M)) continue;
        returns.x.push_back(x);
        returns.y.push_back(y);
        returns.z.push_back(points(row, 2));
        if (returns.x.size() == SAMPLE) break;
    }
    return returns;
}

}  // namespace

std::optional<SensorMotion> find_motion(View2<const float> points) {
    if (points.rows < FEWEST_RETURNS) return std::nullopt;
    const Returns sample = sample_of(points);
    if (sample.x.size() < FEWEST_RETURNS) return std::nullopt;
    std::vector<float> azimuth(sample.x.size());
    for (std::size_t k = 0; k < azimuth.size(); ++k) azimuth[k] = std::atan2(sample.y[k], sample.x[k]);
    std::optional<SensorMotion> best;
    std::int64_t most = 0;
    double sharpest = 0.0;
    for (const double seam : SEAMS) {
        // Search all references in parallel; among equal results the first counts.
        std::array<BestShift, REFERENCES.size()> found;
        for_ranges(found.size(), std::min(found.size(), threads()), [&](std::size_t, std::size_t begin, std::size_t end) {
            for (std::size_t k = begin; k < end; ++k) {
                Returns returns = sample;
                for (const float a : azimuth) returns.turn.push_back(turn_at(a, float(seam), float(REFERENCES[k])));
                found[k] = search(returns);
            }
        });
        for (std::size_t k = 0; k < found.size(); ++k) {
            sharpest = std::max(sharpest, double(found[k].gathered) / double(found[k].widely));
            if (found[k].gathered > most) {
                best = SensorMotion{found[k].shift_m, seam, REFERENCES[k]};
                most = found[k].gathered;
            }
            if (sharpest > SHARP) return best;
        }
        if (sharpest < SMOOTH) return std::nullopt;
    }
    return best;
}

void undo_motion(View2<const float> points, const SensorMotion& motion, View2<float> measured) {
    const std::array<float, 3> shift_m{float(motion.shift_m[0]), float(motion.shift_m[1]), float(motion.shift_m[2])};
    for_ranges(points.rows, count_parts(points.rows, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        float x[BLOCK], y[BLOCK], u[BLOCK], v[BLOCK], turn[BLOCK];
        for (std::size_t start = begin; start < end; start += BLOCK) {
            const std::size_t size = std::min(BLOCK, end - start);
            for (std::size_t k = 0; k < size; ++k) {
                u[k] = x[k] = points(start + k, 0);
                v[k] = y[k] = points(start + k, 1);
            }
            for (int time = 0; time < ITERATIONS; ++time) {
                step_back(x, y, size, shift_m.data(), float(motion.seam), float(motion.reference), u, v, turn);
            }
            for (std::size_t k = 0; k < size; ++k) {
                measured(start + k, 0) = u[k];
                measured(start + k, 1) = v[k];
                measured(start + k, 2) = points(start + k, 2) - turn[k] * shift_m[2];
            }
        }
    });
}

}  // namespace viewshed
