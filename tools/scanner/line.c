#include "tools/scanner/line.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <termios.h>
#include <unistd.h>

static const struct {
    uint32_t baud;
    speed_t speed;
} speeds[] = {{1200, B1200},     {2400, B2400},     {4800, B4800},     {9600, B9600},
              {19200, B19200},   {38400, B38400},   {57600, B57600},   {115200, B115200},
              {230400, B230400}, {460800, B460800}, {921600, B921600}, {1000000, B1000000}};

// The other end of a pseudo-terminal: it has no parity, and asking for nothing else is an error there.
static bool is_pseudo(int file) {
    struct stat info;
    return fstat(file, &info) == 0 && major(info.st_rdev) >= 136 && major(info.st_rdev) <= 143;
}

static bool make_raw(int file, const struct canopy_wire_line *options) {
    struct termios mode;
    speed_t speed = B115200;
    for (size_t i = 0; i < sizeof speeds / sizeof speeds[0]; i++)
        if (speeds[i].baud == options->baud)
            speed = speeds[i].speed;
    if (tcgetattr(file, &mode) != 0)
        return false;
    cfmakeraw(&mode);
    mode.c_cflag |= CLOCAL | CREAD;
    mode.c_cflag &= ~(tcflag_t)(PARENB | PARODD | CSTOPB | CRTSCTS);
    if (options->parity != 'N' && !is_pseudo(file))
        mode.c_cflag |= PARENB;
    if (options->parity == 'O' && !is_pseudo(file))
        mode.c_cflag |= PARODD;
    if (options->stop_bits == 2)
        mode.c_cflag |= CSTOPB;
    return cfsetspeed(&mode, speed) == 0 && tcsetattr(file, TCSANOW, &mode) == 0;
}

static bool open_device(const struct canopy_wire_line *options, struct line *line, struct canopy_fault *fault) {
    line->file = open(options->path, O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (line->file < 0)
        return canopy_fault_set(fault, "%s: %s", options->path, strerror(errno));
    snprintf(line->device, sizeof line->device, "%s", options->path);
    if (make_raw(line->file, options))
        return true;
    canopy_fault_set(fault, "%s: is no serial line: %s", options->path, strerror(errno));
    line_close(line);
    return false;
}

static bool place_link(const char *path, struct line *line, struct canopy_fault *fault) {
    if (strcmp(path, "pty") == 0)
        return true;
    struct stat info;
    if (lstat(path, &info) == 0 && S_ISLNK(info.st_mode))
        unlink(path);
    if (symlink(line->device, path) != 0)
        return canopy_fault_set(fault, "%s: the link to %s cannot be made: %s", path, line->device, strerror(errno));
    snprintf(line->link, sizeof line->link, "%s", path);
    return true;
}

static bool open_pty(const struct canopy_wire_line *options, struct line *line, struct canopy_fault *fault) {
    line->file = posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC);
    if (line->file < 0 || grantpt(line->file) != 0 || unlockpt(line->file) != 0 ||
        ptsname_r(line->file, line->device, sizeof line->device) != 0 ||
        (line->keeper = open(line->device, O_RDWR | O_NOCTTY | O_CLOEXEC)) < 0 || !make_raw(line->keeper, options) ||
        fcntl(line->file, F_SETFL, O_NONBLOCK) != 0)
        canopy_fault_set(fault, "no pseudo-terminal: %s", strerror(errno));
    else if (place_link(options->path, line, fault))
        return true;
    line_close(line);
    return false;
}

// A link into /dev/pts is what an earlier run left behind: its target may be somebody else's by now.
static bool is_device(const char *path) {
    char target[256];
    const ssize_t length = readlink(path, target, sizeof target - 1);
    if (length > 0) {
        target[length] = '\0';
        if (strncmp(target, "/dev/pts/", 9) == 0)
            return false;
    }
    struct stat info;
    return stat(path, &info) == 0 && S_ISCHR(info.st_mode);
}

bool line_open(const struct canopy_wire_line *options, struct line *line, struct canopy_fault *fault) {
    *line = (struct line){.file = -1, .keeper = -1};
    return is_device(options->path) ? open_device(options, line, fault) : open_pty(options, line, fault);
}

void line_close(struct line *line) {
    char target[256];
    const ssize_t length = line->link[0] == '\0' ? -1 : readlink(line->link, target, sizeof target - 1);
    if (length > 0) {
        target[length] = '\0';
        if (strcmp(target, line->device) == 0)  // ours still
            unlink(line->link);
    }
    if (line->keeper >= 0)
        close(line->keeper);
    if (line->file >= 0)
        close(line->file);
    *line = (struct line){.file = -1, .keeper = -1};
}
