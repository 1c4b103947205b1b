// The timer (datasheet, 4.6): microseconds of the watchdog's tick. Without a tick of 1 MHz it is no clock, so it is a
// violation to read it then.
import { BasePeripheral, IRQ } from './library.mjs';
import { Violation } from './faults.mjs';

const TIMEHW = 0x00;
const TIMELW = 0x04;
const TIMEHR = 0x08;
const TIMELR = 0x0c;
const ALARM0 = 0x10;
const ALARM3 = 0x1c;
const ARMED = 0x20;
const TIMERAWH = 0x24;
const TIMERAWL = 0x28;
const DBGPAUSE = 0x2c;
const PAUSE = 0x30;
const INTR = 0x34;
const INTE = 0x38;
const INTF = 0x3c;
const INTS = 0x40;
const TURN = 2 ** 32;

export class Timer extends BasePeripheral {
    constructor(chip) {
        super(chip, 'TIMER');
        this.alarms = [0, 1, 2, 3].map((i) => chip.clock.createAlarm(() => this.ring(i)));
        this.at = [0, 0, 0, 0];
        this.restart();
    }

    restart() {
        this.alarms.forEach((alarm) => alarm.cancel());
        this.armed = this.raw = this.enabled = this.forced = 0;
        this.latched = this.written = 0;
        this.origin = this.rp2040.clock.nanos; // when it was 0
        this.checkInterrupts();
    }

    get micros() {
        if (!this.rp2040.watchdog.ticksMicroseconds) {
            throw new Violation('the timer is used and the watchdog makes no tick of a microsecond for it');
        }
        return Math.floor((this.rp2040.clock.nanos - this.origin) / 1000);
    }

    checkInterrupts() {
        const status = (this.raw & this.enabled) | this.forced;
        for (let i = 0; i < 4; i++) {
            this.rp2040.setInterrupt(IRQ.TIMER_0 + i, (status & (1 << i)) !== 0);
        }
    }

    ring(i) {
        this.armed &= ~(1 << i);
        this.raw |= 1 << i;
        this.checkInterrupts();
    }

    arm(i, value) {
        const ahead = (value - this.micros + 2 * TURN) % TURN;
        this.at[i] = value >>> 0;
        this.armed |= 1 << i;
        this.alarms[i].schedule(
            this.origin + (this.micros + (ahead === 0 ? TURN : ahead)) * 1000 - this.rp2040.clock.nanos,
        );
    }

    readUint32(offset) {
        switch (offset) {
            case TIMEHR:
                return this.latched;
            case TIMELR:
                this.latched = Math.floor(this.micros / TURN);
                return this.micros % TURN;
            case TIMERAWH:
                return Math.floor(this.micros / TURN);
            case TIMERAWL:
                return this.micros % TURN;
            case ARMED:
                return this.armed;
            case DBGPAUSE:
                return 6;
            case PAUSE:
                return 0;
            case INTR:
                return this.raw;
            case INTE:
                return this.enabled;
            case INTF:
                return this.forced;
            case INTS:
                return (this.raw & this.enabled) | this.forced;
            default:
                return offset >= ALARM0 && offset <= ALARM3 ? this.at[(offset - ALARM0) / 4] : super.readUint32(offset);
        }
    }

    writeUint32(offset, value) {
        switch (offset) {
            case TIMELW:
                this.written = value >>> 0;
                break;
            case TIMEHW:
                this.origin = this.rp2040.clock.nanos - ((value >>> 0) * TURN + this.written) * 1000;
                break;
            case ARMED: // writing ones disarms, also through the aliases: hence the value as it was written
                for (let i = 0; i < 4; i++) {
                    if (this.rawWriteValue & (1 << i)) {
                        this.alarms[i].cancel();
                        this.armed &= ~(1 << i);
                    }
                }
                break;
            case INTR:
                this.raw &= ~this.rawWriteValue;
                this.checkInterrupts();
                break;
            case INTE:
                this.enabled = value & 15;
                this.checkInterrupts();
                break;
            case INTF:
                this.forced = value & 15;
                this.checkInterrupts();
                break;
            case DBGPAUSE:
                break;
            default:
                if (offset < ALARM0 || offset > ALARM3) {
                    super.writeUint32(offset, value);
                    break;
                }
                this.arm((offset - ALARM0) / 4, value);
        }
    }
}
