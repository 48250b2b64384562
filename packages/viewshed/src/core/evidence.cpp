// What the beams of a sweep say about a target in each cell: probabilities, and the states that they support.
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

#include "parallel.hpp"
#include "stages.hpp"
#include "vectors.hpp"
#include "visibility.hpp"

namespace viewshed {
namespace {

// Means of a table of probabilities from one step to the next: 1 / STEPS.
constexpr int STEPS = 32;

// Where a cell needs this many returns or more, its probability is 0 or 1.
constexpr int MANY_RETURNS = 100;

// Cells of a part that is worth a thread.
constexpr std::size_t PART = 16384;

// The codes of viewshed.fov.estimate.CellState.
constexpr std::uint8_t UNKNOWN = 0, FREE = 1, SURFACE = 2, HIDDEN = 3;

// P(N >= min_returns), N Poisson with the mean k / STEPS, for k = 0, 1, 2 and so on, until it is 1.
Buffer<float> poisson_table(int min_returns) {
    const int top = min_returns + 10 * int(std::sqrt(double(min_returns))) + 10;
    Buffer<float> table(std::size_t(top) * STEPS + 1);
    double most = 0.0;
    for (std::size_t k = 0; k < table.size(); ++k) {
        const double mean = double(k) / STEPS;
        double prob = mean >= min_returns ? 1.0 : 0.0;
        if (min_returns <= MANY_RETURNS) {
            double below = 0.0, term = 1.0;  // P(N < min_returns), less the factor exp(-mean)
            for (int n = 0; n < min_returns; ++n) {
                below += term;
                term *= mean / (n + 1);
            }
            prob = std::clamp(1.0 - below * std::exp(-mean), 0.0, 1.0);
        }
        most = std::max(most, prob);
        table[k] = float(most);
    }
    return table;
}

// The probability at a mean that is not negative (0 if it is, or if it is not a number).
struct Probabilities {
    const float* table;
    float last;

