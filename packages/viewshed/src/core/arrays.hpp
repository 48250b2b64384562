// Arrays as the stages see them: views with shapes, and buffers. Nothing here or in a stage knows of Python.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <stdexcept>
#include <string>

#include "memory.hpp"

namespace viewshed {

// A contiguous array of one dimension.
template <typename T>
struct View1 {
    T* data;
    std::size_t size;

    T& operator[](std::size_t k) const { return data[k]; }
    T* begin() const { return data; }
    T* end() const { return data + size; }
};

// A contiguous array of rows × columns.
template <typename T>
struct View2 {
    T* data;
    std::size_t rows, columns;

    T& operator()(std::size_t r, std::size_t c) const { return data[r * columns + c]; }
    T* operator[](std::size_t r) const { return data + r * columns; }
    std::size_t size() const { return rows * columns; }
    View1<T> flat() const { return {data, size()}; }
};

// A contiguous array of planes × rows × columns.
template <typename T>
struct View3 {
    T* data;
    std::size_t planes, rows, columns;

    T& operator()(std::size_t p, std::size_t r, std::size_t c) const { return data[(p * rows + r) * columns + c]; }
    View2<T> operator[](std::size_t p) const { return {data + p * rows * columns, rows, columns}; }
    std::size_t size() const { return planes * rows * columns; }
};

// Memory without a value, aligned for vectors and used again: scratch of a stage, or a result.
template <typename T>
class Buffer {
public:
    explicit Buffer(std::size_t size) : size_(size), data_(allocate(size)) {}
    Buffer(std::size_t size, T value) : Buffer(size) {
        for (std::size_t k = 0; k < size; ++k) data_[k] = value;
    }

    T& operator[](std::size_t k) { return data_[k]; }
    const T& operator[](std::size_t k) const { return data_[k]; }
    T* data() { return data_.get(); }
    const T* data() const { return data_.get(); }
    std::size_t size() const { return size_; }
    T* begin() { return data(); }
    T* end() { return data() + size_; }

    operator View1<T>() { return {data(), size_}; }
    operator View1<const T>() const { return {data(), size_}; }
    View1<T> view() { return {data(), size_}; }
    View2<T> view(std::size_t rows, std::size_t columns) { return {data(), rows, columns}; }

    // Give the memory away; who takes it hands it back by give_memory.
    T* release() && { return data_.release(); }

private:
    struct Free {
        void operator()(T* p) const { give_memory(p); }
    };
    static T* allocate(std::size_t size) {
        if (size > SIZE_MAX / sizeof(T)) throw std::bad_alloc();
        return static_cast<T*>(take_memory(size * sizeof(T)));
    }

    std::size_t size_;
    std::unique_ptr<T[], Free> data_;
};

// Throw std::invalid_argument, which is a ValueError in Python, unless a rule holds.
inline void require(bool holds, const char* rule) {
    if (!holds) throw std::invalid_argument(rule);
}

// A copy of an array. Another thread may write an array while it is read: what is read twice, checked first and then used
// above all, is read from a copy.
template <typename T>
Buffer<T> copy_of(View1<const T> values) {
    Buffer<T> copy(values.size);
    std::copy_n(values.data, values.size, copy.data());
    std::atomic_signal_fence(std::memory_order_seq_cst);  // the compiler reads `values` no second time
    return copy;
}

// A copy of indices, all of which lie in [low, high]; throws std::invalid_argument where one does not. Block by block, so that what is
// checked is still at hand.
template <typename T>
Buffer<T> indices_of(View1<const T> values, T low, T high, const char* name) {
    constexpr std::size_t CHECKED = 8192;
    Buffer<T> copy(values.size);
    T outside = 0;
    for (std::size_t start = 0; start < values.size; start += CHECKED) {
        const std::size_t end = std::min(start + CHECKED, values.size);
        std::copy(values.data + start, values.data + end, copy.data() + start);
        std::atomic_signal_fence(std::memory_order_seq_cst);
        const T* const checked = copy.data();
        for (std::size_t k = start; k < end; ++k) outside = T(outside | T((checked[k] < low) | (checked[k] > high)));
    }
    if (outside != 0) {
        const auto [least, most] = std::minmax_element(copy.begin(), copy.end());
        throw std::invalid_argument(std::string(name) + " must lie in [" + std::to_string(low) + ", " +
                                    std::to_string(high) + "], got " + std::to_string(*least < low ? *least : *most));
    }
    return copy;
}

// An element of an array that another thread may write: what is checked is what is used.
template <typename T>
T read_once(View1<const T> values, std::size_t k) {
    return *static_cast<const volatile T*>(&values[k]);
}

}  // namespace viewshed
