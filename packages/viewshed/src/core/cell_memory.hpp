// Remember the obstacles of a stream's last seconds in world-fixed cells, and find contradictions of a new sweep.
#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

#include "sweep_views.hpp"
#include "temporal_evidence.hpp"

namespace viewshed {

class CellMemory {
public:
    // Write by sector around the sensor the meters of standing surfaces that the sweep looks through, and the vertical
    // area in m² of obstacles in cells that were never occupied and that earlier sweeps saw free. `earlier` are sweeps
    // before it, newest first, with the transforms to their frames. Changes nothing.
    void check(const SweepView& now, const Transform& now_from_memory, double t_s, const std::vector<Other>& earlier,
               View1<float> gone_m, View1<float> new_m2) const;

    // Add a sweep at time t_s, and forget cells that were not seen for long.
    void add(const SweepView& now, const Transform& memory_from_now, const Transform& now_from_memory, double t_s);

    std::size_t cells() const { return cells_.size(); }

private:
    // A cell: times of its first and last obstacle, the last obstacle point, and numbers of sweeps that saw it occupied
    // or free.
    struct Cell {
        double first_s, last_s;
        Point3 point;
        std::int32_t occupied, free;
    };

    std::unordered_map<std::int64_t, Cell> cells_;
};

}  // namespace viewshed
