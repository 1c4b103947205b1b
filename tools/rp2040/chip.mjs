// The chip: rp2040js' RP2040 with our processor and those blocks replaced that the package lacks or simplifies, its
// memory map with faults, and its resets.
import { IRQ, RP2040 } from './library.mjs';
import { Clock } from './clock.mjs';
import { Core } from './core.mjs';
import { Fault, Violation, hex } from './faults.mjs';
import { I2c } from './i2c.mjs';
import { RESET_OF, Words, XipControl } from './memory-map.mjs';
import { Pll, Xosc } from './oscillators.mjs';
import { Ppb } from './ppb.mjs';
import { BLOCKS, Resets } from './resets.mjs';
import { Ssi } from './ssi.mjs';
import { Timer } from './timer.mjs';
import { Uart } from './uart.mjs';
import { Watchdog } from './watchdog.mjs';

const FLASH = 0x10000000;
const FLASH_END = 0x14000000;
const SRAM = 0x20000000;
const SRAM_BYTES = 264 * 1024;
const SIO = 0xd0000000;
const PPB = 0xe0000000;
const ROSC_HZ = 6.5e6; // 2.17: typical
const PAD_RESET = 0x56; // 2.19.6.3
const PINS = 30;
const NO_FUNCTION = 0x1f;
// 2.13.5, what a watchdog may reset
const PSM_RESETS = 1 << 3;
const PSM_XIP = 1 << 12;
const PSM_PROCESSOR0 = 1 << 15;
const PSM_CLOCKS = 1 << 2;

/** What rp2040js only warns of is a violation: nothing that is not modelled goes by unseen. */
const strict = {
    debug() {},
    info() {},
    warn(component, message) {
        throw new Violation(`${component}: ${message}`);
    },
    error(component, message) {
        throw new Violation(`${component}: ${message}`);
    },
};

export class Chip extends RP2040 {
    /**
     * `flashBytes` is a power of two. `counting`: an instruction is one cycle (port/board.h,
     * canopy_board_instructions).
     */
    constructor(flashBytes, counting) {
        super(new Clock());
        this.clock.nextAlarm = null; // of blocks that are replaced
        this.logger = strict;
        this.counting = counting;
        this.flashMask = flashBytes - 1;
        this.sram16 = new Uint16Array(this.sram.buffer);
        this.sram32 = new Uint32Array(this.sram.buffer);
        this.window = 0; // bytes of flash that code can run from: 0 while XIP is off
        this.core = new Core(this);
        this.clock.core = this.core;
        this.rom = null; // set by whoever makes the machine
        this.onFault = () => {};
        this.onReset = () => {};
        this.breakpoint = () => false;
        this.needsBoot = true;
        this.addClockListener((hz) => this.changeClock(hz));
        this.replaceBlocks();
        this.powerOn();
    }

    replaceBlocks() {
        this.ppb = new Ppb(this);
        this.ssi = new Ssi(this);
        this.watchdog = new Watchdog(this);
        this.timer = new Timer(this);
        this.resets = new Resets(this);
        this.uart = [new Uart(this, 0, IRQ.UART0), new Uart(this, 1, IRQ.UART1)];
        this.i2c = [new I2c(this, 0, IRQ.I2C0), new I2c(this, 1, IRQ.I2C1)];
        this.pllSys = new Pll(this, 'PLL_SYS');
        this.xosc = new Xosc(this);
        this.chipReset = new Words(this, 'VREG_AND_CHIP_RESET', [
            [0, 0xb1],
            [4, 9],
            [8, 1 << 8],
        ]);
        Object.assign(this.peripherals, {
            0x14000: new XipControl(this),
            0x18000: this.ssi,
            0x4000c: this.resets,
            0x40018: new Words(
                this,
                'IO_QSPI',
                Array.from({ length: 12 }, (_, i) => [4 * i, i % 2 ? NO_FUNCTION : 0]),
            ),
            0x40024: this.xosc,
            0x40028: this.pllSys,
            0x40034: this.uart[0],
            0x40038: this.uart[1],
            0x40044: this.i2c[0],
            0x40048: this.i2c[1],
            0x40054: this.timer,
            0x40058: this.watchdog,
            0x40060: new Words(this, 'ROSC', [
                [0, 0xaa0],
                [4, 0],
                [8, 0],
                [0x10, 16],
                [0x18, 1 << 31],
            ]),
            0x40064: this.chipReset,
        });
    }

    /** The package resets itself before our parts are there; ours have their own ways. */
    reset() {}

    // ---- Time

