// Helpers of the bindings, which check all arrays: numpy arrays as views, and buffers as numpy arrays without a copy.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>

#include <initializer_list>
#include <optional>
#include <type_traits>
#include <utility>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

namespace nb = nanobind;
using namespace nb::literals;

// An argument without conversion: an array of another type is rejected.
constexpr auto operator""_in(const char* name, std::size_t) { return nb::arg(name).noconvert(); }

// Input arrays: contiguous, on the CPU, of exactly this type (use with _in).
template <typename T>
using In1 = nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <typename T>
using In2 = nb::ndarray<const T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
template <typename T>
using In3 = nb::ndarray<const T, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
// Points (N, 3) in meters.
using Points = nb::ndarray<const float, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
// Arrays written in place.
template <typename T>
using InOut1 = nb::ndarray<T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <typename T>
using InOut2 = nb::ndarray<T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
// Returned arrays.
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

// Check that arrays have the same number of rows.
template <typename First, typename... Rest>
bool are_as_long(const First& first, const Rest&... rest) {
    return ((rest.shape(0) == first.shape(0)) && ...);
}
// Check that two-dimensional arrays have the same shape.
template <typename First, typename... Rest>
bool have_one_shape(const First& first, const Rest&... rest) {
    return are_as_long(first, rest...) && ((rest.shape(1) == first.shape(1)) && ...);
}

// Move a buffer into a numpy array of a shape that holds at most as many values. Needs the GIL.
template <typename T>
Out<T> array(Buffer<T>&& buffer, std::initializer_list<std::size_t> shape) {
    T* data = std::move(buffer).release();
    nb::capsule owner(data, [](void* p) noexcept { give_memory(p); });
    return Out<T>(data, shape, owner);
}
template <typename T>
Out<T> array(Buffer<T>&& buffer) {
    const std::size_t size = buffer.size();
    return array(std::move(buffer), {size});
}
// Run a stage without the GIL, and return its result.
template <typename Stage>
auto without_lock(Stage&& stage) {
    nb::gil_scoped_release unlocked;
    return stage();
}

// Copy a vector into an array.
template <typename T>
Out<T> array_of(const std::vector<T>& values) {
    return array(copy_of(View1<const T>{values.data(), values.size()}));
}
template <typename T>
Out<T> array_of(const std::vector<T>& values, std::initializer_list<std::size_t> shape) {
    return array(copy_of(View1<const T>{values.data(), values.size()}), shape);
}

template <typename T>
std::optional<Out<T>> array_or_none(std::optional<Buffer<T>>&& buffer) {
    return buffer ? std::optional(array(std::move(*buffer))) : std::nullopt;
}

// A tuple of several values. Its types go into the module's stub, which the build writes.
template <typename... T>
using Tuple = nb::typed<nb::tuple, T...>;
template <typename... T>
Tuple<std::decay_t<T>...> tuple_of(T&&... values) {
    return Tuple<std::decay_t<T>...>(nb::make_tuple(std::forward<T>(values)...));
}

}  // namespace viewshed
