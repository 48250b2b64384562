#include "parallel.hpp"

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdlib>
#include <exception>
#include <memory>
#include <mutex>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace viewshed {
namespace {

constexpr std::size_t MAX_THREADS = 4;

// Spins of an idle thread before it sleeps: about 0.2 ms, longer than the time between two stages.
constexpr int MAX_SPINS = 8000;

std::size_t threads_at_first() {
    std::size_t count = std::thread::hardware_concurrency();
    if (const char* text = std::getenv("OMP_NUM_THREADS")) count = std::strtoul(text, nullptr, 10);
    return std::clamp<std::size_t>(count, 1, MAX_THREADS);
}

std::atomic<std::size_t> thread_count{threads_at_first()};

// Parts to run. Each thread takes the next one; a late thread finds none left and touches nothing else.
struct Job {
    Job(const std::function<void(std::size_t)>* part, std::size_t parts) : part(part), parts(parts) {}

    const std::function<void(std::size_t)>* part;
    std::size_t parts;
    std::atomic<std::size_t> next{0}, done{0};
    std::mutex mutex{};
    std::size_t failed = parts;  // lowest part that threw, and its exception
    std::exception_ptr error{};

    void take_parts() {
        for (std::size_t k = next.fetch_add(1); k < parts; k = next.fetch_add(1)) {
            try {
                (*part)(k);
            } catch (...) {
                std::lock_guard lock(mutex);
                if (k < failed) error = std::current_exception();
                failed = std::min(failed, k);
            }
            done.fetch_add(1, std::memory_order_release);
        }
    }
};

// Threads that wait for a job. The calling thread works as well and waits only for parts that others have begun, so a
// helper that gets no processor time does not delay it.
class Helpers {
public:
    explicit Helpers(std::size_t count) : count_(count) {
        threads_.reserve(count);
        try {
            for (std::size_t k = 0; k < count; ++k) threads_.emplace_back([this] { help(); });
        } catch (const std::system_error&) {  // the system has no more threads: use those that started
        }
    }
    Helpers(const Helpers&) = delete;
    Helpers& operator=(const Helpers&) = delete;
    ~Helpers() {
        give(nullptr);
        for (std::thread& thread : threads_) thread.join();
    }

    std::size_t count() const { return count_; }

    void run(std::size_t parts, const std::function<void(std::size_t)>& part) {
        const auto job = std::make_shared<Job>(&part, parts);
        give(job);
        job->take_parts();
        while (job->done.load(std::memory_order_acquire) < parts) std::this_thread::yield();
        if (job->error) std::rethrow_exception(job->error);
    }

private:
    // Give the threads a job; a null job ends them.
    void give(std::shared_ptr<Job> job) {
        {
            std::lock_guard lock(mutex_);
            job_ = std::move(job);
            number_.fetch_add(1, std::memory_order_release);
        }
        wake_.notify_all();
    }

    void help() {
        for (std::size_t seen = 0;;) {
            for (int spin = 0; spin < MAX_SPINS && number_.load(std::memory_order_acquire) == seen; ++spin) {
#if defined(__x86_64__)
                __builtin_ia32_pause();
#endif
            }
            std::shared_ptr<Job> job;
            {
                std::unique_lock lock(mutex_);
                wake_.wait(lock, [&] { return number_.load(std::memory_order_acquire) != seen; });
                seen = number_.load(std::memory_order_acquire);
                job = job_;
            }
            if (job == nullptr) return;
            job->take_parts();
        }
    }

    const std::size_t count_;  // requested
    std::mutex mutex_;
    std::condition_variable wake_;
    std::atomic<std::size_t> number_{0};  // of the current job
    std::shared_ptr<Job> job_;
    std::vector<std::thread> threads_;
};

std::mutex one_job_at_a_time;
Helpers* helpers = nullptr;  // never deleted at exit: they wait until the process ends
pid_t owner = 0;             // a forked process has none of its parent's threads and cannot join them

// Start this number of helpers after ending those of another number. Needs the lock.
void set_helpers(std::size_t count) {
    if (owner != getpid()) helpers = nullptr;
    owner = getpid();
    if (helpers != nullptr && helpers->count() == count) return;
    delete std::exchange(helpers, nullptr);
    if (count > 0) helpers = new Helpers(count);
}

}  // namespace

std::size_t threads() { return thread_count.load(std::memory_order_relaxed); }

void set_threads(std::size_t count) {
    thread_count.store(std::clamp<std::size_t>(count, 1, MAX_THREADS));
    // If a job is running, the next one resizes the pool.
    const std::unique_lock lock(one_job_at_a_time, std::try_to_lock);
    if (lock.owns_lock() && helpers != nullptr && helpers->count() + 1 != threads()) set_helpers(0);
}

std::size_t count_parts(std::size_t size, std::size_t least) {
    return std::clamp<std::size_t>(size / std::max<std::size_t>(least, 1), 1, threads());
}

void run_parts(std::size_t parts, const std::function<void(std::size_t)>& part) {
    const std::size_t max_threads = threads();
    std::unique_lock lock(one_job_at_a_time, std::try_to_lock);
    if (parts <= 1 || max_threads <= 1 || !lock.owns_lock()) {
        for (std::size_t k = 0; k < parts; ++k) part(k);
        return;
    }
    set_helpers(max_threads - 1);
    helpers->run(parts, part);
}

}  // namespace viewshed
