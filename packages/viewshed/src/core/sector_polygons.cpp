#include "sector_polygons.hpp"

#include <algorithm>
#include <numeric>

namespace viewshed {
namespace {

constexpr std::int64_t NO_NODE = -1;

// The Cartesian tree: of each bin's widest sector the parent, its first and its end bin. Bin 0 is the shortest, the root.
struct Tree {
    std::vector<std::int64_t> parent, low, high;

    explicit Tree(const std::vector<double>& ranges)
        : parent(ranges.size(), NO_NODE), low(ranges.size()), high(ranges.size(), std::int64_t(ranges.size())) {
        std::iota(low.begin(), low.end(), 0);
        std::vector<std::size_t> stack;
        for (std::size_t k = 0; k < ranges.size(); ++k) {
            std::int64_t last = NO_NODE;
            while (!stack.empty() && ranges[stack.back()] > ranges[k]) {
                last = std::int64_t(stack.back());
                high[stack.back()] = std::int64_t(k);
                stack.pop_back();
            }
            if (last >= 0) {
                parent[std::size_t(last)] = std::int64_t(k);
                low[k] = low[std::size_t(last)];
            }
            if (!stack.empty()) parent[k] = std::int64_t(stack.back());
            stack.push_back(k);
        }
    }
};

// Nodes from parents to children, without those of a sector that reaches no farther than its parent: these have no width,
// and their children belong to the parent. Size: how many nodes are at and below a node.
struct Order {
    std::vector<std::size_t> nodes;
    std::vector<std::int64_t> width;
    std::vector<std::size_t> depth, size;

