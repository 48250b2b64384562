// Stages that the module offers to Python, one file each.
#pragma once

#include "bindings.hpp"

namespace viewshed {

// Results of stages returned by several bindings.
struct RangeImage;
struct LevelPoints;
struct LeveledReturns;
using RangeImageArrays = Tuple<Out<std::int32_t>, Out<std::uint8_t>, Out<float>, Out<float>, Out<bool>, Out<bool>,
                               std::optional<Out<bool>>, bool>;
using LevelArrays = Tuple<Out<float>, Out<float>, Out<float>, Out<float>, Out<std::int32_t>>;
RangeImageArrays range_image_arrays(RangeImage&& image);
LevelArrays level_arrays(LevelPoints&& level);

// Check and view the returns (M,) of a leveled sweep.
LeveledReturns returns_of(const In1<float>& azimuth, const In1<float>& range_m, const In1<float>& height_m, float low_m,
                          float high_m);

// Binding files, in the order in which the module binds them.
#define VIEWSHED_BINDINGS(bind)                                                                                     \
    bind(range_image) bind(sensor_id) bind(ground) bind(held_ground) bind(leveling)                                 \
    bind(level_sweep) bind(no_return) bind(grid) bind(height_map) bind(visibility) bind(evidence)                   \
    bind(guarantees) bind(boxes) bind(object_candidates) bind(shape_classifier) bind(history)                       \
    bind(mc_dropout) bind(ray_trace) bind(concave_hull) bind(polygons) bind(files) bind(temporal_evidence)          \
    bind(fov_code) bind(agent_views)
#define DECLARE(name) void bind_##name(nb::module_& m);
VIEWSHED_BINDINGS(DECLARE)
#undef DECLARE

}  // namespace viewshed
