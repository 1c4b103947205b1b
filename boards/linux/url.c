#include "boards/linux/url.h"

#include <string.h>

#include "tools/common/number.h"
#include "tools/common/wire.h"

static bool keep(char *to, const char *text, struct canopy_fault *fault) {
    if (strlen(text) >= CANOPYD_TEXT_MAX) {
        return canopy_fault_set(fault, "%.40s…: longer than %d characters: give a shorter path", text,
                                CANOPYD_TEXT_MAX - 1);
    }
    strcpy(to, text);
    return true;
}

// Cuts the first part off `*rest`, up to a comma; NULL when nothing is left.
static char *cut(char **rest) { return *rest == NULL ? NULL : strsep(rest, ","); }

// What follows `name` in "name=value", or NULL.
static const char *value_of(const char *part, const char *name) {
    const size_t length = strlen(name);
    return strncmp(part, name, length) == 0 && part[length] == '=' ? part + length + 1 : NULL;
}

// ---- Lines and hosts

// DEVICE,BAUD,8E1,UNIT
static bool read_line(const char *whole, char **rest, struct canopy_linux_serial_config *serial, uint8_t *unit,
                      struct canopy_fault *fault) {
    serial->device = cut(rest);
    const char *baud = cut(rest), *format = cut(rest), *number = cut(rest);
    uint32_t value;
    if (serial->device == NULL || serial->device[0] == '\0' || number == NULL) {
        return canopy_fault_set(fault, "%s: give DEVICE,BAUD,8E1,UNIT, such as /dev/ttyUSB0,115200,8E1,1", whole);
    }
    if (!canopy_number_whole32(baud, 1, 4000000, &serial->baud) || !canopy_linux_baud_known(serial->baud)) {
        return canopy_fault_set(fault, "%s: '%s' is no standard baud rate: give 9600, 19200, 115200, …", whole, baud);
    }
    if (!canopy_wire_format(format, &serial->parity, &serial->stop_bits)) {
        return canopy_fault_set(fault, "%s: '%s' is none of 8N1, 8E1, 8O1, 8N2, 8E2, 8O2", whole, format);
    }
    if (!canopy_number_whole32(number, 1, 247, &value)) {
        return canopy_fault_set(fault, "%s: unit '%s' is none of 1 to 247", whole, number);
    }
    *unit = (uint8_t)value;
    return true;
}

// HOST:PORT; an IPv6 address stands in brackets.
static bool read_host(const char *whole, char *part, uint32_t lowest, const char **host, const char **service,
                      uint32_t *port, struct canopy_fault *fault) {
    char *digits = NULL;
    *host = part == NULL ? NULL : canopy_wire_cut(part, &digits);
    *service = digits;
    if (*host == NULL) {
        return canopy_fault_set(fault, "%s: give HOST:PORT, such as 192.168.0.10:502", whole);
    }
    if (*host == part && strchr(part, ':') != NULL) {
        return canopy_fault_set(fault, "%s: put an IPv6 address in brackets, such as [::1]:502", whole);
    }
    return canopy_number_whole32(*service, lowest, 65535, port) ||
           canopy_fault_set(fault, "%s: port '%s' is none of %u to 65535", whole, *service, lowest);
}

// ---- Scanners

static bool sim_option(const char *whole, const char *part, struct canopyd_scanner_url *url,
                       struct canopy_fault *fault) {
    const char *value;
    if (strcmp(part, "loop") == 0) {
        url->loop = true;
        return true;
    }
    if ((value = value_of(part, "profiles")) != NULL) {
        return canopy_number_whole32(value, 1, 65535, &url->profiles) ||
               canopy_fault_set(fault, "%s: profiles '%s' is none of 1 to 65535", whole, value);
    }
    if ((value = value_of(part, "rate")) != NULL) {
        return (canopy_number_positive(value, &url->rate_hz) && url->rate_hz <= 1e6) ||
               canopy_fault_set(fault, "%s: rate '%s' is no number of hertz above 0, up to 1e6", whole, value);
    }
    return canopy_fault_set(fault, "%s: '%s' is none of profiles=N, rate=HZ, loop (a path has no commas here)", whole,
                            part);
}

