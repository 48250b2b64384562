#include "sector_polygons.hpp"

#include <algorithm>
#include <numeric>

namespace viewshed {
namespace {

constexpr std::int64_t NO_NODE = -1;

// Cartesian tree: parent, first bin and end bin of each bin's widest sector. Bin 0 is the shortest and the root.
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

// Nodes in preorder, without sectors that reach no farther than their parent: these get width 0, and their children
// move to the parent. `size` is the number of nodes in a node's subtree.
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

// Merge a child into its siblings, which can use up to `held` sectors: total[k] becomes the best value of k sectors up
// to `after`, given[k] the child's part. The child uses at most `most`.
void merge(std::vector<double>& total, std::size_t held, const std::vector<double>& value, std::size_t most,
           std::size_t after, std::int16_t* given) {
    // From the largest k down, so that unread values are not overwritten.
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

// Return the nodes of the best choice. State: node, level of the nearest chosen ancestor (0 for none, d + 1 for depth
// d), remaining sectors. No node uses more sectors than its subtree has nodes.
std::vector<std::size_t> choose(const std::vector<double>& ranges, const Tree& tree, const Order& order,
                                std::size_t sectors, double inner) {
    // A node has one state for each level up to its depth.
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
    // Best values of the children merged so far, by depth of the open node and level; most sectors they can use; and
    // for each node the most that it and its merged siblings can use.
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
    // Backtrack; children occur in reverse order of merging.
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
    // Rotate the profile so that it starts at its shortest bin.
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
