/// Where canopyd's scanner and its PLCs are, as written on the command line.
#ifndef CANOPY_BOARDS_LINUX_URL_H
#define CANOPY_BOARDS_LINUX_URL_H

#include <stdbool.h>
#include <stdint.h>

#include "port/linux/serial.h"
#include "tools/common/fault.h"

#define CANOPYD_TEXT_MAX 1024

enum canopyd_scanner_kind { CANOPYD_NO_SCANNER, CANOPYD_SIMULATED, CANOPYD_RTU_SCANNER, CANOPYD_TCP_SCANNER };

/// `text` holds what the pointers of a URL point to: do not copy one.
struct canopyd_scanner_url {
    enum canopyd_scanner_kind kind;
    const char *points;                        ///< sim: the file …
    uint32_t profiles;                         ///< … cut into so many; 0: as suits it
    double rate_hz;                            ///< 0: as fast as they are read
    bool loop;                                 ///< again and again
    struct canopy_linux_serial_config serial;  ///< modbus-rtu
    const char *host, *service;                ///< modbus-tcp
    uint8_t unit;                              ///< of the device
    const char *driver;                        ///< name of a table of lib/scan
    char text[CANOPYD_TEXT_MAX];
};

struct canopyd_modbus_url {
    bool tcp;
    const char *host;  ///< tcp
    uint16_t port;     ///< tcp; 0: any free one
    struct canopy_linux_serial_config serial;
    uint8_t unit;  ///< rtu: ours
    char text[CANOPYD_TEXT_MAX];
};

/// `sim:POINTS[,profiles=N,rate=HZ,loop]`, `modbus-rtu:DEVICE,BAUD,8E1,UNIT[,driver=NAME][,rs485]`,
/// `modbus-tcp:HOST:PORT[,driver=NAME][,unit=U]`. False: `fault` says which part is wrong and what is expected.
bool canopyd_scanner_url(const char *text, struct canopyd_scanner_url *url, struct canopy_fault *fault);

/// `tcp:HOST:PORT` or `rtu:DEVICE,BAUD,8E1,UNIT[,rs485]`.
bool canopyd_modbus_url(const char *text, struct canopyd_modbus_url *url, struct canopy_fault *fault);

#endif
