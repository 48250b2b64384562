#include "files.hpp"

#include "bindings.hpp"

namespace viewshed {

void bind_files(nb::module_& m) {
    m.def(
        "split_xyzi",
        [](In1<float> rows, InOut1<float> points, InOut1<float> intensity) {
            const std::size_t count = intensity.shape(0);
            require(rows.shape(0) >= 4 * count && points.shape(0) == 3 * count, "sizes of columns must agree");
            nb::gil_scoped_release unlocked;
            split_four(rows.data(), count, points.data(), intensity.data());
        },
        "rows"_in, "points"_in, "intensity"_in,
        "Split rows of x, y, z, intensity into points (3 N,) and intensity (N,).");
    m.def(
        "split_xyzir",
        [](In1<float> rows, InOut1<float> points, InOut1<float> intensity, InOut1<std::int16_t> ring,
           bool quarter_turn) {
            const std::size_t count = intensity.shape(0);
            require(rows.shape(0) >= 5 * count && points.shape(0) == 3 * count && ring.shape(0) == count,
                    "sizes of columns must agree");
            nb::gil_scoped_release unlocked;
            return split_five(rows.data(), count, quarter_turn, points.data(), intensity.data(), ring.data());
        },
        "rows"_in, "points"_in, "intensity"_in, "ring"_in, "quarter_turn"_a,
        "Split rows of x, y, z, intensity, ring; return how many rings are not integers. With quarter_turn, points "
        "are (y, -x, z).");
    m.def(
        "spread_of_rings",
        [](Points points, In1<std::int16_t> ring, float half_width) {
            require(ring.shape(0) == points.shape(0), "ring must have one row for each point");
            const RingSpread spread = without_lock([&] { return spread_of_rings(view(points), view(ring), half_width); });
            return tuple_of(spread.count, spread.elevation_std, spread.beside, spread.any_two);
        },
        "points"_in, "ring"_in, "half_width"_a,
        "Return the number of returns in four narrow sectors, the standard deviation of their elevations, and the "
        "mean ring difference of neighbors and of any two.");
    m.def(
        "all_finite",
        [](In2<float> values) {
            nb::gil_scoped_release unlocked;
            return are_finite(values.data(), values.size());
        },
        "values"_in, "Check that all values (N, K) are finite.");
    m.def(
        "plausible_rows",
        [](In1<float> rows, std::size_t columns) {
            require(columns == 4 || columns == 5, "columns must be 4 or 5");
            return without_lock([&] { return is_plausible(rows.data(), rows.shape(0) / columns, columns); });
        },
        "rows"_in, "columns"_a,
        "Check if rows (N · columns,) are plausible as meters within 10 km, an intensity and, if five, a ring in "
        "0…127.");
    m.def(
        "move_points",
        [](nb::ndarray<float, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu> points, In2<double> rotation,
           In1<double> shift) {
            require(rotation.shape(0) == 3 && rotation.shape(1) == 3 && shift.shape(0) == 3,
                    "a transform must be a rotation (3, 3) and a shift (3,)");
            without_lock([&] { move_points({points.data(), points.shape(0), 3}, rotation.data(), shift.data()); });
        },
        "points"_in, "rotation"_in, "shift"_in,
        "Replace points (N, 3) by rotation @ point + shift, computed in float64.");
    m.def(
        "unpack_lzf",
        [](In1<std::uint8_t> packed, InOut1<std::uint8_t> unpacked) {
            return without_lock([&] { return unpack_lzf(view(packed), view(unpacked)); });
        },
        "packed"_in, "unpacked"_in,
        "Decode an LZF stream; return the bytes written, or -1 if it is corrupt.");
}

}  // namespace viewshed
