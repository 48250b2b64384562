// Array views with shapes, and buffers. Nothing here or in a stage depends on Python.
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

// Uninitialized, vector-aligned memory that is reused: scratch space or the result of a stage.
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

    // Release the memory to the caller, who returns it by give_memory.
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

// Throw std::invalid_argument (ValueError in Python) unless a rule holds.
inline void require(bool holds, const char* rule) {
    if (!holds) throw std::invalid_argument(rule);
}

// Copy an array. Read values twice (check, then use) only from a copy: another thread may write the original.
template <typename T>
Buffer<T> copy_of(View1<const T> values) {
    Buffer<T> copy(values.size);
    std::copy_n(values.data, values.size, copy.data());
    std::atomic_signal_fence(std::memory_order_seq_cst);  // keeps the compiler from reading `values` again
    return copy;
}

// Copy indices and check that all lie in [low, high]; throw std::invalid_argument otherwise. Works in blocks, so that
// the values to check are still in cache.
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

// Read an element exactly once, so that the checked value is the used value even if another thread writes the array.
template <typename T>
T read_once(View1<const T> values, std::size_t k) {
    return *static_cast<const volatile T*>(&values[k]);
}

}  // namespace viewshed
