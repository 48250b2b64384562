// Ray tracing, first blocker and the like, by azimuth.
#include "stages.hpp"

namespace viewshed {

void bind_ray_trace(nb::module_&) {}

}  // namespace viewshed
