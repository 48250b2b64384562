#include "ground_guess.hpp"

#include <cmath>

#include "bindings.hpp"
#include "ground_lattice.hpp"

namespace viewshed {

namespace {

ShownGround shown_of(const In2<float>& heights_m, const In2<bool>& seen, double half_m) {
    const std::size_t n = heights_m.shape(0);
    require(heights_m.shape(1) == n && seen.shape(0) == n && seen.shape(1) == n, "heights_m and seen must be (n, n)");
    require_lattice(n, half_m);
    require(n >= 8 * FOLD && (n & (n - 1)) == 0, "a lattice must have a power of two of nodes a side, 32 at least");
    return {view(heights_m), view(seen), float(half_m)};
}

}  // namespace

void bind_ground_guess(nb::module_& m) {
    m.def(
        "guess_inputs",
        [](Points points, In1<float> azimuth, In1<float> range_m, In2<float> heights_m, In2<bool> seen, double half_m,
           float sensor_height_m) {
            const ShownGround shown = shown_of(heights_m, seen, half_m);
            const std::size_t count = points.shape(0), part = heights_m.shape(0) / FOLD;
            require(azimuth.shape(0) == count && range_m.shape(0) == count, "azimuth and range_m must be as long as points");
            require(std::fabs(sensor_height_m) <= MOST_M, "sensor_height_m must be finite");
            Buffer<float> inputs(GUESS_INPUTS * FOLD * FOLD * part * part);
            {
                nb::gil_scoped_release unlocked;
                guess_inputs({view(points), view(azimuth), view(range_m)}, shown, sensor_height_m, inputs);
            }
            return array(std::move(inputs), {1, GUESS_INPUTS * FOLD * FOLD, part, part});
        },
        "points"_a.noconvert(), "azimuth"_a.noconvert(), "range_m"_a.noconvert(), "heights_m"_a.noconvert(),
        "seen"_a.noconvert(), "half_m"_a, "sensor_height_m"_a,
        "Inputs (1, 192, n / 4, n / 4) of the network that guesses the ground, from level points (M, 3) and the ground (n, n) "
        "that returns show.");
    m.def(
        "guessed_ground",
        [](nb::ndarray<const float, nb::ndim<4>, nb::c_contig, nb::device::cpu> outputs,
           nb::ndarray<const float, nb::ndim<4>, nb::c_contig, nb::device::cpu> inputs, In2<float> heights_m, In2<bool> seen,
           double half_m) {
            const ShownGround shown = shown_of(heights_m, seen, half_m);
            const std::size_t n = heights_m.shape(0), part = n / FOLD;
            const auto has = [&](const auto& array, std::size_t maps) {
                return array.shape(0) == 1 && array.shape(1) == maps * FOLD * FOLD && array.shape(2) == part &&
                       array.shape(3) == part;
            };
            require(has(outputs, GUESS_OUTPUTS), "outputs must be (1, 80, n / 4, n / 4)");
            require(has(inputs, GUESS_INPUTS), "inputs must be (1, 192, n / 4, n / 4)");
            require_bounded({outputs.data(), outputs.size()}, "outputs must be finite");
            Buffer<float> median(n * n), std(n * n);
            {
                nb::gil_scoped_release unlocked;
                guessed_ground({outputs.data(), outputs.size()}, {inputs.data(), inputs.size()}, shown, median, std);
            }
            return tuple_of(array(std::move(median), {n, n}), array(std::move(std), {n, n}));
        },
        "outputs"_a.noconvert(), "inputs"_a.noconvert(), "heights_m"_a.noconvert(), "seen"_a.noconvert(), "half_m"_a,
        "Heights and standard deviations (n, n) of the ground that outputs (1, 80, n / 4, n / 4) of the network stand for.");
}

}  // namespace viewshed
