#include "no_return.hpp"

#include <nanobind/stl/optional.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "bindings.hpp"
#include "missing_beams.hpp"

namespace viewshed {

namespace {

using Rotation = nb::ndarray<const double, nb::shape<3, 3>, nb::c_contig, nb::device::cpu>;

void require_aims(const RingAims& aims, std::size_t rings) {
    require(aims.phase.size == rings && aims.elevation.size == rings && aims.origin_m.size == rings,
            "phase, elevation and origin_m must have an element for each ring");
    const auto is_finite = [](auto value) { return std::isfinite(value); };
    const bool finite = std::all_of(aims.phase.begin(), aims.phase.end(), is_finite) &&
                        std::all_of(aims.elevation.begin(), aims.elevation.end(), is_finite) &&
                        std::all_of(aims.origin_m.begin(), aims.origin_m.end(), is_finite) &&
                        std::all_of(aims.rotation, aims.rotation + 9, is_finite);
    require(finite, "phase, elevation, origin_m and rotation must be finite");
}

Pixels pixels_of(const In1<std::int16_t>& ring, const In1<std::int32_t>& column, const In2<std::uint8_t>& counts,
                 const std::optional<In1<bool>>& left_out, const std::optional<In1<bool>>& clutter) {
    const std::size_t count = ring.shape(0);
    const View1<const bool> none{nullptr, 0};
    require(column.shape(0) == count, "ring and column must be as long");
    require(!left_out || left_out->shape(0) == count, "isolated must be as long as ring");
    require(!clutter || clutter->shape(0) == count, "clutter must be as long as ring");
    require(counts.shape(0) >= 1 && counts.shape(1) >= 1, "counts must have a ring and a column at least");
    require(counts.shape(0) <= 32767 && counts.shape(1) <= (1u << 20), "counts must have fewer rings and columns");
    return {view(ring), view(column), view(counts), left_out ? view(*left_out) : none, clutter ? view(*clutter) : none};
}

nb::tuple arrays_of(BeamColumns&& beams) {
    const std::size_t count = beams.count;
    return nb::make_tuple(array(std::move(beams.azimuth), {count}), array(std::move(beams.slope), {count}),
                          array(std::move(beams.depth_m), {count}));
}

}  // namespace

void bind_no_return(nb::module_& m) {
    m.attr("JITTER_COLUMNS") = JITTER_COLUMNS;
    m.def(
        "beams_by_evidence",
        [](In1<std::int16_t> ring, In1<std::int32_t> column, In2<std::uint8_t> counts, In1<bool> isolated,
           std::optional<In1<bool>> clutter, In1<float> phase, In1<double> elevation, In1<double> origin_m,
           Rotation rotation, Points points, In1<float> range_m, In1<float> height_m, In1<std::int32_t> rows,
           double sensor_height_m, In2<float> ground_m, float half_extent_m, double top_m, float obstacle_m) {
            const std::size_t count = rows.shape(0), nodes = ground_m.shape(0);
            const Pixels pixels = pixels_of(ring, column, counts, isolated, clutter);
            const RingAims aims{view(phase), view(elevation), view(origin_m), rotation.data()};
            require_aims(aims, counts.shape(0));
            require(points.shape(0) == count && range_m.shape(0) == count && height_m.shape(0) == count,
                    "points, range_m, height_m and rows must be as long");
            require(ground_m.shape(1) == nodes, "ground_m must be (n, n)");
            require(nodes >= 2 && nodes <= 4096, "ground_m must have 2 to 4096 nodes a side");
            require(half_extent_m > 0.0f, "half_extent_m must be positive");
            const Buffer<std::int32_t> own_rows = copy_of(view(rows));
            Buffer<float> slope(count);
            const std::size_t room = counts.shape(0) * counts.shape(1);
            BeamColumns inferred(room), unresolved(room);
            {
                nb::gil_scoped_release unlocked;
                const float height = float(sensor_height_m), steep_m = float(STEEP * sensor_height_m);
                const DepthImages images =
                    depth_images(pixels, {view(range_m), view(height_m), own_rows}, obstacle_m, steep_m);
                beam_slopes(view(points), view(range_m), height, view(isolated), own_rows, slope);
                split_no_return_beams(images, aims, {view(ground_m), half_extent_m}, height, top_m, steep_m, inferred,
                                      unresolved);
            }
            return nb::make_tuple(array(std::move(slope)), arrays_of(std::move(inferred)),
                                  arrays_of(std::move(unresolved)));
        },
        "ring"_a.noconvert(), "column"_a.noconvert(), "counts"_a.noconvert(), "isolated"_a.noconvert(),
        "clutter"_a.noconvert().none(), "phase"_a.noconvert(), "elevation"_a.noconvert(), "origin_m"_a.noconvert(),
        "rotation"_a.noconvert(), "points"_a.noconvert(), "range_m"_a.noconvert(), "height_m"_a.noconvert(),
        "rows"_a.noconvert(), "sensor_height_m"_a, "ground_m"_a.noconvert(), "half_extent_m"_a, "top_m"_a,
        "obstacle_m"_a,
        "Slope (M,) of measured beams; azimuth, slope and depth of inferred beams; and of unresolved ones.");
    m.def(
        "no_return_beams",
        [](In1<std::int16_t> ring, In1<std::int32_t> column, In2<std::uint8_t> counts, std::optional<In1<bool>> clutter,
           In1<float> phase, In1<double> elevation, In1<double> origin_m, Rotation rotation, In1<float> range_m,
           In1<float> height_m, In1<std::int32_t> rows, bool fill) {
            const Pixels pixels = pixels_of(ring, column, counts, std::nullopt, clutter);
            const RingAims aims{view(phase), view(elevation), view(origin_m), rotation.data()};
            require_aims(aims, counts.shape(0));
            require(range_m.shape(0) == rows.shape(0) && height_m.shape(0) == rows.shape(0),
                    "range_m, height_m and rows must be as long");
            std::optional<BeamColumns> beams;
            {
                nb::gil_scoped_release unlocked;
                // Neither obstacles nor shares of ground are needed.
                const Returns returns{view(range_m), view(height_m), view(rows)};
                beams = no_return_beams(depth_images(pixels, returns, INFINITY, INFINITY), aims, fill);
            }
            return arrays_of(std::move(*beams));
        },
        "ring"_a.noconvert(), "column"_a.noconvert(), "counts"_a.noconvert(), "clutter"_a.noconvert().none(),
        "phase"_a.noconvert(), "elevation"_a.noconvert(), "origin_m"_a.noconvert(), "rotation"_a.noconvert(),
        "range_m"_a.noconvert(), "height_m"_a.noconvert(), "rows"_a.noconvert(), "fill"_a,
        "Azimuth, slope and depth of the beams without a return.");
}

}  // namespace viewshed
