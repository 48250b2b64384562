#include "reach.hpp"

#include <optional>

#include "bindings.hpp"

namespace viewshed {

void bind_reach(nb::module_& m) {
    m.def(
        "sensing_reach",
        [](In1<float> range_m, In1<bool> left_out, std::optional<In1<std::int32_t>> rows, double most_m) {
            const std::size_t count = range_m.shape(0);
            require(rows || left_out.shape(0) == count, "left_out must be as long as range_m");
            require(!rows || rows->shape(0) == count, "rows must be as long as range_m");
            require(count == 0 || left_out.shape(0) > 0, "left_out must have an element for each row");
            Buffer<std::int32_t> of_point(0);
            if (count && rows) of_point = indices_of<std::int32_t>(view(*rows), 0, std::int32_t(left_out.shape(0) - 1), "rows");
            nb::gil_scoped_release unlocked;
            return sensing_reach(view(range_m), view(left_out), of_point, most_m);
        },
        "range_m"_in, "left_out"_in, "rows"_in.none(), "most_m"_a,
        "Reach that ranges (M,) up to most_m show; those left out, by themselves or by their rows, do not count.");
}

}  // namespace viewshed
