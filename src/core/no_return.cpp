// Beams without a return, and how far they went.
#include "stages.hpp"

namespace viewshed {

void bind_no_return(nb::module_&) {}

}  // namespace viewshed
