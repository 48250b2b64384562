// Columns of files.
#include "stages.hpp"

namespace viewshed {

void bind_files(nb::module_&) {}

}  // namespace viewshed
