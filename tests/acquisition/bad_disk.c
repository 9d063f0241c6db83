/* A disk that goes bad: loaded before the C library, fails or harms what a process does to one file. BAD_DISK says what:
   NAME|WHAT|NUMBER|FROM|TO  - the file's path holds NAME; WHAT is read, write, sync, close (fail with errno NUMBER), kill
   (the process dies before the call, counted over writes, syncs, renames, links and unlinks), or delete, truncate,
   replace, overwrite (done before the write, once the file bears NAME itself); calls FROM to TO of that kind, counted
   from 1. For `bytes`, FROM and TO are places in the file instead, and every read there fails. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static char name[512], what[32], path[4096];
static long number, from, to, reads, writes, syncs, closes, steps;
static int harmed;

__attribute__((visibility("default"))) void bad_disk_arm(const char *said) {
    name[0] = what[0] = 0;
    reads = writes = syncs = closes = steps = harmed = 0;
    if (said) sscanf(said, "%511[^|]|%31[^|]|%ld|%ld|%ld", name, what, &number, &from, &to);
}

__attribute__((constructor)) static void begin(void) { bad_disk_arm(getenv("BAD_DISK")); }

static int ours(int fd) {
    if (!name[0]) return 0;
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n < 0) return 0;
    path[n] = 0;
    size_t len = strlen(name);
    if ((size_t)n >= len && !strcmp(path + n - len, name)) return 2;
    return strstr(path, name) != NULL;
}

static int fails(const char *kind, long count) {
    if (strcmp(what, kind) || count < from || count > to) return 0;
    errno = (int)number;
    return 1;
}

static void step(void) {
    if (!strcmp(what, "kill") && ++steps == from) kill(getpid(), SIGKILL);
}

static void step_named(const char *one, const char *other) {
    if (name[0] && (strstr(one, name) || strstr(other, name))) step();
}

static void harm(void) {
    static ssize_t (*real)(int, const void *, size_t, off64_t);
    if (!real) real = dlsym(RTLD_NEXT, "pwrite64");
    char other[4200];
    struct stat is;
    if (harmed || writes < from) return;
    if (!strcmp(what, "delete")) harmed = 1, unlink(path);
    if (!strcmp(what, "truncate") && !stat(path, &is)) harmed = 1, (void)!truncate(path, is.st_size * number / 100);
    if (!strcmp(what, "replace")) {
        harmed = 1;
        snprintf(other, sizeof other, "%s.other", path);
        int fd = open(other, O_CREAT | O_WRONLY, 0644);
        (void)!write(fd, "a stranger", 10);
        close(fd);
        rename(other, path);
    }
    if (!strcmp(what, "overwrite")) {
        harmed = 1;
        int fd = open(path, O_WRONLY);
        real(fd, "a stranger's bytes", 18, number);
        close(fd);
    }
}

#define READ(function, type)                                                              \
    ssize_t function(int fd, void *data, size_t size, type at) {                          \
        static ssize_t (*real)(int, void *, size_t, type);                                \
        if (!real) real = dlsym(RTLD_NEXT, #function);                                    \
        if (ours(fd)) {                                                                   \
            if (!strcmp(what, "bytes") && at < to && at + (off64_t)size > from) { errno = (int)number; return -1; } \
            if (fails("read", ++reads)) return -1;                                        \
        }                                                                                 \
        return real(fd, data, size, at);                                                  \
    }
#define WRITE(function, type)                                                             \
    ssize_t function(int fd, const void *data, size_t size, type at) {                    \
        static ssize_t (*real)(int, const void *, size_t, type);                          \
        if (!real) real = dlsym(RTLD_NEXT, #function);                                    \
        int named = ours(fd);                                                             \
        if (named) {                                                                      \
            writes++;                                                                     \
            step();                                                                       \
            if (named == 2) harm();                                                       \
            if (fails("write", writes)) return -1;                                        \
        }                                                                                 \
        return real(fd, data, size, at);                                                  \
    }
READ(pread, off_t)
READ(pread64, off64_t)
WRITE(pwrite, off_t)
WRITE(pwrite64, off64_t)

int fsync(int fd) {
    static int (*real)(int);
    if (!real) real = dlsym(RTLD_NEXT, "fsync");
    if (ours(fd)) {
        step();
        if (fails("sync", ++syncs)) return -1;
    }
    return real(fd);
}

int close(int fd) {
    static int (*real)(int);
    if (!real) real = dlsym(RTLD_NEXT, "close");
    int failed = ours(fd) && fails("close", ++closes), why = errno, done = real(fd); /* it is closed all the same */
    if (!failed) return done;
    errno = why;
    return -1;
}

#define NAMES(function)                                                                   \
    int function(const char *one, const char *other) {                                    \
        static int (*real)(const char *, const char *);                                   \
        if (!real) real = dlsym(RTLD_NEXT, #function);                                    \
        step_named(one, other);                                                           \
        return real(one, other);                                                          \
    }
NAMES(rename)
NAMES(link)

int linkat(int from_folder, const char *one, int to_folder, const char *other, int flags) {
    static int (*real)(int, const char *, int, const char *, int);
    if (!real) real = dlsym(RTLD_NEXT, "linkat");
    step_named(one, other);
    return real(from_folder, one, to_folder, other, flags);
}

int unlink(const char *one) {
    static int (*real)(const char *);
    if (!real) real = dlsym(RTLD_NEXT, "unlink");
    step_named(one, "");
    return real(one);
}
