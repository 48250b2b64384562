#include "farthest_returns.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <vector>

#include "vectors.hpp"

namespace viewshed {
namespace {

// Two returns are of one beam if their directions differ by less than an angle plus what a coordinate quantum (grain_m)
// turns the nearer one. Within a ring the elevation may differ more: beams start beside the sensor's center.
constexpr float LARGEST_ANGLE = 5e-4f, ANGLE_OF_RING = 4e-3f;
struct Tolerance {
    float angle, grain_m;
};
constexpr Tolerance TOLERANCE{5e-5f, 1e-3f};

// Stricter tolerance to decide if beams have several returns: with a moving sensor, a near and a far return of adjacent
// beams point in nearly the same direction.
constexpr Tolerance EXACT{2e-5f, 2e-4f};

// Nearer returns are ignored: many sensors report zeros for beams without a return.
constexpr float MIN_RANGE_M = 0.5f;

// A sensor is multi-return if more than this share of the returns share a beam with another. It is tested in 16 sectors
// of azimuth, each 1/1024 of a turn, and must hold in MIN_SECTORS of them: while a car turns, the first and the last
// beams of a sweep point the same way with one return each. A sweep of up to FEW returns is tested as a whole; of a
// larger sector only the first FEW returns.
constexpr double MIN_SHARE = 0.01;
constexpr int SECTORS_OF_TURN = 1024, TESTED_SECTORS = 16, MIN_SECTORS = 4;
constexpr std::size_t FEW = 4096;

struct Directions {
    Buffer<float> azimuth, elevation, range_m;
    explicit Directions(std::size_t n) : azimuth(n), elevation(n), range_m(n) {}
};

MULTIVERSION void find_directions(const float* __restrict xyz, std::size_t n, float* __restrict azimuth,
                                  float* __restrict elevation, float* __restrict range_m) {
    for (std::size_t k = 0; k < n; ++k) {
        const float x = xyz[3 * k], y = xyz[3 * k + 1], z = xyz[3 * k + 2];
        const float flat = x * x + y * y, across_m = std::sqrt(flat);
        azimuth[k] = azimuth_of(y, x);
        elevation[k] = azimuth_of(z, across_m);
        range_m[k] = std::sqrt(flat + z * z);
    }
}

// Returns with their directions, and the test for the same beam.
struct AimedReturns {
    const Directions& at;
    const std::int16_t* ring;  // null if unknown
    Tolerance tolerance;

    bool counts(std::size_t k) const { return at.range_m[k] >= MIN_RANGE_M; }
    bool share_beam(std::size_t a, std::size_t b) const {
        const float nearer_m = std::min(at.range_m[a], at.range_m[b]);
        const float most = std::min(tolerance.angle + tolerance.grain_m / nearer_m, LARGEST_ANGLE);
        const float apart = std::fabs(at.azimuth[a] - at.azimuth[b]);
        if (std::min(apart, 2.0f * PI - apart) > most) return false;
        const float higher = std::fabs(at.elevation[a] - at.elevation[b]);
        return ring ? ring[a] == ring[b] && higher <= ANGLE_OF_RING : higher <= most;
    }
};

// Count the returns that share a beam with another one.
std::size_t count_shared(const AimedReturns& returns, std::vector<std::uint32_t>& some) {
    const Buffer<float>& azimuth = returns.at.azimuth;
    std::sort(some.begin(), some.end(), [&](std::uint32_t a, std::uint32_t b) { return azimuth[a] < azimuth[b]; });
    std::size_t shared = 0;
    for (std::size_t i = 0; i < some.size(); ++i) {
        for (std::size_t j = i + 1; j < some.size() && azimuth[some[j]] - azimuth[some[i]] <= LARGEST_ANGLE; ++j) {
            if (!returns.share_beam(some[i], some[j])) continue;
            ++shared;
            break;
        }
    }
    return shared;
}

// Check if the sensor reports several returns of a beam.
bool has_several(const AimedReturns& returns) {
    const Buffer<float>& azimuth = returns.at.azimuth;
    const std::size_t count = azimuth.size();
    const bool is_small = count <= FEW;
    constexpr int EVERY = SECTORS_OF_TURN / TESTED_SECTORS;
    std::array<std::vector<std::uint32_t>, TESTED_SECTORS> some;
    for (std::size_t k = 0; k < count; ++k) {
        if (!returns.counts(k)) continue;
        const int sector = is_small ? EVERY / 2 : int((azimuth[k] + PI) * (float(SECTORS_OF_TURN) / (2.0f * PI)));
        if (sector % EVERY != EVERY / 2 || some[std::size_t(sector / EVERY)].size() == FEW) continue;
        some[std::size_t(sector / EVERY)].push_back(std::uint32_t(k));
    }
    std::size_t shared = 0, total = 0;
    int sectors = 0;
    for (auto& of_sector : some) {
        const std::size_t here = count_shared(returns, of_sector);
        shared += here, total += of_sector.size(), sectors += here > 0;
    }
    return double(shared) > MIN_SHARE * double(total) && sectors >= (is_small ? 1 : MIN_SECTORS);
}

// Hash table of returns by direction cell. Cells are twice as wide as the tolerance, so that returns of a beam lie in
// one cell or in the neighbor on the nearer side.
class ByDirection {
public:
    ByDirection(const AimedReturns& returns, const std::vector<char>& kept)
        : returns_(returns), kept_(kept), first_(std::bit_ceil(2 * kept.size()), NONE), next_(kept.size()) {}

