// What earlier sweeps saw.
#include "stages.hpp"

namespace viewshed {

void bind_history(nb::module_&) {}

}  // namespace viewshed
