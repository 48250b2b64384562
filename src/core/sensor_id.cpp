// Rings and sensor from the points themselves.
#include "stages.hpp"

namespace viewshed {

void bind_sensor_id(nb::module_&) {}

}  // namespace viewshed
