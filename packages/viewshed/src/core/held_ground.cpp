#include "held_ground.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace viewshed {
namespace {

// Standard deviation per meter of range, from the uncertainty of the poses' attitudes (0.1°).
constexpr double TILT_STD = 0.002;

// Two sweeps agree on a node if their heights differ by at most this plus twice their standard deviations.
constexpr float AGREE_M = 0.3f;

// They agree around a node if this share of commonly seen nodes within AROUND rows and columns does.
constexpr std::ptrdiff_t AROUND = 3;
constexpr double AGREEING_SHARE = 0.75;

// If a smaller share of all commonly seen nodes agrees, a pose is wrong, and nothing is carried over.
constexpr double MIN_AGREEING_SHARE = 0.5;

// Ground that an earlier sweep saw counts more than a prediction, until it is this uncertain and the prediction is not.
constexpr float SURE_STD_M = 0.5f;

constexpr float NONE = std::numeric_limits<float>::infinity();

// Write heights and standard deviations (n, n) of the earlier ground on the present lattice, bilinear; the standard
// deviation is +inf if the nearest node was not seen.
void move_ground(const SeenGround& before, const HeldPoses& poses, float variance_m2, std::size_t n, float half_m,
                 View1<float> moved_m, View1<float> moved_std_m) {
    const std::size_t m = before.heights_m.rows;
    const auto before_half_m = float(before.half_m);
    const float node_m = 2.0f * half_m / float(n), nodes_per_m = float(m) / (2.0f * before_half_m);
    for (std::size_t i = 0; i < n; ++i) {
        const float x = (float(i) + 0.5f) * node_m - half_m;
        for (std::size_t j = 0; j < n; ++j) {
            const float y = (float(j) + 0.5f) * node_m - half_m;
            const std::size_t at = i * n + j;
            moved_m[at] = 0.0f;
            moved_std_m[at] = NONE;
            const auto& to_x = poses.before_from_now[0];
            const auto& to_y = poses.before_from_now[1];
            const float bx = to_x[0] * x + to_x[1] * y + to_x[3], by = to_y[0] * x + to_y[1] * y + to_y[3];
            const float u = (bx + before_half_m) * nodes_per_m - 0.5f, v = (by + before_half_m) * nodes_per_m - 0.5f;
            if (!(u >= 0.0f && v >= 0.0f && u < float(m - 1) && v < float(m - 1))) continue;
            const auto p = std::size_t(u), q = std::size_t(v);
            const float fu = u - float(p), fv = v - float(q);
            if (!before.seen(p + (fu >= 0.5f), q + (fv >= 0.5f))) continue;
            const float a = (1.0f - fu) * (1.0f - fv), b = (1.0f - fu) * fv, c = fu * (1.0f - fv), d = fu * fv;
            const auto between = [&](View2<const float> of) {
                return a * of(p, q) + b * of(p, q + 1) + c * of(p + 1, q) + d * of(p + 1, q + 1);
            };
            const float z = between(before.heights_m);
            float s = a * before.std_m(p, q) + b * before.std_m(p, q + 1);
            s += c * before.std_m(p + 1, q) + d * before.std_m(p + 1, q + 1);
            const float turned = poses.now_from_before[0] * bx + poses.now_from_before[1] * by +
                                 poses.now_from_before[2] * z;
            moved_m[at] = turned + poses.now_from_before[3];
            moved_std_m[at] = std::sqrt(s * s + variance_m2 + float(TILT_STD * TILT_STD) * (x * x + y * y));
        }
    }
}

// Give each node the label (n, n) of the nearest node at distance 0, by two passes of a chamfer distance (n, n).
void spread_nearest(std::ptrdiff_t n, View1<float> away, View1<bool> label) {
    for (const std::ptrdiff_t step : {1, -1}) {
        for (std::ptrdiff_t a = 0; a < n; ++a) {
            const std::ptrdiff_t i = step > 0 ? a : n - 1 - a;
            for (std::ptrdiff_t b = 0; b < n; ++b) {
                const std::ptrdiff_t j = step > 0 ? b : n - 1 - b;
                const auto at = std::size_t(i * n + j);
                // Neighbors visited by this pass: one in this row, three in the row before.
                for (int k = 0; k < 4; ++k) {
                    const std::ptrdiff_t p = k == 0 ? i : i - step, q = k == 0 ? j - step : j + k - 2;
                    if (p < 0 || q < 0 || p >= n || q >= n) continue;
                    const auto near = std::size_t(p * n + q);
                    const float found = away[near] + (k % 2 == 1 ? 1.4142135f : 1.0f);
                    if (found < away[at]) {
                        away[at] = found;
                        label[at] = label[near];
                    }
                }
            }
        }
    }
}

// Mark nodes (n, n) that only the earlier sweep saw, if it is certain, or more so than the present one, and both agree:
// the nearest common node decides, by the share of agreeing common nodes around it. Return whether any is marked.
bool find_agreed(const SeenGround& now, View1<const float> moved_m, View1<const float> moved_std_m, View1<bool> taken) {
    const auto n = std::ptrdiff_t(now.heights_m.rows);
    const auto size = std::size_t(n * n);
    std::fill_n(taken.data, size, false);
    const auto is_common = [&](std::size_t at) { return now.seen.data[at] && moved_std_m[at] < NONE; };
    // Summed-area tables of common nodes, and of agreeing ones.
    Buffer<std::int32_t> both(std::size_t((n + 1) * (n + 1)), 0), agree(std::size_t((n + 1) * (n + 1)), 0);
    const auto corner = [n](std::ptrdiff_t i, std::ptrdiff_t j) { return std::size_t(i * (n + 1) + j); };
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        std::int32_t row_both = 0, row_agree = 0;
        for (std::ptrdiff_t j = 0; j < n; ++j) {
            const auto at = std::size_t(i * n + j);
            if (is_common(at)) {
                ++row_both;
                const float doubt_m = 2.0f * (now.std_m.data[at] + moved_std_m[at]);
                row_agree += std::fabs(moved_m[at] - now.heights_m.data[at]) <= AGREE_M + doubt_m;
            }
            both[corner(i + 1, j + 1)] = both[corner(i, j + 1)] + row_both;
            agree[corner(i + 1, j + 1)] = agree[corner(i, j + 1)] + row_agree;
        }
    }
    if (double(agree[corner(n, n)]) < MIN_AGREEING_SHARE * double(both[corner(n, n)])) return false;  // a pose is wrong
    // Common nodes are at distance 0, labeled by agreement; without any, all other nodes may be taken.
    Buffer<float> away(size, NONE);
    Buffer<bool> agreed(size, true);
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        const std::ptrdiff_t top = std::max<std::ptrdiff_t>(i - AROUND, 0), bottom = std::min(i + AROUND + 1, n);
        for (std::ptrdiff_t j = 0; j < n; ++j) {
            const auto at = std::size_t(i * n + j);
            if (!is_common(at)) continue;
            const std::ptrdiff_t left = std::max<std::ptrdiff_t>(j - AROUND, 0), right = std::min(j + AROUND + 1, n);
            const auto within = [&](const Buffer<std::int32_t>& sums) {
                return double(sums[corner(bottom, right)] - sums[corner(top, right)] - sums[corner(bottom, left)] +
                              sums[corner(top, left)]);
            };
            away[at] = 0.0f;
            agreed[at] = within(agree) >= AGREEING_SHARE * within(both);
        }
    }
    spread_nearest(n, away, agreed);
    bool any = false;
    for (std::size_t at = 0; at < size; ++at) {
        taken[at] = agreed[at] && !now.seen.data[at] && moved_std_m[at] < std::max(now.std_m.data[at], SURE_STD_M);
        any |= taken[at];
    }
    return any;
}

}  // namespace

bool hold_ground(const SeenGround& now, const SeenGround& before, const HeldPoses& poses, float variance_m2,
                 View1<float> heights_m, View1<float> std_m, View1<bool> seen) {
    const std::size_t n = now.heights_m.rows, size = n * n;
    // 1. Move the earlier ground to the present lattice, and decide which nodes to take.
    Buffer<float> moved_m(size), moved_std_m(size);
    Buffer<bool> taken(size);
    move_ground(before, poses, variance_m2, n, float(now.half_m), moved_m, moved_std_m);
    if (!find_agreed(now, moved_m, moved_std_m, taken)) return false;
    // 2. Take them.
    for (std::size_t at = 0; at < size; ++at) {
        seen[at] = now.seen.data[at] || taken[at];
        heights_m[at] = taken[at] ? moved_m[at] : now.heights_m.data[at];
        std_m[at] = taken[at] ? moved_std_m[at] : now.std_m.data[at];
    }
    return true;
}

}  // namespace viewshed
