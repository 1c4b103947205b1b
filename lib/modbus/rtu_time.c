#include "lib/modbus/rtu_time.h"

#include "lib/modbus/rtu.h"

uint32_t canopy_modbus_rtu_silence_us(uint32_t baud) {
    if (baud == 0 || baud > 19200)
        return 1750;
    return (38500000u + baud - 1) / baud;
}

uint32_t canopy_modbus_rtu_character_q8(uint32_t baud, uint8_t bits) {
    if (baud == 0)
        return 0;
    return (bits == 10 ? 10u : 11u) * (1000000u << 8) / baud;
}