    void add(std::uint32_t k) {
        std::uint32_t& first = first_[slot_of(cell(column_of(k), COLUMNS), cell(row_of(k), 0))];
        next_[k] = first;
        first = k;
    }

    // Call body for each added return of the same beam that is still kept; unlink those that are not.
    template <typename Body>
    void for_same_beam(std::uint32_t k, const Body& body) {
        const float column = column_of(k), row = row_of(k);
        const std::int32_t c = cell(column, COLUMNS), r = cell(row, 0), rows = returns_.ring ? 1 : 2;
        const std::int32_t column_cells[2] = {c, cell(column - float(c) < 0.5f ? column - 1.0f : column + 1.0f, COLUMNS)};
        const std::int32_t row_cells[2] = {r, row - float(r) < 0.5f ? r - 1 : r + 1};
        for (int i = 0; i < 2; ++i) {
            for (int j = 0; j < rows; ++j) {
                std::uint32_t* at = &first_[slot_of(column_cells[i], row_cells[j])];
                while (*at != NONE) {
                    if (!kept_[*at]) {
                        *at = next_[*at];
                        continue;
                    }
                    if (returns_.share_beam(k, *at)) body(*at);
                    at = &next_[*at];
                }
            }
        }
    }

private:
    static constexpr std::uint32_t NONE = ~std::uint32_t{0};
    static constexpr float CELL = 2.0f * LARGEST_ANGLE;
    static constexpr auto COLUMNS = std::int32_t(2.0f * PI / CELL);

    float column_of(std::uint32_t k) const { return (returns_.at.azimuth[k] + PI) * (float(COLUMNS) / (2.0f * PI)); }
    float row_of(std::uint32_t k) const {
        return returns_.ring ? float(returns_.ring[k]) : (returns_.at.elevation[k] + PI) / CELL;
    }
    // Return the cell of a position, modulo `turn` cells unless that is 0.
    static std::int32_t cell(float place, std::int32_t turn) {
        const auto at = std::int32_t(std::floor(place));
        return turn == 0 ? at : (at + turn) % turn;
    }
    std::size_t slot_of(std::int32_t column, std::int32_t row) const {
        const std::uint64_t mixed = (std::uint64_t(std::uint32_t(column)) << 32 | std::uint32_t(row)) * 0x9e3779b97f4a7c15u;
        return std::size_t(mixed >> 40) & (first_.size() - 1);
    }

    AimedReturns returns_;
    const std::vector<char>& kept_;
    std::vector<std::uint32_t> first_;
    Buffer<std::uint32_t> next_;
};

}  // namespace

std::optional<Buffer<std::int32_t>> farthest_returns(View2<const float> points, std::optional<View1<const std::int16_t>> ring) {
    const std::size_t count = points.rows;
    // 1. Test if beams have several returns.
    Directions at(count);
    find_directions(points.data, count, at.azimuth.data(), at.elevation.data(), at.range_m.data());
    AimedReturns returns{at, ring ? ring->data : nullptr, EXACT};
    if (!has_several(returns)) return std::nullopt;
    // 2. Keep the farthest return of each beam, in the order of the rows.
    returns.tolerance = TOLERANCE;
    std::vector<char> kept(count, 1);
    ByDirection seen(returns, kept);
    for (std::uint32_t k = 0; k < count; ++k) {
        if (!returns.counts(k)) continue;
        seen.for_same_beam(k, [&](std::uint32_t other) { kept[at.range_m[k] > at.range_m[other] ? other : k] = 0; });
        if (kept[k]) seen.add(k);
    }
    Buffer<std::int32_t> rows(std::size_t(std::count(kept.begin(), kept.end(), 1)));
    std::size_t row = 0;
    for (std::size_t k = 0; k < count; ++k) {
        if (kept[k]) rows[row++] = std::int32_t(k);
    }
    return rows;
}

}  // namespace viewshed
