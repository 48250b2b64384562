#include "boxes.hpp"

#include <cmath>

#include "bindings.hpp"

namespace viewshed {

void bind_boxes(nb::module_& m) {
    nb::class_<BeamsByAzimuth>(m, "BeamsByAzimuth", "Beams (B,) sorted by azimuth.")
        .def(
            "__init__",
            [](BeamsByAzimuth* self, In1<float> azimuth, In1<float> slope, In1<float> depth_m) {
                require(are_as_long(azimuth, slope, depth_m), "azimuth, slope and depth_m must have one shape (B,)");
                new (self) BeamsByAzimuth(view(azimuth), view(slope), view(depth_m));
            },
            "azimuth"_in, "slope"_in, "depth_m"_in)
        .def(
            "expected_returns",
            [](const BeamsByAzimuth& beams, In2<float> boxes, float sensor_height_m, bool leave_out_own) {
                const std::size_t count = boxes.shape(0);
                require(boxes.shape(1) == NUMBERS, "boxes must have shape (K, 7)");
                require(std::isfinite(sensor_height_m), "sensor_height_m must be finite");
                const Buffer<float> own = copy_of(view(boxes).flat());
                for (std::size_t k = 0; k < own.size(); ++k) {
                    const float number = own[k];
                    require(std::isfinite(number) && std::fabs(number) < 1e6f, "boxes must be finite, and less than 1e6");
                    const bool is_size = k % NUMBERS >= 3 && k % NUMBERS < 6;
                    require(!is_size || number > 0, "length, width and height of boxes must be positive");
                }
                Buffer<std::int32_t> returns(count);
                without_lock([&] { beams.count({own.data(), count, NUMBERS}, sensor_height_m, leave_out_own, returns); });
                return array(std::move(returns));
            },
            "boxes"_in, "sensor_height_m"_a, "leave_out_own"_a,
            "Count the beams (K,) int32 that would meet each box (K, 7): center, length, width, height, yaw in level.");
}

}  // namespace viewshed
