#include "cell_memory.hpp"

#include <algorithm>
#include <cmath>

namespace viewshed {
namespace {

constexpr float CELL_M = 0.5f;

// Ranges up to which cells are compared with a sweep, and remembered: too few beams hit farther ones.
constexpr float FARTHEST_M = 45.0f, REMEMBERED_M = 60.0f;

// A cell is forgotten after FORGET_S without an obstacle, or GONE_S if sweeps see it free.
constexpr double FORGET_S = 10.0, GONE_S = 0.5;

// A surface is standing if it was seen for STANDS_S, in most sweeps that looked, and within the last MOMENT_S.
constexpr double STANDS_S = 1.0, MOMENT_S = 0.35;
constexpr float MAX_FREE_SHARE = 0.05f, MIN_OCCUPIED = 8.0f;

// An object that covered a cell for T seconds is at most LONGEST_M long, so it moved at most LONGEST_M / T, clamped to
// [SLOWEST_MPS, DRIVEN_MPS]. A speed SUDDEN times higher cannot be driving.
constexpr float LONGEST_M = 20.0f, SLOWEST_MPS = 4.0f, DRIVEN_MPS = 15.0f, SUDDEN = 2.5f;

// Objects that come out of cover are suspicious above this speed.
constexpr float CAME_MPS = 8.0f;

std::int64_t key_of(float x, float y) {
    const auto u = std::int64_t(std::floor(x / CELL_M)), v = std::int64_t(std::floor(y / CELL_M));
    return std::int64_t((std::uint64_t(u) << 32) + std::uint64_t(v));
}

bool is_near(Point3 p, float max_m) { return p.x * p.x + p.y * p.y < max_m * max_m; }

// Return how implausible a speed is for driving: 0 up to `driven_mps`, 1 from SUDDEN times that on.
float suddenness(float speed_mps, float driven_mps) {
    return std::clamp((speed_mps / driven_mps - 1.0f) / (SUDDEN - 1.0f), 0.0f, 1.0f);
}

// Return the speed from the nearest cover to a place that the newest informed earlier sweep saw free, and none
// occupied; else 0.
float arrival_mps(Point3 p, const std::vector<Other>& earlier) {
    float speed_mps = 0.0f, gap_s = 0.0f;
    int free = 0;
    for (const Other& other : earlier) {
        const Point3 there = other.transform(p);
        const Seen seen = other.view->look_at(there);
        gap_s += other.gap_s;
        if (seen == Seen::OCCUPIED) return 0.0f;
        if (seen == Seen::FREE && ++free == 1) speed_mps = other.view->distance_to_cover(there) / gap_s;
    }
    return free >= 2 || (free == 1 && earlier.size() == 1) ? speed_mps : 0.0f;
}

}  // namespace

void CellMemory::check(const SweepView& now, const Transform& now_from_memory, double t_s, const std::vector<Other>& earlier,
                       View1<float> gone_m, View1<float> new_m2) const {
    const int sectors = int(gone_m.size);
    std::fill(gone_m.begin(), gone_m.end(), 0.0f);
    std::fill(new_m2.begin(), new_m2.end(), 0.0f);
    // 1. Standing surfaces that the sweep looks through.
    for (const auto& [key, cell] : cells_) {
        const double stood_s = cell.last_s - cell.first_s;
        const bool stands = stood_s >= STANDS_S && t_s - cell.last_s <= MOMENT_S && float(cell.occupied) >= MIN_OCCUPIED &&
                            float(cell.free) <= MAX_FREE_SHARE * float(cell.occupied);
        const Point3 p = now_from_memory(cell.point);
        if (!stands || !is_near(p, FARTHEST_M)) continue;
        if (!now.is_passed(p) && now.look_at(p) != Seen::FREE) continue;
        const float speed_mps = now.distance_to_cover(p) / float(std::max(t_s - cell.last_s, 1e-3));
        const float driven_mps = std::clamp(LONGEST_M / float(stood_s), SLOWEST_MPS, DRIVEN_MPS);
        gone_m[std::size_t(now.sector_of(p, sectors))] += CELL_M * suddenness(speed_mps, driven_mps);
    }
    if (earlier.empty()) return;
    // 2. Obstacles that were never seen in their cell or beside it, and would have moved too fast.
    const std::vector<Point3>& obstacles = now.obstacles();
    // The transposed rotation maps back.
    const auto& m = now_from_memory.m;
    for (const Point3 p : obstacles) {
        if (!is_near(p, FARTHEST_M)) continue;
        const float x = p.x - m[3], y = p.y - m[7], z = p.z - m[11];
        const float u = m[0] * x + m[4] * y + m[8] * z, v = m[1] * x + m[5] * y + m[9] * z;
        bool known = false;
        for (int i = -1; i <= 1 && !known; ++i) {
            for (int j = -1; j <= 1 && !known; ++j) {
                known = cells_.contains(key_of(u + float(i) * CELL_M, v + float(j) * CELL_M));
            }
        }
        if (known) continue;
        const float sudden = suddenness(arrival_mps(p, earlier), CAME_MPS);
        // The sweep itself must see it in place too: returns off their beams cannot be looked up.
        if (sudden <= 0.0f || now.look_at(p) != Seen::OCCUPIED) continue;
        new_m2[std::size_t(now.sector_of(p, sectors))] += sudden * now.area_of_pixel(p) * float(now.obstacle_step());
    }
}

void CellMemory::add(const SweepView& now, const Transform& memory_from_now, const Transform& now_from_memory, double t_s) {
    // 1. Update the known cells.
    for (auto entry = cells_.begin(); entry != cells_.end();) {
        Cell& cell = entry->second;
        const Point3 p = now_from_memory(cell.point);
        const Seen seen = is_near(p, REMEMBERED_M) ? now.look_at(p) : Seen::UNKNOWN;
        if (seen == Seen::OCCUPIED) {
            cell.last_s = t_s;
            ++cell.occupied;
        }
        if (seen == Seen::FREE) ++cell.free;
        const double unseen_s = t_s - cell.last_s;
        const bool gone = unseen_s > FORGET_S || (seen == Seen::FREE && unseen_s > GONE_S) || !is_near(p, 2 * REMEMBERED_M);
        entry = gone ? cells_.erase(entry) : std::next(entry);
    }
    // 2. Add its own obstacles.
    for (const Point3 p : now.obstacles()) {
        if (!is_near(p, REMEMBERED_M)) continue;
        const Point3 there = memory_from_now(p);
        auto [at, is_new] = cells_.try_emplace(key_of(there.x, there.y), Cell{t_s, t_s, there, 1, 0});
        if (is_new) continue;
        at->second.occupied += at->second.last_s < t_s;
        at->second.last_s = t_s;
        at->second.point = there;
    }
}

}  // namespace viewshed
