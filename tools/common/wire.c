#include "tools/common/wire.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "tools/common/number.h"

bool canopy_wire_format(const char *text, char *parity, uint8_t *stop_bits) {
    if (strlen(text) != 3 || text[0] != '8' || strchr("NEO", text[1]) == NULL || strchr("12", text[2]) == NULL)
        return false;
    *parity = text[1];
    *stop_bits = (uint8_t)(text[2] - '0');
    return true;
}

char *canopy_wire_cut(char *text, char **port) {
    char *colon = strrchr(text, ':');
    if (colon == NULL)
        return NULL;
    *colon = '\0';
    *port = colon + 1;
    if (text[0] == '[' && colon - text >= 2 && colon[-1] == ']') {
        colon[-1] = '\0';
        return text + 1;
    }
    return text;
}

static bool take_baud(const char *text, struct canopy_wire_line *line, struct canopy_fault *fault) {
    return text == NULL || canopy_number_whole32(text, 1200, 1000000, &line->baud) ||
           canopy_fault_set(fault, "'%s' is no baud rate from 1200 to 1000000", text);
}

static bool take_format(const char *text, struct canopy_wire_line *line, struct canopy_fault *fault) {
    return text == NULL || canopy_wire_format(text, &line->parity, &line->stop_bits) ||
           canopy_fault_set(fault, "'%s' is none of 8E1, 8O1, 8N1, 8N2, 8E2, 8O2", text);
}

static bool take_unit(const char *text, uint8_t *unit, struct canopy_fault *fault) {
    uint32_t value = 0;
    if (text == NULL)
        return true;
    if (!canopy_number_whole32(text, 1, 247, &value))
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
    char copy[160], *rest = copy, *digits = NULL;
    uint32_t port = 0;
    if (snprintf(copy, sizeof copy, "%s", text) >= (int)sizeof copy)
        return canopy_fault_set(fault, "%.40s…: too long for a TCP address", text);
    const char *host = canopy_wire_cut(strsep(&rest, ","), &digits);
    if (host == NULL || !canopy_number_whole32(digits, 0, 65535, &port))
        return canopy_fault_set(fault, "'%s' is no TCP address: give HOST:PORT", text);
    if (strlen(host) >= sizeof address->host)
        return canopy_fault_set(fault, "%.40s…: too long for a host", text);
    memcpy(address->host, host, strlen(host) + 1);
    snprintf(address->port, sizeof address->port, "%" PRIu32, port);
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
