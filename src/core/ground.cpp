// Local ground and its uncertainty.
#include "stages.hpp"

namespace viewshed {

void bind_ground(nb::module_&) {}

}  // namespace viewshed
