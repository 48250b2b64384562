// Thread pool: the parts of a stage run on its threads and on the calling thread.
#pragma once

#include <cstddef>
#include <functional>

namespace viewshed {

// Return how many threads a stage may use; initially OMP_NUM_THREADS or the processor's number, at most 4.
std::size_t threads();
// The pool is resized at once, or before the next job if one is running.
void set_threads(std::size_t count);

// Call part(k) for k in [0, parts) on all threads. If another sweep already uses the pool, run all parts on the calling
// thread. Parts must not depend on their thread or order, so that results are bit-identical on any number of threads.
// Rethrows the exception of the first part (lowest k) that threw.
void run_parts(std::size_t parts, const std::function<void(std::size_t)>& part);

// Split [0, size) into about equal ranges of at least `least` elements, at most one per thread; call body(part, begin,
// end).
std::size_t count_parts(std::size_t size, std::size_t least);
template <typename Body>
void for_ranges(std::size_t size, std::size_t parts, const Body& body) {
    if (parts <= 1) {
        body(std::size_t{0}, std::size_t{0}, size);
        return;
    }
    run_parts(parts, [&](std::size_t k) { body(k, size * k / parts, size * (k + 1) / parts); });
}

}  // namespace viewshed
