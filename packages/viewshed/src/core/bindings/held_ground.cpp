#include "held_ground.hpp"

#include <algorithm>

#include "bindings.hpp"
#include "ground_lattice.hpp"

namespace viewshed {

void bind_held_ground(nb::module_& m) {
    m.def(
        "held_ground",
        [](In2<float> heights_m, In2<float> std_m, In2<bool> seen, double half_m, In2<float> before_heights_m,
           In2<float> before_std_m, In2<bool> before_seen, double before_half_m, In2<float> before_from_now,
           In1<float> now_from_before, float variance_m2)
            -> std::optional<Tuple<Out<float>, Out<float>, Out<bool>>> {
            const auto require_ground = [](const auto& heights, const auto& std, const auto& saw, double half) {
                const std::size_t n = heights.shape(0);
                require(heights.shape(1) == n, "heights_m must be (n, n)");
                require_lattice(n, half);
                require_bounded(view(heights).flat(), "heights_m must be finite");
                require(have_one_shape(heights, std, saw), "std_m and seen must be (n, n) as heights_m");
            };
            require_ground(heights_m, std_m, seen, half_m);
            require_ground(before_heights_m, before_std_m, before_seen, before_half_m);
            require(before_from_now.shape(0) == 2 && before_from_now.shape(1) == 4 && now_from_before.shape(0) == 4,
                    "before_from_now must be (2, 4) and now_from_before (4,)");
            require_bounded(view(before_from_now).flat(), "before_from_now must be finite");
            require_bounded(view(now_from_before), "now_from_before must be finite");
            HeldPoses poses;
            std::copy_n(before_from_now.data(), 8, &poses.before_from_now[0][0]);
            std::copy_n(now_from_before.data(), 4, poses.now_from_before);
            const std::size_t n = heights_m.shape(0);
            Buffer<float> out_m(n * n), out_std_m(n * n);
            Buffer<bool> out_seen(n * n);
            const bool taken = without_lock([&] {
                return hold_ground({view(heights_m), view(std_m), view(seen), half_m},
                                   {view(before_heights_m), view(before_std_m), view(before_seen), before_half_m},
                                   poses, variance_m2, out_m, out_std_m, out_seen);
            });
            if (!taken) return std::nullopt;
            return tuple_of(array(std::move(out_m), {n, n}), array(std::move(out_std_m), {n, n}),
                            array(std::move(out_seen), {n, n}));
        },
        "heights_m"_in, "std_m"_in, "seen"_in, "half_m"_a, "before_heights_m"_in, "before_std_m"_in, "before_seen"_in,
        "before_half_m"_a, "before_from_now"_in, "now_from_before"_in, "variance_m2"_a,
        "Return heights, standard deviations and seen nodes (n, n) of the present ground, with nodes that only an "
        "earlier sweep saw; None if nothing is carried over.");
}

}  // namespace viewshed
