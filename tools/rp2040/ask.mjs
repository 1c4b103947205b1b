// Asks the image something as early as it can hear it, and measures how long it takes to answer.

const RETRY_NANOS = 20e6;

/**
 * From when the line `uart` listens, `request` comes every 20 ms until the first byte of an answer is given to the
 * transmitter. `done` gets instructions and microseconds from the reset to then.
 */
export class Question {
    constructor(machine, uart, request, done) {
        Object.assign(this, { machine, uart, request, done });
        this.isAnswered = false;
        const { onWire } = uart;
        this.before = onWire;
        uart.onWire = (busy) => {
            onWire(busy);
            if (busy && this.isAsked) {
                this.answered();
            }
        };
        this.isAsked = false;
        this.alarm = machine.chip.clock.createAlarm(() => this.ask());
        this.alarm.schedule(1000);
    }

    get hears() {
        return (this.uart.cr & 0x201) === 0x201 && this.uart.bitNanos > 0 && this.uart.mask !== 0;
    }

    ask() {
        if (this.isAnswered) {
            return;
        }
        if (!this.hears) {
            this.alarm.schedule(1000);
            return;
        }
        this.isAsked = true;
        this.uart.feed(this.request);
        this.alarm.schedule(RETRY_NANOS);
    }

    answered() {
        if (!this.isAnswered) {
            this.isAnswered = true;
            this.uart.onWire = this.before;
            this.done(this.machine.chip.core.instructions, Math.floor(this.machine.chip.clock.nanos / 1000));
        }
    }
}
