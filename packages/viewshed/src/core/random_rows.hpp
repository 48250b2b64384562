// Random rows of a cloud with a fixed seed: a sample that the order of the points does not bias.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace viewshed {

// Reimplements numpy's default_rng(0) (PCG64, O'Neill 2014; Lemire's bounded integers): the same samples as in Python.
class RandomNumbers {
public:
    // Return a random number in [0, count).
    std::uint32_t below(std::uint32_t count) {
        std::uint64_t product = std::uint64_t(next()) * count;
        if (std::uint32_t(product) < count) {
            const std::uint32_t least = (0u - count) % count;
            while (std::uint32_t(product) < least) product = std::uint64_t(next()) * count;
        }
        return std::uint32_t(product >> 32);
    }

private:
    __extension__ using Wide = unsigned __int128;
    static constexpr Wide wide(std::uint64_t high, std::uint64_t low) { return Wide(high) << 64 | low; }

    // Return 32 bits: the lower half of a step, then its upper half.
    std::uint32_t next() {
        has_half_ = !has_half_;
        if (!has_half_) return half_;
        state_ = state_ * wide(0x2360ed051fc65da4, 0x4385df649fccf645) + wide(0x418ddadb3af71a82, 0x588133bc447873a9);
        const auto mixed = std::uint64_t(state_ >> 64) ^ std::uint64_t(state_);
        const auto turn = unsigned(state_ >> 122);
        const std::uint64_t turned = mixed >> turn | mixed << (-turn & 63);
        half_ = std::uint32_t(turned >> 32);
        return std::uint32_t(turned);
    }

    Wide state_ = wide(0x1aa1b5345996452d, 0x09585eb7a69561e3);
    std::uint32_t half_ = 0;
    bool has_half_ = false;
};

// Return `size` random rows of a cloud of `count` returns, with replacement.
inline std::vector<std::uint32_t> random_rows(std::size_t count, std::size_t size) {
    RandomNumbers numbers;
    std::vector<std::uint32_t> rows(size);
    for (std::uint32_t& row : rows) row = numbers.below(std::uint32_t(count));
    return rows;
}

// Return all rows of a cloud of `count` returns, shuffled.
inline std::vector<std::uint32_t> shuffled_rows(std::size_t count) {
    RandomNumbers numbers;
    std::vector<std::uint32_t> rows(count);
    for (std::size_t k = 0; k < count; ++k) rows[k] = std::uint32_t(k);
    for (std::size_t k = count; k-- > 1;) std::swap(rows[k], rows[numbers.below(std::uint32_t(k) + 1)]);
    return rows;
}

}  // namespace viewshed
