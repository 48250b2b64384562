// The concave hull of returns in bird's-eye view, and the cells inside rings of edges.
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

// A square grid: the corner of least x and y, the side of a cell, and cells a side.
struct SquareGrid {
    double x_m, y_m, cell_m;
    std::size_t cells;
};

// The farthest return of each cell of a lattice as fine as the grid, or coarser where the returns spread over more than
// 1024 cells; in the order of the cells, whatever the order of the returns. Points (M, 3) must be finite.
std::vector<PlanePoint> thin_returns(View2<const float> points, View1<const float> range_m, const SquareGrid& grid);

// Whether points are three or more that do not lie on one line.
bool span_area(const std::vector<PlanePoint>& points);

// The closed ring of a concave hull (Park and Oh 2012, as concaveman computes it). Edges shorter than a length are not
// bent inward; a concavity of 1 follows the points closely, larger ones approach the convex hull.
std::vector<PlanePoint> concave_hull(const std::vector<PlanePoint>& points, double concavity, double length_m);

// Write whether the centers of cells lie inside closed rings of edges, by the even-odd rule. An edge that occurs twice, in
// either direction, cancels out.
void fill_rings(const std::vector<Edge>& edges, const SquareGrid& grid, View2<bool> inside);

}  // namespace viewshed
