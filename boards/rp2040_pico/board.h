/// Raspberry Pi Pico: an RP2040 at 125 MHz, 2 MB of flash (W25Q16JV), a 12 MHz crystal.
///
/// Data of the board for port/rp2040. Any GPIO may be replaced by another that the RP2040 datasheet, 1.4.3, gives the
/// same function.
#ifndef CANOPY_BOARDS_RP2040_PICO_BOARD_H
#define CANOPY_BOARDS_RP2040_PICO_BOARD_H

// Line 0, RS-485: data out, data in, driver enable (with the receiver's inverted enable).
#define BOARD_UART0_SEND_PIN 0u
#define BOARD_UART0_RECEIVE_PIN 1u
#define BOARD_UART0_DIRECTION_PIN 2u

// Line 1, and the console's last words.
#define BOARD_UART1_SEND_PIN 8u
#define BOARD_UART1_RECEIVE_PIN 9u

// The scanner's bus.
#define BOARD_I2C0_DATA_PIN 4u
#define BOARD_I2C0_CLOCK_PIN 5u

// On while the program works, off while it sleeps.
#define BOARD_LED_PIN 25u

/// Each line's rings. Received: a whole Modbus frame, however long the loop is away. To be sent: what the wire takes in
/// 10 ms, longer than the loop is away, so that a frame leaves without gaps.
#define BOARD_RECEIVE_LENGTH 256u
#define BOARD_SEND_LENGTH 128u

#endif