static bool device_option(const char *whole, const char *part, struct canopyd_scanner_url *url,
                          struct canopy_fault *fault) {
    const char *value;
    uint32_t unit;
    if ((value = value_of(part, "driver")) != NULL) {
        url->driver = value;
        return true;
    }
    if (url->kind == CANOPYD_RTU_SCANNER && strcmp(part, "rs485") == 0) {
        url->serial.rs485 = true;
        return true;
    }
    if (url->kind == CANOPYD_TCP_SCANNER && (value = value_of(part, "unit")) != NULL) {
        const bool fits = canopy_number_whole32(value, 0, 255, &unit);
        url->unit = (uint8_t)unit;
        return fits || canopy_fault_set(fault, "%s: unit '%s' is none of 0 to 255", whole, value);
    }
    return canopy_fault_set(fault, "%s: '%s' is none of driver=NAME, %s", whole, part,
                            url->kind == CANOPYD_RTU_SCANNER ? "rs485" : "unit=U");
}

static bool read_options(const char *whole, char *rest, struct canopyd_scanner_url *url, struct canopy_fault *fault) {
    for (const char *part; (part = cut(&rest)) != NULL;) {
        if (!(url->kind == CANOPYD_SIMULATED ? sim_option(whole, part, url, fault)
                                             : device_option(whole, part, url, fault))) {
            return false;
        }
    }
    return true;
}

bool canopyd_scanner_url(const char *text, struct canopyd_scanner_url *url, struct canopy_fault *fault) {
    *url = (struct canopyd_scanner_url){.unit = 1, .driver = "generic"};
    if (!keep(url->text, text, fault)) {
        return false;
    }
    char *rest = url->text;
    const char *scheme = strsep(&rest, ":");
    uint32_t port;
    if (rest != NULL && strcmp(scheme, "sim") == 0) {
        url->kind = CANOPYD_SIMULATED;
        url->points = cut(&rest);
        return (url->points[0] != '\0' ||
                canopy_fault_set(fault, "%s: give a point file, such as sim:scene.xyz", text)) &&
               read_options(text, rest, url, fault);
    }
    if (rest != NULL && strcmp(scheme, "modbus-rtu") == 0) {
        url->kind = CANOPYD_RTU_SCANNER;
        return read_line(text, &rest, &url->serial, &url->unit, fault) && read_options(text, rest, url, fault);
    }
    if (rest != NULL && strcmp(scheme, "modbus-tcp") == 0) {
        url->kind = CANOPYD_TCP_SCANNER;
        return read_host(text, cut(&rest), 1, &url->host, &url->service, &port, fault) &&
               read_options(text, rest, url, fault);
    }
    if (rest != NULL && strcmp(scheme, "i2c") == 0) {
        return canopy_fault_set(fault, "%s: no driver for a scanner on I2C is built in: use modbus-rtu or modbus-tcp",
                                text);
    }
    return canopy_fault_set(fault, "%s: give sim:POINTS, modbus-rtu:DEVICE,BAUD,8E1,UNIT or modbus-tcp:HOST:PORT",
                            text);
}

// ---- PLCs

bool canopyd_modbus_url(const char *text, struct canopyd_modbus_url *url, struct canopy_fault *fault) {
    *url = (struct canopyd_modbus_url){.tcp = false};
    if (!keep(url->text, text, fault)) {
        return false;
    }
    char *rest = url->text;
    const char *scheme = strsep(&rest, ":"), *service;
    uint32_t port = 0;
    if (rest != NULL && strcmp(scheme, "tcp") == 0) {
        url->tcp = true;
        if (!read_host(text, rest, 0, &url->host, &service, &port, fault)) {
            return false;
        }
        url->port = (uint16_t)port;
        return true;
    }
    if (rest == NULL || strcmp(scheme, "rtu") != 0) {
        return canopy_fault_set(fault, "%s: give tcp:HOST:PORT or rtu:DEVICE,BAUD,8E1,UNIT", text);
    }
    if (!read_line(text, &rest, &url->serial, &url->unit, fault)) {
        return false;
    }
    for (const char *part; (part = cut(&rest)) != NULL;) {
        if (strcmp(part, "rs485") != 0) {
            return canopy_fault_set(fault, "%s: '%s' is not rs485, the only thing that may follow the unit", text,
                                    part);
        }
        url->serial.rs485 = true;
    }
    return true;
}
