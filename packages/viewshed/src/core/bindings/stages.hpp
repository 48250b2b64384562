// The stages, each in a file of its own, that the module offers to Python.
#pragma once

#include "bindings.hpp"

namespace viewshed {

// Results of stages that several bindings hand back.
struct RangeImage;
struct LevelPoints;
using RangeImageArrays = Tuple<Out<std::int32_t>, Out<std::uint8_t>, Out<float>, Out<float>, Out<bool>, Out<bool>,
                               std::optional<Out<bool>>, bool>;
using LevelArrays = Tuple<Out<float>, Out<float>, Out<float>, Out<float>, Out<std::int32_t>>;
RangeImageArrays range_image_arrays(RangeImage&& image);
LevelArrays level_arrays(LevelPoints&& level);

void bind_range_image(nb::module_& m);
void bind_sensor_id(nb::module_& m);
void bind_ground(nb::module_& m);
void bind_held_ground(nb::module_& m);
void bind_leveling(nb::module_& m);
void bind_level_sweep(nb::module_& m);
void bind_no_return(nb::module_& m);
void bind_grid(nb::module_& m);
void bind_height_map(nb::module_& m);
void bind_visibility(nb::module_& m);
void bind_evidence(nb::module_& m);
void bind_guarantees(nb::module_& m);
void bind_boxes(nb::module_& m);
void bind_object_candidates(nb::module_& m);
void bind_shape_classifier(nb::module_& m);
void bind_history(nb::module_& m);
void bind_features(nb::module_& m);
void bind_mc_dropout(nb::module_& m);
void bind_ray_trace(nb::module_& m);
void bind_concave_hull(nb::module_& m);
void bind_polygons(nb::module_& m);
void bind_files(nb::module_& m);
void bind_fov_code(nb::module_& m);
void bind_agent_views(nb::module_& m);
void bind_temporal_evidence(nb::module_& m);

}  // namespace viewshed
