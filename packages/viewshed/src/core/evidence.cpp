#include "evidence.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Resolution of probability tables: steps per unit of the mean.
constexpr int STEPS = 32;

// From more required returns than this on, the Poisson probability is approximated as 0 or 1.
constexpr int MANY_RETURNS = 100;

// Offsets of the ground in standard deviations, and the weight of each; the estimated height has the rest. Their
// variance is nearly that of a normal distribution.
constexpr std::array<float, 2> GROUND_STEPS{-1.22f, 1.22f};
constexpr float STEP_WEIGHT = 0.3f, OWN_WEIGHT = 1.0f - STEP_WEIGHT - STEP_WEIGHT;

// Weight of the early and of the late depths of no-return beams; the likely depths have the rest.
constexpr float END_WEIGHT = 0.3f;

// Fewest cells for which a part pays for its thread.
constexpr std::size_t PART = 16384;

}  // namespace

Buffer<float> poisson_table(int min_returns) {
    const int top = min_returns + 10 * int(std::sqrt(double(min_returns))) + 10;
    Buffer<float> table(std::size_t(top) * STEPS + 1);
    double max_prob = 0.0;
    for (std::size_t k = 0; k < table.size(); ++k) {
        const double mean = double(k) / STEPS;
        double prob = mean >= min_returns ? 1.0 : 0.0;
        if (min_returns <= MANY_RETURNS) {
            double below = 0.0, term = 1.0;  // P(N < min_returns) / exp(-mean)
            for (int n = 0; n < min_returns; ++n) {
                below += term;
                term *= mean / (n + 1);
            }
            prob = std::clamp(1.0 - below * std::exp(-mean), 0.0, 1.0);
        }
        max_prob = std::max(max_prob, prob);
        table[k] = float(max_prob);
    }
    return table;
}

namespace {

// Lookup of a probability by its mean; negative means and NaN give the probability at 0.
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

INLINE void write_returns(const float* __restrict sums, std::size_t size, float* __restrict out) {
    for (std::size_t n = 0; n < size; ++n) out[n] = sums[n] > 0.0f ? sums[n] : 0.0f;
}

// Write the evidence of cells [first, first + size) from their sums (LANES, size).
MULTIVERSION void judge_block(const float (*lanes)[CellCounts::BLOCK], std::size_t first, std::size_t size,
                              const float* range_m, const Probabilities& probabilities_, float reach_m,
                              const Evidence& to) {
    const Probabilities probabilities = probabilities_;
    write_returns(lanes[MEASURED], size, to.measured + first);
    write_returns(lanes[INFERRED], size, to.inferred + first);
    write_returns(lanes[LATE], size, to.late + first);
    std::copy_n(lanes[AIMED], size, to.aimed + first);
    const float *__restrict measured = to.measured + first, *__restrict inferred = to.inferred + first;
    const float *__restrict early = lanes[EARLY], *__restrict late = to.late + first;
    const float *__restrict lower = lanes[LOWER], *__restrict higher = lanes[HIGHER];
    float* __restrict const counted_prob = to.counted_prob + first;
    // Computing the steps vectorizes, the look-ups do not: separate loops.
    std::int32_t step[CellCounts::BLOCK], step_if_lower[CellCounts::BLOCK], step_if_higher[CellCounts::BLOCK];
    std::int32_t step_if_early[CellCounts::BLOCK], step_if_late[CellCounts::BLOCK];
    for (std::size_t n = 0; n < size; ++n) {
        step[n] = probabilities.step_of(measured[n] + inferred[n]);
        step_if_lower[n] = probabilities.step_of(lower[n]);
        step_if_higher[n] = probabilities.step_of(higher[n]);
        step_if_early[n] = probabilities.step_of(measured[n] + early[n]);
        step_if_late[n] = probabilities.step_of(measured[n] + late[n]);
    }
    float* __restrict const own_prob = to.own_prob + first;
    float if_lower[CellCounts::BLOCK], if_higher[CellCounts::BLOCK];
    float if_early[CellCounts::BLOCK], if_late[CellCounts::BLOCK];
    for (std::size_t n = 0; n < size; ++n) {
        own_prob[n] = probabilities.table[step[n]];
        if_lower[n] = probabilities.table[step_if_lower[n]];
        if_higher[n] = probabilities.table[step_if_higher[n]];
        if_early[n] = probabilities.table[step_if_early[n]];
        if_late[n] = probabilities.table[step_if_late[n]];
    }
    for (std::size_t n = 0; n < size; ++n) {
        // Average over the ground heights, plus the change by early and late depths.
        const float over_ground = OWN_WEIGHT * own_prob[n] + STEP_WEIGHT * if_lower[n] + STEP_WEIGHT * if_higher[n];
        const float changed = END_WEIGHT * (if_early[n] - own_prob[n]) + END_WEIGHT * (if_late[n] - own_prob[n]);
        const float sum = over_ground + changed, positive = sum > 0.0f ? sum : 0.0f;
        counted_prob[n] = positive < 1.0f ? positive : 1.0f;
    }
    bool* __restrict const within_reach = to.within_reach + first;
    for (std::size_t n = 0; n < size; ++n) within_reach[n] = range_m[first + n] <= reach_m;
}

}  // namespace

