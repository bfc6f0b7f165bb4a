// Steps the system clock of the processes that preload it: CLOCK_REALTIME is what it is plus the offset, ns,
// that lies in the file SSP_CLOCK_STEP. The file is mapped, so that all of them step at the same instant.
//
// Waits until a time of that clock are stepped too, those under way included, as the kernel does it: a clock that is
// set back makes them longer. The wheels' DDS counts its own waits so.

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

namespace {

constexpr int64_t kSecond = 1000000000;
// A wait looks this often whether the clock was stepped.
constexpr int64_t kSlice = 50000000;
// Times of the steady clock are smaller: it counts from the start of the machine.
constexpr int64_t kEpoch = 1000000000 * kSecond;

int64_t stepped() {
  static const volatile int64_t* const offset = [] {
    const char* path = getenv("SSP_CLOCK_STEP");
    const int file = path == nullptr ? -1 : open(path, O_RDONLY | O_CLOEXEC);
    void* at = file < 0 ? MAP_FAILED : mmap(nullptr, sizeof(int64_t), PROT_READ, MAP_SHARED, file, 0);
    if (file >= 0) close(file);
    return at == MAP_FAILED ? nullptr : static_cast<const volatile int64_t*>(at);
  }();
  return offset == nullptr ? 0 : *offset;
}

int64_t ns_of(const timespec& t) { return t.tv_sec * kSecond + t.tv_nsec; }

timespec timespec_of(int64_t ns) { return {static_cast<time_t>(ns / kSecond), static_cast<long>(ns % kSecond)}; }

bool is_wall(clockid_t clock) { return clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE; }

int64_t true_ns() {
  timespec now;
  syscall(SYS_clock_gettime, CLOCK_REALTIME, &now);
  return ns_of(now);
}

// Waits by `wait`, which takes a true time, until a time of the stepped clock; a result that says so is `late()`.
template <typename Wait, typename Late>
int wait_until(const timespec* until, Wait wait, Late late) {
  if (until == nullptr || ns_of(*until) < kEpoch) return wait(until);
  while (true) {
    const int64_t now = true_ns(), end = ns_of(*until) - stepped();
    const timespec slice = timespec_of(end < now + kSlice ? end : now + kSlice);
    const int result = wait(&slice);
    if (!late(result) || true_ns() >= ns_of(*until) - stepped()) return result;
  }
}

template <typename F>
F real(const char* name, const char* version) {
  void* found = version == nullptr ? nullptr : dlvsym(RTLD_NEXT, name, version);
  return reinterpret_cast<F>(found == nullptr ? dlsym(RTLD_NEXT, name) : found);
}

}  // namespace

extern "C" {

int clock_gettime(clockid_t clock, timespec* out) {
  const long result = syscall(SYS_clock_gettime, clock, out);
  if (result == 0 && is_wall(clock)) *out = timespec_of(ns_of(*out) + stepped());
  return static_cast<int>(result);
}

int gettimeofday(timeval* out, void*) {
  const int64_t ns = true_ns() + stepped();
  *out = {static_cast<time_t>(ns / kSecond), static_cast<suseconds_t>(ns % kSecond / 1000)};
  return 0;
}

time_t time(time_t* out) {
  const time_t now = (true_ns() + stepped()) / kSecond;
  if (out != nullptr) *out = now;
  return now;
}

int pthread_cond_timedwait(pthread_cond_t* condition, pthread_mutex_t* mutex, const timespec* until) {
  using F = int (*)(pthread_cond_t*, pthread_mutex_t*, const timespec*);
  static const F wait = real<F>("pthread_cond_timedwait", "GLIBC_2.3.2");
  return wait_until(
      until, [&](const timespec* t) { return wait(condition, mutex, t); }, [](int r) { return r == ETIMEDOUT; });
}

int pthread_mutex_timedlock(pthread_mutex_t* mutex, const timespec* until) {
  using F = int (*)(pthread_mutex_t*, const timespec*);
  static const F wait = real<F>("pthread_mutex_timedlock", nullptr);
  return wait_until(
      until, [&](const timespec* t) { return wait(mutex, t); }, [](int r) { return r == ETIMEDOUT; });
}

int sem_timedwait(sem_t* semaphore, const timespec* until) {
  using F = int (*)(sem_t*, const timespec*);
  static const F wait = real<F>("sem_timedwait", nullptr);
  return wait_until(
      until, [&](const timespec* t) { return wait(semaphore, t); },
      [](int r) { return r != 0 && errno == ETIMEDOUT; });
}

}  // extern "C"
