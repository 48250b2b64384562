#include "parallel.hpp"
#include "stages.hpp"

NB_MODULE(_core, m) {
    m.doc() = "Native core: from points to estimates, one stage per file (packages/viewshed/src/core).";
    m.attr("VERSION") = VIEWSHED_CORE_VERSION;
    m.def("threads", &viewshed::threads, "Return how many threads a stage may use.");
    m.def(
        "set_threads", [](std::size_t count) { viewshed::set_threads(count); }, nanobind::arg("count"),
        "Set how many threads a stage may use, 1 to 4.");
#define BIND(name) viewshed::bind_##name(m);
    VIEWSHED_BINDINGS(BIND)
}
