// Virtual time, in nanoseconds since power-on: so many for each cycle of the processor, and more when it sleeps.
//
// Within a slice of instructions the time is computed from the cycles only when somebody looks at it; the next alarm is
// the slice's limit. So an instruction costs no clock work, and time is exact.
import { SimulationClock } from './library.mjs';

const LONGEST_SLICE = 1 << 28; // cycles: small integers are fast

export class Clock extends SimulationClock {
    constructor() {
        super();
        this.base = 0; // at the beginning of the slice
        this.cycleNanos = 1;
        this.firing = null;
        this.core = { spent: 0, limit: 0, interruptsUpdated: false }; // until there is one
        this.longest = LONGEST_SLICE;
    }

    get nanos() {
        return this.firing ?? this.base + this.core.spent * this.cycleNanos;
    }

    /** The processor's clock has changed. */
    setFrequency(hz) {
        const now = this.nanos;
        this.cycleNanos = 1e9 / hz;
        this.base = now - this.core.spent * this.cycleNanos;
        this.limit();
    }

    linkAlarm(nanos, alarm) {
        super.linkAlarm(Math.max(nanos, 0), alarm);
        this.limit();
        return alarm;
    }

    /** Lets the slice end at the next alarm, or at once when there is an interrupt to look at. */
    limit() {
        const { core } = this;
        if (core.interruptsUpdated) {
            return;
        }
        const left = this.nextAlarm === null ? this.longest : (this.nextAlarm.nanos - this.base) / this.cycleNanos;
        core.limit = Math.min(Math.ceil(left), this.longest);
    }

    /** Ends the slice: its cycles become time, and what is due happens, each thing at its own time. */
    settle() {
        const now = this.nanos;
        this.core.endSlice();
        this.base = now;
        while (this.nextAlarm !== null && this.nextAlarm.nanos <= now) {
            const alarm = this.nextAlarm;
            this.nextAlarm = alarm.next;
            alarm.scheduled = false;
            this.firing = alarm.nanos;
            alarm.callback();
            this.firing = null;
        }
        this.limit();
    }

    /** Sleeps until `nanos`, which is not behind the next alarm. */
    skipTo(nanos) {
        this.base = Math.max(this.base, nanos);
        this.settle();
    }
}
