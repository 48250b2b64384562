#include "agent_views.hpp"

#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "evidence.hpp"
#include "height_map.hpp"

namespace viewshed {
namespace {

constexpr double TURN = 2 * std::numbers::pi, INFINITE = std::numeric_limits<double>::infinity();

// Lines of sight to a box, as fractions of its angular width; MIN_SLOPE bounds the division for lines along a side.
constexpr std::array<double, 5> SIGHTS{0.1, 0.3, 0.5, 0.7, 0.9};
constexpr double MIN_SLOPE = 1e-9;

// Different sides of one surface may lie a cell or two apart: deny it only if all cells within this distance are free.
constexpr double AROUND_M = 1.0;

// Sectors of a view; most sectors to each side covered by a near surface; margin before a surface.
constexpr int SECTORS = 180, MAX_WIDENING = 6;
constexpr double BEFORE_M = 0.5;

// Cell coordinates beyond this become 0; nothing lies there.
constexpr double MAX_CELLS = 1e9;

bool is_visible(std::uint8_t state) { return state == FREE || state == SURFACE; }

double wrapped(double angle) {
    const double turned = std::fmod(angle + std::numbers::pi, TURN);
    return (turned < 0 ? turned + TURN : turned) - std::numbers::pi;
}

// Return the range at which a line with `slope` comes within `half_m` of `middle_m`.
double entry_m(double slope, double middle_m, double half_m) {
    slope = std::fabs(slope) < MIN_SLOPE ? MIN_SLOPE : slope;
    return middle_m / slope - half_m / std::fabs(slope);
}

bool is_on(const ViewCells<std::uint8_t>& view, double x_m, double y_m) {
    const double i = (x_m - view.x_m) / view.cell_m, j = (y_m - view.y_m) / view.cell_m;
    return i >= 0 && i < double(view.values.rows) && j >= 0 && j < double(view.values.columns);
}

// Clamp a coordinate in cells to a valid row or column.
std::size_t clamped(double at, std::size_t cells) {
    return at > 0 ? std::size_t(std::min(at, double(cells - 1))) : 0;
}

std::uint8_t state_at(const ViewCells<std::uint8_t>& view, double x_m, double y_m) {
    return view.values(clamped((x_m - view.x_m) / view.cell_m, view.values.rows),
                       clamped((y_m - view.y_m) / view.cell_m, view.values.columns));
}

std::size_t sector_of(double x_m, double y_m) {
    const double sector = (std::atan2(y_m, x_m) + std::numbers::pi) / TURN * SECTORS;
    return sector >= 0 && sector < SECTORS ? std::size_t(sector) : 0;
}

// Range of the nearest blocker of each sector. A blocker is one cell wide and covers one more sector than it subtends.
class OpenRange {
public:
    OpenRange() { first_m_.fill(INFINITE); }

    void add(double x_m, double y_m) {
        double& first_m = first_m_[sector_of(x_m, y_m)];
        first_m = std::min(first_m, std::hypot(x_m, y_m));
    }

    void widen(double cell_m) {
        const auto narrow = first_m_;
        for (int sector = 0; sector < SECTORS; ++sector) {
            for (int step = 1; step <= MAX_WIDENING; ++step) {
                if (step > 1 && !(narrow[std::size_t(sector)] * step * (TURN / SECTORS) <= cell_m)) break;
                for (const int beside : {sector + step, sector + SECTORS - step}) {
                    double& first_m = first_m_[std::size_t(beside % SECTORS)];
                    first_m = std::min(first_m, narrow[std::size_t(sector)]);
                }
            }
        }
    }

