#include "parallel.hpp"
#include "stages.hpp"

NB_MODULE(_core, m) {
    m.doc() = "The native core: from points to estimate, a stage a file (packages/viewshed/src/core).";
    m.attr("VERSION") = VIEWSHED_CORE_VERSION;
    m.def("threads", &viewshed::threads, "How many threads a stage may use.");
    m.def(
        "set_threads", [](std::size_t count) { viewshed::set_threads(count); }, nanobind::arg("count"),
        "Let a stage use up to this number of threads, 1 to 4.");
    viewshed::bind_range_image(m);
    viewshed::bind_sensor_id(m);
    viewshed::bind_ground(m);
    viewshed::bind_held_ground(m);
    viewshed::bind_leveling(m);
    viewshed::bind_level_sweep(m);
    viewshed::bind_no_return(m);
    viewshed::bind_grid(m);
    viewshed::bind_height_map(m);
    viewshed::bind_visibility(m);
    viewshed::bind_evidence(m);
    viewshed::bind_guarantees(m);
    viewshed::bind_boxes(m);
    viewshed::bind_object_candidates(m);
    viewshed::bind_shape_classifier(m);
    viewshed::bind_history(m);
    viewshed::bind_features(m);
    viewshed::bind_mc_dropout(m);
    viewshed::bind_ray_trace(m);
    viewshed::bind_concave_hull(m);
    viewshed::bind_polygons(m);
    viewshed::bind_files(m);
    viewshed::bind_temporal_evidence(m);
    viewshed::bind_fov_code(m);
    viewshed::bind_agent_views(m);
}
