#include "history.hpp"

#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <tuple>
#include <vector>

#include "bindings.hpp"

namespace viewshed {
namespace {

// Returns of a sweep from Python: points, height_m, and the transform (3, 4) to the present sensor.
using Cloud = std::tuple<Points, In1<float>, In2<float>>;

}  // namespace

void bind_history(nb::module_& m) {
    m.def(
        "obstacle_image",
        [](const std::vector<Cloud>& clouds, float least_m, float sensor_height_m) {
            for (const auto& [points, height_m, transform] : clouds) {
                require(height_m.shape(0) == points.shape(0), "height_m must have one value for each point");
                require(transform.shape(0) == 3 && transform.shape(1) == 4, "transform must have shape (3, 4)");
            }
            Buffer<float> image(SLOPE_ROWS * AZIMUTHS);
            without_lock([&] {
                std::vector<std::vector<Point>> sweeps;
                for (const auto& [points, height_m, transform] : clouds) {
                    sweeps.push_back(obstacle_points(view(points), view(height_m), view(transform), least_m));
                }
                draw_image(sweeps, sensor_height_m, image.view(SLOPE_ROWS, AZIMUTHS));
            });
            return array(std::move(image), {SLOPE_ROWS, AZIMUTHS});
        },
        "clouds"_in, "least_m"_a, "sensor_height_m"_a,
        "Return the range (rows, columns) of the nearest obstacle by slope and azimuth, +inf for none, from sweeps "
        "(points, height_m, transform) with their returns higher than least_m.");
    m.def(
        "end_at_obstacles",
        [](In2<float> image, In1<float> azimuth, In1<float> slope, In1<float> depth_m) {
            const std::size_t size = azimuth.shape(0);
            require(image.shape(0) == SLOPE_ROWS && image.shape(1) == AZIMUTHS, "image must be one of obstacle_image");
            require(are_as_long(azimuth, slope, depth_m), "azimuth, slope and depth_m must be as long");
            Buffer<float> out(size);
            without_lock([&] { end_at_obstacles(image.data(), azimuth.data(), slope.data(), depth_m.data(), size, out.data()); });
            return array(std::move(out));
        },
        "image"_in, "azimuth"_in, "slope"_in, "depth_m"_in,
        "Return the depth (B,) of beams, limited by the obstacle of an image in their direction.");
    m.def(
        "sight_lines",
        []() {
            Buffer<float> azimuth(SIGHT_LINES), slope(SIGHT_LINES);
            sight_lines(azimuth, slope);
            return tuple_of(array(std::move(azimuth)), array(std::move(slope)));
        },
        "Return azimuth and slope (L,) of lines of sight in every fourth row and column of the obstacle image.");
    m.def(
        "confirmed_cells",
        [](In2<bool> seen, In2<float> earlier_from_now, double origin_x_m, double origin_y_m, double cell_m,
           In2<float> open, In2<float> whole) {
            const std::size_t cells = seen.shape(0);
            require(seen.shape(1) == cells && have_one_shape(seen, open, whole),
                    "seen, in_view and whole must have one shape (cells, cells)");
            require(earlier_from_now.shape(0) == 2 && earlier_from_now.shape(1) == 3,
                    "earlier_from_now must have shape (2, 3)");
            require(cell_m > 0, "cell_m must be positive");
            Buffer<bool> confirmed(cells * cells);
            const float origin_m[2] = {float(origin_x_m), float(origin_y_m)};
            without_lock([&] {
                confirm_cells(view(seen), view(earlier_from_now), origin_m, float(cell_m), open.data(), whole.data(), confirmed.data());
            });
            return array(std::move(confirmed), {cells, cells});
        },
        "seen"_in, "earlier_from_now"_in, "origin_x_m"_a, "origin_y_m"_a, "cell_m"_a, "in_view"_in, "whole"_in,
        "Return a mask (cells, cells) of cells that an earlier sweep saw and to which enough of the whole view is "
        "open.");
}

}  // namespace viewshed
