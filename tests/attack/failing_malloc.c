// malloc and its kin, of which one call of the native core and what it links against can be made to
// fail: `failing_malloc_arm(n)` fails the n-th from then on, `failing_malloc_disarm()` says how many
// there were. Calls of Python and NumPy themselves are not counted. Loaded by LD_PRELOAD.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <link.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

static const char* const counted[] = {"/_core.", "libstdc++", "libcholmod", "libumfpack", "libklu",
                                      "libamd",  "libcolamd", "libmetis",   "libsuitesparse"};
enum { most = 64 };
static struct {
  uintptr_t begin, end;
} ranges[most];
static int n_ranges;
static atomic_int armed;
static atomic_long count, fail_at;

static int note(struct dl_phdr_info* library, size_t size, void* data) {
  (void)size, (void)data;
  int ours = 0;
  for (size_t k = 0; k < sizeof counted / sizeof *counted; ++k) {
    ours |= strstr(library->dlpi_name, counted[k]) != NULL;
  }
  for (int k = 0; ours && k < library->dlpi_phnum && n_ranges < most; ++k) {
    const ElfW(Phdr)* part = &library->dlpi_phdr[k];
    if (part->p_type != PT_LOAD) continue;
    ranges[n_ranges].begin = library->dlpi_addr + part->p_vaddr;
    ranges[n_ranges].end = ranges[n_ranges].begin + part->p_memsz;
    ++n_ranges;
  }
  return 0;
}

// Where the libraries are, once they are loaded.
void failing_malloc_look(void) {
  n_ranges = 0;
  dl_iterate_phdr(note, NULL);
}

void failing_malloc_arm(long n) {
  atomic_store(&count, 0);
  atomic_store(&fail_at, n);
  atomic_store(&armed, 1);
}

long failing_malloc_disarm(void) {
  atomic_store(&armed, 0);
  return atomic_load(&count);
}

static int fails(const void* caller) {
  if (!atomic_load_explicit(&armed, memory_order_relaxed)) return 0;
  const uintptr_t at = (uintptr_t)caller;
  for (int k = 0; k < n_ranges; ++k) {
    if (at < ranges[k].begin || at >= ranges[k].end) continue;
    if (atomic_fetch_add(&count, 1) + 1 != atomic_load(&fail_at)) return 0;
    errno = ENOMEM;
    return 1;
  }
  return 0;
}

void* __libc_malloc(size_t);
void* __libc_calloc(size_t, size_t);
void* __libc_realloc(void*, size_t);
void* __libc_memalign(size_t, size_t);

#define CALLER __builtin_return_address(0)
void* malloc(size_t n) { return fails(CALLER) ? NULL : __libc_malloc(n); }
void* calloc(size_t n, size_t m) { return fails(CALLER) ? NULL : __libc_calloc(n, m); }
void* realloc(void* p, size_t n) { return fails(CALLER) ? NULL : __libc_realloc(p, n); }
void* memalign(size_t a, size_t n) { return fails(CALLER) ? NULL : __libc_memalign(a, n); }
void* aligned_alloc(size_t a, size_t n) { return fails(CALLER) ? NULL : __libc_memalign(a, n); }
int posix_memalign(void** p, size_t a, size_t n) {
  void* made = fails(CALLER) ? NULL : __libc_memalign(a, n);
  if (made == NULL) return ENOMEM;
  *p = made;
  return 0;
}
