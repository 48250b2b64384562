#include "ground.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Sensor height if neither the sweep nor its returns give one. Otherwise it is a quantile of the nodes' depths, of at
// least FEWEST_NODES nodes and at most MAX_HEIGHT_M.
constexpr double ASSUMED_HEIGHT_M = 1.8, MAX_HEIGHT_M = 10.0, LOWEST_SHARE = 0.95;
constexpr std::size_t FEWEST_NODES = 6;

// A plane with less support is no ground; then level ground is assumed at the lowest returns.
constexpr double MIN_SUPPORT = 0.22;

// A node whose returns span less than this height may be ground; otherwise it is a car or a wall.
constexpr double FLAT_M = 0.2;

// Nodes form an even patch if their low points lie this near to a plane; steep planes get more tolerance.
constexpr double EVEN_M = 0.12;
constexpr int EVEN_NODES = 7;

// Steepest slope of a patch (50°, the side of a cutting).
constexpr double STEEPEST = 1.2;

// From this step on, the slope of a patch replaces that of the nodes nearer to the sensor.
constexpr double BREAK_M = 0.5;

// A steep patch is a slope, not the front of a car, if it has this area and meets accepted ground within this distance.
constexpr double FACE_M2 = 20.0, FOOT_M = 0.25, FOOT_SLOPE = 0.1;

// Returns below the ground are accepted if two neighbors agree within this distance, or, on a wall seen over an edge,
// if they are this much lower: the ground lies no higher than the foot of the wall.
constexpr float AGREE_M = 0.3f;
constexpr double LOWER_M = 0.3;

// Largest step to follow, plus allowances of flat nodes per meter of side (up to FLAT_NODE_M), and of doubtful ones.
constexpr double STEP_M = 0.10, FLAT_STEP = 0.05, FLAT_NODE_M = 2.5, DOUBT_STEP_M = 0.10;

// Shares of a step that are followed in height and in slope.
constexpr double FOLLOWED = 0.7, FOLLOWED_SLOPE = 0.25;

// Without ground, these shares of slope and weight are carried on, with at most CARRIED_SLOPE off the carrier plane's
// slope.
constexpr float CARRIED_SHARE = 0.9f, CARRIED_SLOPE = 0.15f, CARRIED_WEIGHT = 0.8f, MIN_WEIGHT = 0.05f;

// A beam that passes this far below accepted ground is inconsistent: it would have ended there.
constexpr float BURIED_M = 0.3f;

// Returns are attached to ground within BESIDE_NODES nodes if BESIDE_COUNT nodes of it are about as high.
constexpr std::ptrdiff_t BESIDE_NODES = 2;
constexpr int BESIDE_COUNT = 2;
constexpr float BESIDE_M = 0.12f, BESIDE_SLOPE = 0.03f;

// Fewest nodes for which a part pays for its thread.
constexpr std::size_t PART = 1024;

INLINE bool has(const Lows& lows, std::size_t at) {
    return lows.z_m[at] < std::numeric_limits<float>::infinity();
}

// Planes that are fitted at once in vectors.
constexpr std::size_t LANES = 8;

// Low points of nine nodes for each lane; missing ones have used = 0 and z = 0.
struct Neighborhoods {
    float x[9][LANES] = {}, y[9][LANES] = {}, z[9][LANES] = {}, used[9][LANES] = {}, count[LANES] = {};

    // Load a node and its neighbors into a lane; false if too few have low points.
    bool take(const Lows& lows, std::size_t at, std::ptrdiff_t n, std::size_t lane) {
        const auto i = std::ptrdiff_t(at) / n, j = std::ptrdiff_t(at) % n;
        if (i < 1 || j < 1 || i >= n - 1 || j >= n - 1) return false;
        int found = 0;
        for (std::size_t k = 0; k < 9; ++k) {
            const std::size_t near = at + (k / 3) * std::size_t(n) + k % 3 - std::size_t(n) - 1;
            const bool is_used = has(lows, near);
            x[k][lane] = lows.x_m[near];
            y[k][lane] = lows.y_m[near];
            z[k][lane] = is_used ? lows.z_m[near] : 0.0f;
            used[k][lane] = is_used ? 1.0f : 0.0f;
            found += is_used;
        }
        count[lane] = float(found);
        // Seven of nine cover three rows; with two, a wall and the ground before it would form a plane.
        return found >= EVEN_NODES;
    }
};

