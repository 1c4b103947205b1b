/// What canopyd is asked to do: from the command line and a configuration file with the same keys.
#ifndef CANOPY_BOARDS_LINUX_OPTIONS_H
#define CANOPY_BOARDS_LINUX_OPTIONS_H

#include <stdbool.h>
#include <stdint.h>

#include "boards/linux/url.h"
#include "tools/common/fault.h"

#define CANOPYD_MODBUS_MAX 16  ///< --modbus options

enum { CANOPYD_EXIT_OK = 0, CANOPYD_EXIT_BROKEN = 1, CANOPYD_EXIT_INPUT = 2, CANOPYD_EXIT_USAGE = 64 };

struct canopyd_options {
    struct canopyd_scanner_url scanner;
    struct canopyd_modbus_url modbus[CANOPYD_MODBUS_MAX];
    unsigned modbus_count;
    uint16_t size[2];
    bool size_given;
    uint8_t side;        ///< enum canopy_side
    double unit;         ///< 0: not given
    char *frame;         ///< a surrogate file, or NULL
    char *settings;      ///< a file for settings, or NULL
    int32_t axes[3][3];  ///< of frames around the scanner's scene; all 0: x, y and z
    bool dir_given, plane_given;
    uint16_t field;
    uint16_t lines;
    bool tight;  ///< spare time is spent on tightening
    uint32_t stale_after_ms, interval_ms, refresh_ms;
    uint32_t idle_ms;     ///< 0: TCP clients may idle for ever
    uint32_t timeout_ms;  ///< of the scanner's answers
};

/// Reads the command line and, where it names one, the configuration file; the command line wins, and one --modbus on
/// it replaces all of the file's. Returns CANOPYD_EXIT_OK, or the status to exit with after a line on standard error:
/// CANOPYD_EXIT_USAGE for a command line that cannot be understood (argp ends the process itself for some),
/// CANOPYD_EXIT_INPUT for a value that cannot be or a bad file. `options` needs canopyd_options_free either way.
int canopyd_options_read(int argc, char **argv, struct canopyd_options *options);

void canopyd_options_free(struct canopyd_options *options);

#endif
