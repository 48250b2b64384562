#include "temporal_evidence.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "parallel.hpp"
#include "sweep_views.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr float UNKNOWN_VALUE = std::numeric_limits<float>::quiet_NaN();

// Fewest obstacles for which a part pays for its thread.
constexpr std::size_t PART = 1000;

// Obstacles farther than this are ignored: too few beams hit them.
constexpr float FARTHEST_M = 45.0f;

// The speed of a sector is that of its return of this rank, counted from the fastest.
constexpr std::size_t RANK = 6;

// Fewest obstacles of a sector for a meaningful median.
constexpr std::size_t MIN_OBSTACLES = 10;

// A surface jumps as a whole: its returns must spread less than this.
constexpr float MAX_SPREAD_M = 0.3f;

// Range changes of neighboring beams that are equal up to rounding, and that noise produces about uniformly;
// EQUAL_OF_NOISE is the resulting share below EQUAL_M relative to the rest.
constexpr float EQUAL_M = 0.00075f, NOISE_M = 0.00975f;
constexpr float EQUAL_OF_NOISE = 0.25f;
constexpr int MIN_PAIRS = 60;

// Registration: most returns used; gate distance from the surface in each round.
constexpr std::size_t MAX_REGISTERED = 600;
constexpr std::array<float, 4> GATES_M{2.0f, 1.2f, 0.7f, 0.4f};
constexpr int BASE_COLUMNS = 3;
constexpr float MIN_BASE_M = 0.04f, MAX_BEND_M = 0.08f, MATCH_M = 2.5f;

// Follow an obstacle through other sweeps, the nearest in time first, while they see it in place. The first sweep that
// sees free space there gives the speed from (or to) the nearest cover; 0 if none does.
float follow(Point3 p, const std::vector<Other>& others) {
    for (const Other& other : others) {
        const Point3 there = other.transform(p);
        const Seen seen = other.view->look_at(there);
        if (seen == Seen::FREE) return other.view->distance_to_cover(there) / other.gap_s;
        if (seen != Seen::OCCUPIED) return 0.0f;
    }
    return 0.0f;
}

}  // namespace

void follow_all(const SweepView& view, const std::vector<Other>& others, const SweepView& around,
                const Transform& around_from_view, View1<float> speed_mps) {
    // 1. Find the sector and required speed of each obstacle.
    const std::vector<Point3>& obstacles = view.obstacles();
    const int sectors = int(speed_mps.size);
    std::vector<std::pair<int, float>> followed(obstacles.size(), {0, 0.0f});
    for_ranges(obstacles.size(), count_parts(obstacles.size(), PART),
               [&](std::size_t, std::size_t begin, std::size_t end) {
                   for (std::size_t k = begin; k < end; ++k) {
                       const Point3 p = obstacles[k];
                       if (p.x * p.x + p.y * p.y > FARTHEST_M * FARTHEST_M) continue;
                       const float speed = follow(p, others);
                       // The sweep itself must see it in place too: returns off their beams cannot be looked up.
                       if (speed <= 0.0f || view.look_at(p) != Seen::OCCUPIED) continue;
                       followed[k] = {around.sector_of(around_from_view(p), sectors), speed};
                   }
               });
    // 2. Take the ranked speed of each sector.
    std::vector<std::vector<float>> speeds(speed_mps.size);
    for (const auto& [sector, speed] : followed) {
        if (speed > 0.0f) speeds[std::size_t(sector)].push_back(speed);
    }
    for (std::size_t s = 0; s < speed_mps.size; ++s) {
        std::vector<float>& of_sector = speeds[s];
        speed_mps[s] = 0.0f;
        if (of_sector.size() >= RANK) {
            std::nth_element(of_sector.begin(), of_sector.end() - RANK, of_sector.end());
            speed_mps[s] = *(of_sector.end() - RANK);
        }
    }
}

