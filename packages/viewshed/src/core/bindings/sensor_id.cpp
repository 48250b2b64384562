#include "sensor_id.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "bindings.hpp"
#include "elevation_clusters.hpp"

namespace viewshed {
namespace {

using RingColumn = In1<std::int16_t>;

// Limits of arguments: beams of a table, columns of a revolution, and elevations in radians.
constexpr std::size_t MAX_RINGS = 4096;
constexpr std::int64_t MAX_COLUMNS = 65'536;
constexpr double HIGHEST = std::numbers::pi / 2;

// Check and copy a ring column, if given.
std::optional<Buffer<std::int16_t>> checked_rings(const std::optional<RingColumn>& ring, std::size_t count) {
    if (!ring) return std::nullopt;
    require(ring->shape(0) == count, "ring must have one row for each point");
    return indices_of<std::int16_t>(view(*ring), -1, MAX_RINGS - 1, "ring");
}

// A copy of points: another thread may write the caller's array, and a sort of changing values runs out of bounds.
class OwnPoints {
public:
    explicit OwnPoints(const Points& points) : values_(3 * points.shape(0)) {
        std::copy_n(points.data(), values_.size(), values_.data());
    }
    operator View2<const float>() const { return {values_.data(), values_.size() / 3, 3}; }

private:
    Buffer<float> values_;
};

std::size_t checked_count(const Points& points) {
    require(points.shape(0) < (1u << 28), "a sweep must have fewer than 2^28 points");
    return points.shape(0);
}

// Copy azimuth, slope and range columns.
Directions directions_from(const In1<float>& azimuth, const In1<float>& slope, const In1<float>& range_m) {
    require(are_as_long(azimuth, slope, range_m), "azimuth, slope and range_m must be as long");
    Directions seen(slope.shape(0));
    std::copy_n(azimuth.data(), seen.size(), seen.azimuth.data());
    std::copy_n(slope.data(), seen.size(), seen.slope.data());
    std::copy_n(range_m.data(), seen.size(), seen.range_m.data());
    return seen;
}

// Check and copy the beams of a sensor.
BeamTable checked_table(View1<const double> given_elevation, View1<const double> given_origin_m, std::int64_t columns) {
    require(given_elevation.size >= 1 && given_elevation.size <= MAX_RINGS, "a table must have 1 to 4096 beams");
    require(given_origin_m.size == given_elevation.size, "origin_m must have one value for each beam");
    std::vector<double> elevation(given_elevation.begin(), given_elevation.end());
    std::vector<double> origin_m(given_origin_m.begin(), given_origin_m.end());
    require(columns >= 1 && columns <= MAX_COLUMNS, "columns must lie in [1, 65536]");
    const auto is_wrong = [](double value) { return !std::isfinite(value); };
    require(std::none_of(elevation.begin(), elevation.end(), is_wrong) &&
                std::none_of(origin_m.begin(), origin_m.end(), is_wrong),
            "elevations and origins must be finite");
    require(std::is_sorted(elevation.begin(), elevation.end()), "elevations must ascend");
    require(std::abs(elevation.front()) <= HIGHEST && std::abs(elevation.back()) <= HIGHEST,
            "elevations must lie within a quarter of a turn");
    return BeamTable(std::move(elevation), std::move(origin_m), int(columns));
}

}  // namespace

void bind_sensor_id(nb::module_& m) {
    m.attr("OTHER_BEAMS") = OTHER_BEAMS;
    m.attr("USUAL_REACH_M") = USUAL_REACH_M;
    m.def(
        "identify_sensor",
        [](Points points, std::optional<RingColumn> ring, In1<double> elevation, In1<double> origin_m, bool is_inferred,
           int expected, In1<double> held_elevation, In1<double> held_origin_m)
            -> Tuple<std::optional<Out<std::int16_t>>, int, std::optional<Tuple<Out<double>, Out<double>>>, std::size_t, bool> {
            std::optional<BeamTable> table, held;
            if (elevation.shape(0) > 0) table = checked_table(view(elevation), view(origin_m), 1);
            if (held_elevation.shape(0) > 0) held = checked_table(view(held_elevation), view(held_origin_m), 1);
            require(expected >= NO_SENSOR && expected < int(inferable_sensors().size()),
                    "expected must be the number of a sensor, or -1");
            const auto known = checked_rings(ring, checked_count(points));
            SensorId found = without_lock([&] {
                return identify_sensor(OwnPoints(points), known, table ? &*table : nullptr, is_inferred,
                                       {expected, held ? &*held : nullptr});
            });
            std::optional<Tuple<Out<double>, Out<double>>> layout;
            if (found.layout) layout = tuple_of(array_of(found.layout->elevation), array_of(found.layout->origin_m));
            return tuple_of(array_or_none(std::move(found.ring)), found.sensor, std::move(layout), found.shown,
                            found.is_held);
        },
        "points"_in, "ring"_in.none(), "elevation"_in, "origin_m"_in, "is_inferred"_a, "expected"_a, "held_elevation"_in,
        "held_origin_m"_in,
        "Identify the rings and the sensor of points (N, 3). Return rings (N,), or None if unchanged or unknown; the "
        "number of the inferred sensor, -1 for none, OTHER_BEAMS if the rings are no beams of the table; the layout "
        "of rings without a matching table, elevation and origin_m (rings,), or None; the number of rings that the "
        "points show; and whether the held layout was used. An empty table, or held layout, is none.");
    m.def(
        "infer_sensor",
        [](Points points, std::optional<RingColumn> ring) {
            const auto known = checked_rings(ring, checked_count(points));
            const auto found = without_lock([&] { return infer_sensor(OwnPoints(points), known); });
            return tuple_of(found.first, found.second);
        },
        "points"_in, "ring"_in.none(),
        "Return the number of the sensor that matches points (N, 3) best, -1 for none, and its score.");
    m.def(
        "recover_rings",
        [](Points points, std::optional<RingColumn> ring, In1<double> elevation, In1<double> origin_m,
           std::int64_t columns) {
            std::optional<BeamTable> table;
            if (elevation.shape(0) > 0) table = checked_table(view(elevation), view(origin_m), columns);
            const auto known = checked_rings(ring, checked_count(points));
            auto made = without_lock([&] { return recover_rings(OwnPoints(points), known, table ? &*table : nullptr); });
            return tuple_of(array(std::move(made.ring)), array(std::move(made.column)), made.columns,
                            array(std::move(made.elevation)), made.placed, made.alone, int(made.source));
        },
        "points"_in, "ring"_in.none(), "elevation"_in, "origin_m"_in, "columns"_a,
        "Return ring (N,), column (N,), number of columns, elevation (rings,), number of returns with a ring, number "
        "of those alone in their pixel, source. An empty table is none.");
    m.def(
        "polar",
        [](Points points) {
            Directions seen = without_lock([&] { return directions_of(OwnPoints(points)); });
            return tuple_of(array(std::move(seen.azimuth)), array(std::move(seen.slope)),
                            array(std::move(seen.range_m)));
        },
        "points"_in, "Return azimuth, slope and horizontal range (N,) of points (N, 3).");
    m.def(
        "match_beams",
        [](In1<float> slope, In1<float> range_m, In1<double> elevation, In1<double> origin_m) {
            const BeamTable table = checked_table(view(elevation), view(origin_m), 1);
            require(slope.shape(0) == range_m.shape(0), "slope and range_m must be as long");
            BeamMatch match = without_lock([&] { return match_beams(view(slope), view(range_m), table); });
            return tuple_of(array(std::move(match.ring)), array_of(match.hits), match.excess);
        },
        "slope"_in, "range_m"_in, "elevation"_in, "origin_m"_in,
        "Return the nearest beam of each return (N,), the number of close returns of each beam, and their share in "
        "excess of chance.");
    m.def(
        "find_clusters",
        [](In1<float> azimuth, In1<float> slope, In1<float> range_m) -> std::optional<Tuple<Out<double>, Out<double>, double>> {
            const Directions seen = directions_from(azimuth, slope, range_m);
            const auto found = without_lock([&] { return find_clusters(seen); });
            if (!found) return std::nullopt;
            return tuple_of(array_of(found->elevation), array_of(found->origin_m), found->sharpness);
        },
        "azimuth"_in, "slope"_in, "range_m"_in,
        "Return elevations at which returns (N,) cluster, heights of their origin, and sharpness; or None.");
}

}  // namespace viewshed
