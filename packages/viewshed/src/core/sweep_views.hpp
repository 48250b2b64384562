// What a sweep saw, so that it can be held against sweeps before and after it.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

struct Point3 {
    float x, y, z;
};

// The bin of a position, of `count`; the first for what is no number.
inline int bin_of(float position, int count) {
    return position > 0.0f ? (position < float(count) ? int(position) : count - 1) : 0;
}

// Rotation and shift (3, 4), from one frame to another.
struct Transform {
    std::array<float, 12> m;

    Point3 operator()(Point3 p) const {
        return {m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3], m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7],
                m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11]};
    }
};

// What is found of a place where another sweep looked: an obstacle about there, free passage far beyond, or nothing that is known
// (hidden, not looked at, without a return, at an edge).
enum class Seen : std::uint8_t { UNKNOWN, OCCUPIED, FREE };

// A sweep's range image, its obstacles, and how far the air at their heights is free, by azimuth.
class SweepView {
public:
    // squared_m2 (rings, columns) and phase (rings,) of the range image, elevation (rings,) radians of the rings, whose beams
    // start origin_m (rings,) above the sensor's origin; points (M, 3) in the level frame with height_m above the ground, horizontal range_m, azimuth and whether they are isolated (M,);
    // sensor_from_level as a transform.
    SweepView(View2<const float> squared_m2, View1<const float> phase, View1<const float> elevation,
              View1<const float> origin_m, View2<const float> points, View1<const float> height_m, View1<const float> range_m,
              View1<const float> azimuth, View1<const bool> isolated, const Transform& sensor_from_level);

    std::size_t rings() const { return rings_; }
    std::size_t columns() const { return columns_; }
    const std::vector<Point3>& obstacles() const { return obstacles_; }
    // The number of returns that each obstacle stands for.
    std::size_t obstacle_step() const { return obstacle_step_; }
    const float* ring(std::size_t r) const { return range_m_.data() + r * columns_; }

    // The pixel whose beam points at p in the sensor's frame; a ring of -1 where none does.
    struct Pixel {
        int ring, column;
        float aside;  // from the middle of the column, in columns, -0.5 to 0.5
        float range_m;
    };
    Pixel pixel_of(Point3 p) const;

    // Upright area m2 that the beam of one pixel covers at p.
    float area_of_pixel(Point3 p) const;

    // Where the beam of a pixel ends at a range, in the sensor's frame.
    Point3 at(int ring, int column, float range_m) const;

    // What this sweep found about a place p in its sensor's frame.
    Seen look_at(Point3 p) const;

    // Whether most beams of the ring at p end far beyond it; an attacker who wins not all of them leaves some that do not.
    bool is_passed(Point3 p) const;

    // The difference of range from this sweep's surface to p, in the sensor's frame, between the two beams beside p; NaN
    // where they do not end on one surface near p.
    float range_difference(Point3 p) const;

    // Horizontal distance from p in the sensor's frame to the nearest place where something may have been: behind or at an
    // obstacle, where nothing was seen, or too near to the sensor. 0 where p itself is such a place.
    float distance_to_cover(Point3 p) const;

    // p in the sensor's frame, turned level; the sensor stays the origin.
    Point3 leveled(Point3 p) const;

    // The sector of azimuth in the level frame, of `sectors` from -pi on, of p in the sensor's frame.
    int sector_of(Point3 p, int sectors) const;

private:
    int wrapped(int column) const {
        const int columns = int(columns_);
        return column < 0 ? column + columns : (column >= columns ? column - columns : column);
    }

    int ring_at(float sine) const { return ring_of_sine_[std::size_t(bin_of((sine + 1.0f) * (SINES / 2), SINES))]; }

    // Steps of the sine of the elevation from -1 to 1, in the table of rings.
    static constexpr int SINES = 4096;

    std::size_t rings_, columns_;
    std::vector<float> range_m_, phase_, sine_, cosine_, spacing_, origin_m_;
    std::vector<std::int16_t> ring_of_sine_;
    std::vector<float> cover_m_;
    std::vector<Point3> obstacles_;
    std::size_t obstacle_step_ = 1;
    Transform sensor_from_level_;
};

}  // namespace viewshed
