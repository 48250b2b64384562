// Beams without a return: which ones are missing, where they aimed, and how far each is likely to have gone.
#pragma once

#include <array>
#include <vector>

#include "arrays.hpp"
#include "depth_images.hpp"
#include "leveling.hpp"

namespace viewshed {

// Ground nearer than this many sensor heights (seen at 14° or steeper) is always expected to return.
constexpr double STEEP = 4.0;

// Number of features of a group of beams.
constexpr std::size_t FEATURES = 42;

// Candidate ranges at which a beam may have ended: the nearer or farther neighboring return in its ring, the next
// return below or above in its column, the ground, the mean range around it, the farthest return of its azimuth.
enum Stop { NEARER, FARTHER, BELOW, ABOVE, ON_GROUND, AROUND, FARTHEST, STOPS };

// Directions of the beams of each ring: phase in a column, elevation in radians, height of the origin in meters.
struct RingAims {
    View1<const float> phase;
    View1<const double> elevation, origin_m;
    const double* rotation;  // (3, 3) from the sensor to `level`
};

// B beams, as in viewshed.fov.visibility.Beams; the buffers may be larger.
struct BeamColumns {
    explicit BeamColumns(std::size_t room) : azimuth(room), slope(room), depth_m(room) {}

    std::size_t count = 0;
    Buffer<float> azimuth, slope, depth_m;
};

// B beams, with the ranges that they exceed with probability 0.8, 0.5 and 0.2.
struct NoReturnBeams {
    explicit NoReturnBeams(std::size_t room)
        : azimuth(room), slope(room), early_m(room), depth_m(room), late_m(room) {}

    void add(float new_azimuth, float new_slope, const std::array<float, 3>& depths_m) {
        azimuth[count] = new_azimuth, slope[count] = new_slope;
        early_m[count] = depths_m[0], depth_m[count] = depths_m[1], late_m[count] = depths_m[2];
        ++count;
    }

    std::size_t count = 0;
    Buffer<float> azimuth, slope, early_m, depth_m, late_m;
};

// Inputs of the network for G groups of adjacent beams: direction of the middle beam, number of beams that may meet a
// target, features, and log2 of the candidate ranges.
struct NoReturnGroups {
    Buffer<float> azimuth, slope;
    Buffer<std::int32_t> beams;
    Buffer<float> feature, stop;
};

NoReturnGroups describe_no_return_beams(const DepthImages& images, const RingAims& aims, const Ground& ground,
                                       float sensor_height_m, double top_m, float steep_m);

// Return the missing beams that may meet a target of height top_m, with their depths. A three-layer network on the
// features of a group, fitted by viewshed_lab.training.no_return, gives the probability of each stop, and of none.
NoReturnBeams guess_no_return_beams(const DepthImages& images, const RingAims& aims, const Ground& ground,
                                    float sensor_height_m, double top_m, float steep_m);

// Return all beams without a return, even of empty rings. With `fill`, their depth is the nearer of the two neighboring
// returns in the ring within 16 columns, and beams without one are dropped; otherwise it is infinite.
BeamColumns no_return_beams(const DepthImages& images, const RingAims& aims, bool fill);

}  // namespace viewshed
