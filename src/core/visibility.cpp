// How many beams would return from a target in each cell.
#include "stages.hpp"

namespace viewshed {

void bind_visibility(nb::module_&) {}

}  // namespace viewshed