// Fit a least-squares plane to each lane: write its slopes along x and y, and whether its points lie on it.
MULTIVERSION void fit_planes(const Neighborhoods& p, bool* fits, float* slope_x, float* slope_y) {
    float mx[LANES] = {}, my[LANES] = {}, mz[LANES] = {};
    for (std::size_t k = 0; k < 9; ++k) {
        for (std::size_t l = 0; l < LANES; ++l) {
            mx[l] += p.x[k][l];
            my[l] += p.y[k][l];
            mz[l] += p.z[k][l];
        }
    }
    for (std::size_t l = 0; l < LANES; ++l) {
        const float count = p.count[l] > 0.0f ? p.count[l] : 1.0f;
        mx[l] /= count;
        my[l] /= count;
        mz[l] /= count;
    }
    double xx[LANES], xy[LANES] = {}, yy[LANES], xz[LANES] = {}, yz[LANES] = {};
    for (std::size_t l = 0; l < LANES; ++l) xx[l] = yy[l] = 1e-6;
    for (std::size_t k = 0; k < 9; ++k) {
        for (std::size_t l = 0; l < LANES; ++l) {
            const float used = p.used[k][l];
            const float dx = (p.x[k][l] - mx[l]) * used, dy = (p.y[k][l] - my[l]) * used, dz = (p.z[k][l] - mz[l]) * used;
            xx[l] += double(dx * dx);
            xy[l] += double(dx * dy);
            yy[l] += double(dy * dy);
            xz[l] += double(dx * dz);
            yz[l] += double(dy * dz);
        }
    }
    double a[LANES], b[LANES], slope[LANES], worst[LANES] = {};
    for (std::size_t l = 0; l < LANES; ++l) {
        const double area = xx[l] * yy[l] - xy[l] * xy[l];
        a[l] = (xz[l] * yy[l] - yz[l] * xy[l]) / area;
        b[l] = (yz[l] * xx[l] - xz[l] * xy[l]) / area;
        slope[l] = std::sqrt(a[l] * a[l] + b[l] * b[l]);
    }
    for (std::size_t k = 0; k < 9; ++k) {
        for (std::size_t l = 0; l < LANES; ++l) {
            const float used = p.used[k][l];
            const float dx = (p.x[k][l] - mx[l]) * used, dy = (p.y[k][l] - my[l]) * used, dz = (p.z[k][l] - mz[l]) * used;
            const double off = std::fabs(double(dz) - a[l] * double(dx) - b[l] * double(dy));
            worst[l] = off > worst[l] ? off : worst[l];
        }
    }
    for (std::size_t l = 0; l < LANES; ++l) {
        slope_x[l] = float(a[l]);
        slope_y[l] = float(b[l]);
        fits[l] = slope[l] <= STEEPEST && worst[l] <= EVEN_M * (1.0 + slope[l]);
    }
}

// Nodes that lie on a plane with their neighbors, its slopes along x and y, and the size of connected patches.
class Patches {
public:
    Patches(const Lows& lows, float node_m)
        : lows_(lows), n_(std::ptrdiff_t(lows.nodes)), node_m_(node_m), even_(lows.nodes * lows.nodes, false),
          slope_x_(lows.nodes * lows.nodes), slope_y_(lows.nodes * lows.nodes),
          count_(lows.nodes * lows.nodes, 0) {
        const std::size_t count = lows.occupied.size();
        for_ranges(count, count_parts(count, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
            fit(lows.occupied.data() + begin, end - begin);
        });
    }

    bool is_even(std::size_t at) const { return even_[at]; }
    float slope_x(std::size_t at) const { return slope_x_[at]; }
    float slope_y(std::size_t at) const { return slope_y_[at]; }

