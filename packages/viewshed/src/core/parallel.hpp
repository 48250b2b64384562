// Threads that are kept warm: the parts of a stage run on them and on the thread that asks.
#pragma once

#include <cstddef>
#include <functional>

namespace viewshed {

// How many threads a stage may use; at first as many as the processor runs, at most 4, or OMP_NUM_THREADS.
std::size_t threads();
// Threads that are too many, or too few, end at once, or before the next job where one runs.
void set_threads(std::size_t count);

// Call part(k) for k in [0, parts), on as many threads as there are. Another sweep that is being worked on has the threads
// already: then all parts run here, one after the other. Parts must not depend on who runs them, or in which order, so
// that results are the same bit for bit on any number of threads. What the first of the parts that raise has raised is
// raised here.
void run_parts(std::size_t parts, const std::function<void(std::size_t)>& part);

// Cut [0, size) into about equal ranges of at least `least` elements, at most `most_parts` of them, and call
// body(part, begin, end) for each.
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
