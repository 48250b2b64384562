// Helpers for vectorized loops: compilation for several processors; branch-free arctangent, logarithm and power.
#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>

// Compile a function for several generations of x86 processors; the loader chooses one. Inlined functions are included,
// so helpers are INLINE. Sanitizers start after that choice, so they do without.
#if defined(__x86_64__) && defined(__linux__) && !defined(VIEWSHED_SANITIZE)
#define MULTIVERSION __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define MULTIVERSION
#endif
#define INLINE inline __attribute__((always_inline))

namespace viewshed {

constexpr float PI = std::numbers::pi_v<float>;

// Points of a block: columns of this length stay in the L1 cache.
constexpr std::size_t BLOCK = 1024;

// Inputs that pass through a small network at once. Features are clipped to this many standard deviations, so that an
// unseen one does not dominate.
constexpr std::size_t AT_ONCE = 16;
typedef float Lanes __attribute__((vector_size(AT_ONCE * sizeof(float))));
constexpr float MAX_DEVIATIONS = 6.0f;

// Return the azimuth of (x, y) in [-π, π) radians, within 2e-5; 0 at the origin. An odd minimax polynomial of degree 11
// on [0, 1].
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

// Return log2(x), x > 0, within 1e-5, by a polynomial of the mantissa.
INLINE float log2_of(float x) {
    const auto bits = std::bit_cast<std::uint32_t>(x);
    const float m = std::bit_cast<float>((bits & 0x7fffffu) | 0x3f800000u), exponent = float(std::int32_t(bits >> 23) - 127);
    float p = -0.0248259844f * m + 0.266862768f;
    p = p * m + -1.2342799f;
    p = p * m + 3.21886981f;
    p = p * m + -5.26415552f;
    p = p * m + 6.06585886f;
    return exponent + (p * m + -3.02832497f);
}

// Return 2^x, x in [-120, 120], with a relative error below 1e-6.
INLINE float exp2_of(float x) {
    const auto toward_zero = std::int32_t(x);
    const auto whole = toward_zero - std::int32_t(x < float(toward_zero));
    const float part = x - float(whole);
    float p = 0.00189437942f * part + 0.00894058253f;
    p = p * part + 0.0558765569f;
    p = p * part + 0.240131692f;
    p = p * part + 0.693156777f;
    return (p * part + 0.99999977f) * std::bit_cast<float>(std::uint32_t(whole + 127) << 23);
}

// Return exp(x), x in [-40, 80].
INLINE float exp_of(float x) {
    const float log2 = 1.442695f * x;
    return exp2_of(log2 > -60.0f ? log2 : -60.0f);
}

}  // namespace viewshed