namespace {

float median_of(std::vector<float>& values) {
    const auto middle = values.begin() + std::ptrdiff_t(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
}

}  // namespace

void jumps(const SweepView& view, const Other& last, const Other& second, float ratio, View1<float> jump_m) {
    std::vector<std::vector<float>> differences(jump_m.size);
    for (const Point3 p : view.obstacles()) {
        if (p.x * p.x + p.y * p.y > FARTHEST_M * FARTHEST_M) continue;
        const float one = last.view->range_difference(last.transform(p));
        const float two = second.view->range_difference(second.transform(p));
        if (std::isnan(one) || std::isnan(two)) continue;
        differences[std::size_t(view.sector_of(p, int(jump_m.size)))].push_back(two - ratio * one);
    }
    for (std::size_t s = 0; s < jump_m.size; ++s) {
        std::vector<float>& of_sector = differences[s];
        jump_m[s] = 0.0f;
        if (of_sector.size() < MIN_OBSTACLES) continue;
        const float jump = median_of(of_sector);
        for (float& difference : of_sector) difference = std::fabs(difference - jump);
        if (median_of(of_sector) < MAX_SPREAD_M) jump_m[s] = std::fabs(jump);
    }
}

namespace {

// Count in each sector pairs of neighboring beams, those whose ranges changed by the same amount, and by about the same
// amount, as the noise of a new measurement makes them.
void count_repeats(const SweepView& view, const SweepView& other, std::vector<std::array<int, 3>>& counts) {
    const int sectors = int(counts.size());
    for (std::size_t r = 0; r < view.rings(); ++r) {
        const float *now = view.ring(r), *then = other.ring(r);
        for (int s = 0; s < sectors; ++s) {
            const std::size_t begin = view.columns() * std::size_t(s) / std::size_t(sectors);
            const std::size_t end = view.columns() * std::size_t(s + 1) / std::size_t(sectors);
            int pairs = 0, equal = 0, noise = 0;
            // Differences with an empty pixel are NaN and compare as false.
            for (std::size_t c = std::max(begin, std::size_t{1}); c < end; ++c) {
                const float change = std::fabs((now[c] - then[c]) - (now[c - 1] - then[c - 1]));
                pairs += change < 1e6f;
                equal += change < EQUAL_M;
                noise += change < NOISE_M;
            }
            counts[std::size_t(s)][0] += pairs;
            counts[std::size_t(s)][1] += equal;
            counts[std::size_t(s)][2] += noise;
        }
    }
}

}  // namespace

void find_repeats(const SweepView& view, const SweepView& other, View1<float> share) {
    std::vector<std::array<int, 3>> counts(share.size);
    count_repeats(view, other, counts);
    for (std::size_t s = 0; s < share.size; ++s) {
        const auto [pairs, equal, noise] = counts[s];
        const float excess = float(equal) - EQUAL_OF_NOISE * float(noise - equal);
        share[s] = pairs >= MIN_PAIRS ? excess / float(pairs) : UNKNOWN_VALUE;
    }
}

namespace {

// Neighboring beams to each side in which a range is searched, and the change of range by the sensor's motion.
constexpr int BESIDE = 3;
constexpr float MOVED_M = 0.6f, MOVED_SHARE = 0.1f;
constexpr int MIN_IN_SECTOR = 20;

// Passing objects cover and uncover many beams from sweep to sweep: they may have moved this far across them.
constexpr float PASSED_M = 1.5f;

// Nearer surfaces fall silent as they come closer, and fill too many beams.
constexpr float MIN_SILENCED_M = 2.0f;

// Wrap a column from [-columns, 2 columns) into [0, columns).
int wrapped(int column, int columns) { return column < 0 ? column + columns : column < columns ? column : column - columns; }

// Check if a surface at this range was seen by beams around a column, as far aside as it may have moved; for a return
// that is farther than before, if any of them saw that far.
bool was_beside(const float* ring, int columns, int column, float range_m, float moved_m, bool is_near) {
    const float column_rad = 2 * PI / float(columns);
    for (int side = -1; side <= 1; side += 2) {
        // An object that uncovers a beam is as near as its neighbors, so their range gives the reach.
        for (int b = BESIDE + 1; b < columns / 4; ++b) {
            const float other_m = ring[wrapped(column + side * b, columns)];
            const float reach_m = std::min(range_m, other_m) * float(b) * column_rad;
            if (reach_m > PASSED_M) break;
            if (other_m < 1e6f && (is_near ? std::fabs(other_m - range_m) <= moved_m : other_m >= range_m - moved_m)) {
                return true;
            }
        }
    }
    return false;
}

}  // namespace

void find_new_ranges(const SweepView& view, const std::vector<const SweepView*>& others,
                     const std::vector<float>& turned_columns, View1<float> nearer, View1<float> farther, View1<float> silent) {
    const auto columns = int(view.columns()), sectors = int(nearer.size);
    // Precompute wrapped rotations and the sector of each column: divisions would dominate.
    std::vector<int> turned, sector_of(view.columns());
    for (const float of_other : turned_columns) turned.push_back((int(std::lround(of_other)) % columns + columns) % columns);
    for (int c = 0; c < columns; ++c) sector_of[std::size_t(c)] = c * sectors / columns;
    std::vector<int> returns(nearer.size, 0), near(nearer.size, 0), far(nearer.size, 0);
    std::vector<int> steady(nearer.size, 0), lost(nearer.size, 0);
    std::vector<const float*> then(others.size());
    for (std::size_t r = 0; r < view.rings(); ++r) {
        const float* now = view.ring(r);
        for (std::size_t k = 0; k < then.size(); ++k) then[k] = others[k]->ring(r);
        // Call look(range) for beams around a column in the other sweeps, the center first, until it returns true.
        const auto look_about = [&](int c, const auto& look) {
            for (int side = 0; side <= BESIDE; ++side) {
                for (std::size_t k = 0; k < then.size(); ++k) {
                    const int middle = wrapped(c + turned[k], columns);
                    if (look(then[k][wrapped(middle + side, columns)])) return;
                    if (side > 0 && look(then[k][wrapped(middle - side, columns)])) return;
                }
            }
        };
        for (int c = 0; c < columns; ++c) {
            const float range_m = now[c], moved_m = MOVED_M + MOVED_SHARE * range_m;
            const auto s = std::size_t(sector_of[std::size_t(c)]);
            // 1. A beam without a return: did all beams around it return before?
            if (!(range_m < 1e6f)) {
                bool is_steady = true;
                look_about(c, [&](float other_m) {
                    is_steady = other_m < 1e6f && other_m > MIN_SILENCED_M;
                    return !is_steady;
                });
                steady[s] += is_steady;
                lost[s] += is_steady;
                continue;
            }
            // 2. A return: does a beam around it have a similar range, or are all of them nearer, or all farther?
            bool is_known = false, is_near = true, is_far = true;
            int seen = 0;
            look_about(c, [&](float other_m) {
                if (!(other_m < 1e6f)) return false;
                ++seen;
                is_near &= other_m > range_m;
                is_far &= other_m < range_m;
                is_known = std::fabs(other_m - range_m) <= moved_m;
                return is_known;
            });
            // 3. It, or the object that hid it, may also have passed by.
            if (!is_known && seen > 0 && is_near != is_far) {
                for (std::size_t k = 0; k < then.size() && !is_known; ++k) {
                    is_known = was_beside(then[k], columns, wrapped(c + turned[k], columns), range_m, moved_m, is_near);
                }
            }
            ++returns[s];
            ++steady[s];
            near[s] += !is_known && seen > 0 && is_near;
            far[s] += !is_known && seen > 0 && is_far;
        }
    }
    const auto share = [](int count, int of) { return of >= MIN_IN_SECTOR ? float(count) / float(of) : 0.0f; };
    for (std::size_t s = 0; s < nearer.size; ++s) {
        nearer[s] = share(near[s], returns[s]);
        farther[s] = share(far[s], returns[s]);
        silent[s] = share(lost[s], steady[s]);
    }
}

// Shifts this close belong to one peak: surfaces are wider than a cell.
constexpr int BESIDE_CELLS = 2;

Shift best_shift(View2<const std::uint8_t> now, View2<const std::uint8_t> before, int most) {
    const int cells = int(now.rows), window = 2 * most + 1;
    const auto around = [cells](int k) { return std::size_t((k % cells + cells) % cells); };
    // 1. Pad the present cells by the largest shift, so that sums need not wrap around.
    const std::size_t width = std::size_t(cells + 2 * most);
    std::vector<std::uint8_t> wide(width * width);
    for (std::size_t i = 0; i < width; ++i) {
        const std::uint8_t* row = now[around(int(i) - most)];
        for (std::size_t j = 0; j < width; ++j) wide[i * width + j] = row[around(int(j) - most)];
    }
    // 2. Each earlier cell votes for all shifts that move a present cell onto it.
    std::vector<std::uint32_t> votes(std::size_t(window * window), 0);
    for (int i = 0; i < cells; ++i) {
        for (int j = 0; j < cells; ++j) {
            if (!before[std::size_t(i)][j]) continue;
            for (int down = 0; down < window; ++down) {
                const std::uint8_t* row = &wide[std::size_t(i + down) * width + std::size_t(j)];
                std::uint32_t* of_row = &votes[std::size_t(down * window)];
                for (int across = 0; across < window; ++across) of_row[across] += row[across];
            }
        }
    }
    // 3. Find the best shift, and the best one that is not beside it.
    const int best = int(std::max_element(votes.begin(), votes.end()) - votes.begin()), down = best / window, across = best % window;
    std::uint32_t elsewhere = 0;
    for (int i = 0; i < window; ++i) {
        for (int j = 0; j < window; ++j) {
            const bool is_beside = std::abs(i - down) <= BESIDE_CELLS && std::abs(j - across) <= BESIDE_CELLS;
            if (!is_beside) elsewhere = std::max(elsewhere, votes[std::size_t(i * window + j)]);
        }
    }
    return {down - most, across - most, votes[std::size_t(best)], elsewhere};
}

float range_noise(View2<const float> points, float step_share, float step_m, std::size_t least) {
    std::vector<float> bends;
    bends.reserve(points.rows);
    float last_m = 0.0f, last_step_m = 0.0f;
    bool was_smooth = false;
    for (std::size_t n = 0; n < points.rows; ++n) {
        const float* p = points[n];
        const float range_m = std::sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]), this_step_m = range_m - last_m;
        const bool is_smooth = n > 0 && std::fabs(this_step_m) < step_share * range_m + step_m;
        if (is_smooth && was_smooth) bends.push_back(std::fabs(this_step_m - last_step_m));
        last_m = range_m, last_step_m = this_step_m, was_smooth = is_smooth;
    }
    if (bends.size() < std::max(least, std::size_t{1})) return UNKNOWN_VALUE;
    // Interpolate the quartile between two sorted values.
    const double place = 0.25 * double(bends.size() - 1);
    const auto low = bends.begin() + std::ptrdiff_t(place);
    std::nth_element(bends.begin(), low, bends.end());
    const float next = low + 1 < bends.end() ? *std::min_element(low + 1, bends.end()) : *low;
    return *low + (next - *low) * float(place - std::floor(place));
}

