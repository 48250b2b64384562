#include "mc_dropout.hpp"

#include "bindings.hpp"

namespace viewshed {

// What Python calls: arrays are checked here, whatever hands them in.
void bind_mc_dropout(nb::module_& m) {
    m.def(
        "mean_and_deviation",
        [](In2<float> probability) {
            require(probability.shape(0) >= 1, "there must be a pass");
            Buffer<float> mean(probability.shape(1)), deviation(probability.shape(1));
            without_lock([&] { find_moments(view(probability), mean, deviation); });
            return tuple_of(array(std::move(mean)), array(std::move(deviation)));
        },
        "probability"_in, "Mean and standard deviation (cells,) of probabilities (passes, cells).");
}

}  // namespace viewshed
