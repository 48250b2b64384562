// Arrays as the stages see them: views with shapes, and buffers that become numpy arrays without a copy.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <new>
#include <stdexcept>
#include <string>

#include "memory.hpp"

namespace viewshed {

namespace nb = nanobind;

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

// What numpy hands in: contiguous, on the processor, of exactly this type (bindings say .noconvert()).
template <typename T>
using In1 = nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <typename T>
using In2 = nb::ndarray<const T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
template <typename T>
using In3 = nb::ndarray<const T, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
// Points (N, 3) in meters.
using Points = nb::ndarray<const float, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
// Arrays that are written in place.
template <typename T>
using InOut1 = nb::ndarray<T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <typename T>
using InOut2 = nb::ndarray<T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
// What is handed back.
template <typename T>
using Out = nb::ndarray<T, nb::numpy, nb::c_contig>;

template <typename T>
View1<const T> view(const In1<T>& a) {
    return {a.data(), a.shape(0)};
}
template <typename T>
View2<const T> view(const In2<T>& a) {
    return {a.data(), a.shape(0), a.shape(1)};
}
template <typename T>
View3<const T> view(const In3<T>& a) {
    return {a.data(), a.shape(0), a.shape(1), a.shape(2)};
}
inline View2<const float> view(const Points& a) { return {a.data(), a.shape(0), 3}; }
template <typename T>
View1<T> view(const InOut1<T>& a) {
    return {a.data(), a.shape(0)};
}
template <typename T>
View2<T> view(const InOut2<T>& a) {
    return {a.data(), a.shape(0), a.shape(1)};
}

// Memory without a value, aligned for vectors and used again; either scratch of a stage or, by `array`, numpy's.
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

    // Give the memory to a numpy array of a shape that holds at most as many values. Needs the interpreter's lock.
    Out<T> array(std::initializer_list<std::size_t> shape) && {
        T* data = data_.release();
        nb::capsule owner(data, [](void* p) noexcept { give_memory(p); });
        return Out<T>(data, shape, owner);
    }
    Out<T> array() && {
        const std::size_t size = size_;
        return std::move(*this).array({size});
    }

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

// Raise ValueError unless a rule holds.
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

// A copy of indices, all of which lie in [low, high]; raises ValueError where one does not. Block by block, so that what is
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
