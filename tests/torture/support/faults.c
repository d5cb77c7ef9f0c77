/* Fails chosen writes of a process, for tests/torture.
 *
 * Preloaded, it takes the place of glibc's calls that change files. Those on files under the folder
 * TENSORMAP_FAULTS_UNDER are counted in the file TENSORMAP_FAULTS, which every process of a service
 * maps: a call whose number lies in first..last fails with the error given there, or writes half,
 * all of them or a share.
 * Nothing is counted while `armed` is 0, so that one service is used for many faults.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum operation { OP_OPEN, OP_WRITE, OP_SYNC, OP_RENAME, OP_TRUNCATE, OP_MKDIR, OPERATIONS };

/* Of a path, whose beginning is compared with the folder. Small: Python's signal handlers call `write`
 * on the small stack of faulthandler, which lies in the heap; with 4 KiB more they wrote beyond it. */
#define PATH 512
#define NOTES 512
#define NOTE 320

/* As tests/torture/support/faults.py has it. */
struct control {
    uint64_t armed, first, last, error, halve, share, seed;
    _Atomic uint64_t counted, failed;
    _Atomic uint64_t of_operation[OPERATIONS];
    char notes[NOTES][NOTE];
};

static struct control *control;
static char under[PATH / 2];
static size_t under_length;

__attribute__((constructor)) static void begin(void) {
    const char *file = getenv("TENSORMAP_FAULTS"), *folder = getenv("TENSORMAP_FAULTS_UNDER");
    if (file == NULL || folder == NULL || strlen(folder) >= sizeof under)
        return;
    int descriptor = open(file, O_RDWR | O_CLOEXEC);
    if (descriptor < 0)
        return;
    void *mapped = mmap(NULL, sizeof(struct control), PROT_READ | PROT_WRITE, MAP_SHARED, descriptor, 0);
    close(descriptor);
    if (mapped == MAP_FAILED)
        return;
    strcpy(under, folder);
    under_length = strlen(under);
    control = mapped;
}

static int is_under(const char *path) {
    return strncmp(path, under, under_length) == 0 &&
           (path[under_length] == '/' || path[under_length] == 0);
}

static int counts_path(int folder, const char *path, char *whole) {
    if (control == NULL || !control->armed || path == NULL)
        return 0;
    if (path[0] == '/') {
        snprintf(whole, PATH, "%s", path);
    } else {
        char link[64], base[PATH / 2];
        if (folder == AT_FDCWD)
            strcpy(link, "/proc/self/cwd");
        else
            snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
        ssize_t length = readlink(link, base, sizeof base - 1);
        if (length < 0)
            return 0;
        base[length] = 0;
        snprintf(whole, PATH, "%s/%.250s", base, path);
    }
    return is_under(whole);
}

static int counts_file(int descriptor, char *whole) {
    if (control == NULL || !control->armed)
        return 0;
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t length = readlink(link, whole, PATH - 1);
    if (length < 0)
        return 0;
    whole[length] = 0;
    return is_under(whole);
}

/* Return whether a call in a row of many is one of those that chance lets fail: `share` of 2^32. */
static int is_chosen(uint64_t number) {
    uint64_t mixed = (number + control->seed) * 0x9e3779b97f4a7c15u;
    mixed = (mixed ^ (mixed >> 30)) * 0xbf58476d1ce4e5b9u;
    mixed = (mixed ^ (mixed >> 27)) * 0x94d049bb133111ebu;
    return (mixed >> 32) < control->share;
}

