#include "port/linux/flash_file.h"

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#define PAGE CANOPY_LINUX_FLASH_PAGE
#define BYTES (PAGE * CANOPY_LINUX_FLASH_PAGES)

// ---- Whole reads and writes

static bool read_all(int fd, uint8_t *to, size_t length, off_t at) {
    while (length > 0) {
        const ssize_t got = pread(fd, to, length, at);
        if (got < 0 && errno == EINTR) {
            continue;
        }
        if (got <= 0) {
            return false;
        }
        to += got;
        at += got;
        length -= (size_t)got;
    }
    return true;
}

static bool write_all(int fd, const uint8_t *from, size_t length, off_t at) {
    while (length > 0) {
        const ssize_t put = pwrite(fd, from, length, at);
        if (put < 0 && errno == EINTR) {
            continue;
        }
        if (put <= 0) {
            return false;
        }
        from += put;
        at += put;
        length -= (size_t)put;
    }
    return fdatasync(fd) == 0;
}

static bool blank(int fd, off_t at) {
    uint8_t page[PAGE];
    memset(page, 0xFF, sizeof page);
    return write_all(fd, page, sizeof page, at);
}

// ---- The memory

static bool is_inside(uint32_t page, uint32_t offset, uint32_t length) {
    return page < CANOPY_LINUX_FLASH_PAGES && offset <= PAGE && length <= PAGE - offset;
}

static enum canopy_status flash_read(void *context, uint32_t page, uint32_t offset, uint8_t *to, uint32_t length) {
    const struct canopy_linux_flash_file *file = context;
    if (!is_inside(page, offset, length)) {
        return CANOPY_ARGUMENT;
    }
    return read_all(file->fd, to, length, (off_t)page * PAGE + offset) ? CANOPY_OK : CANOPY_RANGE;
}

static enum canopy_status flash_erase(void *context, uint32_t page) {
    const struct canopy_linux_flash_file *file = context;
    if (!is_inside(page, 0, 0)) {
        return CANOPY_ARGUMENT;
    }
    return blank(file->fd, (off_t)page * PAGE) ? CANOPY_OK : CANOPY_RANGE;
}

static enum canopy_status flash_program(void *context, uint32_t page, uint32_t offset, const uint8_t *from,
                                        uint32_t length) {
    const struct canopy_linux_flash_file *file = context;
    const off_t at = (off_t)page * PAGE + offset;
    uint8_t bytes[PAGE];
    if (!is_inside(page, offset, length)) {
        return CANOPY_ARGUMENT;
    }
    if (!read_all(file->fd, bytes, length, at)) {
        return CANOPY_RANGE;
    }
    for (uint32_t i = 0; i < length; i++) {
        bytes[i] &= from[i];
    }
    return write_all(file->fd, bytes, length, at) ? CANOPY_OK : CANOPY_RANGE;
}

struct canopy_flash canopy_linux_flash_file(struct canopy_linux_flash_file *file) {
    return (struct canopy_flash){.context = file,
                                 .page_bytes = PAGE,
                                 .program_bytes = 1,
                                 .page_count = CANOPY_LINUX_FLASH_PAGES,
                                 .read = flash_read,
                                 .erase = flash_erase,
                                 .program = flash_program};
}

// ---- Opening

// A new name is on the disk when its directory is.
static bool sync_directory(const char *path) {
    char copy[PATH_MAX];
    snprintf(copy, sizeof copy, "%s", path);
    const int fd = open(dirname(copy), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    const bool good = fd >= 0 && fsync(fd) == 0;
    if (fd >= 0) {
        close(fd);
    }
    return good;
}

// Under another name first, so that there is never half a file.
static bool make(const char *path) {
    char draft[PATH_MAX];
    if ((size_t)snprintf(draft, sizeof draft, "%s.new", path) >= sizeof draft) {
        errno = ENAMETOOLONG;
        return false;
    }
    const int fd = open(draft, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    if (fd < 0) {
        return false;
    }
    bool good = blank(fd, 0) && blank(fd, PAGE) && fsync(fd) == 0;
    int reason = errno;
    if (close(fd) != 0 && good) {
        good = false;
        reason = errno;
    }
    if (good && rename(draft, path) == 0 && sync_directory(path)) {
        return true;
    }
    reason = good ? errno : reason;
    unlink(draft);
    errno = reason;
    return false;
}

static const char *what_is_wrong(int fd) {
    struct stat is;
    if (fstat(fd, &is) != 0) {
        return strerror(errno);
    }
    if (!S_ISREG(is.st_mode)) {
        return "it is no plain file";
    }
    if (is.st_size != BYTES) {
        return "it has another length than settings have";
    }
    return flock(fd, LOCK_EX | LOCK_NB) == 0 ? NULL : "another program has it";
}

const char *canopy_linux_flash_file_open(struct canopy_linux_flash_file *file, const char *path) {
    struct stat is;
    file->fd = -1;
    if (stat(path, &is) != 0 && (errno != ENOENT || !make(path))) {
        return strerror(errno);
    }
    file->fd = open(path, O_RDWR | O_CLOEXEC | O_NONBLOCK);
    const char *wrong = file->fd < 0 ? strerror(errno) : what_is_wrong(file->fd);
    if (wrong != NULL) {
        canopy_linux_flash_file_close(file);
    }
    return wrong;
}

void canopy_linux_flash_file_close(struct canopy_linux_flash_file *file) {
    if (file->fd >= 0) {
        close(file->fd);
    }
    file->fd = -1;
}
