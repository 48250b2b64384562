// Concave hull of returns in bird's-eye view, and the cells inside rings of edges.
#pragma once

#include <vector>

#include "arrays.hpp"

namespace viewshed {

struct PlanePoint {
    double x, y;
};

struct Edge {
    PlanePoint from, to;
};

// A square grid: corner of least x and y, cell size, and cells per side.
struct SquareGrid {
    double x_m, y_m, cell_m;
    std::size_t cells;
};

// Return the farthest return of each cell of a lattice as fine as the grid, or coarser if the returns span more than
// 1024 cells. Sorted by cell, independent of the order of the returns. Points (M, 3) must be finite.
std::vector<PlanePoint> thin_returns(View2<const float> points, View1<const float> range_m, const SquareGrid& grid);

// Check that there are at least three points, not on one line.
bool span_area(const std::vector<PlanePoint>& points);

// Return the closed ring of a concave hull (Park and Oh 2012, as in concaveman). Edges shorter than length_m are not
// bent inward; a concavity of 1 follows the points closely, larger values approach the convex hull.
std::vector<PlanePoint> concave_hull(const std::vector<PlanePoint>& points, double concavity, double length_m);

// Mark the cells whose centers lie inside closed rings of edges, by the even-odd rule. An edge that occurs twice, in
// either direction, cancels out.
void fill_rings(const std::vector<Edge>& edges, const SquareGrid& grid, View2<bool> inside);

}  // namespace viewshed
