// The watchdog (datasheet, 4.7): a tick of the reference clock, a counter that errata E1 makes count down twice a tick,
// the reason of the last reset, and eight words that survive one.
import { BasePeripheral } from './library.mjs';
import { Violation } from './faults.mjs';

const CTRL = 0x00;
const LOAD = 0x04;
const REASON = 0x08;
const SCRATCH0 = 0x0c;
const SCRATCH7 = 0x28;
const TICK = 0x2c;
const TRIGGER = 0x80000000;
const ENABLE = 1 << 30;
const PAUSES = 7 << 24;
const TICK_ENABLE = 1 << 9;
const TICK_RUNNING = 1 << 10;
const NANOS_A_COUNT = 500;

export class Watchdog extends BasePeripheral {
    constructor(chip) {
        super(chip, 'WATCHDOG');
        this.alarm = chip.clock.createAlarm(() => this.bite(1));
        this.scratch = new Uint32Array(8);
        this.reason = 0;
        this.restart();
    }

    restart() {
        this.alarm.cancel();
        this.control = PAUSES;
        this.left = 0; // when it stands
        this.due = 0; // when it runs: at what time it bites
        this.tick = TICK_ENABLE;
    }

    /** Whether the tick that the timer counts is a microsecond. */
    get ticksMicroseconds() {
        const cycles = this.tick & 0x1ff;
        return (this.tick & TICK_ENABLE) !== 0 && cycles > 0 && this.rp2040.clocks.refFreq === cycles * 1e6;
    }

    bite(reason) {
        this.reason = reason;
        this.rp2040.watchdogReset();
    }

    get counter() {
        if (!(this.control & ENABLE)) {
            return this.left;
        }
        return Math.max(0, Math.ceil((this.due - this.rp2040.clock.nanos) / NANOS_A_COUNT));
    }

    load(count) {
        this.left = count;
        this.alarm.cancel();
        if (this.control & ENABLE) {
            if (!this.ticksMicroseconds) {
                throw new Violation('the watchdog runs without a tick of a microsecond');
            }
            this.due = this.rp2040.clock.nanos + count * NANOS_A_COUNT;
            this.alarm.schedule(count * NANOS_A_COUNT);
        }
    }

    readUint32(offset) {
        switch (offset) {
            case CTRL:
                return this.control | this.counter;
            case REASON:
                return this.reason;
            case TICK:
                return this.tick | (this.tick & TICK_ENABLE ? TICK_RUNNING : 0);
            case LOAD:
                return 0; // write only
            default:
                return offset >= SCRATCH0 && offset <= SCRATCH7
                    ? this.scratch[(offset - SCRATCH0) / 4]
                    : super.readUint32(offset);
        }
    }

    writeUint32(offset, value) {
        switch (offset) {
            case CTRL: {
                const left = this.counter;
                this.control = value & (ENABLE | PAUSES);
                this.load(left);
                if (value & TRIGGER) {
                    this.bite(2);
                }
                break;
            }
            case LOAD:
                this.load(value & 0xffffff);
                break;
            case TICK:
                this.tick = value & (TICK_ENABLE | 0x1ff);
                break;
            default:
                if (offset < SCRATCH0 || offset > SCRATCH7) {
                    super.writeUint32(offset, value);
                    break;
                }
                this.scratch[(offset - SCRATCH0) / 4] = value;
        }
    }
}
