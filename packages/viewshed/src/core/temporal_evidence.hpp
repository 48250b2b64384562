// Evidence of a monitor that needs earlier sweeps: what appears or vanishes in plain view, surfaces that jump, ranges that
// come again, and poses that do not fit.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "arrays.hpp"
#include "sweep_views.hpp"

namespace viewshed {

// Another sweep, the transform to its sensor's frame, and the time to it.
struct Other {
    const SweepView* view;
    Transform transform;
    float gap_s;
};

// By sector: the speed that its fastest obstacles need.
void follow_all(const SweepView& view, const std::vector<Other>& others, const SweepView& around,
                const Transform& around_from_view, View1<float> speed_mps);

// By sector: how far its surfaces jump, against what moves at a constant speed: the median of the second differences of range
// over the sweep and two before it, whose times before it are in the ratio `ratio`.
void jumps(const SweepView& view, const Other& last, const Other& second, float ratio, View1<float> jump_m);

// By sector: the share of the ranges that repeat those of another sweep, less what noise repeats; NaN where too few beams
// returned in both. Both have the same rings and columns.
void find_repeats(const SweepView& view, const SweepView& other, View1<float> share);

// By sector: the share of the returns that are nearer, and farther, than all that the beams about them had in the other sweeps;
// and the share of the beams that returned in all of those and now do not; 0 where there are too few. All have the same rings and
// columns; turned_columns is by how many columns the sensor turned since each.
void find_new_ranges(const SweepView& view, const std::vector<const SweepView*>& others,
                     const std::vector<float>& turned_columns, View1<float> nearer, View1<float> farther, View1<float> silent);

// The shift in whole cells, each way in [-most, most], that lays the cells of one sweep best on those of another: the first of the
// best; how many cells it lays on each other, and how many the best shift that lies more than two cells away does.
struct Shift {
    int down, across;
    std::uint32_t cells, elsewhere;
};

// Both are square and go around at their edges.
Shift best_shift(View2<const std::uint8_t> now, View2<const std::uint8_t> before, int most);

// The lower quartile of second differences of range between returns that follow each other in this order on one surface, where
// steps are less than step_share of the range and step_m; NaN where there are fewer than `least`.
float range_noise(View2<const float> points, float step_share, float step_m, std::size_t least);

// A correction of a pose: turn and shift, the information (3, 3) about them, the deviation of a return from its surface, and
// how many returns were used.
struct Registration {
    double yaw = 0, x_m = 0, y_m = 0;
    std::array<double, 9> information{};
    double sigma_m = 0;
    std::size_t matches = 0;
};

// Turn and shift a sweep's obstacles until they lie on the surfaces of another.
Registration register_on(const SweepView& view, const SweepView& other, const Transform& other_from_view);

}  // namespace viewshed