    Order(const std::vector<double>& ranges, Tree& tree)
        : nodes(ranges.size()), width(ranges.size()), depth(ranges.size(), 0), size(ranges.size()) {
        const auto bins = std::int64_t(ranges.size());
        for (std::size_t k = 0; k < ranges.size(); ++k) width[k] = tree.high[k] - tree.low[k];
        std::iota(nodes.begin(), nodes.end(), 0);
        std::stable_sort(nodes.begin(), nodes.end(), [&](std::size_t a, std::size_t b) {
            return (tree.low[a] + 1) * (bins + 1) - width[a] < (tree.low[b] + 1) * (bins + 1) - width[b];
        });
        for (std::size_t n = 1; n < nodes.size(); ++n) {
            const std::size_t node = nodes[n];
            auto parent = std::size_t(tree.parent[node]);
            if (width[parent] == 0) parent = std::size_t(tree.parent[node] = tree.parent[parent]);
            if (ranges[node] == ranges[parent]) width[node] = 0;
        }
        std::erase_if(nodes, [&](std::size_t node) { return width[node] == 0; });
        for (std::size_t n = 1; n < nodes.size(); ++n) depth[nodes[n]] = depth[std::size_t(tree.parent[nodes[n]])] + 1;
        for (std::size_t n = nodes.size(); n-- > 0;) {
            ++size[nodes[n]];
            if (n > 0) size[std::size_t(tree.parent[nodes[n]])] += size[nodes[n]];
        }
    }
};

// Add a child to its siblings, which can spend up to `held` sectors: total[k] becomes the best split of k up to `after`,
// given[k] the child's part of it. The child spends at most `most`.
void merge(std::vector<double>& total, std::size_t held, const std::vector<double>& value, std::size_t most,
           std::size_t after, std::int16_t* given) {
    // From the largest k down: what is read is not written yet. More than they can spend is of no use to the siblings.
    for (std::size_t k = after + 1; k-- > 0;) {
        double best = total[std::min(k, held)];
        for (std::size_t c = std::max<std::size_t>(k - std::min(k, held), 1); c <= std::min(k, most); ++c) {
            if (total[k - c] + value[c] > best) {
                best = total[k - c] + value[c];
                given[k] = std::int16_t(c);
            }
        }
        total[k] = best;
    }
}

// The nodes of the best choice. State: node, level of the nearest chosen ancestor, sectors to spend. Level 0 is none,
// level d + 1 the ancestor at depth d. No node spends more sectors than it has nodes at and below it.
std::vector<std::size_t> choose(const std::vector<double>& ranges, const Tree& tree, const Order& order,
                                std::size_t sectors, double inner) {
    // A node has a state for each level up to its own depth.
    const std::size_t depths = *std::max_element(order.depth.begin(), order.depth.end()) + 1, spend = sectors + 1;
    std::vector<std::size_t> begin(ranges.size());
    std::size_t states = 0;
    for (const std::size_t node : order.nodes) {
        begin[node] = states;
        states += order.depth[node] + 1;
    }
    const auto state = [&](std::size_t node, std::size_t level) { return (begin[node] + level) * spend; };
    std::vector<char> taken(states * spend);
    std::vector<std::int16_t> given(states * spend, 0);
    // Of the children of the open node at each depth, by level, the best of what is spent on them; and the most that
    // they can spend. Of each node the most that it and the siblings before it can spend.
    std::vector<std::vector<std::vector<double>>> below(depths);
    for (std::size_t d = 0; d < depths; ++d) below[d].assign(d + 2, std::vector<double>(spend, 0.0));
    std::vector<std::size_t> held(depths, 0), after(ranges.size(), 0);
    std::vector<double> path(depths + 1), value(spend);
    for (std::size_t n = order.nodes.size(); n-- > 0;) {
        const std::size_t node = order.nodes[n], depth = order.depth[node], most = std::min(sectors, order.size[node]);
        auto& children = below[depth];
        for (std::int64_t above = tree.parent[node]; above >= 0; above = tree.parent[std::size_t(above)]) {
            path[order.depth[std::size_t(above)] + 1] = ranges[std::size_t(above)] * ranges[std::size_t(above)];
        }
        path[0] = inner * inner;
        if (n > 0) after[node] = std::min(sectors, held[depth - 1] + most);
        for (std::size_t level = 0; level <= depth; ++level) {
            const double gain = (ranges[node] * ranges[node] - path[level]) * double(order.width[node]);
            value[0] = children[level][0];
            for (std::size_t k = 1; k <= most; ++k) {
                value[k] = children[level][std::min(k, held[depth])];
                if (gain + children[depth + 1][k - 1] > value[k]) {
                    value[k] = gain + children[depth + 1][k - 1];
                    taken[state(node, level) + k] = 1;
                }
            }
            if (n > 0) merge(below[depth - 1][level], held[depth - 1], value, most, after[node], &given[state(node, level)]);
        }
        for (auto& of_level : children) std::fill_n(of_level.begin(), held[depth] + 1, 0.0);
        held[depth] = 0;
        if (n > 0) held[depth - 1] = after[node];
    }
    // Children are met in the reverse of the order in which they were merged.
    std::vector<std::size_t> chosen, left(ranges.size(), 0), level(ranges.size(), 0);
    for (std::size_t n = 0; n < order.nodes.size(); ++n) {
        const std::size_t node = order.nodes[n];
        std::size_t k = std::min(sectors, order.size[node]);
        if (n > 0) {
            const auto parent = std::size_t(tree.parent[node]);
            level[node] = level[parent];
            k = std::size_t(given[state(node, level[node]) + std::min(left[parent], after[node])]);
            left[parent] -= k;
        }
        if (taken[state(node, level[node]) + k]) {
            chosen.push_back(node);
            --k;
            level[node] = order.depth[node] + 1;
        }
        left[node] = k;
    }
    return chosen;
}

}  // namespace

BestSectors best_sectors(View1<const double> ranges, std::size_t sectors, double inner) {
    // The profile from its shortest bin on.
    const std::size_t bins = ranges.size, cut = std::size_t(std::min_element(ranges.begin(), ranges.end()) - ranges.begin());
    std::vector<double> rolled(bins);
    for (std::size_t k = 0; k < bins; ++k) rolled[k] = std::max(ranges[(k + cut) % bins], inner);
    Tree tree(rolled);
    const Order order(rolled, tree);
    std::vector<std::size_t> chosen = choose(rolled, tree, order, sectors, inner);
    const auto first = [&](std::size_t node) { return (tree.low[node] + std::int64_t(cut)) % std::int64_t(bins); };
    std::stable_sort(chosen.begin(), chosen.end(), [&](std::size_t a, std::size_t b) { return first(a) < first(b); });
    BestSectors found;
    for (const std::size_t node : chosen) {
        found.first.push_back(first(node));
        found.end.push_back(first(node) + tree.high[node] - tree.low[node]);
        found.range.push_back(rolled[node]);
    }
    return found;
}

}  // namespace viewshed
