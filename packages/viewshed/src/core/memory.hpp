// Reusable memory: each sweep needs about as much as the one before, and fresh pages cost more than the work on them.
#pragma once

#include <cstddef>

namespace viewshed {

// Return at least this number of bytes, aligned for vectors, from any thread; throws bad_alloc.
void* take_memory(std::size_t bytes);

// Return memory to the pool; some of it is kept for reuse.
void give_memory(void* taken) noexcept;

}  // namespace viewshed
