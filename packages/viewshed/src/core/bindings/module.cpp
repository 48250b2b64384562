#include "parallel.hpp"
#include "stages.hpp"

NB_MODULE(_core, m) {
    m.doc() = "The native core: from points to estimate, a stage a file (packages/viewshed/src/core).";
    m.attr("VERSION") = VIEWSHED_CORE_VERSION;
    m.def("threads", &viewshed::threads, "How many threads a stage may use.");
    m.def(
        "set_threads", [](std::size_t count) { viewshed::set_threads(count); }, nanobind::arg("count"),
        "Let a stage use up to this number of threads, 1 to 4.");
#define BIND(name) viewshed::bind_##name(m);
    VIEWSHED_BINDINGS(BIND)
}
