/* Makes file operations below one folder fail, from the n-th on. Loaded before libc (ld.so(8), LD_PRELOAD).
 *
 *   UNLIT_TEST_DISK_FOLDER  only files below it
 *   UNLIT_TEST_DISK_ORDERS  a file; while it is there, every operation takes so many microseconds and fails with this
 *                           errno (0: does not). It holds both as "DELAY ERRNO", or "DELAY ERRNO PATH": then this
 *                           path alone is meant, and nothing below it. The rest is not looked at
 *   UNLIT_TEST_DISK_FIRST   number of the first operation that fails, from 1
 *   UNLIT_TEST_DISK_LAST    number of the last one
 *   UNLIT_TEST_DISK_ERRNO   errno
 *   UNLIT_TEST_DISK_DELAY   microseconds that every operation takes
 *   UNLIT_TEST_DISK_HANGS   a file: as long as it is there, no operation ends
 *
 * With ENOSPC a write first takes half of what it is given, as a disk that fills up does, and what takes no room
 * (fsync, rename) goes on.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static atomic_long count;

static long number(const char *name, long otherwise)
{
    const char *text = getenv(name);
    return text ? atol(text) : otherwise;
}

/* Whether there are orders for this path now. */
static int ordered(const char *path, long *delay, int *error)
{
    FILE *orders = fopen(getenv("UNLIT_TEST_DISK_ORDERS"), "r");
    if (!orders)
        return 0;
    char only[1024];
    int read = fscanf(orders, "%ld %d %1023[^\n]", delay, error, only);
    fclose(orders);
    return read == 2 || (read == 3 && strcmp(path, only) == 0);
}

/* Whether this operation fails; sets errno. */
static int fails(const char *what, const char *path, int takes_room)
{
    const char *folder = getenv("UNLIT_TEST_DISK_FOLDER");
    if (!folder || !path || strncmp(path, folder, strlen(folder)) != 0)
        return 0;
    int error = (int)number("UNLIT_TEST_DISK_ERRNO", EIO);
    long delay = number("UNLIT_TEST_DISK_DELAY", 0);
    int by_orders = getenv("UNLIT_TEST_DISK_ORDERS") != NULL;
    if (by_orders && !ordered(path, &delay, &error))
        return 0;
    if (delay)
        usleep((useconds_t)delay);
    const char *hangs = getenv("UNLIT_TEST_DISK_HANGS");
    while (hangs && access(hangs, F_OK) == 0)
        usleep(1000);
    if (error == ENOSPC && !takes_room)
        return 0;
    long n = atomic_fetch_add(&count, 1) + 1;
    int chosen = n >= number("UNLIT_TEST_DISK_FIRST", LONG_MAX) && n <= number("UNLIT_TEST_DISK_LAST", LONG_MAX);
    if (by_orders ? !error : !chosen)
        return 0;
    dprintf(2, "disk: %s of %s fails\n", what, path);
    errno = error;
    return 1;
}

static const char *path_of(int fd, char *into, size_t size)
{
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, into, size - 1);
    if (n < 0)
        return NULL;
    into[n] = 0;
    return into;
}

#define REAL(name, type) static type real; if (!real) real = (type)dlsym(RTLD_NEXT, name)

ssize_t write(int fd, const void *bytes, size_t size)
{
    typedef ssize_t (*call)(int, const void *, size_t);
    REAL("write", call);
    char path[PATH_MAX];
    if (fd > 2 && fails("write", path_of(fd, path, sizeof path), 1)) {
        static atomic_int halved;
        if (errno == ENOSPC && size > 1 && !atomic_exchange(&halved, 1))
            return real(fd, bytes, size / 2);
        return -1;
    }
    return real(fd, bytes, size);
}

static int opened(const char *name, const char *path, int flags, mode_t mode)
{
    typedef int (*call)(const char *, int, ...);
    call real = (call)dlsym(RTLD_NEXT, name);
    if ((flags & (O_WRONLY | O_RDWR)) && fails("open", path, (flags & O_CREAT) && access(path, F_OK) != 0))
        return -1;
    return real(path, flags, mode);
}

#define OPEN(name) \
    int name(const char *path, int flags, ...) \
    { \
        mode_t mode = 0; \
        if (flags & (O_CREAT | O_TMPFILE)) { \
            va_list rest; \
            va_start(rest, flags); \
            mode = va_arg(rest, mode_t); \
            va_end(rest); \
        } \
        return opened(#name, path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

int fsync(int fd)
{
    typedef int (*call)(int);
    REAL("fsync", call);
    char path[PATH_MAX];
    return fails("fsync", path_of(fd, path, sizeof path), 0) ? -1 : real(fd);
}

int fdatasync(int fd)
{
    typedef int (*call)(int);
    REAL("fdatasync", call);
    char path[PATH_MAX];
    return fails("fdatasync", path_of(fd, path, sizeof path), 0) ? -1 : real(fd);
}

int rename(const char *from, const char *to)
{
    typedef int (*call)(const char *, const char *);
    REAL("rename", call);
    return fails("rename", to, 0) ? -1 : real(from, to);
}

int mkdir(const char *path, mode_t mode)
{
    typedef int (*call)(const char *, mode_t);
    REAL("mkdir", call);
    return fails("mkdir", path, 1) ? -1 : real(path, mode);
}
