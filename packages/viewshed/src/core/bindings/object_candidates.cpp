#include "object_candidates.hpp"

#include <algorithm>
#include <cmath>

#include "bindings.hpp"

namespace viewshed {

void bind_object_candidates(nb::module_& m) {
    m.def(
        "object_candidates",
        [](Points points, In1<float> height_m, In1<float> range_m, float sensor_height_m) {
            require(are_as_long(points, height_m, range_m), "points, height_m and range_m must be as long");
            require(std::isfinite(sensor_height_m), "sensor_height_m must be finite");
            const Candidates found = without_lock([&] {
                const Buffer<float> own = copy_of(view(points).flat()), own_m = copy_of(view(height_m));
                return find_candidates({own.data(), points.shape(0), 3}, own_m, view(range_m), sensor_height_m);
            });
            const std::size_t count = found.first.size();
            Buffer<float> sides(count * 6), shapes(count * SHAPES);
            for (std::size_t k = 0; k < count; ++k) {
                std::copy(found.sides[k].begin(), found.sides[k].end(), sides.begin() + k * 6);
                std::copy(found.shapes[k].begin(), found.shapes[k].end(), shapes.begin() + k * SHAPES);
            }
            return tuple_of(array_of(found.rows), array_of(found.first), array_of(found.last), array_of(found.parent),
                            array(std::move(sides), {count, 6}), array(std::move(shapes), {count, SHAPES}));
        },
        "points"_in, "height_m"_in, "range_m"_in, "sensor_height_m"_a,
        "Return object candidates: rows (P,) by candidate, first, last, parent (C,), sides (C, 6) and shapes (C, 32).");
}

}  // namespace viewshed