    /** Lets time pass within an instruction: a function of the ROM, which works for so long. */
    pass(nanos) {
        this.core.spent += Math.ceil(nanos / this.clock.cycleNanos);
    }

    changeClock(hz) {
        const { tick } = this.ppb;
        const ticks = tick.current;
        this.clock.setFrequency(hz);
        tick.goOn(ticks);
    }

    updateClocks() {
        super.updateClocks();
        const { refCtrl, sysCtrl } = this.clocks;
        if ((refCtrl & 3) === 2 && !this.xosc.isStable) {
            throw new Violation('clk_ref is taken from the crystal before it is stable');
        }
        if ((sysCtrl & 0xe1) === 1 && !this.pllSys.isLocked) {
            throw new Violation('clk_sys is taken from a PLL that is not locked');
        }
    }

    updateClkPeri() {
        this.clkPeri = this.clocks.periFreq;
    }

    // ---- Resets

    powerOn() {
        this.resetClocks();
        for (const block of BLOCKS) {
            this.blockReset(block);
        }
        this.resets.restart();
        this.ssi.restart();
        this.fillMemory();
    }

    resetClocks() {
        Object.assign(this.clocks, { refCtrl: 0, refDiv: 0x100, sysCtrl: 0, sysDiv: 0x100, periCtrl: 0 });
        this.clkSys = ROSC_HZ;
        this.clkPeri = 0;
        this.changeClock(ROSC_HZ);
    }

    /** Nobody may rely on what memory holds after power-on: it is noise, the same in every run. */
    fillMemory() {
        let state = 0x2545f491;
        for (let i = 0; i < this.sram32.length; i++) {
            state ^= state << 13;
            state ^= state >>> 17;
            state ^= state << 5;
            this.sram32[i] = state;
        }
    }

    /** One block, as its reset leaves it. */
    blockReset(name) {
        const units = {
            UART0: this.uart[0],
            UART1: this.uart[1],
            I2C0: this.i2c[0],
            I2C1: this.i2c[1],
            TIMER: this.timer,
        };
        if (name === 'IO_BANK0') {
            this.eachPin((pin) => (pin.ctrl = NO_FUNCTION));
        } else if (name === 'PADS_BANK0') {
            this.eachPin((pin) => (pin.padValue = PAD_RESET));
        } else if (name === 'SYSCFG') {
            this.core.interruptNMIMask = 0;
        } else if (name === 'PLL_SYS') {
            this.pllSys.restart();
        } else {
            units[name]?.restart();
        }
    }

    eachPin(change) {
        for (let i = 0; i < PINS; i++) {
            change(this.gpio[i]);
            this.gpio[i].checkForUpdates();
            this.gpio[i].refreshInput();
        }
    }

    /** The watchdog bites: what the firmware has selected is reset, memory and the watchdog's words stay. */
    watchdogReset() {
        const selected = this.peripherals[0x40010].wdsel;
        if (!(selected & PSM_PROCESSOR0)) {
            throw new Violation(
                `the watchdog bites, and PSM_WDSEL (${hex(selected)}) does not let it reset the processor`,
            );
        }
        if (!(selected & PSM_RESETS) || !(selected & PSM_XIP) || !(selected & PSM_CLOCKS)) {
            throw new Violation(
                `the watchdog resets the processor without clocks, XIP and devices (PSM_WDSEL ${hex(selected)})`,
            );
        }
        this.onReset('watchdog');
        this.restart();
    }

    /** AIRCR.SYSRESETREQ: of the processor alone; devices and clocks go on as they are (2.4.2.3). */
    requestReset() {
        this.onReset('processor');
        this.ppb.restart();
        this.needsBoot = true;
        this.core.lockUp();
    }

    restart() {
        const { watchdog } = this;
        this.resetClocks();
        BLOCKS.forEach((block) => this.blockReset(block));
        this.resets.restart();
        this.ppb.restart();
        this.ssi.restart();
        this.sio.gpioValue = this.sio.gpioOutputEnable = 0;
        this.eachPin(() => {});
        watchdog.restart();
        this.needsBoot = true;
        this.core.lockUp(); // until the ROM starts it
    }

    // ---- Pins

    /** Whether a pin is an output of a function. */
    pinHas(pin, what) {
        return this.gpio[pin].functionSelect === what && !this.gpio[pin].outputDisable;
    }

    /** Whether a function gets what is on a pin. */
    pinHears(pin, what) {
        return this.gpio[pin].functionSelect === what && this.gpio[pin].inputEnable;
    }

    // ---- Memory. What is not there is a fault; so is an address that is no multiple of the size.

    setXip(on) {
        this.window = on ? this.flashMask + 1 : 0;
        if (on && this.rom) {
            this.rom.exited = false;
        }
    }