namespace {

// Solve a symmetric 3 × 3 system; false if it is singular.
bool solve(const std::array<double, 9>& a, const std::array<double, 3>& b, std::array<double, 3>& x) {
    const double c0 = a[4] * a[8] - a[5] * a[7], c1 = a[5] * a[6] - a[3] * a[8], c2 = a[3] * a[7] - a[4] * a[6];
    const double determinant = a[0] * c0 + a[1] * c1 + a[2] * c2;
    if (!(std::fabs(determinant) > 1e-9)) return false;
    const std::array<double, 9> inverse{c0, a[2] * a[7] - a[1] * a[8], a[1] * a[5] - a[2] * a[4],
                                        c1, a[0] * a[8] - a[2] * a[6], a[2] * a[3] - a[0] * a[5],
                                        c2, a[1] * a[6] - a[0] * a[7], a[0] * a[4] - a[1] * a[3]};
    for (std::size_t k = 0; k < 3; ++k) {
        x[k] = (inverse[3 * k] * b[0] + inverse[3 * k + 1] * b[1] + inverse[3 * k + 2] * b[2]) / determinant;
    }
    return true;
}

// A vertical surface: a point and its horizontal normal.
struct Surface {
    double x, y, nx, ny;
};

// Return the vertical surface of a sweep nearest to p along its beam: a line through two beams of a ring, if that
// between fits.
std::optional<Surface> surface_at(const SweepView& view, Point3 p) {
    const SweepView::Pixel pixel = view.pixel_of(p);
    if (pixel.ring < 0) return std::nullopt;
    const int columns = int(view.columns());
    const auto turned = [&](int column) { return (column + columns) % columns; };
    const float* row = view.ring(std::size_t(pixel.ring));
    const float range_m = row[pixel.column];
    const int before = turned(pixel.column - BASE_COLUMNS), after = turned(pixel.column + BASE_COLUMNS);
    if (!(std::fabs(range_m - pixel.range_m) < MATCH_M && row[before] < 1e6f && row[after] < 1e6f)) return std::nullopt;
    const Point3 a = view.at(pixel.ring, before, row[before]), b = view.at(pixel.ring, after, row[after]);
    const Point3 q = view.at(pixel.ring, pixel.column, range_m);
    const double tx = b.x - a.x, ty = b.y - a.y, length = std::sqrt(tx * tx + ty * ty);
    if (!(length > MIN_BASE_M)) return std::nullopt;
    const double nx = -ty / length, ny = tx / length;
    if (std::fabs(nx * (q.x - a.x) + ny * (q.y - a.y)) > MAX_BEND_M) return std::nullopt;
    return Surface{(a.x + b.x + q.x) / 3.0, (a.y + b.y + q.y) / 3.0, nx, ny};
}

}  // namespace

