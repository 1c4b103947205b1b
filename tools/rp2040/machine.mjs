// A chip that runs: the loop, the pace, and who is connected.
//
// Alone it runs as fast as it can, and every run is the same. With a peer on a line it keeps real time: never faster,
// and where the host is too slow, slower (its clock then has stood still meanwhile).
import { Chip } from './chip.mjs';
import { Fault } from './faults.mjs';
import { Flash } from './flash.mjs';
import { Rom } from './rom.mjs';
import { End, semihosting } from './semihosting.mjs';

const FLASH_BYTES = 2 * 1024 * 1024; // the Pico's W25Q16JV
const ROM_END = 0x4000;
const PACED_SLICE = 1 << 17; // cycles: about a millisecond
const YIELD_SLICES = 256;
const NANOS_A_MILLI = 1e6;

export class Machine {
    constructor({ counting = false, paced = false, cutAfter = Infinity } = {}) {
        this.chip = new Chip(FLASH_BYTES, counting);
        this.flash = new Flash(this.chip.flash, FLASH_BYTES, cutAfter);
        this.rom = new Rom(this.chip, this.flash);
        this.chip.rom = this.rom;
        this.chip.breakpoint = (number) => this.breakpoint(number);
        this.paced = paced;
        if (paced) {
            this.chip.clock.longest = PACED_SLICE;
        }
        this.anchor = 0; // real nanoseconds at virtual 0
        this.frozen = null;
        this.waiting = []; // what came meanwhile
        this.wake = () => {};
        this.ends = [];
        this.limitNanos = Infinity;
        this.resets = [];
        this.chip.onReset = (what) => this.resets.push(what);
    }

    breakpoint(number) {
        if (this.chip.core.PC < ROM_END) {
            this.rom.call(number);
            return true;
        }
        if (number === 0xab) {
            semihosting(this.chip);
            return true;
        }
        return false;
    }

    /** Lets `end` be the other end of a UART. A UART may have several. */
    connect(uart, end) {
        const before = uart.onSent;
        uart.onSent = (byte) => {
            before(byte);
            end.write(byte);
        };
        this.ends.push(end);
        return end.start((data) => this.arrive(() => uart.feed(data)));
    }

    /** Something comes from outside: at the virtual time that it is now, or when time goes on again. */
    arrive(deliver) {
        if (this.frozen !== null) {
            this.waiting.push(deliver);
            return;
        }
        const { core } = this.chip;
        if (this.paced && core.waiting && !core.interruptsUpdated) {
            this.chip.clock.skipTo(Math.min(this.realNanos(), this.nextAlarmNanos));
        }
        deliver();
        this.wake();
    }

    /** Stops time until a promise is kept: for a device whose other half is another program. */
    freeze(promise) {
        this.frozen = promise;
    }

    thaw() {
        this.frozen = null;
        this.setAnchor();
        this.waiting.splice(0).forEach((deliver) => this.arrive(deliver));
    }

    get nextAlarmNanos() {
        return this.chip.clock.nextAlarm?.nanos ?? Infinity;
    }

    realNanos() {
        return Number(process.hrtime.bigint()) - this.anchor;
    }

    setAnchor() {
        this.anchor = Number(process.hrtime.bigint()) - this.chip.clock.nanos;
    }

    // One slice, or one sleep. Returns how long to wait for the real clock, in nanoseconds.
    step() {
        const { chip } = this;
        if (chip.needsBoot) {
            chip.needsBoot = false;
            this.rom.boot();
        }
        chip.core.run();
        if (chip.core.waiting && !chip.core.interruptsUpdated && !chip.needsBoot) {
            const ahead = this.paced ? this.nextAlarmNanos - this.realNanos() : 0;
            if (ahead > 0) {
                return ahead;
            }
            if (this.nextAlarmNanos === Infinity) {
                return Infinity;
            }
            chip.clock.skipTo(this.nextAlarmNanos);
        } else {
            chip.clock.settle();
        }
        return this.paced ? this.keepPace() : 0;
    }

    keepPace() {
        const ahead = this.chip.clock.nanos - this.realNanos();
        if (ahead < -2 * NANOS_A_MILLI) {
            this.setAnchor();
        }
        return Math.max(ahead, 0);
    }

    /** Runs to the end of the image: its exit status. Throws what ends a run otherwise. */
    async run() {
        this.setAnchor();
        try {
            for (let slices = 1; ; slices++) {
                while (this.frozen !== null) {
                    await this.frozen;
                    this.thaw();
                }
                const wait = this.step();
                if (this.frozen !== null) {
                    continue;
                }
                if (wait > 0) {
                    this.flush();
                    await this.pause(wait);
                } else if (slices % (this.paced ? 4 : YIELD_SLICES) === 0) {
                    this.flush();
                    await new Promise(setImmediate);
                }
                if (this.chip.clock.nanos > this.limitNanos) {
                    throw new TooLong(`no end within ${this.limitNanos / 1e9} s of the chip's time`);
                }
            }
        } catch (problem) {
            this.finish();
            if (problem instanceof End) {
                return problem.status;
            }
            throw problem;
        }
    }

    // Until the time is over or something has come from outside.
    pause(nanos) {
        if (nanos === Infinity && this.ends.every((end) => !end.isPeer)) {
            throw new Fault('it sleeps, and nothing is left that could wake it', this.chip.core.PC);
        }
        return new Promise((resolve) => {
            const millis = nanos / NANOS_A_MILLI;
            const timer =
                millis < 1.2 ? setImmediate(resolve) : setTimeout(resolve, Math.min(Math.floor(millis), 1000));
            this.wake = () => {
                clearTimeout(timer);
                resolve();
            };
        });
    }

    flush() {
        this.ends.forEach((end) => end.flush());
    }

    /** What the transmitters still hold goes out, and the ends are closed. */
    finish() {
        for (const uart of this.chip.uart) {
            [uart.shifting, ...uart.out].filter((byte) => byte >= 0).forEach((byte) => uart.onSent(byte));
        }
        this.flush();
        this.ends.forEach((end) => end.close());
    }
}

export class TooLong extends Error {}
