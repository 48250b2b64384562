// Memory that is used again: a sweep needs about what the one before needed, and fresh pages cost more than the work on
// them.
#pragma once

#include <cstddef>

namespace viewshed {

// At least this number of bytes, aligned for vectors, from any thread; bad_alloc where there are none.
void* take_memory(std::size_t bytes);

// Give back what was taken; some of it is kept for the next.
void give_memory(void* taken) noexcept;

}  // namespace viewshed
