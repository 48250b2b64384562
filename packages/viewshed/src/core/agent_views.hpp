// Views of several agents compared with each other, with their past, and looked up before objects.
#pragma once

#include <array>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Cells of a field of view: `values` (cells, cells), the first one's corner, their side in meters.
template <typename T>
struct ViewCells {
    View2<const T> values;
    double x_m, y_m, cell_m;
};

// Where a `level` frame stands in the world.
struct UprightPose {
    double x_m, y_m, z_m, yaw;
};

// Ground below a view: heights (n, n) in `level`, which span ±half_extent_m.
struct ViewGround {
    View2<const float> heights_m;
    float half_extent_m;
};

// Cells of all views (P,): where they lie in the world (P, 2), their ground (P,), whose they are, FREE or a surface.
struct WorldCells {
    View2<const double> places_m;
    View1<const double> ground_m;
    View1<const std::int32_t> owner;
    View1<const bool> is_free;
};

// What is compared: places in these ranges, where grounds differ by less.
struct Compared {
    double nearest_m, farthest_m, same_ground_m;
};

// Write the mean probability (K,) in the cells before boxes (K, 7) of `level`: where five lines of sight meet each box, one
// cell nearer; 0 outside the grid.
void visible_before(const ViewCells<float>& probability, View2<const double> boxes, View1<double> out);

// What the cells in and about a box are; the order is that of the columns in Python (viewshed.objects.cells.BoxCells).
enum BoxCell { IN_SURFACE, IN_FREE, IN_HIDDEN, RING_SURFACE, RING_FREE, NEAR_FREE, FIRST_M, RANGE_M, BOX_CELLS };

// Write what the cells in and about boxes (K, 7) are (K, BOX_CELLS), seen from a place, at `along` x `across` points of each; the
// view's `level` stands at a pose in the boxes' frame.
void look_at_boxes(const ViewCells<std::uint8_t>& states, const UprightPose& pose, View2<const double> boxes, double place_x_m,
                   double place_y_m, std::size_t along, std::size_t across, View2<double> out);

// The centers (S, 2) of the surface cells of a view at ranges between two, in `level`, row by row.
std::vector<double> surface_cells(const ViewCells<std::uint8_t>& states, double nearest_m, double farthest_m);

// Note in a map of the world that an agent sees surfaces (S, 2) of its `level`, or take that back: in the cell that holds each, or
// `wide` in the four nearest.
void mark_surfaces(View2<std::uint32_t> seen_by, View2<const double> surfaces, const UprightPose& pose, double cell_m,
                   std::uint32_t bit, bool wide, bool erase);

// Count how many surfaces (S, 2) of `level` meet one that another agent sees, at each of T headings, X and Y places:
// (T, X, Y). `seen_by` is a map of the world, a bit for each agent, that repeats after its power of two of cells.
void count_met(View2<const double> surfaces, View1<const double> headings, View1<const double> x_m, View1<const double> y_m,
               double cell_m, View2<const std::uint32_t> seen_by, std::uint32_t own_bit, View3<std::int32_t> out);

// Count what agent `own` claims of the cells of others; counts (4, agents) by owner: surfaces where it claims to see, those
// of them about which it claims all free, free cells that nothing hides from it, those of them that it claims hidden.
// Blockers (B, 2) of `level` are its own surfaces and objects; a view from above has nothing hidden.
void compare_view(const ViewCells<std::uint8_t>& states, const ViewGround& ground, const UprightPose& pose,
                  const WorldCells& cells, std::int32_t own, View2<const double> blockers, bool from_above,
                  const Compared& where, View2<std::int32_t> counts);

// Counts of what a view sees at places (P, 2) of its `level` and saw there before: visible now, then, either time, hidden now
// but visible then, visible now but hidden then.
std::array<std::int32_t, 5> compare_past(const ViewCells<std::uint8_t>& now, const ViewCells<std::uint8_t>& last,
                                         const UprightPose& last_from_now, View2<const double> places);

}  // namespace viewshed
