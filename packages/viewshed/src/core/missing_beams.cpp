#include "missing_beams.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>

#include "vectors.hpp"

namespace viewshed {
namespace {

// Eight pixels with one return each.
constexpr std::uint64_t ALL_ONE = 0x0101010101010101;

// Finds the missing beams of a ring from the pixels that do not hold exactly one return, by ascending column.
class Finder {
public:
    Finder(View1<const std::uint8_t> counts, MissingBeams& beams)
        : beams_(beams), columns_(int(counts.size)), doubles_at_(-columns_) {
        // Neighbors across the seam.
        for (int c = columns_ - 1; c >= 0 && last_return_ < 0; --c) last_return_ = counts[c] > 0 ? c : -1;
        for (int c = 0; c < columns_ && first_return_ < 0; ++c) first_return_ = counts[c] > 0 ? c : -1;
    }

    INLINE void visit(int c, int count) {
        if (c - doubles_at_ > JITTER_COLUMNS) doubles_ = 0;
        if (count > 0) {
            close_gap();
            // A second return belongs to the last empty column if that is near, else to a following one.
            for (int k = 1; k < count; ++k) {
                if (m_ > 0 && c - beams_.column[m_ - 1] <= JITTER_COLUMNS) {
                    --m_;
                } else {
                    ++doubles_;
                    doubles_at_ = c;
                }
            }
            return;
        }
        if (c != last_empty_ + 1 || first_in_gap_ < 0) {
            close_gap();
            first_in_gap_ = int(m_);
            before_ = c > 0 ? c - 1 : last_return_ - columns_;
        }
        last_empty_ = c;
        if (doubles_ > 0) {
            --doubles_;
            return;
        }
        beams_.column[m_] = c;
        beams_.before[m_] = first_return_ < 0 ? c : before_;
        beams_.after[m_] = c;
        ++m_;
    }

    void finish() {
        close_gap();
        beams_.count = m_;
    }

private:
    // All beams of a gap share the next return.
    INLINE void close_gap() {
        if (first_in_gap_ >= 0 && first_return_ >= 0) {
            const int after = last_empty_ + 1 < columns_ ? last_empty_ + 1 : columns_ + first_return_;
            for (std::size_t k = std::size_t(first_in_gap_); k < m_; ++k) beams_.after[k] = after;
        }
        first_in_gap_ = -1;
    }

    MissingBeams& beams_;
    int columns_, first_return_ = -1, last_return_ = -1;
    std::size_t m_ = 0;
    int doubles_ = 0, doubles_at_;
    int last_empty_ = -2, first_in_gap_ = -1, before_ = 0;
};

}  // namespace

void find_missing(View1<const std::uint8_t> counts, MissingBeams& beams) {
    // List the pixels that do not hold one return, branch-free except for eight full pixels at once.
    const std::size_t columns = counts.size;
    Buffer<std::int32_t> others(columns + 1);
    std::size_t m = 0, c = 0;
    const auto write_down = [&](std::size_t k) {
        others[m] = std::int32_t(k);
        m += counts[k] != 1;
    };
    for (; c + 8 <= columns; c += 8) {
        std::uint64_t eight;
        std::memcpy(&eight, counts.data + c, 8);
        if (eight == ALL_ONE) continue;
        for (std::size_t k = c; k < c + 8; ++k) write_down(k);
    }
    for (; c < columns; ++c) write_down(c);
    Finder finder(counts, beams);
    for (std::size_t k = 0; k < m; ++k) finder.visit(others[k], counts[std::size_t(others[k])]);
    finder.finish();
}

Turn::Turn(std::size_t columns) : cos(columns), sin(columns) {
    // Compute coarse and fine angles only; each column follows by the angle sum identities.
    constexpr std::size_t FINE = 64;
    double fine_cos[FINE], fine_sin[FINE];
    const double step = 2 * std::numbers::pi / double(columns);
    for (std::size_t k = 0; k < FINE; ++k) {
        fine_cos[k] = std::cos(double(k) * step), fine_sin[k] = std::sin(double(k) * step);
    }
    for (std::size_t start = 0; start < columns; start += FINE) {
        const double azimuth = double(start) * step - std::numbers::pi, co = std::cos(azimuth), si = std::sin(azimuth);
        for (std::size_t k = 0; k < std::min(FINE, columns - start); ++k) {
            cos[start + k] = co * fine_cos[k] - si * fine_sin[k];
            sin[start + k] = si * fine_cos[k] + co * fine_sin[k];
        }
    }
}

MULTIVERSION void aim_beams(const Turn& turn, View1<const std::int32_t> column, double phase, double tangent,
                            const double* rotation, float* azimuth, float* slope) {
    const double angle = 2 * std::numbers::pi * phase / double(turn.cos.size());
    const double co = std::cos(angle), si = std::sin(angle);
    const double *cos = turn.cos.data(), *sin = turn.sin.data(), *r = rotation;
    for (std::size_t k = 0; k < column.size; ++k) {
        const double tc = cos[column[k]], ts = sin[column[k]];
        const double x = tc * co - ts * si, y = ts * co + tc * si, z = tangent;
        const double u = r[0] * x + r[1] * y + r[2] * z, v = r[3] * x + r[4] * y + r[5] * z;
        const double w = r[6] * x + r[7] * y + r[8] * z, flat = std::sqrt(u * u + v * v);
        azimuth[k] = azimuth_of(float(v), float(u));
        slope[k] = float(w / (flat > 1e-6 ? flat : 1e-6));
    }
}

}  // namespace viewshed
