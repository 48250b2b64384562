#include "parallel.hpp"

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdlib>
#include <exception>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace viewshed {
namespace {

constexpr std::size_t MOST_THREADS = 4;

// How often a thread without work looks again before it sleeps: some microseconds, the time between two stages.
constexpr int LOOKS = 2000;

std::size_t threads_at_first() {
    std::size_t count = std::thread::hardware_concurrency();
    if (const char* text = std::getenv("OMP_NUM_THREADS")) count = std::strtoul(text, nullptr, 10);
    return std::clamp<std::size_t>(count, 1, MOST_THREADS);
}

std::atomic<std::size_t> thread_count{threads_at_first()};

// Helpers that wait for a job; each takes its next part until none is left.
class Helpers {
public:
    explicit Helpers(std::size_t count) {
        for (std::size_t k = 0; k < count; ++k) threads_.emplace_back([this] { help(); });
        for (std::thread& thread : threads_) thread.detach();
    }

    std::size_t count() const { return threads_.size(); }

    void run(std::size_t parts, const std::function<void(std::size_t)>& part) {
        {
            std::lock_guard lock(mutex_);
            part_ = &part;
            parts_ = parts;
            next_.store(0);
            error_ = nullptr;
            is_open_ = true;
            job_.fetch_add(1, std::memory_order_release);
        }
        wake_.notify_all();
        take_parts();
        {
            std::lock_guard lock(mutex_);
            is_open_ = false;  // who is still asleep has nothing left to do and is not waited for
        }
        while (busy_.load(std::memory_order_acquire) > 0) std::this_thread::yield();
        if (error_) std::rethrow_exception(error_);
    }

private:
    void take_parts() {
        for (std::size_t k = next_.fetch_add(1); k < parts_; k = next_.fetch_add(1)) {
            try {
                (*part_)(k);
            } catch (...) {
                std::lock_guard lock(mutex_);
                error_ = std::current_exception();
            }
        }
    }

    void help() {
        for (std::size_t done = 0;;) {
            for (int look = 0; look < LOOKS && job_.load(std::memory_order_acquire) == done; ++look) {
#if defined(__x86_64__)
                __builtin_ia32_pause();
#endif
            }
            if (job_.load(std::memory_order_acquire) == done) {
                std::unique_lock lock(mutex_);
                wake_.wait(lock, [&] { return job_.load(std::memory_order_acquire) != done; });
            }
            {
                std::lock_guard lock(mutex_);
                done = job_.load(std::memory_order_relaxed);
                if (!is_open_) continue;
                busy_.fetch_add(1, std::memory_order_relaxed);
            }
            take_parts();
            busy_.fetch_sub(1, std::memory_order_release);
        }
    }

    std::vector<std::thread> threads_;
    std::mutex mutex_;
    std::condition_variable wake_;
    std::atomic<std::size_t> job_{0}, next_{0}, busy_{0};
    const std::function<void(std::size_t)>* part_ = nullptr;
    std::size_t parts_ = 0;
    bool is_open_ = false;  // the last job has parts that nobody has taken yet, perhaps
    std::exception_ptr error_;
};

std::mutex one_job_at_a_time;
Helpers* helpers = nullptr;  // never deleted: its threads wait until the process ends
pid_t owner = 0;             // a forked process has none of its parent's threads

}  // namespace

std::size_t threads() { return thread_count.load(std::memory_order_relaxed); }

void set_threads(std::size_t count) { thread_count.store(std::clamp<std::size_t>(count, 1, MOST_THREADS)); }

std::size_t count_parts(std::size_t size, std::size_t least) {
    return std::clamp<std::size_t>(size / std::max<std::size_t>(least, 1), 1, threads());
}

void run_parts(std::size_t parts, const std::function<void(std::size_t)>& part) {
    const std::size_t wanted = threads();
    std::unique_lock lock(one_job_at_a_time, std::try_to_lock);
    if (parts <= 1 || wanted <= 1 || !lock.owns_lock()) {
        for (std::size_t k = 0; k < parts; ++k) part(k);
        return;
    }
    if (helpers == nullptr || owner != getpid() || helpers->count() != wanted - 1) {
        helpers = new Helpers(wanted - 1);
        owner = getpid();
    }
    helpers->run(parts, part);
}

}  // namespace viewshed
