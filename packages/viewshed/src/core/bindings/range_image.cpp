#include "range_image.hpp"

#include "stages.hpp"

namespace viewshed {

// Convert a range image to a tuple of arrays.
RangeImageArrays range_image_arrays(RangeImage&& image) {
    const std::size_t rings = image.rings, columns = image.columns;
    return tuple_of(array(std::move(image.column)), array(std::move(image.counts), {rings, columns}),
                    array(std::move(image.nearest_m2), {rings, columns}), array(std::move(image.phase)),
                    array(std::move(image.isolated)), array(std::move(image.behind)),
                    array_or_none(std::move(image.clutter)), image.has_full_rings);
}

void bind_range_image(nb::module_& m) {
    m.def(
        "range_image",
        [](Points points, In1<std::int16_t> ring, std::size_t columns, std::size_t rings, float near_m, float far_m) {
            require(ring.shape(0) == points.shape(0), "ring must have one row for each point");
            require_image(rings, columns);
            const Buffer<std::int16_t> own = indices_of<std::int16_t>(view(ring), -1, std::int16_t(rings - 1), "ring");
            auto made = without_lock([&] { return range_image(view(points), own, columns, rings, near_m, far_m); });
            return range_image_arrays(std::move(made));
        },
        "points"_in, "ring"_in, "columns"_a, "rings"_a, "near_m"_a, "far_m"_a,
        "Return column, counts, nearest_m2, phase, isolated, behind, clutter (or None) of points (N, 3) with ring "
        "(N,); and whether full rings hold about one return per column.");
    m.def(
        "silent_columns",
        [](In2<std::uint8_t> counts) { return array(without_lock([&] { return silent_columns(view(counts)); })); },
        "counts"_in, "Return a mask (columns,) of silent columns, from counts (rings, columns).");
    m.def(
        "pixels_without",
        [](In1<std::int16_t> ring, In1<bool> left_out, In1<std::int32_t> column, In2<std::uint8_t> counts) {
            const std::size_t rings = counts.shape(0), columns = counts.shape(1);
            require_image(rings, columns);
            require(are_as_long(ring, left_out, column), "ring, left_out and column must be as long");
            const Buffer<std::int16_t> own = indices_of<std::int16_t>(view(ring), -1, std::int16_t(rings - 1), "ring");
            auto kept = indices_of<std::int32_t>(view(column), -1, std::int32_t(columns - 1), "column");
            Buffer<std::uint8_t> fewer = copy_of(view(counts).flat());
            without_lock([&] { take_out(own, view(left_out), kept, fewer.view(rings, columns)); });
            return tuple_of(array(std::move(kept)), array(std::move(fewer), {rings, columns}));
        },
        "ring"_in, "left_out"_in, "column"_in, "counts"_in,
        "Return column (N,) and counts (rings, columns) without the returns left_out (N,).");
}

}  // namespace viewshed
