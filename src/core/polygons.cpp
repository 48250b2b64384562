// Polygons of cells.
#include "stages.hpp"

namespace viewshed {

void bind_polygons(nb::module_&) {}

}  // namespace viewshed
