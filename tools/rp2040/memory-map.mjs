// Which block an address of the chip belongs to (datasheet, 2.2), by its upper bits, and the reset that holds it.
import { BasePeripheral } from './library.mjs';
import { Violation, hex } from './faults.mjs';
import { BLOCKS } from './resets.mjs';

// Of blocks that can be held in reset: base address and the name of its reset.
const HELD_BY = {
    0x40004: 'SYSCFG',
    0x40000: 'SYSINFO',
    0x40014: 'IO_BANK0',
    0x40018: 'IO_QSPI',
    0x4001c: 'PADS_BANK0',
    0x40020: 'PADS_QSPI',
    0x40028: 'PLL_SYS',
    0x4002c: 'PLL_USB',
    0x40030: 'BUSCTRL',
    0x40034: 'UART0',
    0x40038: 'UART1',
    0x4003c: 'SPI0',
    0x40040: 'SPI1',
    0x40044: 'I2C0',
    0x40048: 'I2C1',
    0x4004c: 'ADC',
    0x40050: 'PWM',
    0x40054: 'TIMER',
    0x4005c: 'RTC',
    0x4006c: 'TBMAN',
    0x50000: 'DMA',
    0x50110: 'USBCTRL',
    0x50200: 'PIO0',
    0x50300: 'PIO1',
};

/** Bit number of the reset for each key of the map. */
export const RESET_OF = new Map(Object.entries(HELD_BY).map(([key, name]) => [Number(key), BLOCKS.indexOf(name)]));

/** A block of which the firmware may write and read words, and nothing comes of it. */
export class Words extends BasePeripheral {
    constructor(chip, name, values) {
        super(chip, name);
        this.initial = values;
        this.restart();
    }

    restart() {
        this.values = new Map(this.initial);
    }

    readUint32(offset) {
        if (!this.values.has(offset)) {
            throw new Violation(`register ${hex(offset)} of ${this.name} is read, and not modelled`);
        }
        return this.values.get(offset);
    }

    writeUint32(offset, value) {
        if (!this.values.has(offset)) {
            throw new Violation(`register ${hex(offset)} of ${this.name} is written, and not modelled`);
        }
        this.values.set(offset, value >>> 0);
    }
}

/** The control registers of the flash's cache (2.6.3): nothing is cached here, so only the flush has an effect. */
export class XipControl extends Words {
    constructor(chip) {
        super(chip, 'XIP_CTRL', [
            [0x00, 3],
            [0x04, 0],
            [0x08, 3],
            [0x0c, 0],
            [0x10, 0],
        ]);
    }

    writeUint32(offset, value) {
        if (offset === 0x04) {
            this.rp2040.ssi.stale &&= (value & 1) === 0;
        } else {
            super.writeUint32(offset, value);
        }
    }
}
