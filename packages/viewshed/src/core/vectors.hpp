// What lets the compiler write vectors: loops compiled for several processors, and an arctangent without branches.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>

// A function that is compiled for several generations of x86 processors; the one that runs is chosen when the module is
// loaded. Functions that it inlines come along, so helpers are INLINE. Sanitizers start after that choice: without it.
#if defined(__x86_64__) && defined(__linux__) && !defined(VIEWSHED_SANITIZE)
#define MULTIVERSION __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define MULTIVERSION
#endif
#define INLINE inline __attribute__((always_inline))

namespace viewshed {

constexpr float PI = std::numbers::pi_v<float>;

// Points of a block: columns of this length stay in the nearest memory.
constexpr std::size_t BLOCK = 1024;

// The azimuth of (x, y) in [-π, π) radians, within 2e-5; 0 at the origin. A minimax polynomial of the arctangent on
// [0, 1], odd, to the eleventh power.
INLINE float azimuth_of(float y, float x) {
    const float ax = std::fabs(x), ay = std::fabs(y);
    const float small = ax < ay ? ax : ay, large = ax < ay ? ay : ax;
    const float ratio = small / (large + 1e-30f);
    const float s = ratio * ratio;
    float p = -0.01172120f * s + 0.05265332f;
    p = p * s - 0.11643287f;
    p = p * s + 0.19354346f;
    p = p * s - 0.33262347f;
    float a = (p * s + 0.99997726f) * ratio;
    a = ay > ax ? PI / 2 - a : a;
    a = x < 0 ? PI - a : a;
    a = y < 0 ? -a : a;
    return a >= PI ? -PI : a;
}

}  // namespace viewshed
