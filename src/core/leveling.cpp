// Points in the level frame.
#include "stages.hpp"

namespace viewshed {

void bind_leveling(nb::module_&) {}

}  // namespace viewshed
