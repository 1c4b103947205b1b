// The boot ROM (datasheet, 2.8): what it does before the second stage, the table of its functions, and those of them
// that concern the flash. The table and its look-up are real code; a function is a breakpoint that ends up here.
import { PAGE, SECTOR } from './flash.mjs';
import { Violation, hex } from './faults.mjs';

const LOOKUP = 0x20;
const TABLE = 0x100;
const FUNCTIONS = 0x200;
const BOOT2 = 0x20041f00;
const BOOT2_BYTES = 256;
const SRAM = 0x20000000;
const SRAM_END = 0x20042000;
const VECTOR_MAGIC = 0xb007c0d3;
const RESET_IO_QSPI = 1 << 6;
const RESET_PADS_QSPI = 1 << 9;
// Typical times of the W25Q16JV (its datasheet, 9.6)
const SECTOR_ERASE_NANOS = 45e6;
const PAGE_PROGRAM_NANOS = 0.4e6;

/** The chip does not start: what it says is for a person. */
export class NoBoot extends Error {}

// r0 a table, r1 a code: the function in r0, or 0.
const LOOKUP_CODE = [
    0x8802, // 1: ldrh r2, [r0]
    0x428a, //    cmp  r2, r1
    0xd004, //    beq  2f
    0x3004, //    adds r0, #4
    0x2a00, //    cmp  r2, #0
    0xd1f9, //    bne  1b
    0x2000, //    movs r0, #0
    0x4770, //    bx   lr
    0x8840, // 2: ldrh r0, [r0, #2]
    0x4770, //    bx   lr
];

/** The CRC-32 of the second stage (2.8.1.3.1): most significant bit first, nothing turned. */
export function crc32(bytes) {
    let crc = 0xffffffff;
    for (const byte of bytes) {
        crc ^= byte << 24;
        for (let i = 0; i < 8; i++) {
            crc = crc & 0x80000000 ? (crc << 1) ^ 0x04c11db7 : crc << 1;
        }
    }
    return crc >>> 0;
}

export class Rom {
    constructor(chip, flash) {
        this.chip = chip;
        this.flash = flash;
        this.functions = {
            IF: () => chip.ssi.enterCommandMode(),
            EX: () => this.exitXip(),
            RE: (offset, count) => this.erase(offset, count),
            RP: (offset, from, count) => this.program(offset, from, count),
            FC: () => this.flushCache(),
            CX: () => this.enterCommandXip(),
            UB: () => {
                throw new NoBoot('the program asks the boot ROM for the USB boot mode');
            },
        };
        this.names = Object.keys(this.functions);
        this.connected = this.exited = false;
        this.write(new Uint16Array(chip.bootrom.buffer));
    }

    write(rom) {
        const at = (address) => address / 2;
        rom.set([0x754d, 0x0301, TABLE, TABLE + 4 * this.names.length, LOOKUP | 1], at(0x10));
        rom.set(LOOKUP_CODE, at(LOOKUP));
        this.names.forEach((name, i) => {
            const address = FUNCTIONS + 4 * i;
            rom.set([name.charCodeAt(0) | (name.charCodeAt(1) << 8), address | 1], at(TABLE + 4 * i));
            rom.set([0xbe00 | i, 0x4770], at(address)); // bkpt #i; bx lr
        });
    }

    /** A breakpoint in the ROM: the function of this number is called, with up to four arguments. */
    call(number) {
        const name = this.names[number];
        if (name === undefined) {
            throw new Violation('the boot ROM is entered where it has no function');
        }
        const [r0, r1, r2, r3] = this.chip.core.registers;
        this.functions[name](r0, r1, r2, r3);
        this.connected ||= name === 'IF';
    }

    // ---- Flash

    // What these functions and their caller need: the flash cannot be read while they are at it.
    checkCaller(name, offset, count, unit) {
        const { core } = this.chip;
        const from = core.LR & ~1;
        if (from < SRAM || from >= SRAM_END) {
            throw new Violation(`${name} is called from ${hex(from)}, which is not RAM`);
        }
        if (!core.PM) {
            throw new Violation(`${name} is called with interrupts on, and their vectors are in the flash`);
        }
        if (core.interruptNMIMask !== 0) {
            throw new Violation(`${name} is called while an interrupt is non-maskable, and its vector is in the flash`);
        }
        if (!this.connected || !this.exited) {
            throw new Violation(`${name} is called before connect_internal_flash and flash_exit_xip`);
        }
        if (offset % unit !== 0 || count % unit !== 0 || offset + count > this.flash.bytes) {
            throw new Violation(`${name} of ${count} bytes at ${hex(offset)}: no whole units of ${unit} in the flash`);
        }
    }

    exitXip() {
        const from = this.chip.core.LR & ~1;
        if (from < SRAM || from >= SRAM_END) {
            throw new Violation(`flash_exit_xip is called from ${hex(from)}, which is not RAM`);
        }
        this.chip.ssi.enterCommandMode();
        this.exited = true;
    }

    erase(offset, count) {
        this.checkCaller('flash_range_erase', offset, count, SECTOR);
        this.chip.ssi.stale = true;
        this.flash.erase(offset, count);
        this.chip.pass((count / SECTOR) * SECTOR_ERASE_NANOS);
    }

    program(offset, from, count) {
        this.checkCaller('flash_range_program', offset, count, PAGE);
        if (from < SRAM || from + count > SRAM_END) {
            throw new Violation(`flash_range_program reads ${hex(from)}, which is not RAM`);
        }
        this.chip.ssi.stale = true;
        this.flash.program(offset, this.chip.sram.subarray(from - SRAM, from - SRAM + count));
        this.chip.pass((count / PAGE) * PAGE_PROGRAM_NANOS);
    }

    // It also takes the force of the chip select back, without which XIP cannot read.
    flushCache() {
        this.chip.ssi.stale = false;
    }

    enterCommandXip() {
        this.chip.ssi.enterSlowReading();
        this.connected = this.exited = false;
    }

    // ---- Boot

    /** From a reset of the processors to the first instruction of the second stage. */
    boot() {
        const { chip } = this;
        chip.resets.set(chip.resets.held & ~(RESET_IO_QSPI | RESET_PADS_QSPI));
        this.connected = this.exited = false;
        const [magic, check, sp, pc] = chip.watchdog.scratch.subarray(4, 8);
        if (chip.watchdog.reason !== 0 && magic === VECTOR_MAGIC && (check ^ -VECTOR_MAGIC) >>> 0 === pc) {
            chip.watchdog.scratch[4] = 0;
            chip.core.restart(pc, sp);
            return;
        }
        const block = this.flash.memory.subarray(0, BOOT2_BYTES);
        const stored = new DataView(block.buffer, block.byteOffset).getUint32(BOOT2_BYTES - 4, true);
        const computed = crc32(block.subarray(0, BOOT2_BYTES - 4));
        if (stored !== computed) {
            throw new NoBoot(
                `the boot ROM finds no second stage: 252 bytes have the CRC ${hex(computed)}, and behind them ` +
                    `stands ${hex(stored)}; the chip would wait for a UF2 file on USB`,
            );
        }
        chip.sram.set(block, BOOT2 - SRAM);
        chip.ssi.enterCommandMode();
        chip.core.restart(BOOT2, BOOT2);
        chip.core.LR = 0;
    }
}