    /** Flash and everything that is no memory: a word. */
    readSlowly(address) {
        if (address >= FLASH && address < FLASH_END) {
            if (this.window === 0) {
                throw new Violation(`the flash is read at ${hex(address)} while it cannot be`);
            }
            return this.flashView.getUint32(address & this.flashMask & ~3, true);
        }
        if (address < this.bootrom.length * 4) {
            return this.bootrom[address >>> 2];
        }
        if (address >>> 12 === 0xe000e) {
            return this.ppb.readUint32(address & 0xffc);
        }
        if (address >= SIO && address < PPB) {
            return this.sio.readUint32((address - SIO) & ~3);
        }
        return this.peripheralAt(address).readUint32(address & 0xffc) >>> 0;
    }

    peripheralAt(address) {
        const key = (address >>> 14) << 2;
        const peripheral = address >= 0x14000000 && address < SIO ? this.peripherals[key] : undefined;
        if (peripheral === undefined) {
            throw new Fault('nothing there', address);
        }
        const reset = RESET_OF.get(key);
        if (reset !== undefined && this.resets.isHeld(reset)) {
            throw new Violation(`${BLOCKS[reset]} is used at ${hex(address)} while it is in reset`);
        }
        return peripheral;
    }

    fetch(address) {
        if (address >= SRAM && address < SRAM + SRAM_BYTES) {
            return this.sram16[(address - SRAM) >> 1];
        }
        if (address < 0 || address >= FLASH_END || (address >= this.bootrom.length * 4 && address < FLASH)) {
            throw new Fault('nothing to execute', address);
        }
        const word = this.readSlowly(address & ~3);
        return address & 2 ? word >>> 16 : word & 0xffff;
    }

    readUint32(address) {
        const place = (address - SRAM) | 0;
        if (address & 3) {
            throw new Fault('no multiple of four', address);
        }
        if (place >= 0 && place < SRAM_BYTES) {
            return this.sram32[place >> 2];
        }
        const inFlash = (address - FLASH) | 0;
        return inFlash >= 0 && inFlash < this.window
            ? this.flashView.getUint32(inFlash, true)
            : this.readSlowly(address >>> 0);
    }

    readUint16(address) {
        const place = (address - SRAM) | 0;
        if (address & 1) {
            throw new Fault('no multiple of two', address);
        }
        if (place >= 0 && place < SRAM_BYTES) {
            return this.sram16[place >> 1];
        }
        return (this.readSlowly(address >>> 0) >>> (8 * (address & 2))) & 0xffff;
    }

    readUint8(address) {
        const place = (address - SRAM) | 0;
        if (place >= 0 && place < SRAM_BYTES) {
            return this.sram[place];
        }
        return (this.readSlowly(address >>> 0) >>> (8 * (address & 3))) & 0xff;
    }

    writeUint32(address, value) {
        const place = (address - SRAM) | 0;
        if (address & 3) {
            throw new Fault('no multiple of four', address);
        }
        if (place >= 0 && place < SRAM_BYTES) {
            this.sram32[place >> 2] = value;
        } else {
            this.writeSlowly(address >>> 0, value >>> 0);
        }
    }

    // Peripherals take a narrow write as the value in all places (2.1.4).
    writeUint16(address, value) {
        const place = (address - SRAM) | 0;
        if (address & 1) {
            throw new Fault('no multiple of two', address);
        }
        if (place >= 0 && place < SRAM_BYTES) {
            this.sram16[place >> 1] = value;
        } else {
            this.writeSlowly((address & ~3) >>> 0, (value | (value << 16)) >>> 0);
        }
    }

    writeUint8(address, value) {
        const place = (address - SRAM) | 0;
        if (place >= 0 && place < SRAM_BYTES) {
            this.sram[place] = value;
        } else {
            this.writeSlowly((address & ~3) >>> 0, Math.imul(value, 0x01010101) >>> 0);
        }
    }

    writeSlowly(address, value) {
        if (address >= FLASH && address < FLASH_END) {
            throw new Fault('a write to the flash', address);
        }
        if (address < this.bootrom.length * 4) {
            throw new Fault('a write to the ROM', address);
        }
        if (address >>> 12 === 0xe000e) {
            this.ppb.writeUint32(address & 0xffc, value);
        } else if (address >= SIO && address < PPB) {
            this.sio.writeUint32(address - SIO, value);
        } else {
            this.peripheralAt(address).writeUint32Atomic(
                address & 0xffc,
                value,
                address < 0x40000000 ? 0 : (address >>> 12) & 3,
            );
        }
    }
}
