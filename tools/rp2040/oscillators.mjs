// Crystal and PLL, which take their time: who does not wait for them runs from a clock that is none yet.
import { BasePeripheral, RPPLL } from './library.mjs';
import { Violation } from './faults.mjs';

const CTRL = 0x00;
const STATUS = 0x04;
const STARTUP = 0x0c;
const ENABLE = 0xfab;
const DISABLE = 0xd1e;
const ENABLED = 1 << 12;
const STABLE = 0x80000000;
const CRYSTAL_NANOS = 1e9 / 12e6;
const CRYSTAL_START_NANOS = 0.9e6; // what a crystal may need; STARTUP has to be longer

/** The crystal oscillator (datasheet, 2.16): it says that it is stable when STARTUP's clocks are over. */
export class Xosc extends BasePeripheral {
    constructor(chip) {
        super(chip, 'XOSC');
        this.control = 0;
        this.startup = 0;
        this.stableAt = Infinity;
    }

    get isStable() {
        return this.rp2040.clock.nanos >= this.stableAt;
    }

    readUint32(offset) {
        switch (offset) {
            case CTRL:
                return this.control;
            case STATUS:
                return ((this.stableAt < Infinity ? ENABLED : 0) | (this.isStable ? STABLE : 0)) >>> 0;
            case STARTUP:
                return this.startup;
            default:
                return super.readUint32(offset);
        }
    }

    writeUint32(offset, value) {
        switch (offset) {
            case CTRL:
                this.control = value & 0xffffff;
                this.turn((value >> 12) & 0xfff);
                break;
            case STARTUP:
                this.startup = value & 0x103fff;
                break;
            default:
                super.writeUint32(offset, value);
        }
    }

    turn(enable) {
        if (enable === DISABLE) {
            this.stableAt = Infinity;
        } else if (enable === ENABLE && this.stableAt === Infinity) {
            const clocks = (this.startup & 0x3fff) * 256 * (this.startup & 0x100000 ? 4 : 1);
            if (clocks * CRYSTAL_NANOS < CRYSTAL_START_NANOS) {
                throw new Violation(`the crystal is given ${clocks} clocks to start, less than a millisecond`);
            }
            this.stableAt = this.rp2040.clock.nanos + clocks * CRYSTAL_NANOS;
        }
    }
}

const PLL_CS = 0x00;
const PLL_PWR = 0x04;
const PLL_LOCK = 0x80000000;
const PLL_OFF = (1 << 0) | (1 << 5); // the whole, its oscillator
const LOCK_NANOS = 50e3;

/** A PLL (2.18): it locks some time after it has been powered. */
export class Pll extends RPPLL {
    constructor(chip, name) {
        super(chip, name);
        this.restart();
    }

    restart() {
        Object.assign(this, { cs: 1, pwr: 0x2d, fbdivInt: 0, prim: 0x77000, lockedAt: Infinity });
    }

    get isLocked() {
        return this.rp2040.clock.nanos >= this.lockedAt;
    }

    readUint32(offset) {
        return offset === PLL_CS ? (this.cs | (this.isLocked ? PLL_LOCK : 0)) >>> 0 : super.readUint32(offset);
    }

    writeUint32(offset, value) {
        if (offset === PLL_PWR) {
            const isOn = (value & PLL_OFF) === 0;
            this.lockedAt = !isOn ? Infinity : Math.min(this.lockedAt, this.rp2040.clock.nanos + LOCK_NANOS);
        }
        super.writeUint32(offset, value);
    }
}
