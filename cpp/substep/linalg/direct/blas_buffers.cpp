#include "substep/linalg/direct/blas_buffers.h"

#include <sys/mman.h>

#include <array>
#include <cstddef>
#include <new>

#include "substep/core/usize.h"

namespace substep {
namespace {

// OpenBLAS 0.3 asks for BUFFER_SIZE, 32 << 22 bytes on x86-64 and aarch64 (common_x86_64.h,
// common_arm64.h). Only what a product touches becomes memory.
constexpr std::size_t kBufferBytes = std::size_t{32} << 22;

void* map_buffer() {
  void* const at = mmap(nullptr, kBufferBytes, PROT_READ | PROT_WRITE,
                        MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  return at == MAP_FAILED ? nullptr : at;
}

// The free buffers of a thread. One is enough for what we call; a deeper call maps another.
struct Buffers {
  std::array<void*, 4> free{};
  int count = 0;
  long taken = 0;  // since the thread began
  ~Buffers() {
    while (count > 0) munmap(free[usize(--count)], kBufferBytes);
  }
};
thread_local Buffers buffers;

}  // namespace

void reserve_blas_buffer() {
  if (buffers.count > 0) return;
  void* const buffer = map_buffer();
  if (!buffer) throw std::bad_alloc();
  buffers.free[usize(buffers.count++)] = buffer;
}

extern "C" {
void dsyrk_(const char*, const char*, const int*, const int*, const double*, const double*,
            const int*, const double*, double*, const int*);

__attribute__((visibility("default"))) void* blas_memory_alloc(int) {
  ++buffers.taken;
  return buffers.count > 0 ? buffers.free[usize(--buffers.count)] : map_buffer();
}

__attribute__((visibility("default"))) void blas_memory_free(void* buffer) {
  if (usize(buffers.count) < buffers.free.size()) {
    buffers.free[usize(buffers.count++)] = buffer;
  } else {
    munmap(buffer, kBufferBytes);
  }
}
}

bool blas_is_reentrant() {
  static const bool reentrant = [] {
    reserve_blas_buffer();
    const long before = buffers.taken;
    const int n = 2;
    const double one = 1, a[4] = {1, 2, 3, 4};
    double c[4] = {};
    dsyrk_("L", "N", &n, &n, &one, a, &n, &one, c, &n);
    return buffers.taken > before;
  }();
  return reentrant;
}

}  // namespace substep
