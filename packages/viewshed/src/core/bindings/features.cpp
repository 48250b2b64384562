#include "features.hpp"

#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <utility>

#include "azimuth_bins.hpp"
#include "bindings.hpp"

namespace viewshed {
namespace {

// The arrays of a feature, of any types.
using Arrays = nb::typed<nb::tuple, nb::any, nb::ellipsis>;

// An array that stands in a tuple, of exactly this type.
template <typename Array>
auto array_in(const Arrays& arrays, std::size_t k) {
    Array array;
    if (!nb::try_cast(arrays[k], array, false) || !array.is_valid()) {
        throw nb::type_error("a feature's arrays must be contiguous, and of their coding's type and rank");
    }
    return view(array);
}

// What Python hands in for one feature: the name of its coding, and the arrays that it asks for.
Feature feature_of(const std::pair<std::string, Arrays>& given, std::size_t cells) {
    constexpr std::array<const char*, 6> NAMES = {"bytes", "returns", "probability", "beyond", "range", "deviation"};
    constexpr std::array<std::size_t, 6> FEWEST = {1, 1, 1, 1, 0, 1}, MOST = {1, 2, 1, 1, 0, 1};
    const auto& [name, arrays] = given;
    const auto coding = std::size_t(std::find(NAMES.begin(), NAMES.end(), name) - NAMES.begin());
    require(coding < NAMES.size(), "coding must be bytes, returns, probability, beyond, range or deviation");
    require(arrays.size() >= FEWEST[coding] && arrays.size() <= MOST[coding], "a feature must have its arrays");
    Feature feature{Coding(coding), {}, {}, {}, {}};
    const auto of_grid = [&](const auto& values) {
        require(values.rows == cells && values.columns == cells, "a feature's array must have the grid's shape");
        return values;
    };
    switch (feature.coding) {
        case Coding::BYTES:
            feature.bytes = of_grid(array_in<In2<std::uint8_t>>(arrays, 0));
            break;
        case Coding::RETURNS:
            feature.values = of_grid(array_in<In2<float>>(arrays, 0));
            if (arrays.size() == 2) feature.further = of_grid(array_in<In2<float>>(arrays, 1));
            break;
        case Coding::PROBABILITY:
            feature.values = of_grid(array_in<In2<float>>(arrays, 0));
            break;
        case Coding::BEYOND:
            feature.limit_m = array_in<In1<float>>(arrays, 0);
            break;
        case Coding::RANGE:
            break;
        case Coding::DEVIATION:
            feature.values = array_in<In2<float>>(arrays, 0);
            require(feature.values.rows >= 2 && feature.values.columns >= 2, "the ground must have 2 nodes a side");
            break;
    }
    return feature;
}

}  // namespace

// What Python calls: arrays are checked here, whatever hands them in.
void bind_features(nb::module_& m) {
    m.def(
        "feature_maps",
        [](const std::vector<std::pair<std::string, Arrays>>& given, In2<float> range_m, In2<std::int16_t> bin,
           In1<float> x_m, In1<float> y_m, float half_extent_m, std::size_t fold) {
            const std::size_t cells = x_m.shape(0), features = given.size();
            require(cells >= 1 && cells <= MOST_CELLS && features <= 64, "1 to 4096 cells, and up to 64 features");
            require(are_as_long(x_m, y_m, range_m) && range_m.shape(1) == cells && have_one_shape(range_m, bin),
                    "cell_range_m and cell_bin must have the grid's shape, x_m and y_m its side");
            require(fold <= cells && (fold == 0 || cells % fold == 0), "fold must divide the cells of a side");
            require(half_extent_m > 0.0f, "half_extent_m must be positive");
            std::vector<Feature> wanted;
            for (const auto& one : given) wanted.push_back(feature_of(one, cells));
            std::size_t bins = MOST_BINS + 1;
            for (const Feature& one : wanted) {
                if (one.coding == Coding::BEYOND) bins = std::min(bins, one.limit_m.size);
            }
            require(bins > 0, "a limit must have bins");
            Buffer<std::int16_t> cell_bin(0);
            if (bins <= MOST_BINS) cell_bin = indices_of<std::int16_t>(view(bin).flat(), 0, std::int16_t(bins - 1), "cell_bin");
            Buffer<std::uint8_t> codes(features * cells * cells);
            without_lock([&] {
                write_features(wanted, {view(range_m), {cell_bin.data(), cells, cells}, view(x_m), view(y_m)},
                    half_extent_m, fold, codes);
            });
            if (fold == 0) return array(std::move(codes), {features, cells, cells});
            return array(std::move(codes), {cells / fold, cells / fold, features * fold * fold});
        },
        "features"_a, "cell_range_m"_in, "cell_bin"_in, "x_m"_in, "y_m"_in, "half_extent_m"_a, "fold"_a,
        "Codes (features, cells, cells) of features, or of fold > 0 in blocks (side, side, features · fold²).");
    m.def(
        "height_codes",
        [](Points points, In1<float> height_m, float x0_m, float y0_m, float cells_per_m, std::size_t cells) {
            require(points.shape(0) == height_m.shape(0), "points and height_m must be as long");
            require(cells >= 1 && cells <= MOST_CELLS, "cells must lie in [1, 4096]");
            Buffer<std::uint8_t> lowest(cells * cells), highest(cells * cells);
            without_lock([&] {
                write_heights(view(points), view(height_m), x0_m, y0_m, cells_per_m, cells, lowest, highest);
            });
            return tuple_of(array(std::move(lowest), {cells, cells}), array(std::move(highest), {cells, cells}));
        },
        "points"_in, "height_m"_in, "x0_m"_a, "y0_m"_a, "cells_per_m"_a, "cells"_a,
        "Codes (cells, cells) of the lowest and the highest return of each cell, 0 for none.");
    m.def(
        "fold_maps",
        [](In3<std::uint8_t> maps, std::size_t fold) {
            const std::size_t features = maps.shape(0), cells = maps.shape(1);
            require(cells >= 1 && maps.shape(2) == cells, "maps must be square");
            require(fold >= 1 && cells % fold == 0, "fold must divide the cells of a side");
            const std::size_t blocks = cells / fold, block_size = features * fold * fold;
            Buffer<std::uint8_t> out(maps.size());
            without_lock([&] { fold_maps(view(maps), fold, out); });
            return array(std::move(out), {blocks, blocks, block_size});
        },
        "maps"_in, "fold"_a, "Maps (features, cells, cells) in blocks (side, side, features · fold²).");
}

}  // namespace viewshed