    // Return the area in m² of the patch of an even node: connected neighbors whose planes predict each other's low
    // points. Computed on demand, since few patches are needed.
    double area_m2(std::size_t at) {
        if (count_[at] == 0) measure(at);
        return double(count_[at]) * double(node_m_) * double(node_m_);
    }

private:
    // Fit planes to nodes, LANES at a time.
    void fit(const std::int32_t* nodes, std::size_t size) {
        Neighborhoods around;
        std::array<std::size_t, LANES> of{};
        std::size_t lanes = 0;
        const auto finish = [&] {
            std::array<bool, LANES> fits;
            std::array<float, LANES> a, b;
            fit_planes(around, fits.data(), a.data(), b.data());
            for (std::size_t l = 0; l < lanes; ++l) {
                even_[of[l]] = fits[l];
                slope_x_[of[l]] = a[l];
                slope_y_[of[l]] = b[l];
            }
            lanes = 0;
        };
        for (std::size_t k = 0; k < size; ++k) {
            const auto at = std::size_t(nodes[k]);
            slope_x_[at] = slope_y_[at] = 0.0f;
            if (!around.take(lows_, at, n_, lanes)) continue;
            of[lanes++] = at;
            if (lanes == LANES) finish();
        }
        if (lanes > 0) finish();
    }

    void measure(std::size_t first) {
        std::vector<std::int32_t> members{std::int32_t(first)};
        count_[first] = -1;
        for (std::size_t k = 0; k < members.size(); ++k) {
            const auto at = std::size_t(members[k]);
            const std::ptrdiff_t i = members[k] / n_, j = members[k] % n_;
            for (std::ptrdiff_t p = std::max<std::ptrdiff_t>(i - 1, 0); p < std::min(i + 2, n_); ++p) {
                for (std::ptrdiff_t q = std::max<std::ptrdiff_t>(j - 1, 0); q < std::min(j + 2, n_); ++q) {
                    const auto near = std::size_t(p * n_ + q);
                    if (count_[near] != 0 || !even_[near] || !continues(at, near)) continue;
                    count_[near] = -1;
                    members.push_back(std::int32_t(near));
                }
            }
        }
        for (const std::int32_t at : members) count_[std::size_t(at)] = std::int32_t(members.size());
    }

    // Check that the mean slope of two nodes connects their low points.
    bool continues(std::size_t from, std::size_t to) const {
        const float dx = lows_.x_m[to] - lows_.x_m[from], dy = lows_.y_m[to] - lows_.y_m[from];
        const double rise =
            0.5 * double((slope_x_[to] + slope_x_[from]) * dx + (slope_y_[to] + slope_y_[from]) * dy);
        return std::fabs(double(lows_.z_m[to] - lows_.z_m[from]) - rise) < FLAT_M;
    }

    const Lows& lows_;
    std::ptrdiff_t n_;
    float node_m_;
    Buffer<bool> even_;
    Buffer<float> slope_x_, slope_y_;
    Buffer<std::int32_t> count_;  // 0 if not measured yet
};

// Walk outward from the sensor: heights (n, n) of the accepted nodes (n, n); others have no value.
class Walk {
public:
    Walk(const Lattice& lattice, const Lows& lows, Patches& patches, const Plane& carrier)
        : height_m(lattice.size()), accepted(lattice.size()), lattice_(lattice), lows_(lows), patches_(patches),
          n_(std::ptrdiff_t(lattice.nodes)), node_m_(float(lattice.node_m)), nodes_per_m_(1.0f / node_m_), carrier_x_(carrier[0]), carrier_y_(carrier[1]),
          carrier_z_(carrier[2]), carried_(std::size_t(n_ + 2) * std::size_t(n_ + 2)) {}

    // Run the walk. Attached nodes (n, n) are accepted whatever the step.
    void walk(const bool* attached);

    Buffer<float> height_m;
    Buffer<bool> accepted;

private:
    enum class Kind { refused, followed, patch, below };

    // State carried on by a node: weighted height, rise per node along x and y, and the weight; zeros until visited.
    using Carried = float __attribute__((vector_size(16)));

    // Prediction from the nodes nearer to the sensor: height, slopes, weight, and their mean offset.
    struct Prediction {
        float z, slope_x, slope_y, weight, mean_x, mean_y;
    };

    INLINE Prediction predict(const Carried* here) const;
    INLINE Carried carry(const Prediction& near) const;
    Carried visit(std::size_t at, const Prediction& near, const bool* attached);
    Kind kind_of(std::ptrdiff_t i, std::ptrdiff_t j, double step, double support, bool is_even_node, float a, float b);
    bool agrees(std::ptrdiff_t i, std::ptrdiff_t j) const;
    bool is_buried(std::size_t at) const;
    bool meets(std::ptrdiff_t i, std::ptrdiff_t j, float a, float b) const;

    // Return x or y of a node's center.
    double middle(std::ptrdiff_t i) const { return (double(i) + 0.5 - double(n_) / 2) * double(node_m_); }

