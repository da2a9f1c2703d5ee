/* Errors, delays and short transfers in system calls of a process, by rules in a shared file; preloaded. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/types.h>
#include <unistd.h>

enum { READ, WRITE, SEND, RECVMSG, FSYNC, OPEN };
enum { PORT = 1, SOCKET, FILE_ };
struct rule { volatile int role, call, where, error, delay_us, is_short; };
enum { RULES = 8 };
static struct rule *rules;
static int my_role;

void inject_begin(const char *path, int role) {
    int fd = open(path, O_RDWR);
    void *page = mmap(NULL, RULES * sizeof(struct rule), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    close(fd);
    my_role = role;
    rules = page == MAP_FAILED ? NULL : page;
}

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("INJECT_FILE");
    if (path && getenv("INJECT_ROLE")) inject_begin(path, atoi(getenv("INJECT_ROLE")));
}

static int class_of(const char *path) {
    if (!strncmp(path, "socket:", 7)) return SOCKET;
    if (!strncmp(path, "/dev/pts/", 9) || strstr(path, "/ports/")) return PORT;
    return strstr(path, "/disk/") ? FILE_ : 0;
}

static int strike(int call, int fd, const char *path, size_t *size) {
    for (int i = 0; rules && i < RULES; i++) {
        if (rules[i].role != my_role || rules[i].call != call) continue;
        char link[64], target[512];
        if (!path) {
            snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
            ssize_t length = readlink(link, target, sizeof target - 1);
            target[length < 0 ? 0 : length] = 0;
        }
        if (class_of(path ? path : target) != rules[i].where) continue;
        if (rules[i].delay_us) usleep(rules[i].delay_us);
        if (rules[i].is_short && size && *size > 1) *size = 1;
        if (rules[i].error) return rules[i].error;
    }
    return 0;
}

#define REAL(name) static __typeof__(&name) real; if (!real) real = dlsym(RTLD_NEXT, #name)
#define STRUCK(call, fd, path, size) { int error = strike(call, fd, path, size); if (error) { errno = error; return -1; } }

ssize_t read(int fd, void *data, size_t size) { REAL(read); STRUCK(READ, fd, NULL, &size); return real(fd, data, size); }
ssize_t write(int fd, const void *data, size_t size) { REAL(write); STRUCK(WRITE, fd, NULL, &size); return real(fd, data, size); }
ssize_t send(int fd, const void *data, size_t size, int flags) { REAL(send); STRUCK(SEND, fd, NULL, NULL); return real(fd, data, size, flags); }
ssize_t recvmsg(int fd, struct msghdr *message, int flags) { REAL(recvmsg); STRUCK(RECVMSG, fd, NULL, NULL); return real(fd, message, flags); }
int fsync(int fd) { REAL(fsync); STRUCK(FSYNC, fd, NULL, NULL); return real(fd); }
int open64(const char *path, int flags, ...) {
    va_list rest;
    va_start(rest, flags);
    mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0;
    va_end(rest);
    REAL(open64);
    STRUCK(OPEN, -1, path, NULL);
    return real(path, flags, mode);
}
