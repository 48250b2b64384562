#include "no_return.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

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

Ground ground_of(const In2<float>& heights_m, float half_extent_m) {
    const std::size_t nodes = heights_m.shape(0);
    require(heights_m.shape(1) == nodes, "ground_m must be (n, n)");
    require(nodes >= 2 && nodes <= 4096, "ground_m must have 2 to 4096 nodes a side");
    require(half_extent_m > 0.0f, "half_extent_m must be positive");
    return {view(heights_m), half_extent_m};
}

// Arrays of a sweep from Python.
struct SweepArrays {
    Pixels pixels;
    RingAims aims;
    View1<const float> range_m, height_m;
    Buffer<std::int32_t> rows;
    float obstacle_m, sensor_height_m;
    Ground ground;

    void check() const {
        require_aims(aims, pixels.counts.rows);
        require(range_m.size == rows.size() && height_m.size == rows.size(),
                "points, range_m, height_m and rows must be as long");
    }
    float steep_m() const { return float(STEEP * double(sensor_height_m)); }
    DepthImages images() const { return depth_images(pixels, {range_m, height_m, rows}, obstacle_m, steep_m()); }
};

}  // namespace

void bind_no_return(nb::module_& m) {
    m.attr("JITTER_COLUMNS") = JITTER_COLUMNS;
    m.def(
        "beams_by_evidence",
        [](In1<std::int16_t> ring, In1<std::int32_t> column, In2<std::uint8_t> counts, In1<bool> isolated,
           std::optional<In1<bool>> clutter, In1<float> phase, In1<double> elevation, In1<double> origin_m,
           Rotation rotation, Points points, In1<float> range_m, In1<float> height_m, In1<std::int32_t> rows,
           double sensor_height_m, In2<float> ground_m, float half_extent_m, double top_m, float obstacle_m) {
            const SweepArrays sweep{pixels_of(ring, column, counts, isolated, clutter),
                                    {view(phase), view(elevation), view(origin_m), rotation.data()},
                                    view(range_m), view(height_m), copy_of(view(rows)), obstacle_m,
                                    float(sensor_height_m), ground_of(ground_m, half_extent_m)};
            sweep.check();
            require(points.shape(0) == rows.shape(0), "points, range_m, height_m and rows must be as long");
            Buffer<float> slope(rows.shape(0));
            std::optional<NoReturnBeams> beams;
            without_lock([&] {
                const DepthImages images = sweep.images();  // checks the rows, which beam_slopes relies on
                beam_slopes(view(points), view(range_m), sweep.sensor_height_m, view(isolated), sweep.rows, slope);
                beams = guess_no_return_beams(images, sweep.aims, sweep.ground, sweep.sensor_height_m, top_m,
                                              sweep.steep_m());
            });
            const auto shaped = [&](auto& buffer) { return array(std::move(buffer), {beams->count}); };
            return tuple_of(array(std::move(slope)), shaped(beams->azimuth), shaped(beams->slope),
                            shaped(beams->early_m), shaped(beams->depth_m), shaped(beams->late_m));
        },
        "ring"_in, "column"_in, "counts"_in, "isolated"_in, "clutter"_in.none(), "phase"_in, "elevation"_in,
        "origin_m"_in, "rotation"_in, "points"_in, "range_m"_in, "height_m"_in, "rows"_in, "sensor_height_m"_a,
        "ground_m"_in, "half_extent_m"_a, "top_m"_a, "obstacle_m"_a,
        "Return slope (M,) of measured beams; azimuth, slope, early, likely and late depth (B,) of beams without a "
        "return.");
    m.def(
        "no_return_groups",
        [](In1<std::int16_t> ring, In1<std::int32_t> column, In2<std::uint8_t> counts, In1<bool> isolated,
           std::optional<In1<bool>> clutter, In1<float> phase, In1<double> elevation, In1<double> origin_m,
           Rotation rotation, In1<float> range_m, In1<float> height_m, In1<std::int32_t> rows, double sensor_height_m,
           In2<float> ground_m, float half_extent_m, double top_m, float obstacle_m) {
            const SweepArrays sweep{pixels_of(ring, column, counts, isolated, clutter),
                                    {view(phase), view(elevation), view(origin_m), rotation.data()},
                                    view(range_m), view(height_m), copy_of(view(rows)), obstacle_m,
                                    float(sensor_height_m), ground_of(ground_m, half_extent_m)};
            sweep.check();
            NoReturnGroups groups = without_lock([&] {
                return describe_no_return_beams(sweep.images(), sweep.aims, sweep.ground, sweep.sensor_height_m, top_m,
                                                sweep.steep_m());
            });
            const std::size_t size = groups.azimuth.size();
            return tuple_of(array(std::move(groups.azimuth)), array(std::move(groups.slope)),
                            array(std::move(groups.beams)), array(std::move(groups.feature), {size, FEATURES}),
                            array(std::move(groups.stop), {size, std::size_t(STOPS)}));
        },
        "ring"_in, "column"_in, "counts"_in, "isolated"_in, "clutter"_in.none(), "phase"_in, "elevation"_in,
        "origin_m"_in, "rotation"_in, "range_m"_in, "height_m"_in, "rows"_in, "sensor_height_m"_a, "ground_m"_in,
        "half_extent_m"_a, "top_m"_a, "obstacle_m"_a,
        "Return azimuth, slope, number of beams that may meet a target (G,), features (G, F) and log2 ranges of "
        "stops (G, S) of groups of beams without a return.");
    m.def(
        "no_return_beams",
        [](In1<std::int16_t> ring, In1<std::int32_t> column, In2<std::uint8_t> counts, std::optional<In1<bool>> clutter,
           In1<float> phase, In1<double> elevation, In1<double> origin_m, Rotation rotation, In1<float> range_m,
           In1<float> height_m, In1<std::int32_t> rows, bool fill) {
            const Pixels pixels = pixels_of(ring, column, counts, std::nullopt, clutter);
            const RingAims aims{view(phase), view(elevation), view(origin_m), rotation.data()};
            require_aims(aims, counts.shape(0));
            require(are_as_long(range_m, height_m, rows), "range_m, height_m and rows must be as long");
            // Infinite limits: neither obstacles nor ground shares are needed.
            const Returns returns{view(range_m), view(height_m), view(rows)};
            BeamColumns beams = without_lock(
                [&] { return no_return_beams(depth_images(pixels, returns, INFINITY, INFINITY), aims, fill); });
            const auto shaped = [&](auto& buffer) { return array(std::move(buffer), {beams.count}); };
            return tuple_of(shaped(beams.azimuth), shaped(beams.slope), shaped(beams.depth_m));
        },
        "ring"_in, "column"_in, "counts"_in, "clutter"_in.none(), "phase"_in, "elevation"_in, "origin_m"_in,
        "rotation"_in, "range_m"_in, "height_m"_in, "rows"_in, "fill"_a,
        "Return azimuth, slope and depth of the beams without a return.");
}

}  // namespace viewshed