    bool holds(double x_m, double y_m) const {
        return std::hypot(x_m, y_m) < first_m_[sector_of(x_m, y_m)] - BEFORE_M;
    }

private:
    std::array<double, SECTORS> first_m_;
};

// Return the position of the k-th of `count` points along a side, from -1/2 to 1/2.
double part_of_side(std::size_t k, std::size_t count) {
    return k + 1 == count ? 0.5 : double(k) * (1.0 / double(count - 1)) - 0.5;
}

std::int32_t map_step(double along_m, double cell_m, std::int32_t last) {
    const double at = std::floor(along_m / cell_m);
    return std::fabs(at) < MAX_CELLS ? std::int32_t(at) & last : 0;
}

// Sampled margin of a box, and the width of the ring around it.
constexpr double MARGIN_M = 0.25, RING_M = 1.0;

// Depth of the near side of a box: a fraction of its depth, at least NEAR_M.
constexpr double NEAR_PART = 0.4, NEAR_M = 0.8;

// Depth of the first surface in a box that has none.
constexpr double NO_SURFACE_M = 10.0;

}  // namespace

void look_at_boxes(const ViewCells<std::uint8_t>& states, const UprightPose& pose, View2<const double> boxes, double place_x_m,
                   double place_y_m, std::size_t along, std::size_t across, View2<double> out) {
    const double pose_cosine = std::cos(pose.yaw), pose_sine = std::sin(pose.yaw);
    const auto state_of = [&](double x, double y) {
        const double level_x = pose_cosine * (x - pose.x_m) + pose_sine * (y - pose.y_m);
        const double level_y = pose_cosine * (y - pose.y_m) - pose_sine * (x - pose.x_m);
        return is_on(states, level_x, level_y) ? state_at(states, level_x, level_y) : UNKNOWN;
    };
    const std::size_t count = along * across;
    std::vector<double> depth_m(count);
    std::vector<std::uint8_t> in(count);
    for (std::size_t k = 0; k < boxes.rows; ++k) {
        const double *box = boxes[k], cosine = std::cos(box[6]), sine = std::sin(box[6]);
        const double away_x = box[0] - place_x_m, away_y = box[1] - place_y_m, range_m = std::hypot(away_x, away_y);
        const double to_x = away_x / std::max(range_m, 1e-6), to_y = away_y / std::max(range_m, 1e-6);
        double nearest_m = INFINITE, farthest_m = -INFINITE, ring = 0, ring_surface = 0, ring_free = 0;
        for (std::size_t p = 0; p < count; ++p) {
            const double ahead = part_of_side(p / across, along), left = part_of_side(p % across, across);
            const double x = ahead * (box[3] + 2 * MARGIN_M), y = left * (box[4] + 2 * MARGIN_M);
            in[p] = state_of(box[0] + cosine * x - sine * y, box[1] + sine * x + cosine * y);
            depth_m[p] = (cosine * x - sine * y) * to_x + (sine * x + cosine * y) * to_y;
            nearest_m = std::min(nearest_m, depth_m[p]);
            farthest_m = std::max(farthest_m, depth_m[p]);
            // Sample the ring: points of a box a meter larger that lie outside the box itself.
            const double out_x = ahead * (box[3] + 2 * RING_M), out_y = left * (box[4] + 2 * RING_M);
            if (std::fabs(out_x) <= box[3] / 2 + MARGIN_M && std::fabs(out_y) <= box[4] / 2 + MARGIN_M) continue;
            const std::uint8_t about = state_of(box[0] + cosine * out_x - sine * out_y, box[1] + sine * out_x + cosine * out_y);
            ++ring;
            ring_surface += about == SURFACE;
            ring_free += about == FREE;
        }
        const double near_m = std::max(NEAR_PART * (farthest_m - nearest_m), NEAR_M);
        double surface = 0, free = 0, hidden = 0, near = 0, near_free = 0, first_m = NO_SURFACE_M;
        for (std::size_t p = 0; p < count; ++p) {
            const double deep_m = depth_m[p] - nearest_m;
            surface += in[p] == SURFACE;
            free += in[p] == FREE;
            hidden += in[p] == HIDDEN;
            near += deep_m <= near_m;
            near_free += deep_m <= near_m && in[p] == FREE;
            if (in[p] == SURFACE) first_m = std::min(first_m, deep_m);
        }
        double* cells = out[k];
        cells[IN_SURFACE] = surface / double(count);
        cells[IN_FREE] = free / double(count);
        cells[IN_HIDDEN] = hidden / double(count);
        cells[RING_SURFACE] = ring_surface / std::max(ring, 1.0);
        cells[RING_FREE] = ring_free / std::max(ring, 1.0);
        cells[NEAR_FREE] = near_free / std::max(near, 1.0);
        cells[FIRST_M] = first_m;
        cells[RANGE_M] = range_m;
    }
}

void visible_before(const ViewCells<float>& probability, View2<const double> boxes, View1<double> out) {
    for (std::size_t k = 0; k < boxes.rows; ++k) {
        const double* box = boxes[k];
        const double x = box[0], y = box[1], long_m = box[3] / 2, wide_m = box[4] / 2, yaw = box[6];
        const double cosine = std::cos(yaw), sine = std::sin(yaw), middle = std::atan2(y, x);
        // Angular width of the box.
        double low = INFINITE, high = -INFINITE;
        for (const double ahead : {long_m, -long_m}) {
            for (const double left : {wide_m, -wide_m}) {
                const double off = wrapped(std::atan2(y + ahead * sine + left * cosine, x + ahead * cosine - left * sine) - middle);
                low = std::min(low, off);
                high = std::max(high, off);
            }
        }
        // Each line enters the box at the later of its two slab entries.
        const double ahead_m = cosine * x + sine * y, left_m = cosine * y - sine * x;
        double sum = 0.0;
        for (const double sight : SIGHTS) {
            const double azimuth = middle + low + (high - low) * sight, turned = azimuth - yaw;
            const double enters_m = std::max(entry_m(std::cos(turned), ahead_m, long_m), entry_m(std::sin(turned), left_m, wide_m));
            const double range_m = std::max(enters_m - probability.cell_m, 0.0);
            const double i = (range_m * std::cos(azimuth) - probability.x_m) / probability.cell_m;
            const double j = (range_m * std::sin(azimuth) - probability.y_m) / probability.cell_m;
            if (i >= 0 && i < double(probability.values.rows) && j >= 0 && j < double(probability.values.columns)) {
                sum += probability.values(std::size_t(i), std::size_t(j));
            }
        }
        out[k] = sum / double(SIGHTS.size());
    }
}

std::vector<double> surface_cells(const ViewCells<std::uint8_t>& states, double nearest_m, double farthest_m) {
    std::vector<double> centers;
    for (std::size_t i = 0; i < states.values.rows; ++i) {
        const double x = states.x_m + (double(i) + 0.5) * states.cell_m;
        for (std::size_t j = 0; j < states.values.columns; ++j) {
            if (states.values(i, j) != SURFACE) continue;
            const double y = states.y_m + (double(j) + 0.5) * states.cell_m, range_m2 = x * x + y * y;
            if (range_m2 > nearest_m * nearest_m && range_m2 < farthest_m * farthest_m) centers.insert(centers.end(), {x, y});
        }
    }
    return centers;
}

void mark_surfaces(View2<std::uint32_t> seen_by, View2<const double> surfaces, const UprightPose& pose, double cell_m,
                   std::uint32_t bit, bool wide, bool erase) {
    const auto last = std::int32_t(seen_by.rows) - 1;
    const double cosine = std::cos(pose.yaw), sine = std::sin(pose.yaw), before_m = wide ? cell_m / 2 : 0.0;
    for (std::size_t s = 0; s < surfaces.rows; ++s) {
        const double x = cosine * surfaces(s, 0) - sine * surfaces(s, 1) + pose.x_m;
        const double y = sine * surfaces(s, 0) + cosine * surfaces(s, 1) + pose.y_m;
        const std::int32_t row = map_step(x - before_m, cell_m, last), column = map_step(y - before_m, cell_m, last);
        for (const std::int32_t down : {0, 1}) {
            for (const std::int32_t right : {0, 1}) {
                if (!wide && (down || right)) continue;
                std::uint32_t& cell = seen_by(std::size_t((row + down) & last), std::size_t((column + right) & last));
                cell = erase ? cell & ~bit : cell | bit;
            }
        }
    }
}

void count_met(View2<const double> surfaces, View1<const double> headings, View1<const double> x_m, View1<const double> y_m,
               double cell_m, View2<const std::uint32_t> seen_by, std::uint32_t own_bit, View3<std::int32_t> out) {
    const auto last = std::int32_t(seen_by.rows) - 1;
    std::vector<std::int32_t> down(x_m.size), right(y_m.size);
    std::fill_n(out.data, out.size(), 0);
    for (std::size_t turn = 0; turn < headings.size; ++turn) {
        const double cosine = std::cos(headings[turn]), sine = std::sin(headings[turn]);
        for (std::size_t s = 0; s < surfaces.rows; ++s) {
            const double x = cosine * surfaces(s, 0) - sine * surfaces(s, 1), y = sine * surfaces(s, 0) + cosine * surfaces(s, 1);
            for (std::size_t i = 0; i < down.size(); ++i) down[i] = map_step(x + x_m[i], cell_m, last);
            for (std::size_t j = 0; j < right.size(); ++j) right[j] = map_step(y + y_m[j], cell_m, last);
            for (std::size_t i = 0; i < down.size(); ++i) {
                const std::uint32_t* row = seen_by[std::size_t(down[i])];
                std::int32_t* met = &out(turn, i, 0);
                for (std::size_t j = 0; j < right.size(); ++j) met[j] += (row[right[j]] & ~own_bit) != 0;
            }
        }
    }
}

void compare_view(const ViewCells<std::uint8_t>& states, const ViewGround& ground, const UprightPose& pose,
                  const WorldCells& cells, std::int32_t own, View2<const double> blockers, bool from_above,
                  const Compared& where, View2<std::int32_t> counts) {
    std::fill_n(counts.data, counts.size(), 0);
    const double cosine = std::cos(pose.yaw), sine = std::sin(pose.yaw);
    // 1. Cells of others within range.
    std::vector<std::size_t> near;
    std::vector<double> level;
    std::vector<float> at;
    for (std::size_t k = 0; k < cells.owner.size; ++k) {
        if (cells.owner[k] == own) continue;
        const double x = cells.places_m(k, 0) - pose.x_m, y = cells.places_m(k, 1) - pose.y_m;
        const double level_x = cosine * x + sine * y, level_y = cosine * y - sine * x, range_m = std::hypot(x, y);
        if (!(range_m > where.nearest_m && range_m < where.farthest_m)) continue;
        near.push_back(k);
        level.insert(level.end(), {level_x, level_y});
        at.insert(at.end(), {float(level_x), float(level_y)});
    }
    // 2. Keep cells at a similar ground height: count surfaces at once, collect free cells.
    const LatticePositions positions = lattice_positions({at.data(), near.size(), 2}, ground.half_extent_m, ground.heights_m.rows);
    Buffer<float> height_m(near.size());
    interpolate(ground.heights_m, positions.node, positions.down, positions.right, height_m);
    OpenRange open;
    for (std::size_t b = 0; b < blockers.rows; ++b) open.add(blockers(b, 0), blockers(b, 1));
    std::vector<std::size_t> free;
    for (std::size_t n = 0; n < near.size(); ++n) {
        const std::size_t k = near[n];
        if (!(std::fabs(pose.z_m + double(height_m[n]) - cells.ground_m[k]) < where.same_ground_m)) continue;
        if (cells.is_free[k]) {
            free.push_back(n);
            continue;
        }
        const double x = level[2 * n], y = level[2 * n + 1];
        const auto owner = std::size_t(cells.owner[k]);
        open.add(x, y);
        if (!is_on(states, x, y) || !is_visible(state_at(states, x, y))) continue;
        ++counts(0, owner);
        bool all_free = true;
        for (const double dx : {-AROUND_M, 0.0, AROUND_M}) {
            for (const double dy : {-AROUND_M, 0.0, AROUND_M}) all_free &= state_at(states, x + dx, y + dy) == FREE;
        }
        counts(1, owner) += all_free;
    }
    open.widen(states.cell_m);
    for (const std::size_t n : free) {
        const double x = level[2 * n], y = level[2 * n + 1];
        if (!is_on(states, x, y) || (!from_above && !open.holds(x, y))) continue;
        const auto owner = std::size_t(cells.owner[near[n]]);
        ++counts(2, owner);
        counts(3, owner) += state_at(states, x, y) == HIDDEN;
    }
}

std::array<std::int32_t, 5> compare_past(const ViewCells<std::uint8_t>& now, const ViewCells<std::uint8_t>& last,
                                         const UprightPose& last_from_now, View2<const double> places) {
    const double cosine = std::cos(last_from_now.yaw), sine = std::sin(last_from_now.yaw);
    std::array<std::int32_t, 5> counts{};
    for (std::size_t k = 0; k < places.rows; ++k) {
        const double x = cosine * places(k, 0) - sine * places(k, 1) + last_from_now.x_m;
        const double y = sine * places(k, 0) + cosine * places(k, 1) + last_from_now.y_m;
        if (!is_on(last, x, y) || !is_on(now, places(k, 0), places(k, 1))) continue;
        const std::uint8_t here = state_at(now, places(k, 0), places(k, 1)), before = state_at(last, x, y);
        const bool sees = is_visible(here), saw = is_visible(before);
        counts[0] += sees;
        counts[1] += saw;
        counts[2] += sees || saw;
        counts[3] += saw && here == HIDDEN;
        counts[4] += sees && before == HIDDEN;
    }
    return counts;
}

}  // namespace viewshed
