#include "temporal_evidence.hpp"

#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "bindings.hpp"
#include "cell_memory.hpp"
#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

Transform transform_of(const float* values) {
    Transform transform;
    for (std::size_t k = 0; k < 12; ++k) {
        transform.m[k] = values[k];
        require(std::isfinite(transform.m[k]), "transforms must be finite");
    }
    return transform;
}

Transform transform_of(const In2<float>& values) {
    require(values.shape(0) == 3 && values.shape(1) == 4, "a transform must have shape (3, 4)");
    return transform_of(values.data());
}

// Check that a transform keeps positions in the range of cell numbers.
Transform bounded(const Transform& transform) {
    for (const float value : transform.m) require(std::fabs(value) < 1e7f, "transforms must be less than 1e7");
    return transform;
}

// Check and copy the transforms (K, 3, 4) to the sensor frames of other sweeps.
std::vector<Transform> transforms_of(const std::vector<const SweepView*>& views, const In3<float>& transforms) {
    require(transforms.shape(0) == views.size() && transforms.shape(1) == 3 && transforms.shape(2) == 4,
            "transforms must have shape (K, 3, 4), one for each view");
    std::vector<Transform> result;
    for (std::size_t k = 0; k < views.size(); ++k) {
        require(views[k] != nullptr, "views must be views");
        result.push_back(transform_of(transforms.data() + 12 * k));
    }
    return result;
}

// Combine other sweeps with the transforms (K, 3, 4)to their frames and the seconds to the sweep before.
std::vector<Other> others_of(const std::vector<const SweepView*>& views, const In3<float>& transforms,
                             const In1<float>& gaps_s) {
    const std::vector<Transform> transforms_to_views = transforms_of(views, transforms);
    require(gaps_s.shape(0) == views.size(), "gaps_s must have one value for each view");
    std::vector<Other> others;
    for (std::size_t k = 0; k < views.size(); ++k) {
        const float gap_s = read_once(view(gaps_s), k);
        require(std::isfinite(gap_s) && gap_s > 0.0f, "gaps_s must be positive");
        others.push_back({views[k], transforms_to_views[k], gap_s});
    }
    return others;
}

}  // namespace

