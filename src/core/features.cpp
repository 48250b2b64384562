// What the networks are shown.
#include "stages.hpp"

namespace viewshed {

void bind_features(nb::module_&) {}

}  // namespace viewshed
