// The second stage of the boot (datasheet 2.8.1.3.1): the boot ROM copies the first 256 bytes of flash to the end of
// RAM, checks their CRC (tools/uf2.py fills it in) and jumps to them. They set up the SSI (4.10) so that code runs from
// flash at full speed, and start the program behind them.
//
// The flash is the W25Q16JV of the Raspberry Pi Pico: its datasheet's 8.2 has the instructions. It is read by Fast Read
// Quad I/O (EBh) at 62.5 MHz in continuous read mode: an access is an address and data, on four wires, without an
// instruction. The flash driver runs a copy of this block as a function to come back to that mode (flash.c), so that
// there is a return address then; the boot ROM gives 0.
//
// Nothing here may reach outside of the block, and all of it must work wherever it is copied: no data, no library, no
// switch tables.
#include <stddef.h>

#include "port/cortexm/core.h"

#define IN_BLOCK(part) __attribute__((section(".boot2." part), used))

// 4.10.13. Functions are given the address, which keeps them short.
struct ssi {
    volatile uint32_t ctrlr0, ctrlr1, ssienr, mwcr, ser, baudr, txftlr, rxftlr, txflr, rxflr, sr, unused[13], dr0;
};
#define SSI ((struct ssi *)0x18000000u)
#define SSI_SAMPLING ((struct ssi_sampling *)0x180000F0u)
struct ssi_sampling {
    volatile uint32_t rx_sample_dly, spi_ctrlr0;
};
#define SR_BUSY (1u << 0)
#define SR_SEND_EMPTY (1u << 2)
#define SR_RECEIVED (1u << 3)
#define CTRLR0_8_BITS (7u << 16)
#define CTRLR0_32_BITS (31u << 16)
#define CTRLR0_SEND_AND_RECEIVE (0u << 8)
#define CTRLR0_READ_EEPROM (3u << 8)
#define CTRLR0_QUAD (2u << 21)
#define SPI_CTRLR0_QUAD_ADDRESS (1u << 0)  // instruction on one wire, address on four
#define SPI_CTRLR0_QUAD_ALL (2u << 0)
#define SPI_CTRLR0_ADDRESS_32_BITS (8u << 2)  // 24 of the address, 8 of the mode
#define SPI_CTRLR0_INSTRUCTION_8_BITS (2u << 8)
#define SPI_CTRLR0_WAIT_4 (4u << 11)
#define SPI_CTRLR0_MODE(bits) ((bits) << 24)

// 2.19.6.4: pads of the flash, its clock and its four wires for data
struct pads {
    volatile uint32_t sclk, sd0, sd1, sd2, sd3;
};
#define PADS ((struct pads *)0x40020004u)
#define PAD_FAST_8_MA 0x21u
#define PAD_INPUT_NO_SCHMITT 0x50u  // and 4 mA; without the trigger a bit comes sooner

// W25Q16JV, 8.2
#define FLASH_WRITE_ENABLE 0x06u
#define FLASH_READ_STATUS_1 0x05u
#define FLASH_READ_STATUS_2 0x35u
#define FLASH_WRITE_STATUS_2 0x31u
#define FLASH_READ_QUAD_IO 0xEBu
#define FLASH_CONTINUOUS_READ 0xA0u
#define FLASH_STATUS_1_BUSY 1u
#define FLASH_STATUS_2_QUAD 2u

#define CLOCK_DIVIDER 2u    // 62.5 MHz at a clk_sys of 125 MHz
#define RX_SAMPLE_DELAY 1u  // half the flash's clock-to-output time in clk_sys

_Static_assert(offsetof(struct ssi, dr0) == 0x60, "the layout of the SSI");

IN_BLOCK("text") __attribute__((noinline)) static void wait_idle(struct ssi *ssi) {
    while ((ssi->sr & (SR_BUSY | SR_SEND_EMPTY)) != SR_SEND_EMPTY)
        ;
}