    explicit Probabilities(View1<const float> of) : table(of.data), last(float(of.size - 1)) {}
    INLINE std::int32_t step_of(float mean) const {
        float step = mean * float(STEPS);
        step = step > 0.0f ? step : 0.0f;
        return std::int32_t(step < last ? step : last);
    }
};

MULTIVERSION void look_up(Probabilities probabilities, const float* counts, std::size_t size, float* prob) {
    for (std::size_t n = 0; n < size; ++n) prob[n] = probabilities.table[probabilities.step_of(counts[n])];
}

// What evidence weighs: the weights of the ground's own height, and of the lower and the higher one; the probability from
// which a claim is supported, and the largest one below it; and the reach.
struct Rule {
    float own, lower, higher;
    float threshold, below_threshold;
    float reach_m;
};

// The arrays (N,) of viewshed.preprocess.evidence.BeamEvidence.
struct Evidence {
    float *measured, *inferred, *unresolved, *aimed, *visible_prob;
    bool* within_reach;
};

INLINE void write_returns(const float* __restrict sums, std::size_t size, float* __restrict out) {
    for (std::size_t n = 0; n < size; ++n) out[n] = sums[n] > 0.0f ? sums[n] : 0.0f;
}

// Write the evidence of the cells [first, first + size) from their sums (LANES, size).
MULTIVERSION void judge_block(const float (*lanes)[CellCounts::BLOCK], std::size_t first, std::size_t size,
                              const float* range_m, const Probabilities& probabilities_, const Rule& rule_,
                              const Evidence& to) {
    const Rule rule = rule_;
    const Probabilities probabilities = probabilities_;
    write_returns(lanes[MEASURED], size, to.measured + first);
    write_returns(lanes[INFERRED], size, to.inferred + first);
    write_returns(lanes[UNRESOLVED], size, to.unresolved + first);
    std::copy_n(lanes[AIMED], size, to.aimed + first);
    const float *__restrict measured = to.measured + first, *__restrict inferred = to.inferred + first;
    const float *__restrict lower = lanes[LOWER], *__restrict higher = lanes[HIGHER];
    float* __restrict const visible_prob = to.visible_prob + first;
    // The steps become vectors, the look-ups do not.
    std::int32_t step[CellCounts::BLOCK], step_if_lower[CellCounts::BLOCK], step_if_higher[CellCounts::BLOCK];
    for (std::size_t n = 0; n < size; ++n) {
        step[n] = probabilities.step_of(measured[n] + inferred[n]);
        step_if_lower[n] = probabilities.step_of(lower[n]);
        step_if_higher[n] = probabilities.step_of(higher[n]);
    }
    float supported_by[CellCounts::BLOCK], if_lower[CellCounts::BLOCK], if_higher[CellCounts::BLOCK];
    for (std::size_t n = 0; n < size; ++n) {
        supported_by[n] = probabilities.table[step[n]];
        if_lower[n] = probabilities.table[step_if_lower[n]];
        if_higher[n] = probabilities.table[step_if_higher[n]];
    }
    for (std::size_t n = 0; n < size; ++n) {
        const float supported = supported_by[n];
        const float prob = rule.own * supported + rule.lower * if_lower[n] + rule.higher * if_higher[n];
        // No claim rests on other heights of the ground alone, and none lies beyond the reach, where things may be too dark.
        const float cut = prob < rule.below_threshold ? prob : rule.below_threshold;
        visible_prob[n] = (supported >= rule.threshold) & (range_m[first + n] <= rule.reach_m) ? prob : cut;
    }
    bool* __restrict const within_reach = to.within_reach + first;
    for (std::size_t n = 0; n < size; ++n) within_reach[n] = range_m[first + n] <= rule.reach_m;
}

// The mean from which on a probability is reached; +inf where none is. A mean is compared faster than it is looked up.
float mean_of(View1<const float> table, float prob) {
    const float* const first = std::lower_bound(table.begin(), table.end(), prob);
    return first == table.end() ? std::numeric_limits<float>::infinity() : float(first - table.begin()) / STEPS;
}

// What an estimator's cells must have: enough returns, a sure aim, a probability.
struct Support {
    const float *measured, *inferred, *aimed, *visible_prob;
    const std::uint8_t* within_reach;
    float enough, sure_aim, threshold;
};

// By bytes of 0 or 1, which become vectors, as bools do not.
MULTIVERSION void write_states(const Support& support_, const std::uint8_t* visible, const std::uint8_t* denied,
                               const std::uint8_t* obstacle, std::size_t begin, std::size_t end,
                               std::uint8_t* __restrict state) {
    const Support s = support_;
    for (std::size_t n = begin; n < end; ++n) {
        const std::uint8_t claimed = visible[n] & (s.visible_prob[n] >= s.threshold);
        const bool aimed = s.aimed[n] >= s.sure_aim;
        const bool enough = s.measured[n] + s.inferred[n] >= s.enough;
        const std::uint8_t hidden = denied[n] & aimed & !enough & s.within_reach[n];
        const std::uint8_t seen = obstacle[n] ? SURFACE : FREE, unseen = hidden ? HIDDEN : UNKNOWN;
        state[n] = claimed ? seen : unseen;
    }
}

// How many cells are claimed, how many of these lie over ground whose height is unsure by more than unsure_m, and how many
// measured beams alone would not support.
struct Claims {
    std::size_t all = 0, over_unsure_ground = 0, inferred = 0;
};

// Count them over some cells; is_unsure says whether the ground of each node is. By bytes, which become vectors.
MULTIVERSION Claims count_claims(const std::uint8_t* state, const float* measured, const std::int32_t* node,
                                 std::size_t cells, const std::int32_t* is_unsure, float enough) {
    std::int32_t all = 0, over_unsure_ground = 0, inferred = 0;
    for (std::size_t n = 0; n < cells; ++n) {
        const std::int32_t claimed = (state[n] == FREE) | (state[n] == SURFACE);
        all += claimed;
        inferred += claimed & !(measured[n] >= enough);
    }
    for (std::size_t n = 0; n < cells; ++n) {
        const std::int32_t claimed = (state[n] == FREE) | (state[n] == SURFACE);
        over_unsure_ground += claimed & is_unsure[node[n]];
    }
    return {std::size_t(all), std::size_t(over_unsure_ground), std::size_t(inferred)};
}

// The beams of one kind as Python hands them in: azimuth, slope, depth_m.
using BeamArrays = std::tuple<In1<float>, In1<float>, In1<float>>;

Beams beams_of(const BeamArrays& arrays) {
    const auto& [azimuth, slope, depth_m] = arrays;
    require(azimuth.shape(0) == slope.shape(0) && azimuth.shape(0) == depth_m.shape(0),
            "azimuth, slope and depth_m must have one shape (B,)");
    require(azimuth.shape(0) < (1u << 30), "beams must be fewer than 2^30");
    return {view(azimuth), view(slope), view(depth_m)};
}

const std::uint8_t* bytes_of(const In2<bool>& mask) { return reinterpret_cast<const std::uint8_t*>(mask.data()); }

TargetGround ground_of(const In2<float>& heights_m, const In2<float>& std_m, float half_extent_m, float sensor_height_m) {
    const std::size_t nodes = heights_m.shape(0);
    require(nodes >= 2 && nodes <= 16384 && heights_m.shape(1) == nodes,
            "heights_m must have shape (nodes, nodes), 2 to 16384 of them");
    require(std_m.shape(0) == nodes && std_m.shape(1) == nodes, "std_m must have the shape of heights_m");
    require(std::isfinite(half_extent_m) && half_extent_m > 0, "half_extent_m must be positive and finite");
    return {view(heights_m), view(std_m), half_extent_m, sensor_height_m};
}

Probabilities probabilities_of(const In1<float>& table) {
    require(table.shape(0) > 0, "table must have at least one probability");
    return Probabilities(view(table));
}

}  // namespace

void bind_evidence(nb::module_& m) {
    m.def(
        "poisson_table",
        [](int min_returns) {
            require(min_returns >= 1 && min_returns <= 10000, "min_returns must lie in [1, 10000]");
            return poisson_table(min_returns).array();
        },
        "min_returns"_a, "P(N >= min_returns), N Poisson, at means 0, 1/32, 2/32 and so on, until it is 1.");
    m.def(
        "probability_of_visible",
        [](In1<float> counts, In1<float> table) {
            Buffer<float> prob(counts.shape(0));
            look_up(probabilities_of(table), counts.data(), prob.size(), prob.data());
            return std::move(prob).array();
        },
        "counts"_a.noconvert(), "table"_a.noconvert(), "Probability (N,) at mean counts (N,), from a poisson_table.");
    m.def(
        "returns_by_kind",
        [](const CellWindows& windows, const std::vector<BeamArrays>& kinds, In2<float> heights_m, float half_extent_m,
           float sensor_height_m, float target_height_m) {
            require(kinds.size() >= 1 && kinds.size() <= 3, "kinds must be one to three sets of beams");
            std::array<Beams, 3> beams{};
            std::transform(kinds.begin(), kinds.end(), beams.begin(), beams_of);
            const TargetGround ground = ground_of(heights_m, heights_m, half_extent_m, sensor_height_m);
            const std::size_t cells = windows.cells();
            Buffer<float> returns(kinds.size() * cells), aimed(cells);
            {
                nb::gil_scoped_release unlocked;
                const CellCounts counts = count_beams(windows, beams, ground, target_height_m, nullptr);
                float lanes[LANES][CellCounts::BLOCK];
                for (std::size_t first = 0; first < cells; first += CellCounts::BLOCK) {
                    const std::size_t size = std::min(CellCounts::BLOCK, cells - first);
                    counts.read(first, size, lanes);
                    for (std::size_t kind = 0; kind < kinds.size(); ++kind) {
                        float* const out = &returns[kind * cells + first];
                        for (std::size_t n = 0; n < size; ++n) out[n] = std::max(lanes[kind][n], 0.0f);
                    }
                    std::copy_n(lanes[AIMED], size, &aimed[first]);
                }
            }
            return nb::make_tuple(std::move(returns).array({kinds.size(), windows.grid_rows, windows.grid_columns}),
                                  std::move(aimed).array({windows.grid_rows, windows.grid_columns}));
        },
        "windows"_a, "kinds"_a.noconvert(), "heights_m"_a.noconvert(), "half_extent_m"_a, "sensor_height_m"_a,
        "target_height_m"_a,
        "Expected returns (kinds, cells, cells) of a target in each cell, and the beams (cells, cells) of the first two kinds "
        "that aim.");
    m.def(
        "beam_evidence",
        [](const CellWindows& windows, const std::array<BeamArrays, 3>& kinds, In2<float> heights_m, In2<float> std_m,
           float half_extent_m, float sensor_height_m, float target_height_m,
           const std::array<std::pair<float, float>, 2>& ground_steps, In1<float> table, float threshold, float reach_m) {
            const std::array<Beams, 3> beams{beams_of(kinds[0]), beams_of(kinds[1]), beams_of(kinds[2])};
            const TargetGround ground = ground_of(heights_m, std_m, half_extent_m, sensor_height_m);
            const Probabilities probabilities = probabilities_of(table);
            const std::array<float, 2> deviations{ground_steps[0].first, ground_steps[1].first};
            const float lower = ground_steps[0].second, higher = ground_steps[1].second;
            const Rule rule{1.0f - lower - higher, lower, higher, threshold, std::nextafter(threshold, 0.0f), reach_m};
            const std::size_t cells = windows.cells();
            Buffer<float> measured(cells), inferred(cells), unresolved(cells), aimed(cells), visible_prob(cells);
            Buffer<bool> within_reach(cells);
            {
                nb::gil_scoped_release unlocked;
                const CellCounts counts = count_beams(windows, beams, ground, target_height_m, &deviations);
                const Evidence evidence{measured.data(), inferred.data(),     unresolved.data(),
                                        aimed.data(),    visible_prob.data(), within_reach.data()};
                for_ranges(cells, count_parts(cells, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
                    float lanes[LANES][CellCounts::BLOCK];
                    for (std::size_t first = begin; first < end; first += CellCounts::BLOCK) {
                        const std::size_t size = std::min(CellCounts::BLOCK, end - first);
                        counts.read(first, size, lanes);
                        judge_block(lanes, first, size, windows.cell_range_m.data(), probabilities, rule, evidence);
                    }
                });
            }
            const auto shaped = [&](auto& buffer) { return std::move(buffer).array({windows.grid_rows, windows.grid_columns}); };
            return nb::make_tuple(shaped(measured), shaped(inferred), shaped(unresolved), shaped(aimed),
                                  shaped(visible_prob), shaped(within_reach));
        },
        "windows"_a, "kinds"_a.noconvert(), "heights_m"_a.noconvert(), "std_m"_a.noconvert(), nb::kw_only(),
        "half_extent_m"_a, "sensor_height_m"_a, "target_height_m"_a, "ground_steps"_a, "table"_a.noconvert(),
        "threshold"_a, "reach_m"_a,
        "Measured, inferred, unresolved, aimed, visible_prob, within_reach (cells, cells) of a target in each cell, from "
        "beams of three kinds.");
    m.def(
        "states",
        [](In2<float> measured, In2<float> inferred, In2<float> aimed, In2<float> visible_prob, In2<bool> within_reach,
           In2<bool> visible, In2<bool> denied, In2<bool> obstacle, In1<float> table, float threshold, float sure_aim) {
            const auto has_shape = [&](const auto& array) {
                return array.shape(0) == measured.shape(0) && array.shape(1) == measured.shape(1);
            };
            require(has_shape(inferred) && has_shape(aimed) && has_shape(visible_prob) && has_shape(within_reach) &&
                        has_shape(visible) && has_shape(denied) && has_shape(obstacle),
                    "all arrays must have one shape (cells, cells)");
            const std::size_t cells = measured.size();
            const Support support{measured.data(),     inferred.data(),
                                  aimed.data(),        visible_prob.data(),
                                  bytes_of(within_reach), mean_of(view(table), threshold),
                                  mean_of(view(table), sure_aim), threshold};
            Buffer<std::uint8_t> state(cells);
            {
                nb::gil_scoped_release unlocked;
                for_ranges(cells, count_parts(cells, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
                    write_states(support, bytes_of(visible), bytes_of(denied), bytes_of(obstacle), begin, end, state.data());
                });
            }
            return std::move(state).array({measured.shape(0), measured.shape(1)});
        },
        "measured"_a.noconvert(), "inferred"_a.noconvert(), "aimed"_a.noconvert(), "visible_prob"_a.noconvert(),
        "within_reach"_a.noconvert(), "visible"_a.noconvert(), "denied"_a.noconvert(), "obstacle"_a.noconvert(),
        nb::kw_only(), "table"_a.noconvert(), "threshold"_a, "sure_aim"_a,
        "States (cells, cells) uint8 of cells that an estimator calls visible, or not, and that hold an obstacle or not.");
    m.def(
        "claims",
        [](In2<std::uint8_t> state, In2<float> measured, In2<std::int32_t> node, In2<float> std_m, In1<float> table,
           float threshold, float unsure_m) {
            const auto has_shape = [&](const auto& array) {
                return array.shape(0) == state.shape(0) && array.shape(1) == state.shape(1);
            };
            require(has_shape(measured) && has_shape(node), "state, measured and node must have one shape (cells, cells)");
            require(table.shape(0) > 0, "table must have at least one probability");
            require(state.size() < (1u << 31), "cells must be fewer than 2^31");
            const Buffer<std::int32_t> nodes =
                indices_of<std::int32_t>(view(node).flat(), 0, std::int32_t(std_m.size()) - 1, "node");
            Buffer<std::int32_t> is_unsure(std_m.size());
            for (std::size_t at = 0; at < is_unsure.size(); ++at) is_unsure[at] = std_m.data()[at] > unsure_m;
            const Claims claims = count_claims(state.data(), measured.data(), nodes.data(), state.size(),
                                               is_unsure.data(), mean_of(view(table), threshold));
            return nb::make_tuple(claims.all, claims.over_unsure_ground, claims.inferred);
        },
        "state"_a.noconvert(), "measured"_a.noconvert(), "node"_a.noconvert(), "std_m"_a.noconvert(), nb::kw_only(),
        "table"_a.noconvert(), "threshold"_a, "unsure_m"_a,
        "How many cells (cells, cells) are free or surface; how many of these lie over ground, at a node of std_m, that is "
        "unsure; and how many measured returns alone would not support.");
}

}  // namespace viewshed