    const Lattice& lattice_;
    const Lows& lows_;
    Patches& patches_;
    std::ptrdiff_t n_;
    float node_m_, nodes_per_m_, carrier_x_, carrier_y_, carrier_z_;
    Buffer<Carried> carried_;  // (n + 2, n + 2) with a border of zeros
};

// Diagonal neighbors count half. Height and slopes are linear in the carried state, so sums over rows and columns of
// the nine nodes give them all; the node itself still holds zeros.
Walk::Prediction Walk::predict(const Carried* here) const {
    const Carried *above = here - (n_ + 2), *below = here + (n_ + 2);
    const Carried before = 0.5f * (above[-1] + above[1]) + above[0], after = 0.5f * (below[-1] + below[1]) + below[0];
    const Carried across = 0.5f * ((above[-1] - above[1]) + (below[-1] - below[1])) + (here[-1] - here[1]);
    const Carried sum = before + (here[-1] + here[1]) + after, along = before - after;
    const float per = sum[3] > 0.0f ? 1.0f / sum[3] : 0.0f, per_m = per * nodes_per_m_;
    return {(sum[0] + along[1] + across[2]) * per, sum[1] * per_m, sum[2] * per_m, sum[3],
            along[3] * per * node_m_, across[3] * per * node_m_};
}

// Return the state to carry on without ground: the slope decays to the carrier's.
Walk::Carried Walk::carry(const Prediction& near) const {
    const float steeper_x = near.slope_x - carrier_x_, steeper_y = near.slope_y - carrier_y_;
    const float steeper2 = steeper_x * steeper_x + steeper_y * steeper_y;
    float share = CARRIED_SHARE;
    if (steeper2 > CARRIED_SLOPE * CARRIED_SLOPE) share *= CARRIED_SLOPE / std::sqrt(steeper2);
    const float weight = std::max(std::min(CARRIED_WEIGHT / 3.0f * near.weight, CARRIED_WEIGHT), MIN_WEIGHT);
    const Carried state{near.z, (carrier_x_ + share * steeper_x) * node_m_, (carrier_y_ + share * steeper_y) * node_m_, 1.0f};
    return weight * state;
}

void Walk::walk(const bool* attached) {
    std::fill_n(accepted.data(), accepted.size(), false);
    std::fill_n(carried_.data(), carried_.size(), Carried{});
    // Stop after the last low point.
    std::size_t left = lows_.occupied.size();
    for (std::size_t k = 0; left > 0; ++k) {
        const std::size_t at = lattice_.order[k];
        Carried* here = &carried_[lattice_.padded[k]];
        Prediction near = predict(here);
        if (k == 0) near = {carrier_z_, carrier_x_, carrier_y_, 0.0f, node_m_, 0.0f};
        if (has(lows_, at)) {
            *here = visit(at, near, attached);
            --left;
        } else {
            *here = carry(near);
        }
    }
}

// Accept or refuse the low point of a node, and return the state to carry on.
Walk::Carried Walk::visit(std::size_t at, const Prediction& near, const bool* attached) {
    const auto i = std::ptrdiff_t(at) / n_, j = std::ptrdiff_t(at) % n_;
    // 1. Compute the step above the prediction, and classify the low point.
    const double dx = double(lows_.x_m[at]) - middle(i), dy = double(lows_.y_m[at]) - middle(j);
    const double low = double(lows_.z_m[at]), z = double(near.z);
    const double step = low - z - double(near.slope_x) * dx - double(near.slope_y) * dy;
    const bool is_even_node = patches_.is_even(at);
    const float a = patches_.slope_x(at), b = patches_.slope_y(at);
    Kind kind = is_even_node ? Kind::patch : Kind::below;
    if (attached == nullptr || !attached[at]) {
        kind = kind_of(i, j, step, std::min(double(near.weight) / 3.0, 1.0), is_even_node, a, b);
    }
    if (kind == Kind::refused) return carry(near);
    // 2. Take patches as they are, with their slope if it breaks with the prediction; follow small steps in part.
    double height, slope_x, slope_y;
    if (kind == Kind::followed) {
        const double mx = double(near.mean_x), my = double(near.mean_y), side = double(node_m_);
        const double length2 = mx * mx + my * my + 0.25 * side * side;
        height = z + FOLLOWED * step;
        slope_x = double(near.slope_x) + FOLLOWED_SLOPE * step * mx / length2;
        slope_y = double(near.slope_y) + FOLLOWED_SLOPE * step * my / length2;
    } else if (is_even_node) {
        const bool breaks = kind == Kind::below || std::fabs(step) >= BREAK_M;
        height = low - double(a) * dx - double(b) * dy;
        slope_x = double(breaks ? a : 0.5f * (near.slope_x + a));
        slope_y = double(breaks ? b : 0.5f * (near.slope_y + b));
    } else {
        height = low - double(near.slope_x) * dx - double(near.slope_y) * dy;
        slope_x = double(0.5f * near.slope_x);
        slope_y = double(0.5f * near.slope_y);
    }
    height_m[at] = float(height);
    accepted[at] = true;
    return Carried{float(height), float(slope_x) * node_m_, float(slope_y) * node_m_, 1.0f};
}

