#include "tools/common/wire.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static bool number(const char *text, unsigned long low, unsigned long high, unsigned long *to) {
    char *end = NULL;
    errno = 0;
    *to = strtoul(text, &end, 10);
    return text[0] >= '0' && text[0] <= '9' && *end == '\0' && errno == 0 && *to >= low && *to <= high;
}

static bool take_baud(const char *text, struct canopy_wire_line *line, struct canopy_fault *fault) {
    unsigned long value = 0;
    if (text == NULL)
        return true;
    if (!number(text, 1200, 1000000, &value))
        return canopy_fault_set(fault, "'%s' is no baud rate from 1200 to 1000000", text);
    line->baud = (uint32_t)value;
    return true;
}

static bool take_format(const char *text, struct canopy_wire_line *line, struct canopy_fault *fault) {
    if (text == NULL)
        return true;
    if (strlen(text) != 3 || text[0] != '8' || strchr("NEO", text[1]) == NULL || strchr("12", text[2]) == NULL)
        return canopy_fault_set(fault, "'%s' is none of 8E1, 8O1, 8N1, 8N2, 8E2, 8O2", text);
    line->parity = text[1];
    line->stop_bits = (uint8_t)(text[2] - '0');
    return true;
}

static bool take_unit(const char *text, uint8_t *unit, struct canopy_fault *fault) {
    unsigned long value = 0;
    if (text == NULL)
        return true;
    if (!number(text, 1, 247, &value))
        return canopy_fault_set(fault, "'%s' is no unit from 1 to 247", text);
    *unit = (uint8_t)value;
    return true;
}

bool canopy_wire_line_parse(const char *text, struct canopy_wire_line *line, struct canopy_fault *fault) {
    *line = (struct canopy_wire_line){.baud = 115200, .parity = 'E', .stop_bits = 1, .unit = 1};
    char copy[320], *rest = copy;
    if (snprintf(copy, sizeof copy, "%s", text) >= (int)sizeof copy)
        return canopy_fault_set(fault, "%.40s…: too long for a serial line", text);
    const char *path = strsep(&rest, ","), *baud = strsep(&rest, ","), *format = strsep(&rest, ","), *unit = rest;
    if (path[0] == '\0' || strlen(path) >= sizeof line->path)
        return canopy_fault_set(fault, "'%s' is no serial line: give PATH[,BAUD[,8E1[,UNIT]]]", text);
    memcpy(line->path, path, strlen(path) + 1);
    return (take_baud(baud, line, fault) && take_format(format, line, fault) && take_unit(unit, &line->unit, fault)) ||
           canopy_fault_prefix(fault, "%s", text);
}

bool canopy_wire_tcp_parse(const char *text, struct canopy_wire_tcp *address, struct canopy_fault *fault) {
    *address = (struct canopy_wire_tcp){.unit = 1};
    char copy[160], *rest = copy;
    unsigned long port = 0;
    if (snprintf(copy, sizeof copy, "%s", text) >= (int)sizeof copy)
        return canopy_fault_set(fault, "%.40s…: too long for a TCP address", text);
    char *place = strsep(&rest, ","), *colon = strrchr(place, ':');
    if (colon == NULL || !number(colon + 1, 0, 65535, &port))
        return canopy_fault_set(fault, "'%s' is no TCP address: give HOST:PORT", text);
    *colon = '\0';
    size_t length = strlen(place);
    if (length >= 2 && place[0] == '[' && place[length - 1] == ']') {
        place++;
        length -= 2;
    }
    if (length >= sizeof address->host)
        return canopy_fault_set(fault, "%.40s…: too long for a host", text);
    memcpy(address->host, place, length);
    snprintf(address->port, sizeof address->port, "%lu", port);
    return take_unit(rest, &address->unit, fault) || canopy_fault_prefix(fault, "%s", text);
}

bool canopy_wire_url_parse(const char *text, struct canopy_wire_url *url, struct canopy_fault *fault) {
    *url = (struct canopy_wire_url){.tcp = strncmp(text, "tcp:", 4) == 0};
    if (url->tcp)
        return canopy_wire_tcp_parse(text + 4, &url->address, fault);
    if (strncmp(text, "rtu:", 4) == 0)
        return canopy_wire_line_parse(text + 4, &url->line, fault);
    return canopy_fault_set(fault, "'%s' is no wire: give rtu:DEVICE,BAUD,8E1,UNIT or tcp:HOST:PORT", text);
}

unsigned canopy_wire_character_bits(const struct canopy_wire_line *line) {
    return 9u + (line->parity != 'N') + line->stop_bits;
}
