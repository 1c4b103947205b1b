/// A main's scanner that speaks Modbus RTU on one of the board's lines.
#ifndef CANOPY_BOARDS_COMMON_RTU_SCANNER_H
#define CANOPY_BOARDS_COMMON_RTU_SCANNER_H

#include "boards/common/program.h"
#include "lib/scan/generic.h"
#include "lib/station/rtu_link.h"

/// Configures the device's scanner; `link`, the main's, reaches it over `line`. False: the settings are none for it.
static inline bool canopy_program_rtu_scanner(struct canopy_device_config *to, struct canopy_rtu_link *link,
                                              const struct canopy_board *board, const struct canopy_settings *settings,
                                              uint8_t line) {
    const struct canopy_rtu_link_config config = {.clock = board->clock,
                                                  .stream = board->line[line],
                                                  .baud = settings->scanner_baud,
                                                  .character_bits = CANOPY_PROGRAM_BITS,
                                                  .timeout_us = settings->scanner_timeout_ms * 1000U};
    to->scanner = (struct canopy_device_scanner){.link = canopy_rtu_link(link),
                                                 .table = &canopy_profile_generic,
                                                 .columns = CANOPY_PROGRAM_COLUMNS,
                                                 .unit = (uint8_t)settings->scanner_unit};
    return canopy_rtu_link_init(link, &config) == CANOPY_OK;
}

#endif
