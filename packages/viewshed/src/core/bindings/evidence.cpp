#include "evidence.hpp"

#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "bindings.hpp"
#include "calibration.hpp"
#include "stages.hpp"

namespace viewshed {
namespace {

// Azimuth, slope and depth_m of measured beams; azimuth, slope, likely, early and late depth of beams without a return.
using BeamArrays = std::tuple<In1<float>, In1<float>, In1<float>>;
using LostArrays = std::tuple<In1<float>, In1<float>, In1<float>, In1<float>, In1<float>>;

Beams beams_of(const BeamArrays& arrays) {
    const auto& [azimuth, slope, depth_m] = arrays;
    require(are_as_long(azimuth, slope, depth_m), "azimuth, slope and depth_m must have one shape (B,)");
    require(azimuth.shape(0) < (1u << 30), "beams must be fewer than 2^30");
    return {view(azimuth), view(slope), view(depth_m)};
}

LostBeams lost_beams_of(const LostArrays& arrays) {
    const auto& [azimuth, slope, likely_m, early_m, late_m] = arrays;
    LostBeams lost{};
    for (std::size_t d = 0; const auto* depth_m : {&likely_m, &early_m, &late_m}) {
        const Beams beams = beams_of({azimuth, slope, *depth_m});
        lost.azimuth = beams.azimuth, lost.slope = beams.slope, lost.depth_m[d++] = beams.depth_m;
    }
    return lost;
}

const std::uint8_t* bytes_of(const In2<bool>& mask) { return reinterpret_cast<const std::uint8_t*>(mask.data()); }

TargetGround ground_of(const In2<float>& heights_m, const In2<float>& std_m, float half_extent_m, float sensor_height_m) {
    const std::size_t nodes = heights_m.shape(0);
    require(nodes >= 2 && nodes <= 16384 && heights_m.shape(1) == nodes,
            "heights_m must have shape (nodes, nodes), 2 to 16384 of them");
    require(have_one_shape(heights_m, std_m), "std_m must have the shape of heights_m");
    require(std::isfinite(half_extent_m) && half_extent_m > 0, "half_extent_m must be positive and finite");
    return {view(heights_m), view(std_m), half_extent_m, sensor_height_m};
}

// Evidence (cells, cells): measured, inferred, late, aimed, counted_prob, own_prob.
using EvidenceArrays = std::tuple<In2<float>, In2<float>, In2<float>, In2<float>, In2<float>, In2<float>>;
// Azimuth, range_m and height_m (M,) of the returns of a leveled sweep.
using ReturnArrays = std::tuple<In1<float>, In1<float>, In1<float>>;

CellEvidence cells_of(const CellWindows& windows, const EvidenceArrays& arrays) {
    const auto& [measured, inferred, late, aimed, counted, own] = arrays;
    require(have_one_shape(measured, inferred, late, aimed, counted, own) && measured.shape(0) == windows.grid_rows &&
                measured.shape(1) == windows.grid_columns,
            "evidence must have the shape (cells, cells) of the windows");
    return {measured.data(), inferred.data(), late.data(), aimed.data(), counted.data(), own.data()};
}

LeveledReturns returns_of(const ReturnArrays& arrays, float low_m, float high_m) {
    const auto& [azimuth, range_m, height_m] = arrays;
    return viewshed::returns_of(azimuth, range_m, height_m, low_m, high_m);
}

View1<const float> table_of(const In1<float>& table) {
    require(table.shape(0) > 0, "table must have at least one probability");
    return view(table);
}

}  // namespace

void bind_evidence(nb::module_& m) {
    m.attr("THRESHOLD") = THRESHOLD;
    m.attr("UNSURE_M") = UNSURE_M;
    m.def(
        "poisson_table",
        [](int min_returns) {
            require(min_returns >= 1 && min_returns <= 10000, "min_returns must lie in [1, 10000]");
            return array(poisson_table(min_returns));
        },
        "min_returns"_a, "Return P(N >= min_returns), N Poisson, at means 0, 1/32, 2/32 and so on, until it is 1.");
    m.def(
        "probability_of_visible",
        [](In1<float> counts, In1<float> table) {
            Buffer<float> prob(counts.shape(0));
            without_lock([&] { look_up(table_of(table), view(counts), prob); });
            return array(std::move(prob));
        },
        "counts"_in, "table"_in, "Return the probability (N,) at mean counts (N,), from a poisson_table.");
    m.def(
        "expected_returns",
        [](const CellWindows& windows, const BeamArrays& beams_, In2<float> heights_m, float half_extent_m,
           float sensor_height_m, float target_height_m) {
            const Beams beams = beams_of(beams_);
            const TargetGround ground = ground_of(heights_m, heights_m, half_extent_m, sensor_height_m);
            const std::size_t cells = windows.cells();
            Buffer<float> returns(cells), aimed(cells);
            without_lock([&] {
                const CellCounts counts = count_beams(windows, beams, {}, ground, target_height_m, nullptr);
                float lanes[LANES][CellCounts::BLOCK];
                for (std::size_t first = 0; first < cells; first += CellCounts::BLOCK) {
                    const std::size_t size = std::min(CellCounts::BLOCK, cells - first);
                    counts.read(first, size, lanes);
                    for (std::size_t n = 0; n < size; ++n) returns[first + n] = std::max(lanes[MEASURED][n], 0.0f);
                    std::copy_n(lanes[AIMED], size, &aimed[first]);
                }
            });
            const auto shaped = [&](auto& buffer) { return array(std::move(buffer), {windows.grid_rows, windows.grid_columns}); };
            return tuple_of(shaped(returns), shaped(aimed));
        },
        "windows"_a, "beams"_in, "heights_m"_in, "half_extent_m"_a, "sensor_height_m"_a,
        "target_height_m"_a,
        "Return expected returns (cells, cells) of a target in each cell, and the number of beams (cells, cells) "
        "that aim at it.");
    m.def(
        "beam_evidence",
        [](const CellWindows& windows, const BeamArrays& measured_beams, const LostArrays& lost_arrays,
           const ReturnArrays& return_arrays, In2<float> heights_m, In2<float> std_m, float half_extent_m,
           float sensor_height_m, float target_height_m, float low_m, float high_m, In1<float> table, float reach_m) {
            const Beams beams = beams_of(measured_beams);
            const LeveledReturns returns = returns_of(return_arrays, low_m, high_m);
            const LostBeams lost = lost_beams_of(lost_arrays);
            const TargetGround ground = ground_of(heights_m, std_m, half_extent_m, sensor_height_m);
            const View1<const float> probabilities = table_of(table);
            const std::size_t cells = windows.cells();
            Buffer<float> measured(cells), inferred(cells), late(cells), aimed(cells), counted(cells), own(cells), prob(cells);
            Buffer<bool> within_reach(cells);
            without_lock([&] {
                measure_evidence(windows, beams, lost, ground, target_height_m, probabilities, reach_m,
                                 {measured.data(), inferred.data(), late.data(), aimed.data(), counted.data(), own.data(),
                                  within_reach.data()});
                calibrate(windows, {measured.data(), inferred.data(), late.data(), aimed.data(), counted.data(), own.data()},
                          within_reach.data(), returns, ground.heights_m, prob);
            });
            const auto shaped = [&](auto& buffer) { return array(std::move(buffer), {windows.grid_rows, windows.grid_columns}); };
            return tuple_of(shaped(measured), shaped(inferred), shaped(late), shaped(aimed), shaped(counted), shaped(prob),
                            shaped(within_reach));
        },
        "windows"_a, "measured"_in, "lost"_in, "returns"_in, "heights_m"_in, "std_m"_in, nb::kw_only(), "half_extent_m"_a,
        "sensor_height_m"_a, "target_height_m"_a, "low_m"_a, "high_m"_a, "table"_in, "reach_m"_a,
        "Return measured, inferred, late, aimed, counted_prob, visible_prob, within_reach (cells, "
        "cells) of a target in each cell, from measured beams (azimuth, slope, depth), lost ones (azimuth, slope, likely, "
        "early and late depth), returns (azimuth, range_m, height_m), and height limits low_m and high_m of obstacles.");
    m.def(
        "cell_features",
        [](const CellWindows& windows, const EvidenceArrays& evidence, const ReturnArrays& returns, float low_m, float high_m,
           In2<float> heights_m) {
            Buffer<float> feature(SHOWN_FEATURES * windows.cells());
            const CellEvidence cells = cells_of(windows, evidence);
            const LeveledReturns seen = returns_of(returns, low_m, high_m);
            without_lock([&] {
                describe_cells(windows, cells, seen, view(heights_m),
                               {feature.data(), SHOWN_FEATURES, windows.cells()});
            });
            return array(std::move(feature), {SHOWN_FEATURES, windows.grid_rows, windows.grid_columns});
        },
        "windows"_a, "evidence"_in, "returns"_in, "low_m"_a, "high_m"_a, "heights_m"_in,
        "Return the features (features, cells, cells) of the network that corrects the counted probability: of each cell, "
        "then of the sweep. Evidence is measured, inferred, late, aimed, counted_prob and own_prob.");
    m.def(
        "states",
        [](In2<float> measured, In2<float> late, In2<float> aimed, In2<float> visible_prob, In2<bool> within_reach,
           In2<bool> visible, In2<bool> denied, In2<bool> obstacle, In1<float> table) {
            require(have_one_shape(measured, late, aimed, visible_prob, within_reach, visible, denied, obstacle),
                    "all arrays must have one shape (cells, cells)");
            const std::size_t cells = measured.size();
            const SupportedCells support{measured.data(), late.data(), aimed.data(), visible_prob.data(),
                                         bytes_of(within_reach)};
            Buffer<std::uint8_t> state(cells);
            without_lock([&] {
                write_states(support, view(table), {bytes_of(visible), bytes_of(denied), bytes_of(obstacle)}, state);
            });
            return array(std::move(state), {measured.shape(0), measured.shape(1)});
        },
        "measured"_in, "late"_in, "aimed"_in, "visible_prob"_in, "within_reach"_in, "visible"_in, "denied"_in,
        "obstacle"_in, nb::kw_only(), "table"_in,
        "Return states (cells, cells) uint8, from masks of cells that an estimator calls visible or denied, and of "
        "obstacles.");
    m.def(
        "claims",
        [](In2<std::uint8_t> state, In2<float> measured, In2<std::int32_t> node, In2<float> std_m, In1<float> table) {
            require(have_one_shape(state, measured, node), "state, measured and node must have one shape (cells, cells)");
            require(table.shape(0) > 0, "table must have at least one probability");
            require(state.size() < (1u << 31), "cells must be fewer than 2^31");
            const Buffer<std::int32_t> nodes =
                indices_of<std::int32_t>(view(node).flat(), 0, std::int32_t(std_m.size()) - 1, "node");
            const Claims claims = without_lock([&] {
                return count_claims(view(state).flat(), measured.data(), nodes.data(), view(std_m).flat(), view(table));
            });
            return tuple_of(claims.all, claims.over_unsure_ground, claims.inferred);
        },
        "state"_in, "measured"_in, "node"_in, "std_m"_in, nb::kw_only(),
        "table"_in,
        "Return how many cells (cells, cells) are free or surface, how many of these lie over unsure ground (by "
        "std_m at their node), and how many are not supported by measured returns alone.");
}

}  // namespace viewshed
