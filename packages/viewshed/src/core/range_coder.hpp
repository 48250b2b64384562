// Adaptive binary range coder. Encoder and decoder share the `bit` interface, so that one template, compiled for
// either, both writes and reads the data.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "arrays.hpp"
#include "vectors.hpp"

namespace viewshed {

// Model of one kind of decision: the probability of true in units of 2^-16, and the number of decisions seen.
struct BitModel {
    std::uint16_t probability = 1 << 15;
    std::uint16_t seen = 0;
};

namespace coder {

// After this number of decisions a model adapts at a constant rate.
constexpr std::uint16_t MAX_SEEN = 24;

// Adaptation rate in units of 2^-16, by the number of decisions seen.
constexpr auto RATE = [] {
    std::array<std::int32_t, MAX_SEEN + 1> rate{};
    for (int seen = 0; seen <= MAX_SEEN; ++seen) rate[seen] = std::int32_t(65536.0 / (seen + 2.5));
    return rate;
}();

// Probabilities stay in [SMALLEST, 65536 - SMALLEST] / 65536, so that no decision is impossible.
constexpr std::int32_t SMALLEST = 32;

INLINE void learn(BitModel& model, bool bit) {
    const std::int32_t target = bit ? 65536 - SMALLEST : SMALLEST;
    model.probability = std::uint16_t(model.probability + (((target - model.probability) * RATE[model.seen]) >> 16));
    model.seen = std::uint16_t(model.seen + (model.seen < MAX_SEEN));
}

// The range stays above this; data moves in 32-bit words.
constexpr std::uint64_t MIN_RANGE = 1ull << 32;

// Return the number in [low, low + range), modulo 2^64, with the most trailing zeros: it ends a code.
inline std::uint64_t shortest(std::uint64_t low, std::uint64_t range) {
    for (int zeros = 63; zeros > 0; --zeros) {
        const std::uint64_t step = 1ull << zeros, number = (low + (step - 1)) & ~(step - 1);
        if (number - low < range) return number;
    }
    return low;
}

}  // namespace coder

// Encodes decisions; `finish` returns the code.
class RangeEncoder {
public:
    static constexpr bool DECODES = false;

    INLINE bool bit(BitModel& model, bool value) {
        ++decisions_;
        narrow(value, (range_ >> 16) * model.probability);
        coder::learn(model, value);
        return value;
    }

    // Encode `count` equiprobable bits, the highest first.
    std::uint32_t plain(std::uint32_t value, int count) {
        for (int k = count - 1; k >= 0; --k) narrow((value >> k) & 1, range_ >> 1);
        return value;
    }

    std::size_t decisions() const { return decisions_; }
    bool failed() const { return false; }

    // Return the shortest code of these decisions; a decoder reads zeros beyond its end.
    std::vector<std::uint8_t> finish() {
        const std::uint64_t last = coder::shortest(low_, range_);
        if (last < low_) carry();
        low_ = last;
        const std::size_t least = bytes_.size();
        for (int k = 0; k < 2; ++k) push();
        while (bytes_.size() > least && bytes_.back() == 0) bytes_.pop_back();
        return std::move(bytes_);
    }

private:
    INLINE void narrow(bool value, std::uint64_t bound) {
        if (value) {
            range_ = bound;
        } else {
            low_ += bound;
            if (low_ < bound) carry();
            range_ -= bound;
        }
        if (range_ < coder::MIN_RANGE) {
            push();
            range_ <<= 32;
        }
    }
    void push() {
        for (int shift = 56; shift >= 32; shift -= 8) bytes_.push_back(std::uint8_t(low_ >> shift));
        low_ <<= 32;
    }
    void carry() {
        std::size_t k = bytes_.size();
        while (k > 0 && ++bytes_[--k] == 0) {
        }
    }

    std::uint64_t low_ = 0, range_ = std::numeric_limits<std::uint64_t>::max();
    std::size_t decisions_ = 0;
    std::vector<std::uint8_t> bytes_;
};

// Decodes decisions. Any bytes give decisions: `failed` tells invalid codes, `ended` complete ones.
class RangeDecoder {
public:
    static constexpr bool DECODES = true;

    explicit RangeDecoder(View1<const std::uint8_t> bytes) : bytes_(bytes) {
        value_ = std::uint64_t(next()) << 32;
        value_ |= next();
    }

    INLINE bool bit(BitModel& model, bool) {
        const std::uint64_t bound = (range_ >> 16) * model.probability;
        const bool value = value_ < bound;
        ++decisions_;
        narrow(value, bound);
        coder::learn(model, value);
        return value;
    }

    std::uint32_t plain(std::uint32_t, int count) {
        std::uint32_t found = 0;
        for (int k = 0; k < count; ++k) {
            const bool value = value_ < (range_ >> 1);
            narrow(value, range_ >> 1);
            found = found << 1 | std::uint32_t(value);
        }
        return found;
    }

    std::size_t decisions() const { return decisions_; }

    // Check if more was read than the code and the zeros beyond it.
    bool failed() const { return at_ > bytes_.size + AHEAD; }

    // Check that the code ends here exactly as an encoder ends it, so that codes are unique.
    bool ended() const {
        if (failed() || at_ < bytes_.size) return false;
        std::uint64_t last = 0;
        for (std::size_t k = at_ - AHEAD; k < at_; ++k) last = last << 8 | byte(k);
        const bool has_no_zeros = bytes_.size + AHEAD == at_ || bytes_[bytes_.size - 1] != 0;
        return has_no_zeros && last == coder::shortest(last - value_, range_);
    }

private:
    INLINE void narrow(bool value, std::uint64_t bound) {
        range_ = value ? bound : range_ - bound;
        value_ -= value ? 0 : bound;
        if (range_ < coder::MIN_RANGE) {
            value_ = value_ << 32 | next();
            range_ <<= 32;
        }
    }
    std::uint32_t next() {
        std::uint32_t word = 0;
        for (std::size_t k = 0; k < 4; ++k) word = word << 8 | byte(at_ + k);
        at_ += 4;
        return word;
    }
    std::uint32_t byte(std::size_t k) const { return k < bytes_.size ? bytes_[k] : 0u; }

    // Bytes read ahead.
    static constexpr std::size_t AHEAD = 8;

    View1<const std::uint8_t> bytes_;
    std::size_t at_ = 0, decisions_ = 0;
    std::uint64_t value_ = 0, range_ = std::numeric_limits<std::uint64_t>::max();
};

}  // namespace viewshed