void bind_temporal_evidence(nb::module_& m) {
    nb::class_<SweepView>(m, "SweepView", "View of a sweep, to be compared with sweeps before and after it.")
        .def(
            "__init__",
            [](SweepView* self, In2<float> squared_m2, In1<float> phase, In1<float> elevation, In1<float> origin_m,
               Points points, In1<float> height_m, In1<float> range_m, In1<float> azimuth, In1<bool> isolated,
               In2<float> sensor_from_level) {
                const std::size_t rings = squared_m2.shape(0), count = points.shape(0);
                require(rings >= 1 && rings <= 4096, "an image must have 1 to 4096 rings");
                require(squared_m2.shape(1) >= 8 && squared_m2.shape(1) <= 65536,
                        "an image must have 8 to 65536 columns");
                require(phase.shape(0) == rings && elevation.shape(0) == rings && origin_m.shape(0) == rings,
                        "phase, elevation and origin_m must have one value for each ring");
                const Buffer<float> own_phase = copy_of(view(phase)), own_elevation = copy_of(view(elevation));
                const Buffer<float> own_origin_m = copy_of(view(origin_m));
                for (std::size_t r = 0; r < rings; ++r) {
                    require(std::isfinite(own_elevation[r]) && std::isfinite(own_origin_m[r]),
                            "elevation and origin_m must be finite");
                    require(own_phase[r] >= 0.0f && own_phase[r] <= 1.0f, "phase must lie in [0, 1]");
                }
                require(height_m.shape(0) == count && range_m.shape(0) == count && azimuth.shape(0) == count &&
                            isolated.shape(0) == count,
                        "points, height_m, range_m, azimuth and isolated must be as long");
                const Transform transform = transform_of(sensor_from_level);
                nb::gil_scoped_release unlocked;
                new (self) SweepView(view(squared_m2), own_phase, own_elevation, own_origin_m, view(points), view(height_m),
                                     view(range_m), view(azimuth), view(isolated), transform);
            },
            "squared_m2"_in, "phase"_in, "elevation"_in, "origin_m"_in, "points"_in, "height_m"_in, "range_m"_in,
            "azimuth"_in, "isolated"_in, "sensor_from_level"_in)
        .def_prop_ro("rings", &SweepView::rings)
        .def_prop_ro("columns", &SweepView::columns)
        .def_prop_ro("obstacles", [](const SweepView& self) { return self.obstacles().size(); })
        .def(
            "follow",
            [](const SweepView& self, const std::vector<const SweepView*>& views, In3<float> transforms,
               In1<float> gaps_s, const SweepView& around, In2<float> around_from_self, std::size_t sectors) {
                require(sectors >= 1 && sectors <= 3600, "sectors must lie in [1, 3600]");
                const std::vector<Other> others = others_of(views, transforms, gaps_s);
                const Transform transform = transform_of(around_from_self);
                Buffer<float> speed_mps(sectors);
                without_lock([&] { follow_all(self, others, around, transform, speed_mps); });
                return array(std::move(speed_mps));
            },
            "views"_a, "transforms"_in, "gaps_s"_in, "around"_a, "around_from_self"_in, "sectors"_a,
            "Return the speed (sectors,) in m/s that obstacles need to match these views, by azimuth around the "
            "sweep `around`.")
        .def(
            "jumps",
            [](const SweepView& self, const std::vector<const SweepView*>& views, In3<float> transforms,
               In1<float> gaps_s, std::size_t sectors) {
                require(sectors >= 1 && sectors <= 3600, "sectors must lie in [1, 3600]");
                require(views.size() == 2, "two views are needed");
                const std::vector<Other> others = others_of(views, transforms, gaps_s);
                Buffer<float> jump_m(sectors);
                const float ratio = (others[0].gap_s + others[1].gap_s) / others[0].gap_s;
                without_lock([&] { jumps(self, others[0], others[1], ratio, jump_m); });
                return array(std::move(jump_m));
            },
            "views"_a, "transforms"_in, "gaps_s"_in, "sectors"_a,
            "Return how far surfaces jump (sectors,) in m relative to constant speed, over the two views before.")
        .def(
            "repeats",
            [](const SweepView& self, const std::vector<const SweepView*>& views, std::size_t sectors) {
                require(sectors >= 1 && sectors <= 3600, "sectors must lie in [1, 3600]");
                for (const SweepView* other : views) {
                    require(other != nullptr && other->rings() == self.rings() && other->columns() == self.columns(),
                            "views must have the same rings and columns");
                }
                Buffer<float> share(views.size() * sectors);
                without_lock([&] {
                    for_ranges(views.size(), views.size(), [&](std::size_t, std::size_t begin, std::size_t end) {
                        for (std::size_t k = begin; k < end; ++k) {
                            find_repeats(self, *views[k], {share.data() + k * sectors, sectors});
                        }
                    });
                });
                return array(std::move(share), {views.size(), sectors});
            },
            "views"_a, "sectors"_a,
            "Return the share (views, sectors) of ranges that repeat those of other views, minus what noise repeats; "
            "NaN where too few beams returned in both.")
        .def(
            "new_ranges",
            [](const SweepView& self, const std::vector<const SweepView*>& views, const std::vector<float>& turned,
               std::size_t sectors) {
                require(sectors >= 1 && sectors <= 3600, "sectors must lie in [1, 3600]");
                require(turned.size() == views.size(), "turned must have one value for each view");
                std::vector<float> columns;
                for (std::size_t k = 0; k < views.size(); ++k) {
                    require(views[k] != nullptr && views[k]->rings() == self.rings() && views[k]->columns() == self.columns(),
                            "views must have the same rings and columns");
                    require(std::fabs(turned[k]) <= 2 * PI, "turned must be at most a full turn");
                    columns.push_back(turned[k] * float(self.columns()) / (2 * PI));
                }
                Buffer<float> nearer(sectors), farther(sectors), silent(sectors);
                without_lock([&] { find_new_ranges(self, views, columns, nearer, farther, silent); });
                return tuple_of(array(std::move(nearer)), array(std::move(farther)), array(std::move(silent)));
            },
            "views"_a, "turned"_a, "sectors"_a,
            "Return the share (sectors,) of returns nearer, and farther, than all neighboring beams in other views, "
            "and of beams that returned in all of those but not now; turned is the sensor's rotation in radians "
            "since each view.")
        .def(
            "register_on",
            [](const SweepView& self, const std::vector<const SweepView*>& views, In3<float> transforms) {
                const std::vector<Transform> transforms_to_views = transforms_of(views, transforms);
                std::vector<Registration> found(views.size());
                without_lock([&] {
                    for_ranges(views.size(), views.size(), [&](std::size_t, std::size_t begin, std::size_t end) {
                        for (std::size_t k = begin; k < end; ++k) found[k] = register_on(self, *views[k], transforms_to_views[k]);
                    });
                });
                Buffer<double> step(3 * views.size()), information(9 * views.size()), sigma_m(views.size());
                Buffer<std::int64_t> matches(views.size());
                for (std::size_t k = 0; k < views.size(); ++k) {
                    step[3 * k] = found[k].yaw;
                    step[3 * k + 1] = found[k].x_m;
                    step[3 * k + 2] = found[k].y_m;
                    std::copy(found[k].information.begin(), found[k].information.end(), &information[9 * k]);
                    sigma_m[k] = found[k].sigma_m;
                    matches[k] = std::int64_t(found[k].matches);
                }
                return tuple_of(array(std::move(step), {views.size(), 3}),
                                array(std::move(information), {views.size(), 3, 3}), array(std::move(sigma_m)),
                                array(std::move(matches)));
            },
            "views"_a, "transforms"_in,
            "Register the obstacles on the surfaces of other views: return rotation and shift (K, 3), information "
            "matrix (K, 3, 3), standard deviation of a return in m (K,), and number of returns used (K,).");

    m.def(
        "best_shift",
        [](In2<bool> now, In2<bool> before, int most) {
            const std::size_t cells = now.shape(0);
            require(cells >= 1 && cells <= 4096 && now.shape(1) == cells && have_one_shape(now, before),
                    "now and before must have one shape (cells, cells), 1 to 4096 of them");
            require(most >= 0 && std::size_t(most) <= cells / 2, "most must lie in [0, cells / 2]");
            const auto bytes = [cells](const In2<bool>& mask) {
                return View2<const std::uint8_t>{reinterpret_cast<const std::uint8_t*>(mask.data()), cells, cells};
            };
            const Shift shift = without_lock([&] { return best_shift(bytes(now), bytes(before), most); });
            return tuple_of(shift.down, shift.across, int(shift.cells), int(shift.elsewhere));
        },
        "now"_in, "before"_in, "most"_a,
        "Return the shift (down, across) in cells, each in [-most, most], with the largest overlap of two masks, its "
        "overlap, and the largest overlap more than two cells away; edges wrap around, and the first of equal shifts "
        "counts.");
    m.def(
        "range_noise",
        [](Points points, float step_share, float step_m, std::size_t least) {
            return without_lock([&] { return range_noise(view(points), step_share, step_m, least); });
        },
        "points"_in, "step_share"_a, "step_m"_a, "least"_a,
        "Return the lower quartile in m of second differences of range between consecutive returns on one surface; "
        "NaN with fewer than `least`.");

    nb::class_<CellMemory>(m, "CellMemory", "Obstacles of a stream's last seconds, in world-fixed cells.")
        .def(nb::init<>())
        .def("copy", [](const CellMemory& self) { return CellMemory(self); })
        .def_prop_ro("cells", &CellMemory::cells)
        .def(
            "check",
            [](const CellMemory& self, const SweepView& now, In2<float> now_from_memory, double t_s,
               const std::vector<const SweepView*>& views, In3<float> transforms, In1<float> gaps_s,
               std::size_t sectors) {
                require(sectors >= 1 && sectors <= 3600, "sectors must lie in [1, 3600]");
                require(std::isfinite(t_s), "t_s must be finite");
                const Transform transform = bounded(transform_of(now_from_memory));
                const std::vector<Other> earlier = others_of(views, transforms, gaps_s);
                // Keep the GIL: another thread may add a sweep to the memory.
                Buffer<float> gone_m(sectors), new_m2(sectors);
                self.check(now, transform, t_s, earlier, gone_m, new_m2);
                return tuple_of(array(std::move(gone_m)), array(std::move(new_m2)));
            },
            "now"_a, "now_from_memory"_in, "t_s"_a, "views"_a, "transforms"_in, "gaps_s"_in, "sectors"_a,
            "Return by azimuth around the sweep (sectors,) the meters of standing surfaces that it looks through, "
            "and the area in m2 of obstacles that are new and came too fast.")
        .def(
            "add",
            [](CellMemory& self, const SweepView& now, In2<float> memory_from_now, In2<float> now_from_memory, double t_s) {
                require(std::isfinite(t_s), "t_s must be finite");
                self.add(now, bounded(transform_of(memory_from_now)), bounded(transform_of(now_from_memory)), t_s);
            },
            "now"_a, "memory_from_now"_in, "now_from_memory"_in, "t_s"_a,
            "Add the obstacles of a sweep; forget cells not seen for ten seconds.");
}

}  // namespace viewshed
