#include "ground_guess.hpp"

#include <cmath>

#include "bindings.hpp"
#include "ground_lattice.hpp"

namespace viewshed {

void bind_ground_guess(nb::module_& m) {
    m.def(
        "guess_inputs",
        [](Points points, In1<float> azimuth, In1<float> range_m, In2<float> heights_m, In2<float> std_m, In2<bool> seen,
           double half_m, float sensor_height_m) {
            const std::size_t count = points.shape(0), n = heights_m.shape(0);
            const auto has_shape = [n](const auto& array) { return array.shape(0) == n && array.shape(1) == n; };
            require(has_shape(heights_m) && has_shape(std_m) && has_shape(seen), "heights_m, std_m and seen must be (n, n)");
            require_lattice(n, half_m);
            require(azimuth.shape(0) == count && range_m.shape(0) == count, "azimuth and range_m must be as long as points");
            require(std::fabs(sensor_height_m) <= MOST_M, "sensor_height_m must be finite");
            Buffer<float> inputs(GUESS_INPUTS * n * n);
            without_lock([&] {
                guess_inputs({view(points), view(azimuth), view(range_m)}, {view(heights_m), view(std_m), view(seen), float(half_m)},
                             sensor_height_m, inputs);
            });
            return array(std::move(inputs), {GUESS_INPUTS, n, n});
        },
        "points"_in, "azimuth"_in, "range_m"_in, "heights_m"_in, "std_m"_in, "seen"_in, "half_m"_a, "sensor_height_m"_a,
        "Inputs (13, n, n) of the network that guesses the ground, from level points (M, 3) and the found ground (n, n).");
}

}  // namespace viewshed
