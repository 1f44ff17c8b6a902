/* Allocations of `least` bytes and more fail from the k-th after `fail_at` on, or only that one.
   Loaded by LD_PRELOAD; memory that libraries map themselves counts too. */
#define _GNU_SOURCE
#include <errno.h>
#include <stddef.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

extern void *__libc_malloc(size_t);
extern void *__libc_calloc(size_t, size_t);
extern void *__libc_realloc(void *, size_t);
extern void *__libc_memalign(size_t, size_t);

static volatile long armed, at, seen, least_bytes, for_ever;

void fail_at(long k, long least, long from_there_on) {
    at = k, least_bytes = least, for_ever = from_there_on, seen = 0, armed = 1;
}

long allocations(void) { armed = 0; return seen; }

static int fails(size_t size) {
    if (!armed || size < (size_t)least_bytes) return 0;
    long one = __sync_add_and_fetch(&seen, 1);
    if (one != at && !(for_ever && at && one > at)) return 0;
    errno = ENOMEM;
    return 1;
}

void *malloc(size_t size) { return fails(size) ? NULL : __libc_malloc(size); }
void *calloc(size_t n, size_t size) { return fails(n * size) ? NULL : __libc_calloc(n, size); }
void *realloc(void *p, size_t size) { return fails(size) ? NULL : __libc_realloc(p, size); }
void *memalign(size_t a, size_t size) { return fails(size) ? NULL : __libc_memalign(a, size); }
void *aligned_alloc(size_t a, size_t size) { return memalign(a, size); }
int posix_memalign(void **p, size_t a, size_t size) {
    void *found = memalign(a, size);
    if (!found) return ENOMEM;
    *p = found;
    return 0;
}
void *mmap(void *p, size_t n, int prot, int flags, int fd, off_t offset) {
    if ((flags & MAP_ANONYMOUS) && fails(n)) return MAP_FAILED;
    return (void *)syscall(SYS_mmap, p, n, prot, flags, fd, offset);
}
