/// A file as the flash of lib/port.h: two pages of 4096 bytes, so that a torn block of a disk is a torn page.
///
/// What erase and program have written is on the disk when they return (fdatasync), as far as the disk tells the truth.
/// The file belongs to one process at a time.
#ifndef CANOPY_PORT_LINUX_FLASH_FILE_H
#define CANOPY_PORT_LINUX_FLASH_FILE_H

#include "lib/port.h"

#define CANOPY_LINUX_FLASH_PAGE 4096U
#define CANOPY_LINUX_FLASH_PAGES 2U

struct canopy_linux_flash_file {
    int fd;  ///< -1 when closed
};

/// Opens the file, or makes an erased one where there is none: whole or not at all, also if the power goes. NULL, or in
/// a few words what is wrong: the system's reason, or that the file is none of these (another length, no plain file, in
/// use). It is closed then, and what was there is unchanged.
const char *canopy_linux_flash_file_open(struct canopy_linux_flash_file *file, const char *path);

/// Closes; harmless when closed.
void canopy_linux_flash_file_close(struct canopy_linux_flash_file *file);

/// The memory; the file must outlive it. Programs any number of bytes anywhere; like a flash it only clears bits.
struct canopy_flash canopy_linux_flash_file(struct canopy_linux_flash_file *file);

#endif
