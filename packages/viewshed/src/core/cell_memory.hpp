// The obstacles of the last seconds of one stream, in cells that stand still in the world, and what a sweep contradicts of them.
#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

#include "sweep_views.hpp"
#include "temporal_evidence.hpp"

namespace viewshed {

class CellMemory {
public:
    // By sector about the sensor: meters of standing surfaces through which a sweep looks, and the upright area m2 of obstacles in
    // cells that were never occupied and that earlier sweeps looked through. Nothing is changed. earlier are sweeps before it, the
    // newest first, with the transforms to their frames.
    void check(const SweepView& now, const Transform& now_from_memory, double t_s, const std::vector<Other>& earlier,
               View1<float> gone_m, View1<float> new_m2) const;

    // Remember a sweep at a time, and forget what was not seen for long.
    void add(const SweepView& now, const Transform& memory_from_now, const Transform& now_from_memory, double t_s);

    std::size_t cells() const { return cells_.size(); }

private:
    // What is known of a cell: when obstacles were seen there first and last, the last of them, and how many sweeps found it
    // occupied, or looked through it.
    struct Cell {
        double first_s, last_s;
        Point3 point;
        std::int32_t occupied, free;
    };

    std::unordered_map<std::int64_t, Cell> cells_;
};

}  // namespace viewshed
