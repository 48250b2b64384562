#include "fov_code.hpp"

#include "bindings.hpp"

namespace viewshed {

namespace {

void require_view(std::size_t cells, std::size_t row, std::size_t column) {
    require(cells >= 1 && cells <= MAX_CELLS, "cells must lie in [1, 512]");
    require(row < cells && column < cells, "the sensor's row and column must lie on the grid");
}

}  // namespace

void bind_fov_code(nb::module_& m) {
    m.def(
        "encode_view",
        [](In2<std::uint8_t> state, In2<std::uint8_t> level, In2<std::uint8_t> deviation, std::size_t row,
           std::size_t column) {
            const std::size_t cells = state.shape(0);
            require_view(cells, row, column);
            require(state.shape(1) == cells && have_one_shape(state, level),
                    "state and level must be square and of the same shape");
            require(deviation.shape(0) == deviation.shape(1) && (deviation.shape(0) == 0 || deviation.shape(0) == cells),
                    "deviation must have the shape of state, or (0, 0)");
            const auto states = indices_of<std::uint8_t>(view(state).flat(), 0, STATES - 1, "state");
            const auto levels = indices_of<std::uint8_t>(view(level).flat(), 0, LEVELS - 1, "level");
            const auto deviations = indices_of<std::uint8_t>(view(deviation).flat(), 0, DEVIATIONS - 1, "deviation");
            const std::size_t side = deviation.shape(0);
            auto code = without_lock([&] {
                return encode_view({{states.data(), cells, cells}, {levels.data(), cells, cells}, {deviations.data(), side, side}},
                                   {row, column});
            });
            return nb::bytes(code.data(), code.size());
        },
        "state"_in, "level"_in, "deviation"_in, "row"_a, "column"_a,
        "Encode a view: state 0…3, probability level 0…15 and, unless (0, 0), deviation level 0…8 of each cell. "
        "Empty if it would take too many decisions.");
    m.def(
        "decode_view",
        [](In1<std::uint8_t> code, std::size_t cells, std::size_t row, std::size_t column, In1<float> prob,
           In1<float> std)
            -> std::optional<Tuple<Out<std::uint8_t>, Out<float>, std::optional<Out<float>>>> {
            require_view(cells, row, column);
            require(prob.shape(0) == LEVELS, "prob must have a value for each of 16 levels");
            require(std.shape(0) == 0 || std.shape(0) == DEVIATIONS, "std must have a value for each of 9 levels, or none");
            const bool has_std = std.shape(0) > 0;
            Buffer<std::uint8_t> state(cells * cells);
            Buffer<float> probs(cells * cells), stds(has_std ? cells * cells : 0);
            const std::size_t side = has_std ? cells : 0;
            const auto is_view = without_lock([&] {
                return decode_view(view(code), {row, column}, {prob.data(), std.data()},
                                   {state.view(cells, cells), probs.view(cells, cells), stds.view(side, side)});
            });
            if (!is_view) return std::nullopt;
            std::optional<Out<float>> deviation;
            if (has_std) deviation = array(std::move(stds), {cells, cells});
            return tuple_of(array(std::move(state), {cells, cells}), array(std::move(probs), {cells, cells}),
                            deviation);
        },
        "code"_in, "cells"_a, "row"_a, "column"_a, "prob"_in, "std"_in,
        "Return state, probability and standard deviation (None without values for it) of each cell; None if the "
        "code is invalid.");
}

}  // namespace viewshed
