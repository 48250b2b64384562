#include "integrity_evidence.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "bindings.hpp"

namespace viewshed {

namespace {

// Raise ValueError unless an image of ranges has columns, each with a sector; return both.
Image checked_image(const In2<float>& range_m, const In1<std::int16_t>& sector, std::size_t sectors) {
    require(range_m.shape(1) >= 1 && range_m.shape(1) <= 65536, "range_m must have 1 to 65536 columns");
    require(range_m.shape(0) <= 4096, "range_m must have at most 4096 rings");
    require(sector.shape(0) == range_m.shape(1), "sector must have one element for each column");
    require(sectors >= 1 && sectors <= 3600, "sectors must lie in [1, 3600]");
    return {view(range_m), indices_of<std::int16_t>(view(sector), 0, std::int16_t(sectors - 1), "sector")};
}

void require_alike(const In2<float>& range_m, const In2<float>& other, const char* rule) {
    require(other.shape(0) == range_m.shape(0) && other.shape(1) == range_m.shape(1), rule);
}

// Count without the interpreter's lock, and hand back both counts by sector.
template <typename Count>
nb::tuple counted(std::size_t sectors, const Count& count) {
    Buffer<std::int32_t> some(sectors, 0), all(sectors, 0);
    {
        nb::gil_scoped_release unlocked;
        count(Counts{some, all});
    }
    return nb::make_tuple(array(std::move(some)), array(std::move(all)));
}

// Measure without the interpreter's lock, and hand back a number by sector.
template <typename Measure>
Out<float> measured(std::size_t sectors, const Measure& measure) {
    Buffer<float> values(sectors);
    {
        nb::gil_scoped_release unlocked;
        measure(values.view());
    }
    return array(std::move(values));
}

// Rings and columns (N,) of points, and rows (M,) of some of them.
struct Beams {
    Buffer<std::int16_t> ring;
    Buffer<std::int32_t> column, rows;
};

// Raise ValueError unless rings, columns and rows are those of the points; return them.
Beams checked_beams(const Points& points, const In1<std::int16_t>& ring, const In1<std::int32_t>& column,
                    const In1<std::int32_t>& rows, std::size_t rings, std::size_t columns) {
    const std::size_t count = points.shape(0);
    require(ring.shape(0) == count && column.shape(0) == count, "points, ring and column must be as long");
    require(rings >= 1 && rings <= 4096, "rings must lie in [1, 4096]");
    require(columns >= 1 && columns <= 65536, "columns must lie in [1, 65536]");
    require(count > 0 || rows.shape(0) == 0, "rows must be those of points");
    return {indices_of<std::int16_t>(view(ring), -1, std::int16_t(rings - 1), "ring"),
            indices_of<std::int32_t>(view(column), -1, std::int32_t(columns - 1), "column"),
            indices_of<std::int32_t>(view(rows), 0, std::int32_t(std::max<std::size_t>(count, 1) - 1), "rows")};
}

}  // namespace

void bind_integrity_evidence(nb::module_& m) {
    m.def(
        "beam_image",
        [](Points points, In1<std::int16_t> ring, In1<std::int32_t> column, In1<std::int32_t> rows,
           In1<float> height_m, std::size_t rings, std::size_t columns) {
            const Beams beams = checked_beams(points, ring, column, rows, rings, columns);
            require(rows.shape(0) == height_m.shape(0), "rows and height_m must be as long");
            std::optional<BeamImage> made;
            {
                nb::gil_scoped_release unlocked;
                made = beam_image(view(points), beams.ring, beams.column, beams.rows, view(height_m), rings, columns);
            }
            BeamImage& image = *made;
            const std::size_t alive = image.rings;
            return nb::make_tuple(array(std::move(image.range_m), {alive, columns}),
                                  array(std::move(image.farthest_m), {alive, columns}),
                                  array(std::move(image.height_m), {alive, columns}));
        },
        "points"_a.noconvert(), "ring"_a.noconvert(), "column"_a.noconvert(), "rows"_a.noconvert(),
        "height_m"_a.noconvert(), "rings"_a, "columns"_a,
        "Nearest and farthest range and height above ground (A, columns) of the returns rows (M,) of points (N, 3).");
    m.def(
        "count_chosen",
        [](Points points, In1<bool> chosen, std::size_t sectors) {
            require(chosen.shape(0) == points.shape(0), "chosen must have one element for each point");
            require(sectors >= 1 && sectors <= 3600, "sectors must lie in [1, 3600]");
            return counted(sectors, [&](const Counts& counts) { count_chosen(view(points), view(chosen), counts); });
        },
        "points"_a.noconvert(), "chosen"_a.noconvert(), "sectors"_a,
        "How many of the points (N, 3) are chosen (N,), and how many there are, by sector of azimuth (sectors,).");
    m.def(
        "count_holes",
        [](In2<float> range_m, In1<std::int16_t> sector, std::size_t sectors) {
            const Image image = checked_image(range_m, sector, sectors);
            return counted(sectors, [&](const Counts& counts) { count_holes(image, counts); });
        },
        "range_m"_a.noconvert(), "sector"_a.noconvert(), "sectors"_a,
        "Pixels (A, columns) that look through the surface around them, and pixels surrounded, by sector (sectors,).");
    m.def(
        "count_specks",
        [](In2<float> range_m, In1<std::int16_t> sector, std::size_t sectors) {
            const Image image = checked_image(range_m, sector, sectors);
            return counted(sectors, [&](const Counts& counts) { count_specks(image, counts); });
        },
        "range_m"_a.noconvert(), "sector"_a.noconvert(), "sectors"_a,
        "Pixels (A, columns) in line before all around them, and pixels that returned, by sector (sectors,).");
    m.def(
        "count_double_returns",
        [](In2<float> range_m, In2<float> farthest_m, In1<std::int16_t> sector, std::size_t sectors) {
            const Image image = checked_image(range_m, sector, sectors);
            require_alike(range_m, farthest_m, "farthest_m must have the shape of range_m");
            return counted(sectors,
                           [&](const Counts& counts) { count_double_returns(image, view(farthest_m), counts); });
        },
        "range_m"_a.noconvert(), "farthest_m"_a.noconvert(), "sector"_a.noconvert(), "sectors"_a,
        "Pixels (A, columns) that returned twice, and pixels that returned, by sector (sectors,).");
    m.def(
        "measure_noise",
        [](In2<float> range_m, In2<float> height_m, In1<std::int16_t> sector, std::size_t sectors, std::size_t bands) {
            const Image image = checked_image(range_m, sector, sectors);
            require_alike(range_m, height_m, "height_m must have the shape of range_m");
            require(bands >= 1 && bands <= 256, "bands must lie in [1, 256]");
            Buffer<float> noise_m(3 * sectors * bands);
            {
                nb::gil_scoped_release unlocked;
                measure_noise(image, view(height_m), {noise_m.data(), 3, sectors, bands});
            }
            return array(std::move(noise_m), {3, sectors, bands});
        },
        "range_m"_a.noconvert(), "height_m"_a.noconvert(), "sector"_a.noconvert(), "sectors"_a, "bands"_a,
        "Lower quartile of the noise of range in meters along rings (A, columns), of ground, near and all returns (3, "
        "sectors, bands); NaN for too few.");
    m.def(
        "measure_steps",
        [](In2<float> range_m, In2<float> height_m, In1<std::int16_t> sector, std::size_t sectors) {
            const Image image = checked_image(range_m, sector, sectors);
            require_alike(range_m, height_m, "height_m must have the shape of range_m");
            return measured(sectors, [&](View1<float> steps) { measure_steps(image, view(height_m), steps); });
        },
        "range_m"_a.noconvert(), "height_m"_a.noconvert(), "sector"_a.noconvert(), "sectors"_a,
        "Largest common jump of the ground rings (A, columns) against its spread, by sector (sectors,).");
    m.def(
        "measure_breaks",
        [](In2<float> range_m, In1<std::int16_t> sector, std::size_t sectors) {
            const Image image = checked_image(range_m, sector, sectors);
            return measured(sectors, [&](View1<float> breaks) { measure_breaks(image, breaks); });
        },
        "range_m"_a.noconvert(), "sector"_a.noconvert(), "sectors"_a,
        "Largest share of rings (A, columns) that jump between two columns, by sector (sectors,).");
    m.def(
        "measure_empty_runs",
        [](In2<float> range_m, In1<std::int16_t> sector, std::size_t sectors) {
            const Image image = checked_image(range_m, sector, sectors);
            return measured(sectors, [&](View1<float> runs) { measure_empty_runs(image, runs); });
        },
        "range_m"_a.noconvert(), "sector"_a.noconvert(), "sectors"_a,
        "Longest run of empty columns of an image (A, columns) in radians, by sector (sectors,).");
    m.def(
        "find_off_beam",
        [](Points points, In1<std::int16_t> ring, In1<std::int32_t> column, In1<double> origin_m,
           In1<std::int32_t> rows, std::size_t columns) {
            const Beams beams = checked_beams(points, ring, column, rows, origin_m.shape(0), columns);
            Buffer<bool> off_beam(rows.shape(0));
            {
                nb::gil_scoped_release unlocked;
                find_off_beam(view(points), beams.ring, beams.column, view(origin_m), beams.rows, columns, off_beam);
            }
            return array(std::move(off_beam));
        },
        "points"_a.noconvert(), "ring"_a.noconvert(), "column"_a.noconvert(), "origin_m"_a.noconvert(),
        "rows"_a.noconvert(), "columns"_a,
        "Mask (M,) of the returns rows (M,) of points (N, 3) that lie on no beam of their ring (N,).");
    m.def(
        "measure_range_offset",
        [](Points points, float sensor_height_m, std::size_t sectors) {
            require(sectors >= 1 && sectors <= 3600, "sectors must lie in [1, 3600]");
            require(std::isfinite(sensor_height_m) && sensor_height_m > 0.0f, "sensor_height_m must be positive");
            return measured(sectors, [&](View1<float> offset_m) {
                measure_range_offset(view(points), sensor_height_m, offset_m);
            });
        },
        "points"_a.noconvert(), "sensor_height_m"_a, "sectors"_a,
        "Offset of range in meters that flattens the ground in level points (M, 3), by sector (sectors,).");
}

}  // namespace viewshed
