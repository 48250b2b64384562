// The stages, each in a file of its own, that the module offers to Python.
#pragma once

#include "arrays.hpp"

namespace viewshed {

using namespace nb::literals;

void bind_range_image(nb::module_& m);

}  // namespace viewshed