// Sends an instruction and a byte under one chip select and returns what came with the byte.
IN_BLOCK("text") __attribute__((noinline)) static uint32_t exchange(struct ssi *ssi, uint32_t first, uint32_t second) {
    ssi->dr0 = first;
    ssi->dr0 = second;
    wait_idle(ssi);
    (void)ssi->dr0;
    return ssi->dr0;
}

// The wires for data must not be the flash's "hold" and "write protect" any more; that is kept without power, so it is
// written once in the life of a board, if the maker has not done so.
IN_BLOCK("text") __attribute__((noinline)) static void enable_quad(struct ssi *ssi) {
    if ((exchange(ssi, FLASH_READ_STATUS_2, 0) & FLASH_STATUS_2_QUAD) != 0)
        return;
    ssi->dr0 = FLASH_WRITE_ENABLE;
    wait_idle(ssi);
    (void)ssi->dr0;
    (void)exchange(ssi, FLASH_WRITE_STATUS_2, FLASH_STATUS_2_QUAD);
    while ((exchange(ssi, FLASH_READ_STATUS_1, 0) & FLASH_STATUS_1_BUSY) != 0)
        ;
}

// The first read has an instruction and asks for the mode in which the following have none.
IN_BLOCK("text") __attribute__((noinline)) static void set_up(struct ssi *ssi, struct ssi_sampling *sampling) {
    PADS->sclk = PAD_FAST_8_MA;
    PADS->sd0 = PAD_INPUT_NO_SCHMITT;
    PADS->sd1 = PAD_INPUT_NO_SCHMITT;
    PADS->sd2 = PAD_INPUT_NO_SCHMITT;
    PADS->sd3 = PAD_INPUT_NO_SCHMITT;
    ssi->ssienr = 0;
    ssi->baudr = CLOCK_DIVIDER;
    sampling->rx_sample_dly = RX_SAMPLE_DELAY;
    ssi->ctrlr0 = CTRLR0_8_BITS | CTRLR0_SEND_AND_RECEIVE;
    ssi->ssienr = 1;
    enable_quad(ssi);
    ssi->ssienr = 0;
    ssi->ctrlr0 = CTRLR0_QUAD | CTRLR0_32_BITS | CTRLR0_READ_EEPROM;
    ssi->ctrlr1 = 0;
    sampling->spi_ctrlr0 =
        SPI_CTRLR0_QUAD_ADDRESS | SPI_CTRLR0_ADDRESS_32_BITS | SPI_CTRLR0_INSTRUCTION_8_BITS | SPI_CTRLR0_WAIT_4;
    ssi->ssienr = 1;
    ssi->dr0 = FLASH_READ_QUAD_IO;
    ssi->dr0 = FLASH_CONTINUOUS_READ;
    wait_idle(ssi);
    ssi->ssienr = 0;
    sampling->spi_ctrlr0 =
        SPI_CTRLR0_QUAD_ALL | SPI_CTRLR0_ADDRESS_32_BITS | SPI_CTRLR0_WAIT_4 | SPI_CTRLR0_MODE(FLASH_CONTINUOUS_READ);
    ssi->ssienr = 1;
}

// First in the block. Without a return address: to the program, as a reset would.
IN_BLOCK("entry") __attribute__((naked)) static void boot2(void) {
    __asm volatile("push {lr}\n\t"
                   "ldr r0, =%c0\n\t"
                   "ldr r1, =%c1\n\t"
                   "bl %c2\n\t"
                   "pop {r0}\n\t"
                   "cmp r0, #0\n\t"
                   "beq 1f\n\t"
                   "bx r0\n"
                   "1:\tldr r0, =0x10000100\n\t"
                   "ldr r1, =0xE000ED08\n\t"  // VTOR
                   "str r0, [r1]\n\t"
                   "ldmia r0, {r0, r1}\n\t"
                   "msr msp, r0\n\t"
                   "bx r1\n\t"
                   ".ltorg" ::"i"(SSI),
                   "i"(SSI_SAMPLING), "i"(set_up));
}
