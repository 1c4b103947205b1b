// The processor's own peripherals: the package's interrupt controller, and what it lacks: SysTick that counts as the
// chip's does (a written 0 is no tick), the memory protection unit's registers, and the reset request.
import { RPPPB } from './library.mjs';
import { Violation, hex } from './faults.mjs';

const SYST_CSR = 0x010;
const SYST_RVR = 0x014;
const SYST_CVR = 0x018;
const AIRCR = 0xd0c;
const SCR = 0xd10;
const CCR = 0xd14;
const MPU_TYPE = 0xd90;
const MPU_CTRL = 0xd94;
const MPU_RNR = 0xd98;
const MPU_RBAR = 0xd9c;
const MPU_RASR = 0xda0;
const TOP = 0x1000000;

/** SysTick: `start` is when it held 0, at the frequency it has. */
class SysTick {
    constructor(chip) {
        this.chip = chip;
        this.alarm = chip.clock.createAlarm(() => this.turn());
        this.reset();
    }

    reset() {
        this.control = 0;
        this.reload = 0;
        this.value = 0; // while it stands
        this.start = 0;
        this.flag = false;
        this.alarm.cancel();
    }

    get running() {
        return (this.control & 1) !== 0;
    }

    get cycleNanos() {
        return this.chip.clock.cycleNanos;
    }

    // It holds 0 for one cycle, then the reload value, and so on.
    get current() {
        if (!this.running) {
            return this.value;
        }
        const cycles = Math.round((this.chip.clock.nanos - this.start) / this.cycleNanos) % (this.reload + 1);
        return cycles === 0 ? 0 : this.reload + 1 - cycles;
    }

    /** Goes on from `value`, at whatever frequency there is now. */
    goOn(value) {
        this.value = value;
        this.alarm.cancel();
        if (!this.running || this.reload === 0) {
            return;
        }
        const { nanos } = this.chip.clock;
        this.start = nanos - (value === 0 ? 0 : this.reload + 1 - value) * this.cycleNanos;
        this.alarm.schedule((value === 0 ? this.reload + 1 : value) * this.cycleNanos);
    }

    turn() {
        this.flag = true;
        this.start = this.chip.clock.nanos;
        this.alarm.schedule((this.reload + 1) * this.cycleNanos);
        if (this.control & 2) {
            this.chip.core.pendingSystick = true;
            this.chip.core.interruptsUpdated = true;
        }
    }
}

export class Ppb extends RPPPB {
    constructor(chip) {
        super(chip, 'PPB');
        this.systickAlarm.enable = false; // the package's own
        this.tick = new SysTick(chip);
        this.restart();
    }

    /** The package resets itself before there is ours. */
    reset() {}

    restart() {
        this.tick.reset();
        this.mpu = { control: 0, region: 0, base: new Uint32Array(8), size: new Uint32Array(8) };
    }

    readUint32(offset) {
        const { tick, mpu } = this;
        switch (offset) {
            case SYST_CSR: {
                const value = (tick.flag ? 1 << 16 : 0) | tick.control;
                tick.flag = false;
                return value;
            }
            case SYST_RVR:
                return tick.reload;
            case SYST_CVR:
                return tick.current;
            case AIRCR:
                return 0xfa050000;
            case SCR:
                return 0;
            case CCR:
                return 0x208;
            case MPU_TYPE:
                return 0x800;
            case MPU_CTRL:
                return mpu.control;
            case MPU_RNR:
                return mpu.region;
            case MPU_RBAR:
                return mpu.base[mpu.region];
            case MPU_RASR:
                return mpu.size[mpu.region];
            default:
                return super.readUint32(offset);
        }
    }

    writeUint32(offset, value) {
        const { tick, mpu } = this;
        switch (offset) {
            case SYST_CSR: {
                const now = tick.current;
                tick.control = value & 7;
                tick.goOn(now);
                break;
            }
            case SYST_RVR: {
                const now = tick.current;
                tick.reload = value & (TOP - 1);
                tick.goOn(Math.min(now, tick.reload));
                break;
            }
            case SYST_CVR:
                tick.flag = false;
                tick.goOn(0);
                break;
            case AIRCR:
                if (value >>> 16 === 0x05fa && value & 4) {
                    this.rp2040.requestReset();
                }
                break;
            case SCR:
                if (value !== 0) {
                    throw new Violation(`SCR is written ${hex(value)}: deep sleep is not modelled`);
                }
                break;
            case CCR:
                break; // read-only on ARMv6-M
            case MPU_CTRL:
                mpu.control = value & 7;
                break;
            case MPU_RNR:
                mpu.region = value & 7;
                break;
            case MPU_RBAR:
                if (value & 16) {
                    mpu.region = value & 7;
                }
                mpu.base[mpu.region] = value & ~31;
                break;
            case MPU_RASR:
                mpu.size[mpu.region] = value;
                this.checkRegion(mpu.base[mpu.region], value);
                break;
            default:
                super.writeUint32(offset, value);
        }
    }

    // Regions are not enforced: what they forbid must be what is not there anyway.
    checkRegion(base, size) {
        const bytes = 2 ** (((size >>> 1) & 31) + 1);
        const isBelowRam = base >= 0x15004000 && base + bytes <= 0x18000000;
        if (size & 1 && !isBelowRam && !(base >= 0x18004000 && base + bytes <= 0x20000000)) {
            throw new Violation(
                `a region of ${bytes} bytes at ${hex(base)} for the memory protection unit, which is not modelled`,
            );
        }
    }
}
