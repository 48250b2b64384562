#include "mask_regions.hpp"

#include <algorithm>
#include <vector>

namespace viewshed {
namespace {

// Consecutive true cells of a row: [begin, end).
struct Run {
    std::size_t row, begin, end;
};

std::size_t root_of(std::vector<std::size_t>& parent, std::size_t run) {
    while (parent[run] != run) run = parent[run] = parent[parent[run]];
    return run;
}

}  // namespace

void label_regions(View2<const bool> mask, bool diagonal, View2<std::int32_t> labels) {
    const std::size_t reach = diagonal ? 1 : 0;
    std::vector<Run> runs;
    std::vector<std::size_t> parent;
    std::size_t above = 0;  // the first run of the row before
    for (std::size_t i = 0; i < mask.rows; ++i) {
        // 1. Find the runs of a row.
        const bool *row = mask[i], *end = row + mask.columns;
        const std::size_t first = runs.size();
        for (const bool* at = std::find(row, end, true); at != end; at = std::find(at, end, true)) {
            const bool* stop = std::find(at, end, false);
            parent.push_back(runs.size());
            runs.push_back({i, std::size_t(at - row), std::size_t(stop - row)});
            at = stop;
        }
        // 2. Join each run with the runs above that it touches; the root is the first run of its region.
        for (std::size_t k = first, m = above; k < runs.size() && m < first;) {
            if (runs[m].begin < runs[k].end + reach && runs[k].begin < runs[m].end + reach) {
                const std::size_t a = root_of(parent, k), b = root_of(parent, m);
                parent[std::max(a, b)] = std::min(a, b);
            }
            (runs[m].end < runs[k].end ? m : k) += 1;
        }
        above = first;
    }
    // 3. Number the roots in order.
    std::vector<std::int32_t> number(runs.size(), 0);
    std::int32_t regions = 0;
    std::fill_n(labels.data, labels.size(), 0);
    for (std::size_t k = 0; k < runs.size(); ++k) {
        const std::size_t root = root_of(parent, k);
        number[k] = root == k ? ++regions : number[root];
        std::fill(&labels(runs[k].row, runs[k].begin), labels[runs[k].row] + runs[k].end, number[k]);
    }
}

void find_squared_depth(View2<const bool> mask, View2<std::int64_t> depth) {
    const auto rows = std::int64_t(mask.rows), columns = std::int64_t(mask.columns);
    // 1. Along columns: distance to the nearest false cell above or below.
    std::vector<std::int64_t> along(mask.size());
    for (std::size_t j = 0; j < mask.columns; ++j) {
        for (std::int64_t i = 0, last = -1; i < rows; ++i) {
            last = mask(std::size_t(i), j) ? last : i;
            along[std::size_t(i) * mask.columns + j] = i - last;
        }
        for (std::int64_t i = rows - 1, next = rows; i >= 0; --i) {
            next = mask(std::size_t(i), j) ? next : i;
            std::int64_t& nearest = along[std::size_t(i) * mask.columns + j];
            nearest = std::min(nearest, next - i);
        }
    }
    // 2. Across columns: lower envelope of parabolas (Meijster et al. 2000); columns beyond the border are false.
    const std::int64_t wide = columns + 2;
    std::vector<std::int64_t> square(std::size_t(wide), 0), about(std::size_t(wide), 0), from(std::size_t(wide), 0);
    const auto parabola = [&](std::int64_t j, std::int64_t k) { return (j - k) * (j - k) + square[std::size_t(k)]; };
    for (std::size_t i = 0; i < mask.rows; ++i) {
        for (std::size_t j = 0; j < mask.columns; ++j) square[j + 1] = along[i * mask.columns + j] * along[i * mask.columns + j];
        std::size_t size = 1;
        about[0] = from[0] = 0;
        for (std::int64_t k = 1; k < wide; ++k) {
            while (size > 0 && parabola(from[size - 1], about[size - 1]) > parabola(from[size - 1], k)) --size;
            std::int64_t begin = 0;
            if (size > 0) {
                const std::int64_t last = about[size - 1];
                begin = 1 + (k * k - last * last + square[std::size_t(k)] - square[std::size_t(last)]) / (2 * (k - last));
            }
            if (begin >= wide) continue;
            about[size] = k;
            from[size++] = begin;
        }
        for (std::int64_t j = columns; j >= 1; --j) {
            while (from[size - 1] > j) --size;
            depth(i, std::size_t(j - 1)) = parabola(j, about[size - 1]);
        }
    }
}

}  // namespace viewshed
