// libviewshed for C++: streams that close themselves, and exceptions in place of statuses. viewshed.h says what each value is.
#pragma once

#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "viewshed.h"

namespace viewshed {

// What a call found wrong.
class Error : public std::runtime_error {
public:
    explicit Error(viewshed_status status) : std::runtime_error(viewshed_error()), status(status) {}
    viewshed_status status;
};

inline void check(viewshed_status status) {
    if (status != VIEWSHED_OK) throw Error(status);
}

struct Estimate {
    std::vector<std::uint8_t> state;  // (cells, cells)
    std::vector<float> visible_prob;  // (cells, cells)
    viewshed_basis basis;
};

// Rings of corners (x, y) in meters; where each begins, one more than there are rings; their regions, negative for a hole.
struct Outline {
    std::vector<double> corners_m;
    std::vector<std::int64_t> begin;
    std::vector<std::int32_t> region;
};

class Stream {
public:
    explicit Stream(const viewshed_options& options = viewshed_defaults())
        : cells_(std::size_t(options.cells) * options.cells) {
        check(viewshed_open(&options, &stream_));
    }
    Stream(Stream&& other) noexcept : stream_(std::exchange(other.stream_, 0)), cells_(other.cells_) {}
    Stream& operator=(Stream&& other) noexcept {
        std::swap(stream_, other.stream_);
        std::swap(cells_, other.cells_);
        return *this;
    }
    ~Stream() {
        if (stream_ != 0) viewshed_close(stream_);
    }

    Estimate estimate(const viewshed_sweep& sweep) const {
        Estimate found{std::vector<std::uint8_t>(cells_), std::vector<float>(cells_), {}};
        check(viewshed_estimate(stream_, &sweep, found.state.data(), found.visible_prob.data(), cells_, &found.basis));
        return found;
    }

    // The outline of what the last estimate calls visible.
    Outline outline() const {
        Outline found;
        std::size_t corners = 0, rings = 0;
        viewshed_status status = VIEWSHED_ERROR_ROOM;
        while (status == VIEWSHED_ERROR_ROOM) {  // and again where another thread estimates meanwhile
            found.corners_m.resize(2 * corners), found.begin.resize(rings + 1), found.region.resize(rings);
            status = viewshed_outline(stream_, found.corners_m.data(), corners, found.begin.data(), found.region.data(), rings,
                                      &corners, &rings);
        }
        check(status);
        found.corners_m.resize(2 * corners), found.begin.resize(rings + 1), found.region.resize(rings);
        return found;
    }

private:
    viewshed_stream stream_ = 0;
    std::size_t cells_;
};

}  // namespace viewshed