/* Count a call; return whether it is to fail. */
static int fails(enum operation operation, const char *path) {
    uint64_t number = atomic_fetch_add(&control->counted, 1) + 1;
    atomic_fetch_add(&control->of_operation[operation], 1);
    if (number <= NOTES)
        snprintf(control->notes[number - 1], NOTE, "%d %.310s", (int)operation, path + under_length);
    if (number < control->first || number > control->last || !is_chosen(number))
        return 0;
    if (control->halve && operation != OP_WRITE)
        return 0;
    atomic_fetch_add(&control->failed, 1);
    return 1;
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define KEEP(name)                                                                                 \
    static __typeof__(&name) real;                                                                 \
    if (real == NULL)                                                                              \
    real = REAL(name)
#define FAIL return errno = (int)control->error, -1

#define INTERPOSE_WRITE(name, arguments, buffer, ...)                                              \
    ssize_t name arguments {                                                                       \
        KEEP(name);                                                                                \
        char path[PATH];                                                                           \
        if (counts_file(descriptor, path) && fails(OP_WRITE, path)) {                              \
            if (!control->halve || size < 2)                                                       \
                FAIL;                                                                              \
            size /= 2;                                                                             \
        }                                                                                          \
        return real(descriptor, buffer, size, ##__VA_ARGS__);                                      \
    }

INTERPOSE_WRITE(write, (int descriptor, const void *bytes, size_t size), bytes)
INTERPOSE_WRITE(pwrite, (int descriptor, const void *bytes, size_t size, off_t at), bytes, at)
INTERPOSE_WRITE(pwrite64, (int descriptor, const void *bytes, size_t size, off64_t at), bytes, at)

#define INTERPOSE_MANY(name, arguments, ...)                                                       \
    ssize_t name arguments {                                                                       \
        KEEP(name);                                                                                \
        char path[PATH];                                                                           \
        if (counts_file(descriptor, path) && fails(OP_WRITE, path)) {                              \
            if (!control->halve || parts < 2)                                                      \
                FAIL;                                                                              \
            parts /= 2;                                                                            \
        }                                                                                          \
        return real(descriptor, vector, parts, ##__VA_ARGS__);                                     \
    }

INTERPOSE_MANY(writev, (int descriptor, const struct iovec *vector, int parts))
INTERPOSE_MANY(pwritev, (int descriptor, const struct iovec *vector, int parts, off_t at), at)
INTERPOSE_MANY(pwritev64, (int descriptor, const struct iovec *vector, int parts, off64_t at), at)
INTERPOSE_MANY(pwritev2, (int descriptor, const struct iovec *vector, int parts, off_t at, int how), at, how)
INTERPOSE_MANY(pwritev64v2, (int descriptor, const struct iovec *vector, int parts, off64_t at, int how), at, how)

#define INTERPOSE_COPY(name, type)                                                                 \
    ssize_t name(int descriptor, int from, type *at, size_t size) {                                \
        KEEP(name);                                                                                \
        char path[PATH];                                                                           \
        if (counts_file(descriptor, path) && fails(OP_WRITE, path)) {                              \
            if (!control->halve || size < 2)                                                       \
                FAIL;                                                                              \
            size /= 2;                                                                             \
        }                                                                                          \
        return real(descriptor, from, at, size);                                                   \
    }

ssize_t sendfile(int, int, off_t *, size_t);
ssize_t sendfile64(int, int, off64_t *, size_t);
INTERPOSE_COPY(sendfile, off_t)
INTERPOSE_COPY(sendfile64, off64_t)

#define INTERPOSE_FILE(name, operation, arguments, ...)                                            \
    int name arguments {                                                                           \
        KEEP(name);                                                                                \
        char path[PATH];                                                                           \
        if (counts_file(descriptor, path) && fails(operation, path))                               \
            FAIL;                                                                                  \
        return real(descriptor, ##__VA_ARGS__);                                                    \
    }

INTERPOSE_FILE(fsync, OP_SYNC, (int descriptor))
INTERPOSE_FILE(fdatasync, OP_SYNC, (int descriptor))
INTERPOSE_FILE(ftruncate, OP_TRUNCATE, (int descriptor, off_t length), length)
INTERPOSE_FILE(ftruncate64, OP_TRUNCATE, (int descriptor, off64_t length), length)

/* posix_fallocate returns its error. */
int posix_fallocate(int descriptor, off_t at, off_t length) {
    KEEP(posix_fallocate);
    char path[PATH];
    if (counts_file(descriptor, path) && fails(OP_TRUNCATE, path))
        return (int)control->error;
    return real(descriptor, at, length);
}

#define INTERPOSE_OPEN(name)                                                                       \
    int name(const char *file, int flags, ...) {                                                   \
        KEEP(name);                                                                                \
        mode_t mode = 0;                                                                           \
        if (__OPEN_NEEDS_MODE(flags)) {                                                            \
            va_list rest;                                                                          \
            va_start(rest, flags);                                                                 \
            mode = va_arg(rest, mode_t);                                                           \
            va_end(rest);                                                                          \
        }                                                                                          \
        char path[PATH];                                                                           \
        if (flags & (O_CREAT | O_TRUNC) && counts_path(AT_FDCWD, file, path) && fails(OP_OPEN, path)) \
            FAIL;                                                                                  \
        return real(file, flags, mode);                                                            \
    }
#define INTERPOSE_OPENAT(name)                                                                     \
    int name(int folder, const char *file, int flags, ...) {                                       \
        KEEP(name);                                                                                \
        mode_t mode = 0;                                                                           \
        if (__OPEN_NEEDS_MODE(flags)) {                                                            \
            va_list rest;                                                                          \
            va_start(rest, flags);                                                                 \
            mode = va_arg(rest, mode_t);                                                           \
            va_end(rest);                                                                          \
        }                                                                                          \
        char path[PATH];                                                                           \
        if (flags & (O_CREAT | O_TRUNC) && counts_path(folder, file, path) && fails(OP_OPEN, path)) \
            FAIL;                                                                                  \
        return real(folder, file, flags, mode);                                                    \
    }

INTERPOSE_OPEN(open)
INTERPOSE_OPEN(open64)
INTERPOSE_OPENAT(openat)
INTERPOSE_OPENAT(openat64)

#define INTERPOSE_PATH(name, operation, folder, arguments, ...)                                    \
    int name arguments {                                                                           \
        KEEP(name);                                                                                \
        char path[PATH];                                                                           \
        if (counts_path(folder, to, path) && fails(operation, path))                               \
            FAIL;                                                                                  \
        return real(__VA_ARGS__);                                                                  \
    }

INTERPOSE_PATH(rename, OP_RENAME, AT_FDCWD, (const char *from, const char *to), from, to)
INTERPOSE_PATH(renameat, OP_RENAME, folder, (int of, const char *from, int folder, const char *to), of, from, folder, to)
INTERPOSE_PATH(renameat2, OP_RENAME, folder, (int of, const char *from, int folder, const char *to, unsigned how), of, from, folder, to, how)
INTERPOSE_PATH(link, OP_RENAME, AT_FDCWD, (const char *from, const char *to), from, to)
INTERPOSE_PATH(linkat, OP_RENAME, folder, (int of, const char *from, int folder, const char *to, int how), of, from, folder, to, how)
INTERPOSE_PATH(mkdir, OP_MKDIR, AT_FDCWD, (const char *to, mode_t mode), to, mode)
INTERPOSE_PATH(mkdirat, OP_MKDIR, folder, (int folder, const char *to, mode_t mode), folder, to, mode)
