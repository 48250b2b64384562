#include "memory.hpp"

#include <array>
#include <bit>
#include <cstdint>
#include <cstdlib>
#include <mutex>
#include <new>
#include <vector>

#include <pthread.h>

namespace viewshed {
namespace {

// Alignment of blocks; each is preceded by its size class.
constexpr std::size_t ALIGNMENT = 64;

// Size classes, four per power of two from 64 bytes on. Larger blocks go back to the system, and so do blocks below a
// page (MIN_KEPT_SIZE); at most MAX_KEPT_BYTES bytes of the others are kept.
constexpr std::size_t CLASSES = 4 * 20;
constexpr std::size_t MIN_KEPT_SIZE = std::size_t{1} << 12, MAX_KEPT_BYTES = std::size_t{64} << 20;

constexpr std::size_t size_of_class(std::size_t number) {
    const std::size_t power = std::size_t{ALIGNMENT} << (number / 4);
    return (power + power / 4 * (number % 4) + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
}

// Return the first class that holds this number of bytes; CLASSES if none does.
std::size_t class_of_size(std::size_t bytes) {
    if (bytes <= ALIGNMENT) return 0;
    const auto log2 = std::size_t(std::bit_width(bytes - 1)) - 1;
    for (std::size_t number = 4 * (log2 - 6); number < CLASSES; ++number) {
        if (size_of_class(number) >= bytes) return number;
    }
    return CLASSES;
}

struct Pool {
    std::mutex mutex;
    std::array<std::vector<void*>, CLASSES> blocks;
    std::size_t bytes = 0;
};

[[maybe_unused]] Pool& process_pool() {
    static Pool* const pool = [] {
        // Hold the lock during a fork: the child finds the lists consistent and the lock free.
        const auto unlock = [] { process_pool().mutex.unlock(); };
        pthread_atfork([] { process_pool().mutex.lock(); }, unlock, unlock);
        return new Pool;  // never deleted: arrays may outlive every destructor
    }();
    return *pool;
}

}  // namespace

void* take_memory(std::size_t bytes) {
    if (bytes > SIZE_MAX - 2 * ALIGNMENT) throw std::bad_alloc();
    const std::size_t number = class_of_size(bytes);
    const std::size_t size = number < CLASSES ? size_of_class(number) : (bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
#ifndef VIEWSHED_SANITIZE
    if (size >= MIN_KEPT_SIZE && number < CLASSES) {
        Pool& pool = process_pool();
        // Wait for the lock: if threads asked the system instead, each would add a block to those that are kept.
        std::lock_guard lock(pool.mutex);
        if (!pool.blocks[number].empty()) {
            void* block = pool.blocks[number].back();
            pool.blocks[number].pop_back();
            pool.bytes -= size;
            return block;
        }
    }
#endif
    void* begin = std::aligned_alloc(ALIGNMENT, size + ALIGNMENT);
    if (begin == nullptr) throw std::bad_alloc();
    *static_cast<std::size_t*>(begin) = number;
    return static_cast<char*>(begin) + ALIGNMENT;
}

void give_memory(void* taken) noexcept {
    if (taken == nullptr) return;
    void* begin = static_cast<char*>(taken) - ALIGNMENT;
#ifndef VIEWSHED_SANITIZE
    const std::size_t number = *static_cast<std::size_t*>(begin);
    if (number < CLASSES && size_of_class(number) >= MIN_KEPT_SIZE) {
        try {
            Pool& pool = process_pool();
            std::lock_guard lock(pool.mutex);
            if (pool.bytes + size_of_class(number) <= MAX_KEPT_BYTES) {
                pool.blocks[number].push_back(taken);
                pool.bytes += size_of_class(number);
                return;
            }
        } catch (...) {  // no room in the list: free the block
        }
    }
#endif
    std::free(begin);
}

}  // namespace viewshed
