#include "ground_guess.hpp"

#include <cmath>

#include "bindings.hpp"
#include "ground_lattice.hpp"

namespace viewshed {

namespace {

FoundOnLattice found_of(const In2<float>& heights_m, const In2<float>& std_m, const In2<bool>& seen, double half_m) {
    const std::size_t n = heights_m.shape(0);
    const auto has_shape = [n](const auto& array) { return array.shape(0) == n && array.shape(1) == n; };
    require(has_shape(heights_m) && has_shape(std_m) && has_shape(seen), "heights_m, std_m and seen must be (n, n)");
    require_lattice(n, half_m);
    require(n % LEAST_GUESSED_NODES == 0, "a lattice must have a multiple of 32 nodes a side");
    require_bounded(view(heights_m).flat(), "heights_m must be finite");
    require_bounded(view(std_m).flat(), "std_m must be finite");
    return {view(heights_m), view(std_m), view(seen), float(half_m)};
}

LevelReturns returns_of(const Points& points, const In1<float>& azimuth, const In1<float>& range_m, float sensor_height_m) {
    const std::size_t count = points.shape(0);
    require(azimuth.shape(0) == count && range_m.shape(0) == count, "azimuth and range_m must be as long as points");
    require(std::fabs(sensor_height_m) <= MOST_M, "sensor_height_m must be finite");
    return {view(points), view(azimuth), view(range_m)};
}

}  // namespace

void bind_ground_guess(nb::module_& m) {
    m.def(
        "guess_inputs",
        [](Points points, In1<float> azimuth, In1<float> range_m, In2<float> heights_m, In2<float> std_m, In2<bool> seen,
           double half_m, float sensor_height_m) {
            const FoundOnLattice ground = found_of(heights_m, std_m, seen, half_m);
            const LevelReturns returns = returns_of(points, azimuth, range_m, sensor_height_m);
            const std::size_t n = heights_m.shape(0);
            Buffer<float> inputs(GUESS_INPUTS * n * n);
            without_lock([&] { guess_inputs(returns, ground, sensor_height_m, inputs); });
            return array(std::move(inputs), {n / FOLD, n / FOLD, FOLD * FOLD * GUESS_INPUTS});
        },
        "points"_in, "azimuth"_in, "range_m"_in, "heights_m"_in, "std_m"_in, "seen"_in, "half_m"_a, "sensor_height_m"_a,
        "Inputs (n / 4, n / 4, 208) of the network that guesses the ground, from level points (M, 3) and the found ground (n, n).");
    m.def(
        "guess_ground",
        [](Points points, In1<float> azimuth, In1<float> range_m, In2<float> heights_m, In2<float> std_m, In2<bool> seen,
           double half_m, float sensor_height_m) {
            const FoundOnLattice ground = found_of(heights_m, std_m, seen, half_m);
            const LevelReturns returns = returns_of(points, azimuth, range_m, sensor_height_m);
            const std::size_t n = heights_m.shape(0);
            Buffer<float> median(n * n), std(n * n);
            without_lock([&] {
                guess_ground(returns, ground, sensor_height_m, median.view(n, n), std.view(n, n));
            });
            return tuple_of(array(std::move(median), {n, n}), array(std::move(std), {n, n}));
        },
        "points"_in, "azimuth"_in, "range_m"_in, "heights_m"_in, "std_m"_in, "seen"_in, "half_m"_a, "sensor_height_m"_a,
        "Heights and standard deviations (n, n) of the ground, guessed where no return shows it.");
}

}  // namespace viewshed
