// Beams without a return: which ones a sweep lacks, where they aimed, and how far each of them is likely to have gone.
#pragma once

#include "arrays.hpp"
#include "depth_images.hpp"
#include "leveling.hpp"

namespace viewshed {

// Ground nearer than this many sensor heights (seen at 14° or more) is always expected to return.
constexpr double STEEP = 4.0;

// Where the beams of each ring point: where in its columns it fires, radians above the horizon, height of their origin.
struct RingAims {
    View1<const float> phase;
    View1<const double> elevation, origin_m;
    const double* rotation;  // (3, 3) from the sensor to `level`
};

// B beams; as viewshed.fov.visibility.Beams. There is room for more.
struct BeamColumns {
    explicit BeamColumns(std::size_t room) : azimuth(room), slope(room), depth_m(room) {}

    void add(float new_azimuth, float new_slope, float new_depth_m) {
        azimuth[count] = new_azimuth, slope[count] = new_slope, depth_m[count] = new_depth_m;
        ++count;
    }

    std::size_t count = 0;
    Buffer<float> azimuth, slope, depth_m;
};

// Split the beams without a return into those of inferred depth and unresolved ones, by the rules of
// viewshed.preprocess.no_return.beams_by_evidence. Targets are top_m high.
void split_no_return_beams(const DepthImages& images, const RingAims& aims, const Ground& ground, float sensor_height_m,
                           double top_m, float steep_m, BeamColumns& inferred, BeamColumns& unresolved);

// All beams without a return, in rings without any as well: as deep as the nearer of the two returns beside them in the
// ring within 16 columns, and left out without these; or endless, without `fill`.
BeamColumns no_return_beams(const DepthImages& images, const RingAims& aims, bool fill);

}  // namespace viewshed
