// Beams without a return: which ones a sweep lacks, where they aimed, and how far each of them is likely to have gone.
#pragma once

#include <array>
#include <vector>

#include "arrays.hpp"
#include "depth_images.hpp"
#include "leveling.hpp"

namespace viewshed {

// Ground nearer than this many sensor heights (seen at 14° or more) is always expected to return.
constexpr double STEEP = 4.0;

// Features of a group of beams.
constexpr std::size_t FEATURES = 42;

// Where a beam may have ended: at the nearer or farther return beside it in its ring, at the next one below or above it in
// its column, at the ground, at the middle range around it, at the farthest return of its azimuth.
enum Stop { NEARER, FARTHER, BELOW, ABOVE, ON_GROUND, AROUND, FARTHEST, STOPS };

// Where the beams of each ring point: where in its columns it fires, radians above the horizon, height of their origin.
struct RingAims {
    View1<const float> phase;
    View1<const double> elevation, origin_m;
    const double* rotation;  // (3, 3) from the sensor to `level`
};

// B beams; as viewshed.fov.visibility.Beams. There is room for more.
struct BeamColumns {
    explicit BeamColumns(std::size_t room) : azimuth(room), slope(room), depth_m(room) {}

    std::size_t count = 0;
    Buffer<float> azimuth, slope, depth_m;
};

// B beams and the ranges that they passed with a probability of .8, .5 and .2.
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

// What the network is fed with, for G groups of beams beside each other: where their middle aims, how many beams may meet
// a target, features, and logarithms (base 2) of the ranges at which they may have ended.
struct NoReturnGroups {
    Buffer<float> azimuth, slope;
    Buffer<std::int32_t> beams;
    Buffer<float> feature, stop;
};

NoReturnGroups describe_no_return_beams(const DepthImages& images, const RingAims& aims, const Ground& ground,
                                       float sensor_height_m, double top_m, float steep_m);

// The beams that may meet a target of height top_m. A network of three layers over the features of a group of beams, fitted
// by viewshed_lab.training.no_return, says how likely each stop is, and that nothing stopped them.
NoReturnBeams guess_no_return_beams(const DepthImages& images, const RingAims& aims, const Ground& ground,
                                    float sensor_height_m, double top_m, float steep_m);

// All beams without a return, in rings without any as well: as deep as the nearer of the two returns beside them in the
// ring within 16 columns, and left out without these; or endless, without `fill`.
BeamColumns no_return_beams(const DepthImages& images, const RingAims& aims, bool fill);

}  // namespace viewshed