void look_up(View1<const float> table, View1<const float> counts, View1<float> prob) {
    look_up(Probabilities(table), counts.data, counts.size, prob.data);
}

void measure_evidence(const CellWindows& windows, const Beams& measured, const LostBeams& lost, const TargetGround& ground,
                      float target_height_m, View1<const float> table, float reach_m, const Evidence& to) {
    const Probabilities probabilities(table);
    const std::size_t cells = windows.cells();
    const CellCounts counts = count_beams(windows, measured, lost, ground, target_height_m, &GROUND_STEPS);
    for_ranges(cells, count_parts(cells, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        float lanes[LANES][CellCounts::BLOCK];
        for (std::size_t first = begin; first < end; first += CellCounts::BLOCK) {
            const std::size_t size = std::min(CellCounts::BLOCK, end - first);
            counts.read(first, size, lanes);
            judge_block(lanes, first, size, windows.cell_range_m.data(), probabilities, reach_m, to);
        }
    });
}

namespace {

// Return the least mean with this probability, +inf if none has it. Comparing means is faster than looking up.
float mean_of(View1<const float> table, float prob) {
    const float* const first = std::lower_bound(table.begin(), table.end(), prob);
    return first == table.end() ? std::numeric_limits<float>::infinity() : float(first - table.begin()) / STEPS;
}

// Required mean returns of a claim, and required mean of aimed beams of a hidden cell.
struct Support {
    SupportedCells of;
    float enough, sure_aim;
};

// Write the states of cells [begin, end). Bytes of 0 or 1 vectorize, bools do not.
MULTIVERSION void write_range(const Support& support_, const std::uint8_t* visible, const std::uint8_t* denied,
                              const std::uint8_t* obstacle, std::size_t begin, std::size_t end,
                              std::uint8_t* __restrict state) {
    const Support s = support_;
    for (std::size_t n = begin; n < end; ++n) {
        const std::uint8_t claimed = visible[n] & (s.of.visible_prob[n] >= THRESHOLD);
        const bool aimed = s.of.aimed[n] >= s.sure_aim;
        const bool enough = s.of.measured[n] + s.of.late[n] >= s.enough;
        const std::uint8_t hidden = denied[n] & aimed & !enough & s.of.within_reach[n];
        const std::uint8_t seen = obstacle[n] ? SURFACE : FREE, unseen = hidden ? HIDDEN : UNKNOWN;
        state[n] = claimed ? seen : unseen;
    }
}

// Count claims; is_unsure (nodes,) marks nodes with unsure ground. Integers vectorize, bools do not.
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

}  // namespace

void write_states(const SupportedCells& cells, View1<const float> table, const Calls& calls, View1<std::uint8_t> state) {
    const Support support{cells, mean_of(table, THRESHOLD), mean_of(table, SURE_AIM)};
    for_ranges(state.size, count_parts(state.size, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        write_range(support, calls.visible, calls.denied, calls.obstacle, begin, end, state.data);
    });
}

Claims count_claims(View1<const std::uint8_t> state, const float* measured, const std::int32_t* node,
                    View1<const float> std_m, View1<const float> table) {
    Buffer<std::int32_t> is_unsure(std_m.size);
    for (std::size_t at = 0; at < is_unsure.size(); ++at) is_unsure[at] = std_m[at] > UNSURE_M;
    return count_claims(state.data, measured, node, state.size, is_unsure.data(), mean_of(table, THRESHOLD));
}

}  // namespace viewshed
