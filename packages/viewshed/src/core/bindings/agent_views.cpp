#include "agent_views.hpp"

#include <cmath>

#include "bindings.hpp"

namespace viewshed {
namespace {

constexpr std::size_t MAX_SIDE = 16384;

// Check and view the cells of a square field of view.
template <typename T>
ViewCells<T> cells_of(const In2<T>& values, double x_m, double y_m, double cell_m) {
    require(values.shape(0) == values.shape(1) && values.shape(0) >= 1 && values.shape(0) <= MAX_SIDE,
            "cells of a view must be a square, of at most 16384 a side");
    require(std::isfinite(x_m) && std::isfinite(y_m), "the corner of a view must be finite");
    require(std::isfinite(cell_m) && cell_m > 0, "cell_m must be positive and finite");
    return {view(values), x_m, y_m, cell_m};
}

void require_map(std::size_t rows, std::size_t columns, double cell_m) {
    require(columns == rows && rows >= 1 && rows <= MAX_SIDE && (rows & (rows - 1)) == 0,
            "seen_by must be a square of a power of two, at most 16384");
    require(std::isfinite(cell_m) && cell_m > 0, "cell_m must be positive and finite");
}

// Check and copy a pose (x, y, z, yaw).
UprightPose pose_of(const In1<double>& numbers) {
    require(numbers.shape(0) == 4, "a pose must be x, y, z and yaw");
    UprightPose pose{read_once(view(numbers), 0), read_once(view(numbers), 1), read_once(view(numbers), 2),
                     read_once(view(numbers), 3)};
    require(std::isfinite(pose.x_m) && std::isfinite(pose.y_m) && std::isfinite(pose.z_m) && std::isfinite(pose.yaw),
            "a pose must be finite");
    return pose;
}

}  // namespace

void bind_agent_views(nb::module_& m) {
    m.def(
        "visible_before",
        [](In2<float> prob, double x_m, double y_m, double cell_m, In2<double> boxes) {
            require(boxes.shape(1) == 7, "boxes must have seven columns");
            const ViewCells<float> cells = cells_of(prob, x_m, y_m, cell_m);
            Buffer<double> out(boxes.shape(0));
            const Buffer<double> own = copy_of(view(boxes).flat());
            without_lock([&] { visible_before(cells, {own.data(), boxes.shape(0), 7}, out); });
            return array(std::move(out));
        },
        "prob"_in, "x_m"_a, "y_m"_a, "cell_m"_a, "boxes"_in,
        "Return the mean probability (K,) of the cells in front of boxes (K, 7), where lines of sight meet them.");
    m.def(
        "look_at_boxes",
        [](In2<std::uint8_t> states, double x_m, double y_m, double cell_m, In1<double> pose, In2<double> boxes,
           double place_x_m, double place_y_m, std::size_t along, std::size_t across) {
            require(boxes.shape(1) == 7, "boxes must have seven columns");
            require(along >= 2 && across >= 2 && along <= 256 && across <= 256, "along and across must lie in [2, 256]");
            const ViewCells<std::uint8_t> cells = cells_of(states, x_m, y_m, cell_m);
            const UprightPose at = pose_of(pose);
            Buffer<double> out(boxes.shape(0) * BOX_CELLS);
            without_lock([&] {
                look_at_boxes(cells, at, view(boxes), place_x_m, place_y_m, along, across, out.view(boxes.shape(0), BOX_CELLS));
            });
            return array(std::move(out), {boxes.shape(0), BOX_CELLS});
        },
        "states"_in, "x_m"_a, "y_m"_a, "cell_m"_a, "pose"_in, "boxes"_in, "place_x_m"_a, "place_y_m"_a, "along"_a, "across"_a,
        "Return measures (K, 8) of the cells in and around boxes (K, 7).");
    m.def(
        "surface_cells",
        [](In2<std::uint8_t> states, double x_m, double y_m, double cell_m, double nearest_m, double farthest_m) {
            const std::vector<double> centers = surface_cells(cells_of(states, x_m, y_m, cell_m), nearest_m, farthest_m);
            return array_of(centers, {centers.size() / 2, 2});
        },
        "states"_in, "x_m"_a, "y_m"_a, "cell_m"_a, "nearest_m"_a, "farthest_m"_a,
        "Return the centers (S, 2) of the surface cells of a view between two ranges.");
    m.def(
        "mark_surfaces",
        [](InOut2<std::uint32_t> seen_by, In2<double> surfaces, In1<double> pose, double cell_m, std::uint32_t bit, bool wide,
           bool erase) {
            require(surfaces.shape(1) == 2, "surfaces must have two columns");
            require_map(seen_by.shape(0), seen_by.shape(1), cell_m);
            mark_surfaces(view(seen_by), view(surfaces), pose_of(pose), cell_m, bit, wide, erase);
        },
        "seen_by"_in, "surfaces"_in, "pose"_in, "cell_m"_a, "bit"_a, "wide"_a, "erase"_a,
        "Set or erase an agent's bit in a world map for the surfaces (S, 2) that it sees.");
    m.def(
        "count_met",
        [](In2<double> surfaces, In1<double> headings, In1<double> x_m, In1<double> y_m, double cell_m,
           In2<std::uint32_t> seen_by, std::uint32_t own_bit) {
            const std::size_t side = seen_by.shape(0), turns = headings.shape(0), rows = x_m.shape(0), columns = y_m.shape(0);
            require(surfaces.shape(1) == 2, "surfaces must have two columns");
            require_map(side, seen_by.shape(1), cell_m);
            require(turns <= 64 && rows <= 64 && columns <= 64, "at most 64 headings and places along each axis");
            Buffer<std::int32_t> out(turns * rows * columns);
            without_lock([&] {
                count_met(view(surfaces), view(headings), view(x_m), view(y_m), cell_m, view(seen_by), own_bit,
                          {out.data(), turns, rows, columns});
            });
            return array(std::move(out), {turns, rows, columns});
        },
        "surfaces"_in, "headings"_in, "x_m"_in, "y_m"_in, "cell_m"_a, "seen_by"_in, "own_bit"_a,
        "Count the surfaces (S, 2) that coincide with one of another agent, for each heading and position (T, X, Y).");
    m.def(
        "compare_view",
        [](In2<std::uint8_t> states, double x_m, double y_m, double cell_m, In2<float> heights_m, float half_extent_m,
           In1<double> pose, In2<double> places_m, In1<double> ground_m, In1<std::int32_t> owner, In1<bool> is_free,
           std::int32_t own, std::int32_t agents, In2<double> blockers, bool from_above, double nearest_m, double farthest_m,
           double same_ground_m) {
            const std::size_t nodes = heights_m.shape(0);
            require(nodes >= 2 && nodes <= MAX_SIDE && heights_m.shape(1) == nodes, "heights_m must be a square");
            require(std::isfinite(half_extent_m) && half_extent_m > 0, "half_extent_m must be positive and finite");
            require(places_m.shape(1) == 2 && blockers.shape(1) == 2, "places_m and blockers must have two columns");
            require(are_as_long(owner, places_m, ground_m, is_free), "places_m, ground_m, owner and is_free must be as long");
            require(agents >= 1 && agents <= 65536, "agents must lie in [1, 65536]");
            const Buffer<std::int32_t> owners = indices_of<std::int32_t>(view(owner), 0, agents - 1, "owner");
            const ViewCells<std::uint8_t> cells = cells_of(states, x_m, y_m, cell_m);
            const UprightPose at = pose_of(pose);
            Buffer<std::int32_t> counts(4 * std::size_t(agents));
            without_lock([&] {
                const WorldCells others{view(places_m), view(ground_m), owners, view(is_free)};
                compare_view(cells, {view(heights_m), half_extent_m}, at, others, own, view(blockers), from_above,
                             {nearest_m, farthest_m, same_ground_m}, counts.view(4, std::size_t(agents)));
            });
            return array(std::move(counts), {4, std::size_t(agents)});
        },
        "states"_in, "x_m"_a, "y_m"_a, "cell_m"_a, "heights_m"_in, "half_extent_m"_a, "pose"_in, "places_m"_in, "ground_m"_in,
        "owner"_in, "is_free"_in, "own"_a, "agents"_a, "blockers"_in, "from_above"_a, "nearest_m"_a, "farthest_m"_a,
        "same_ground_m"_a,
        "Return counts (4, agents) of others' surfaces: claimed, seen through; and of their free ground: open, "
        "denied.");
    m.def(
        "compare_past",
        [](In2<std::uint8_t> states, double x_m, double y_m, double cell_m, In2<std::uint8_t> last_states, double last_x_m,
           double last_y_m, double last_cell_m, In1<double> last_from_now, In2<double> places) {
            require(places.shape(1) == 2, "places must have two columns");
            const auto counts = compare_past(cells_of(states, x_m, y_m, cell_m),
                                             cells_of(last_states, last_x_m, last_y_m, last_cell_m), pose_of(last_from_now),
                                             view(places));
            return tuple_of(counts[0], counts[1], counts[2], counts[3], counts[4]);
        },
        "states"_in, "x_m"_a, "y_m"_a, "cell_m"_a, "last_states"_in, "last_x_m"_a, "last_y_m"_a, "last_cell_m"_a,
        "last_from_now"_in, "places"_in,
        "Count places visible now, visible then, at either time, hidden now but visible then, visible now but hidden "
        "then.");
}

}  // namespace viewshed
