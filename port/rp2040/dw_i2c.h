/// The I2C controller of an RP2040 (datasheet 4.3, Synopsys DW_apb_i2c) as a master at 400 kHz: struct canopy_i2c.
///
/// Its interrupt keeps its FIFO of 16 filled and emptied, so that a transfer of any length goes on however long the
/// program is away; where the program is so late that the FIFO runs dry the controller holds the clock low. The outcome
/// is told by polling. An alarm of the timer wakes the program when the time of a transfer is over.
///
/// A transfer that has not ended in time is ended by a reset of the controller, and the bus is brought to rest with the
/// pins as open drains: while a device holds the data line up to nine clocks, then STOP. The same is done before a
/// transfer that finds the data line low. That waits inside of the call: 0.12 ms, 0.7 ms at most. It supposes that
/// nobody else is master for so long.
///
/// The controller cannot send an address alone: the probe of lib/port.h reads a byte and drops it.
#ifndef CANOPY_PORT_RP2040_DW_I2C_H
#define CANOPY_PORT_RP2040_DW_I2C_H

#include "lib/port.h"

struct canopy_dw_i2c_config {
    uint32_t base;      ///< RP2040_I2C0 or RP2040_I2C1
    uint32_t reset;     ///< RP2040_RESET_I2C0 or RP2040_RESET_I2C1
    uint32_t irq;       ///< RP2040_IRQ_I2C0 or RP2040_IRQ_I2C1
    uint32_t clock_hz;  ///< clk_sys
    uint32_t data_pin, clock_pin;
    uint32_t alarm;  ///< of the timer
};

/// Private.
struct canopy_dw_i2c {
    struct canopy_dw_i2c_config config;
    struct canopy_i2c_transfer transfer;
    uint64_t deadline_us;
    uint32_t issued, received;  // commands, bytes
    uint32_t recoveries;
    enum canopy_i2c_outcome outcome;
    enum canopy_i2c_outcome refused;  // why the controller broke it off; PENDING: it did not
    bool stopped;                     // a STOP was seen
    uint8_t probed;
};

/// Sets controller and pins up and lets the interrupts in: the board's vector table must call the entries below.
void canopy_dw_i2c_start(struct canopy_dw_i2c *i2c, const struct canopy_dw_i2c_config *config);

/// The master of lib/port.h; `i2c` must outlive it.
struct canopy_i2c canopy_dw_i2c(struct canopy_dw_i2c *i2c);

/// Interrupt entry: true if polling has something new to tell. At most 16 bytes each way.
bool canopy_dw_i2c_on_interrupt(struct canopy_dw_i2c *i2c);

/// Interrupt entry of the alarm: polling has a timeout to tell.
void canopy_dw_i2c_on_alarm(struct canopy_dw_i2c *i2c);

#endif