// Classify a low point at a step above the prediction.
Walk::Kind Walk::kind_of(std::ptrdiff_t i, std::ptrdiff_t j, double step, double support, bool is_even_node, float a, float b) {
    const auto at = std::size_t(i * n_ + j);
    if (!std::isfinite(step)) return Kind::refused;
    const bool flat = double(lows_.rise_m[at]) < double(float(FLAT_M));
    const double small = STEP_M + (flat ? FLAT_STEP * std::min(double(node_m_), FLAT_NODE_M) : 0.0) +
                         DOUBT_STEP_M * (1.0 - support);
    if (std::fabs(step) < small) return Kind::followed;
    if (step < 0.0) {
        // Only ground lies below ground.
        const bool is_floor = is_even_node || (flat ? agrees(i, j) : step < -LOWER_M);
        return is_floor && !is_buried(at) ? Kind::below : Kind::refused;
    }
    const bool is_slope = is_even_node && patches_.area_m2(at) >= FACE_M2 && meets(i, j, a, b);
    return is_slope ? Kind::patch : Kind::refused;
}

// Check that two of the eight neighbors of (i, j) have low points at about its height.
bool Walk::agrees(std::ptrdiff_t i, std::ptrdiff_t j) const {
    const float own = lows_.z_m[std::size_t(i * n_ + j)];
    int count = 0;
    for (std::ptrdiff_t p = std::max<std::ptrdiff_t>(i - 1, 0); p < std::min(i + 2, n_); ++p) {
        for (std::ptrdiff_t q = std::max<std::ptrdiff_t>(j - 1, 0); q < std::min(j + 2, n_); ++q) {
            count += std::fabs(lows_.z_m[std::size_t(p * n_ + q)] - own) < AGREE_M;
        }
    }
    return count > 2;
}

// Check if the beam to a low point passes below accepted ground on its way.
bool Walk::is_buried(std::size_t at) const {
    // Clamp to the lattice, even if another thread writes the points meanwhile.
    const float center = 0.5f * float(n_), z = lows_.z_m[at];
    const float u = std::max(std::min(center, lows_.x_m[at] / node_m_), -center);
    const float v = std::max(std::min(center, lows_.y_m[at] / node_m_), -center);
    const int steps = int(std::max(std::fabs(u), std::fabs(v)));
    for (int k = 1; k < steps; ++k) {
        const float share = 1.0f - float(k) / float(steps);
        const auto p = std::ptrdiff_t(center + share * u), q = std::ptrdiff_t(center + share * v);
        const auto on_way = std::size_t(p * n_ + q);
        if (accepted[on_way] && share * z < height_m[on_way] - BURIED_M) return true;
    }
    return false;
}

// Check that the plane through a low point with slope (a, b) meets accepted ground within two nodes.
bool Walk::meets(std::ptrdiff_t i, std::ptrdiff_t j, float a, float b) const {
    const auto at = std::size_t(i * n_ + j);
    const double low_x = double(lows_.x_m[at]), low_y = double(lows_.y_m[at]), low = double(lows_.z_m[at]);
    const double tolerance = FOOT_M + FOOT_SLOPE * double(std::sqrt(a * a + b * b));
    for (std::ptrdiff_t p = std::max<std::ptrdiff_t>(i - 2, 0); p < std::min(i + 3, n_); ++p) {
        for (std::ptrdiff_t q = std::max<std::ptrdiff_t>(j - 2, 0); q < std::min(j + 3, n_); ++q) {
            const auto near = std::size_t(p * n_ + q);
            if (!accepted[near]) continue;
            const double rise = double(a) * (middle(p) - low_x) + double(b) * (middle(q) - low_y);
            if (std::fabs(low + rise - double(height_m[near])) < tolerance) return true;
        }
    }
    return false;
}

