// Temporal evidence of a monitor: objects that appear or vanish, surfaces that jump, repeated ranges, inconsistent
// poses.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "arrays.hpp"
#include "sweep_views.hpp"

namespace viewshed {

// Another sweep, the transform to its sensor's frame, and the time to it in seconds.
struct Other {
    const SweepView* view;
    Transform transform;
    float gap_s;
};

// Write the speed (sectors,) in m/s required by the fastest obstacles of each sector.
void follow_all(const SweepView& view, const std::vector<Other>& others, const SweepView& around,
                const Transform& around_from_view, View1<float> speed_mps);

// Write how far surfaces jump (sectors,) in meters relative to constant speed: the median second difference of range
// over the sweep and two earlier ones, whose ages have the ratio `ratio`.
void jumps(const SweepView& view, const Other& last, const Other& second, float ratio, View1<float> jump_m);

// Write the share (sectors,) of ranges that repeat those of another sweep, minus the share that noise repeats; NaN
// where too few beams returned in both. Both sweeps have the same rings and columns.
void find_repeats(const SweepView& view, const SweepView& other, View1<float> share);

// Write by sector the share of returns nearer (farther) than all neighboring beams in the other sweeps, and the share
// of beams that returned in all of those but not now; 0 with too few. All sweeps have the same rings and columns.
// turned_columns is the rotation of the sensor in columns since each sweep.
void find_new_ranges(const SweepView& view, const std::vector<const SweepView*>& others,
                     const std::vector<float>& turned_columns, View1<float> nearer, View1<float> farther, View1<float> silent);

// The shift in whole cells, within ±most, with the largest overlap between the cells of two sweeps (the first one of a
// tie), its overlap, and the largest overlap of shifts more than two cells away.
struct Shift {
    int down, across;
    std::uint32_t cells, elsewhere;
};

// Find the best shift of square masks, which wrap around at their edges.
Shift best_shift(View2<const std::uint8_t> now, View2<const std::uint8_t> before, int most);

// Return the lower quartile of second differences of range between consecutive returns on one surface, i.e. with steps
// below step_share · range + step_m; NaN with fewer than `least`.
float range_noise(View2<const float> points, float step_share, float step_m, std::size_t least);

// A pose correction: rotation and shift, their information matrix (3, 3), the standard deviation of a return from its
// surface, and the number of returns used.
struct Registration {
    double yaw = 0, x_m = 0, y_m = 0;
    std::array<double, 9> information{};
    double sigma_m = 0;
    std::size_t matches = 0;
};

// Register a sweep's obstacles on the surfaces of another.
Registration register_on(const SweepView& view, const SweepView& other, const Transform& other_from_view);

}  // namespace viewshed
