// Compare the views of several agents with each other and with their past, and look views up around objects.
#pragma once

#include <array>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Cells of a field of view: `values` (cells, cells), the corner of the first cell, and the cell size in meters.
template <typename T>
struct ViewCells {
    View2<const T> values;
    double x_m, y_m, cell_m;
};

// Pose of a `level` frame in the world.
struct UprightPose {
    double x_m, y_m, z_m, yaw;
};

// Ground below a view: heights (n, n) in `level` on a lattice that spans ±half_extent_m.
struct ViewGround {
    View2<const float> heights_m;
    float half_extent_m;
};

// Cells of all views (P,): positions in the world (P, 2), ground heights (P,), owning agents, and FREE or SURFACE.
struct WorldCells {
    View2<const double> places_m;
    View1<const double> ground_m;
    View1<const std::int32_t> owner;
    View1<const bool> is_free;
};

// Limits of a comparison: range from the sensor, and difference of the ground heights.
struct Compared {
    double nearest_m, farthest_m, same_ground_m;
};

// Write the mean probability (K,) in front of boxes (K, 7) in `level`: of five lines of sight, each looked up one cell
// before it enters the box; 0 outside the grid.
void visible_before(const ViewCells<float>& probability, View2<const double> boxes, View1<double> out);

// Measures of the cells in and around a box, in the order of viewshed.objects.cells.BoxCells.
enum BoxCell { IN_SURFACE, IN_FREE, IN_HIDDEN, RING_SURFACE, RING_FREE, NEAR_FREE, FIRST_M, RANGE_M, BOX_CELLS };

// Write the measures (K, BOX_CELLS) of boxes (K, 7) seen from a place, sampled at `along` x `across` points each.
// `pose` is the view's `level` frame in the boxes' frame.
void look_at_boxes(const ViewCells<std::uint8_t>& states, const UprightPose& pose, View2<const double> boxes, double place_x_m,
                   double place_y_m, std::size_t along, std::size_t across, View2<double> out);

// Return the centers (S, 2) of the surface cells between two ranges in `level`, row by row, flattened.
std::vector<double> surface_cells(const ViewCells<std::uint8_t>& states, double nearest_m, double farthest_m);

// Set (or erase) an agent's bit in a world map for the surfaces (S, 2) of its `level` frame: in the cell of each, or if
// `wide` in the four nearest.
void mark_surfaces(View2<std::uint32_t> seen_by, View2<const double> surfaces, const UprightPose& pose, double cell_m,
                   std::uint32_t bit, bool wide, bool erase);

// Count the surfaces (S, 2) of `level` that coincide with one seen by another agent, for each of T headings and X × Y
// positions: (T, X, Y). `seen_by` is a world map, a bit per agent, periodic, with a power of two of cells.
void count_met(View2<const double> surfaces, View1<const double> headings, View1<const double> x_m, View1<const double> y_m,
               double cell_m, View2<const std::uint32_t> seen_by, std::uint32_t own_bit, View3<std::int32_t> out);

// Count what agent `own` claims about the cells of others; counts (4, agents) by owner: [0] surfaces it claims to see,
// [1] those with only free cells around, [2] free cells that nothing occludes, [3] those it claims hidden. Blockers (B,
// 2) of `level` are its own surfaces and objects; in a view from above nothing is occluded.
void compare_view(const ViewCells<std::uint8_t>& states, const ViewGround& ground, const UprightPose& pose,
                  const WorldCells& cells, std::int32_t own, View2<const double> blockers, bool from_above,
                  const Compared& where, View2<std::int32_t> counts);

// Count places (P, 2) of `level`, now against the last view: visible now, visible then, at either time, hidden now but
// visible then, visible now but hidden then.
std::array<std::int32_t, 5> compare_past(const ViewCells<std::uint8_t>& now, const ViewCells<std::uint8_t>& last,
                                         const UprightPose& last_from_now, View2<const double> places);

}  // namespace viewshed