Registration register_on(const SweepView& view, const SweepView& other, const Transform& other_from_view) {
    Registration result;
    std::vector<float> residuals;
    const std::vector<Point3>& obstacles = view.obstacles();
    const std::size_t stride = obstacles.size() / MAX_REGISTERED + 1;
    for (const float gate_m : GATES_M) {
        std::array<double, 9> h{};
        std::array<double, 3> b{};
        residuals.clear();
        const double c = std::cos(result.yaw), s = std::sin(result.yaw);
        for (std::size_t n = 0; n < obstacles.size(); n += stride) {
            const Point3 p = other_from_view(obstacles[n]);
            const double x = c * p.x - s * p.y + result.x_m, y = s * p.x + c * p.y + result.y_m;
            const auto surface = surface_at(other, {float(x), float(y), p.z});
            if (!surface) continue;
            const double residual = surface->nx * (x - surface->x) + surface->ny * (y - surface->y);
            if (std::fabs(residual) > gate_m) continue;
            // Tukey's biweight: returns farther from their surface weigh less.
            const double u = 1.0 - (residual / gate_m) * (residual / gate_m), weight = u * u;
            const std::array<double, 3> j{surface->ny * x - surface->nx * y, surface->nx, surface->ny};
            for (std::size_t k = 0; k < 3; ++k) {
                for (std::size_t l = 0; l < 3; ++l) h[3 * k + l] += weight * j[k] * j[l];
                b[k] -= weight * j[k] * residual;
            }
            residuals.push_back(float(std::fabs(residual)));
        }
        // A weak prior keeps directions that are not observed at their given value.
        std::array<double, 9> regularized = h;
        regularized[0] += 10.0;
        regularized[4] += 1.0;
        regularized[8] += 1.0;
        std::array<double, 3> step{};
        if (residuals.empty() || !solve(regularized, b, step)) return Registration{};
        const double turned = std::clamp(step[0], -0.2, 0.2), c1 = std::cos(turned), s1 = std::sin(turned);
        const double x_m = c1 * result.x_m - s1 * result.y_m + step[1], y_m = s1 * result.x_m + c1 * result.y_m + step[2];
        result = {result.yaw + turned, x_m, y_m, h, 1.4826 * median_of(residuals), residuals.size()};
    }
    return result;
}

}  // namespace viewshed