// Check that the low point of one node continues that of another.
INLINE bool continues_from(const Lows& lows, std::size_t from, std::size_t to) {
    const float dx = lows.x_m[to] - lows.x_m[from], dy = lows.y_m[to] - lows.y_m[from];
    return std::fabs(lows.z_m[to] - lows.z_m[from]) < BESIDE_M + BESIDE_SLOPE * std::sqrt(dx * dx + dy * dy);
}

// Call body(near) for each node within BESIDE_NODES rows and columns.
template <typename Body>
INLINE void for_beside(std::ptrdiff_t n, std::size_t at, const Body& body) {
    const auto i = std::ptrdiff_t(at) / n, j = std::ptrdiff_t(at) % n;
    const auto left = std::max<std::ptrdiff_t>(j - BESIDE_NODES, 0), right = std::min(j + BESIDE_NODES + 1, n);
    for (auto p = std::max<std::ptrdiff_t>(i - BESIDE_NODES, 0); p < std::min(i + BESIDE_NODES + 1, n); ++p) {
        for (auto q = left; q < right; ++q) body(std::size_t(p * n + q));
    }
}

// Accept low points that continue two accepted ones (n, n), until nothing changes. A ring that continues behind a hole
// or a car lies beside the ring before, whatever height the walk carried there.
void attach(const Lows& lows, View1<bool> accepted) {
    const auto n = std::ptrdiff_t(lows.nodes);
    std::vector<std::size_t> found;
    Buffer<std::uint8_t> count(accepted.size);
    for (const std::int32_t node : lows.occupied) {
        const auto at = std::size_t(node);
        if (accepted[at]) continue;
        int beside = 0;
        for_beside(n, at, [&](std::size_t near) { beside += accepted[near] && continues_from(lows, near, at); });
        count[at] = std::uint8_t(beside);
        if (beside >= BESIDE_COUNT) found.push_back(at);
    }
    for (std::size_t k = 0; k < found.size(); ++k) {
        const std::size_t at = found[k];
        accepted[at] = true;
        for_beside(n, at, [&](std::size_t near) {
            if (accepted[near] || !has(lows, near) || !continues_from(lows, at, near)) return;
            if (++count[near] == BESIDE_COUNT) found.push_back(near);
        });
    }
}

// Return the depth below the sensor of the lowest 5 % of the nodes; the assumed height without any.
double estimated_height_m(const Lows& lows) {
    if (lows.occupied.size() < FEWEST_NODES) return ASSUMED_HEIGHT_M;
    std::vector<double> below;
    for (const std::int32_t at : lows.occupied) below.push_back(-double(lows.z_m[std::size_t(at)]));
    std::sort(below.begin(), below.end());
    const double place = LOWEST_SHARE * double(below.size() - 1);
    const auto k = std::size_t(place);
    const double above = below[std::min(k + 1, below.size() - 1)];
    return std::clamp(below[k] + (above - below[k]) * (place - double(k)), MIN_HEIGHT_M, MAX_HEIGHT_M);
}

}  // namespace

FoundGround estimate_ground(const Lattice& lattice, const Lows& lows, double height_m) {
    const CarrierPlane carrier = carrier_plane(lows, height_m);
    // Walk, attach low points that continue the ground, and walk again from there.
    Patches patches(lows, float(lattice.node_m));
    Walk walk(lattice, lows, patches, carrier.plane);
    walk.walk(nullptr);
    Buffer<bool> attached = copy_of(View1<const bool>(walk.accepted));
    attach(lows, attached);
    walk.walk(attached.data());
    FoundGround ground{std::move(walk.height_m), std::move(walk.accepted), carrier, std::numeric_limits<double>::quiet_NaN()};
    // No plane, or one at the sensor's own height: no ground is seen.
    const bool is_known = std::isfinite(height_m);
    const bool is_own = double(ground.carrier.plane[2]) > -MIN_HEIGHT_M;
    if (ground.carrier.support < MIN_SUPPORT || (!is_known && is_own)) {
        ground.level_m = -(is_known ? height_m : estimated_height_m(lows));
    }
    return ground;
}

}  // namespace viewshed
