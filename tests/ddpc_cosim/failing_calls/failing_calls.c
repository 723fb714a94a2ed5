/* Loaded before the C library: lets the n-th system call of this process on some folders fail, once it is told to.

   Calls are counted in the order in which they are made; reading and what concerns other folders does not count.
   A process that is forked from this one counts nothing. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

#define LONGEST 4096

static char folder[LONGEST], failed[2 * LONGEST];
static pid_t owner;
static atomic_long calls;
static long chosen;
static int error_number;

/* Count calls on what is in the folder from now on, and let one of them fail, the first being number 1; of number -1
   the next fork fails. */
void failing_calls_begin(const char *within, long number, int error) {
    snprintf(folder, sizeof folder, "%s/", within);
    failed[0] = '\0';
    chosen = number;
    error_number = error;
    calls = 0;
    owner = getpid();
}

/* Count no longer; return how many there were. */
long failing_calls_end(void) {
    owner = 0;
    return calls;
}

/* What has failed; empty: nothing. */
const char *failing_calls_failed(void) { return failed; }

static int fails_now(const char *call, const char *path) {
    snprintf(failed, sizeof failed, "%s %s", call, path);
    errno = error_number;
    return 1;
}

static int fails(const char *call, const char *path) {
    if (owner == 0 || owner != getpid() || ++calls != chosen) return 0;
    return fails_now(call, path);
}
static int fails_on_path(const char *call, const char *path) {
    return owner != 0 && path && strncmp(path, folder, strlen(folder)) == 0 && fails(call, path);
}

static const char *path_of(int descriptor, char *path) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t length = readlink(link, path, LONGEST - 1);
    path[length < 0 ? 0 : length] = '\0';
    return path;
}

static int fails_on_descriptor(const char *call, int descriptor) {
    char path[LONGEST];
    return owner != 0 && fails_on_path(call, path_of(descriptor, path));
}

static int fails_at(const char *call, int descriptor, const char *path) {
    char within[LONGEST], whole[2 * LONGEST + 1];
    if (owner == 0) return 0;
    if (descriptor == AT_FDCWD || path[0] == '/') return fails_on_path(call, path);
    snprintf(whole, sizeof whole, "%s/%s", path_of(descriptor, within), path);
    return fails_on_path(call, whole);
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

#define OPEN(name)                                             \
    int name(const char *path, int flags, ...) {               \
        va_list rest;                                          \
        va_start(rest, flags);                                 \
        mode_t mode = va_arg(rest, mode_t);                    \
        va_end(rest);                                          \
        return fails_on_path("open", path) ? -1 : REAL(name)(path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

#define OPEN_AT(name)                                          \
    int name(int within, const char *path, int flags, ...) {   \
        va_list rest;                                          \
        va_start(rest, flags);                                 \
        mode_t mode = va_arg(rest, mode_t);                    \
        va_end(rest);                                          \
        return fails_at("open", within, path) ? -1 : REAL(name)(within, path, flags, mode); \
    }
OPEN_AT(openat)
OPEN_AT(openat64)

ssize_t write(int descriptor, const void *content, size_t length) {
    return fails_on_descriptor("write", descriptor) ? -1 : REAL(write)(descriptor, content, length);
}

int fsync(int descriptor) { return fails_on_descriptor("fsync", descriptor) ? -1 : REAL(fsync)(descriptor); }

int ftruncate(int descriptor, off_t length) {
    return fails_on_descriptor("ftruncate", descriptor) ? -1 : REAL(ftruncate)(descriptor, length);
}

int rename(const char *from, const char *to) { return fails_on_path("rename", to) ? -1 : REAL(rename)(from, to); }

int link(const char *from, const char *to) { return fails_on_path("link", to) ? -1 : REAL(link)(from, to); }

int mkdir(const char *path, mode_t mode) { return fails_on_path("mkdir", path) ? -1 : REAL(mkdir)(path, mode); }

int rmdir(const char *path) { return fails_on_path("rmdir", path) ? -1 : REAL(rmdir)(path); }

int unlink(const char *path) { return fails_on_path("unlink", path) ? -1 : REAL(unlink)(path); }

int unlinkat(int within, const char *path, int flags) {
    return fails_at("unlink", within, path) ? -1 : REAL(unlinkat)(within, path, flags);
}

pid_t fork(void) {
    if (owner != 0 && owner == getpid() && chosen == -1) {
        chosen = 0;
        fails_now("fork", "");
        return -1;
    }
    return REAL(fork)();
}
