// The resets of subsystems (datasheet, 2.14): what is held in reset must not be used, and is as new when it is let go.
import { BasePeripheral } from './library.mjs';

const RESET = 0x0;
const WDSEL = 0x4;
const RESET_DONE = 0x8;
const ALL = 0x1ffffff;
const RELEASE_NANOS = 200; // until DONE says so: the firmware has to wait

export const BLOCKS = [
    'ADC',
    'BUSCTRL',
    'DMA',
    'I2C0',
    'I2C1',
    'IO_BANK0',
    'IO_QSPI',
    'JTAG',
    'PADS_BANK0',
    'PADS_QSPI',
    'PIO0',
    'PIO1',
    'PLL_SYS',
    'PLL_USB',
    'PWM',
    'RTC',
    'SPI0',
    'SPI1',
    'SYSCFG',
    'SYSINFO',
    'TBMAN',
    'TIMER',
    'UART0',
    'UART1',
    'USBCTRL',
];

export class Resets extends BasePeripheral {
    constructor(chip) {
        super(chip, 'RESETS');
        this.wdsel = 0;
        this.restart();
    }

    restart() {
        this.held = ALL;
        this.released = new Array(BLOCKS.length).fill(0);
    }

    get done() {
        const { nanos } = this.rp2040.clock;
        return this.released.reduce((bits, at, i) => bits | (!(this.held & (1 << i)) && nanos >= at ? 1 << i : 0), 0);
    }

    /** True while `block`, a bit number, cannot be used. */
    isHeld(block) {
        return (this.held & (1 << block)) !== 0 || this.rp2040.clock.nanos < this.released[block];
    }

    set(held) {
        const before = this.held;
        this.held = held & ALL;
        for (let i = 0; i < BLOCKS.length; i++) {
            const bit = 1 << i;
            if (this.held & ~before & bit) {
                this.rp2040.blockReset(BLOCKS[i]);
            }
            if (before & ~this.held & bit) {
                this.released[i] = this.rp2040.clock.nanos + RELEASE_NANOS;
            }
        }
    }

    readUint32(offset) {
        switch (offset) {
            case RESET:
                return this.held;
            case WDSEL:
                return this.wdsel;
            case RESET_DONE:
                return this.done;
            default:
                return super.readUint32(offset);
        }
    }

    writeUint32(offset, value) {
        switch (offset) {
            case RESET:
                this.set(value);
                break;
            case WDSEL:
                this.wdsel = value & ALL;
                break;
            default:
                super.writeUint32(offset, value);
        }
    }
}
