// The processor: a Cortex-M0+ (ARMv6-M Architecture Reference Manual).
//
// Exceptions and special registers are rp2040js's. The instructions are decoded anew here, for three reasons: faults
// (the package has none; ours says the address of the instruction, as the chip does), the overflow flag of ADC and SBC,
// which the package gets wrong when the carry turns an operand's sign (comparisons of 64 bits depend on it), and speed:
// four times as many instructions a second. Cycles are those of the Cortex-M0+ with its fast multiplier and single-
// cycle I/O port (Technical Reference Manual, table 3-1), without misses of the flash's cache.
import { CortexM0Core } from './library.mjs';
import { Fault, Violation, hex } from './faults.mjs';

const NMI = 2;
const NMI_PRIORITY = -2;
const HARD_FAULT = 3;
const SYSTICK = 15;
const LOWEST_PRIORITY = 4;
const ENTRY_CYCLES = 15;
const FLASH = 0x10000000;
const SIO = 0xd;
const APB = 0x4;
const NOP = 0xbf00;

export class Core extends CortexM0Core {
    constructor(chip) {
        super(chip);
        this.chip = chip;
        this.r = new Int32Array(this.registers.buffer);
        this.executed = 0; // instructions since power-on, up to the slice
        this.cycleCount = 0; // likewise
        this.spent = 0; // cycles of this slice
        this.done = 0; // instructions of this slice, when somebody looks
        this.limit = 0; // cycles at which the slice ends
        this.nz = 1; // negative and zero as that number is
        this.carry = 0;
        this.overflow = 0;
        this.locked = false;
        this.updated = true;
    }

    // The package's constructor writes these.
    set N(_) {}
    set Z(_) {}
    set C(value) {
        this.carry = value ? 1 : 0;
    }
    set V(value) {
        this.overflow = value ? 1 : 0;
    }

    get APSR() {
        return (
            (this.nz < 0 ? 0x80000000 : 0) |
            (this.nz === 0 ? 0x40000000 : 0) |
            (this.carry << 29) |
            (this.overflow << 28)
        );
    }
    set APSR(value) {
        this.nz = value & 0x80000000 ? -1 : value & 0x40000000 ? 0 : 1;
        this.carry = (value >>> 29) & 1;
        this.overflow = (value >>> 28) & 1;
    }

    // Whoever changes what is pending ends the slice.
    get interruptsUpdated() {
        return this.updated;
    }
    set interruptsUpdated(value) {
        this.updated = value;
        if (value) {
            this.limit = -1;
        }
    }

    /** Instructions executed since power-on, this one included. */
    get instructions() {
        return this.executed + this.done;
    }

    endSlice() {
        this.executed += this.done;
        this.cycleCount += this.spent;
        this.done = this.spent = 0;
    }

    /** As a reset of the processor leaves it; registers are kept, as on the chip. */
    restart(pc, sp) {
        this.IPSR = 0;
        this.currentMode = 0;
        this.SPSEL = 0;
        this.PM = this.nPRIV = this.waiting = this.locked = this.eventRegistered = false;
        this.pendingInterrupts = this.enabledInterrupts = 0;
        this.interruptPriorities = [0xffffffff, 0, 0, 0];
        this.pendingNMI = this.pendingPendSV = this.pendingSVCall = this.pendingSystick = false;
        this.interruptNMIMask = 0;
        this.VTOR = this.SHPR2 = this.SHPR3 = 0;
        this.SP = sp;
        this.PC = pc;
        this.interruptsUpdated = true;
    }

    setInterrupt(irq, value) {
        const bit = 1 << irq;
        if (value && this.interruptNMIMask & bit & ~this.pendingInterrupts) {
            this.pendingNMI = true;
        }
        if (!value) {
            this.pendingInterrupts &= ~bit;
        } else if (!(this.pendingInterrupts & bit)) {
            this.pendingInterrupts |= bit;
            this.interruptsUpdated = true;
        }
    }

    /** The pending exception of the highest priority above `than`, or 0. Of equal ones the lowest number. */
    highestPending(than) {
        if (this.pendingNMI && than > NMI_PRIORITY) {
            return NMI;
        }
        const irqs = this.pendingInterrupts & this.enabledInterrupts;
        for (let priority = 0; priority < than; priority++) {
            if (this.pendingSVCall && priority === this.svCallPriority) {
                return 11;
            }
            if (this.pendingPendSV && priority === this.pendSVPriority) {
                return 14;
            }
            if (this.pendingSystick && priority === this.systickPriority) {
                return SYSTICK;
            }
            const here = irqs & this.interruptPriorities[priority];
            if (here) {
                return 16 + (31 - Math.clz32(here & -here));
            }
        }
        return 0;
    }

    /** Takes what is pending, if it may be taken. Masked, it only ends a WFI. */
    checkForInterrupts() {
        this.interruptsUpdated = false;
        if (this.locked) {
            return false;
        }
        const active = this.IPSR ? this.exceptionPriority(this.IPSR) : LOWEST_PRIORITY;
        const number = this.highestPending(active);
        if (number === 0) {
            return false;
        }
        this.waiting = false;
        if (this.PM && number !== NMI) {
            return false;
        }
        this.pendingNMI &&= number !== NMI;
        this.pendingSVCall &&= number !== 11;
        this.pendingPendSV &&= number !== 14;
        this.pendingSystick &&= number !== SYSTICK;
        this.enter(number);
        return true;
    }

    /**
     * Enters an exception; r15 is the address to return to. Where even its frame cannot be pushed, the processor locks
     * up.
     */
    enter(number) {
        try {
            this.exceptionEntry(number);
        } catch (fault) {
            if (!(fault instanceof Fault)) {
                throw fault;
            }
            this.lockUp();
        }
        this.spent += this.chip.counting ? 0 : ENTRY_CYCLES;
    }

    /** HardFault, or within one the end: only a reset helps then. */
    hardFault(pc) {
        this.r[15] = pc;
        if (this.IPSR === HARD_FAULT || this.IPSR === NMI) {
            this.lockUp();
        } else {
            this.enter(HARD_FAULT);
        }
    }

    lockUp() {
        this.locked = this.waiting = true;
        this.interruptsUpdated = true;
    }

    /** Executes until the limit: an alarm is due, an interrupt is to be looked at, the processor sleeps. */
    run() {
        if (this.updated) {
            this.checkForInterrupts();
            this.chip.clock.limit();
        }
        if (this.waiting) {
            return;
        }
        this.slice();
    }

    slice() {
        const { r, chip } = this;
        const flash16 = chip.flash16;
        const extra = chip.counting ? 0 : -1; // an instruction is one cycle when instructions are counted
        let pc = r[15] & ~1;
        let nz = this.nz;
        let c = this.carry;
        let v = this.overflow;
        let spent = this.spent;
        let done = this.done;
        // Flags and counts live in variables of this function; keep() writes them back for whoever is asked something.
        try {
            while (spent < this.limit) {
                const place = pc - FLASH;
                const op = place >= 0 && place < chip.window ? flash16[place >> 1] : chip.fetch(pc);
                let next = pc + 2;
                let a;
                let b;
                let s;
                done++;
                spent++;
                switch (op >>> 11) {
                    case 0: // LSLS immediate, MOVS register
                        a = r[(op >> 3) & 7];
                        b = (op >> 6) & 31;
                        if (b !== 0) {
                            c = (a >>> (32 - b)) & 1;
                        }
                        r[op & 7] = nz = a << b;
                        break;
                    case 1: // LSRS immediate
                        a = r[(op >> 3) & 7];
                        b = (op >> 6) & 31;
                        c = (a >>> (b === 0 ? 31 : b - 1)) & 1;
                        r[op & 7] = nz = b === 0 ? 0 : (a >>> b) | 0;
                        break;
                    case 2: // ASRS immediate
                        a = r[(op >> 3) & 7];
                        b = (op >> 6) & 31;
                        c = (a >> (b === 0 ? 31 : b - 1)) & 1;
                        r[op & 7] = nz = a >> (b === 0 ? 31 : b);
                        break;
                    case 3: // ADDS, SUBS: register or three bits
                        a = r[(op >> 3) & 7];
                        b = op & 0x400 ? (op >> 6) & 7 : r[(op >> 6) & 7];
                        if (op & 0x200) {
                            s = (a - b) | 0;
                            v = ((a ^ b) & (a ^ s)) >>> 31;
                            c = ((a & ~b) | ((a | ~b) & ~s)) >>> 31;
                        } else {
                            s = (a + b) | 0;
                            v = ((a ^ s) & (b ^ s)) >>> 31;
                            c = ((a & b) | ((a | b) & ~s)) >>> 31;
                        }
                        r[op & 7] = nz = s;
                        break;
                    case 4: // MOVS
                        r[(op >> 8) & 7] = nz = op & 0xff;
                        break;
                    case 5: // CMP
                        a = r[(op >> 8) & 7];
                        b = op & 0xff;
                        s = (a - b) | 0;
                        v = ((a ^ b) & (a ^ s)) >>> 31;
                        c = ((a & ~b) | ((a | ~b) & ~s)) >>> 31;
                        nz = s;
                        break;
                    case 6: // ADDS
                        a = r[(op >> 8) & 7];
                        b = op & 0xff;
                        s = (a + b) | 0;
                        v = ((a ^ s) & (b ^ s)) >>> 31;
                        c = ((a & b) | ((a | b) & ~s)) >>> 31;
                        r[(op >> 8) & 7] = nz = s;
                        break;
                    case 7: // SUBS
                        a = r[(op >> 8) & 7];
                        b = op & 0xff;
                        s = (a - b) | 0;
                        v = ((a ^ b) & (a ^ s)) >>> 31;
                        c = ((a & ~b) | ((a | ~b) & ~s)) >>> 31;
                        r[(op >> 8) & 7] = nz = s;
                        break;
                    case 8:
                        if (op < 0x4400) {
                            // Data processing
                            const d = op & 7;
                            a = r[d];
                            b = r[(op >> 3) & 7];
                            switch ((op >> 6) & 15) {
                                case 0: // ANDS
                                    r[d] = nz = a & b;
                                    break;
                                case 1: // EORS
                                    r[d] = nz = a ^ b;
                                    break;
                                case 2: // LSLS
                                    b &= 0xff;
                                    if (b !== 0) {
                                        c = b <= 32 ? (a >>> (32 - b)) & 1 : 0;
                                        a = b < 32 ? a << b : 0;
                                    }
                                    r[d] = nz = a;
                                    break;
                                case 3: // LSRS
                                    b &= 0xff;
                                    if (b !== 0) {
                                        c = b <= 32 ? (a >>> (b - 1)) & 1 : 0;
                                        a = b < 32 ? (a >>> b) | 0 : 0;
                                    }
                                    r[d] = nz = a;
                                    break;
                                case 4: // ASRS
                                    b &= 0xff;
                                    if (b !== 0) {
                                        c = (a >> Math.min(b - 1, 31)) & 1;
                                        a >>= Math.min(b, 31);
                                    }
                                    r[d] = nz = a;
                                    break;
                                case 5: // ADCS
                                    s = (a + b + c) | 0;
                                    v = ((a ^ s) & (b ^ s)) >>> 31;
                                    c = ((a & b) | ((a | b) & ~s)) >>> 31;
                                    r[d] = nz = s;
                                    break;
                                case 6: // SBCS
                                    s = (a - b - 1 + c) | 0;
                                    v = ((a ^ b) & (a ^ s)) >>> 31;
                                    c = ((a & ~b) | ((a | ~b) & ~s)) >>> 31;
                                    r[d] = nz = s;
                                    break;
                                case 7: // RORS
                                    b &= 0xff;
                                    if (b !== 0) {
                                        b &= 31;
                                        a = b === 0 ? a : (a >>> b) | (a << (32 - b));
                                        c = a >>> 31;
                                    }
                                    r[d] = nz = a;
                                    break;
                                case 8: // TST
                                    nz = a & b;
                                    break;
                                case 9: // RSBS
                                    s = -b | 0;
                                    v = (b & s) >>> 31;
                                    c = b === 0 ? 1 : 0;
                                    r[d] = nz = s;
                                    break;
                                case 10: // CMP
                                    s = (a - b) | 0;
                                    v = ((a ^ b) & (a ^ s)) >>> 31;
                                    c = ((a & ~b) | ((a | ~b) & ~s)) >>> 31;
                                    nz = s;
                                    break;
                                case 11: // CMN
                                    s = (a + b) | 0;
                                    v = ((a ^ s) & (b ^ s)) >>> 31;
                                    c = ((a & b) | ((a | b) & ~s)) >>> 31;
                                    nz = s;
                                    break;
                                case 12: // ORRS
                                    r[d] = nz = a | b;
                                    break;
                                case 13: // MULS
                                    r[d] = nz = Math.imul(a, b);
                                    break;
                                case 14: // BICS
                                    r[d] = nz = a & ~b;
                                    break;
                                default: // MVNS
                                    r[d] = nz = ~b;
                                    break;
                            }
                        } else {
                            // High registers
                            const d = ((op >> 4) & 8) | (op & 7);
                            const m = (op >> 3) & 15;
                            r[15] = pc + 4;
                            a = r[d];
                            b = r[m];
                            switch ((op >> 8) & 3) {
                                case 0: // ADD
                                case 2: // MOV
                                    s = op & 0x200 ? b : (a + b) | 0;
                                    if (d === 15) {
                                        next = s & ~1;
                                        spent += 1 & extra;
                                    } else {
                                        r[d] = d === 13 ? s & ~3 : s;
                                    }
                                    break;
                                case 1: // CMP
                                    s = (a - b) | 0;
                                    v = ((a ^ b) & (a ^ s)) >>> 31;
                                    c = ((a & ~b) | ((a | ~b) & ~s)) >>> 31;
                                    nz = s;
                                    break;
                                default: // BX, BLX
                                    spent += 1 & extra;
                                    if (op & 0x80) {
                                        r[14] = (pc + 2) | 1;
                                    } else if (b >>> 28 === 15 && this.IPSR !== 0) {
                                        this.keep(nz, c, v, spent, done);
                                        this.exceptionReturn(b & 0x0fffffff);
                                        nz = this.nz;
                                        c = this.carry;
                                        v = this.overflow;
                                        spent += ENTRY_CYCLES & extra;
                                        next = r[15] & ~1;
                                        break;
                                    }
                                    next = b & ~1;
                                    if (!(b & 1)) {
                                        pc = next;
                                        throw new Fault('no Thumb bit', b);
                                    }
                                    break;
                            }
                        }
                        break;
                    case 9: // LDR literal
                        spent += 1 & extra;
                        this.spent = spent;
                        this.done = done;
                        r[(op >> 8) & 7] = chip.readUint32(((pc + 4) & ~3) + ((op & 0xff) << 2));
                        break;
                    case 10:
                    case 11: // loads and stores by register
                        a = (r[(op >> 3) & 7] + r[(op >> 6) & 7]) | 0;
                        b = op & 7;
                        spent += (a >>> 28 === APB ? 4 : a >>> 28 === SIO ? 0 : 1) & extra;
                        this.spent = spent;
                        this.done = done;
                        switch ((op >> 9) & 7) {
                            case 0:
                                chip.writeUint32(a, r[b]);
                                break;
                            case 1:
                                chip.writeUint16(a, r[b] & 0xffff);
                                break;
                            case 2:
                                chip.writeUint8(a, r[b] & 0xff);
                                break;
                            case 3:
                                r[b] = (chip.readUint8(a) << 24) >> 24;
                                break;
                            case 4:
                                r[b] = chip.readUint32(a);
                                break;
                            case 5:
                                r[b] = chip.readUint16(a);
                                break;
                            case 6:
                                r[b] = chip.readUint8(a);
                                break;
                            default:
                                r[b] = (chip.readUint16(a) << 16) >> 16;
                                break;
                        }
                        break;
                    case 12: // STR
                        a = (r[(op >> 3) & 7] + ((op >> 4) & 0x7c)) | 0;
                        spent += (a >>> 28 === APB ? 4 : a >>> 28 === SIO ? 0 : 1) & extra;
                        this.spent = spent;
                        this.done = done;
                        chip.writeUint32(a, r[op & 7]);
                        break;
                    case 13: // LDR
                        a = (r[(op >> 3) & 7] + ((op >> 4) & 0x7c)) | 0;
                        spent += (a >>> 28 === APB ? 4 : a >>> 28 === SIO ? 0 : 1) & extra;
                        this.spent = spent;
                        this.done = done;
                        r[op & 7] = chip.readUint32(a);
                        break;
                    case 14: // STRB
                        a = (r[(op >> 3) & 7] + ((op >> 6) & 31)) | 0;
                        spent += (a >>> 28 === APB ? 4 : a >>> 28 === SIO ? 0 : 1) & extra;
                        this.spent = spent;
                        this.done = done;
                        chip.writeUint8(a, r[op & 7] & 0xff);
                        break;
                    case 15: // LDRB
                        a = (r[(op >> 3) & 7] + ((op >> 6) & 31)) | 0;
                        spent += (a >>> 28 === APB ? 4 : a >>> 28 === SIO ? 0 : 1) & extra;
                        this.spent = spent;
                        this.done = done;
                        r[op & 7] = chip.readUint8(a);
                        break;
                    case 16: // STRH
                        a = (r[(op >> 3) & 7] + ((op >> 5) & 0x3e)) | 0;
                        spent += (a >>> 28 === APB ? 4 : a >>> 28 === SIO ? 0 : 1) & extra;
                        this.spent = spent;
                        this.done = done;
                        chip.writeUint16(a, r[op & 7] & 0xffff);
                        break;
                    case 17: // LDRH
                        a = (r[(op >> 3) & 7] + ((op >> 5) & 0x3e)) | 0;
                        spent += (a >>> 28 === APB ? 4 : a >>> 28 === SIO ? 0 : 1) & extra;
                        this.spent = spent;
                        this.done = done;
                        r[op & 7] = chip.readUint16(a);
                        break;
                    case 18: // STR to the stack
                        spent += 1 & extra;
                        this.spent = spent;
                        this.done = done;
                        chip.writeUint32(r[13] + ((op & 0xff) << 2), r[(op >> 8) & 7]);
                        break;
                    case 19: // LDR from the stack
                        spent += 1 & extra;
                        this.spent = spent;
                        this.done = done;
                        r[(op >> 8) & 7] = chip.readUint32(r[13] + ((op & 0xff) << 2));
                        break;
                    case 20: // ADR
                        r[(op >> 8) & 7] = ((pc + 4) & ~3) + ((op & 0xff) << 2);
                        break;
                    case 21: // ADD rd, sp
                        r[(op >> 8) & 7] = r[13] + ((op & 0xff) << 2);
                        break;
                    case 22:
                        this.spent = spent;
                        this.done = done;
                        if (op < 0xb100) {
                            r[13] += op & 0x80 ? -((op & 0x7f) << 2) : (op & 0x7f) << 2;
                        } else if (op >= 0xb400 && op < 0xb600) {
                            spent += this.push(op & 0x1ff) & extra;
                        } else if (op >>> 8 === 0xb2) {
                            a = r[(op >> 3) & 7];
                            b = (op >> 6) & 3; // SXTH, SXTB, UXTH, UXTB
                            r[op & 7] =
                                b === 0 ? (a << 16) >> 16 : b === 1 ? (a << 24) >> 24 : b === 2 ? a & 0xffff : a & 0xff;
                        } else if (op === 0xb672) {
                            this.PM = true;
                        } else if (op === 0xb662) {
                            this.PM = false;
                            this.interruptsUpdated = true;
                        } else {
                            throw new Fault('undefined instruction', pc);
                        }
                        break;
                    case 23:
                        this.spent = spent;
                        this.done = done;
                        if (op >= 0xbc00 && op < 0xbe00) {
                            // POP
                            s = this.pop(op & 0xff);
                            spent += s & extra;
                            if (op & 0x100) {
                                spent += 2 & extra;
                                b = chip.readUint32(r[13]) | 0;
                                r[13] += 4;
                                if (b >>> 28 === 15 && this.IPSR !== 0) {
                                    this.keep(nz, c, v, spent, done);
                                    this.exceptionReturn(b & 0x0fffffff);
                                    nz = this.nz;
                                    c = this.carry;
                                    v = this.overflow;
                                    spent += ENTRY_CYCLES & extra;
                                    next = r[15] & ~1;
                                } else {
                                    next = b & ~1;
                                    if (!(b & 1)) {
                                        pc = next;
                                        throw new Fault('no Thumb bit', b);
                                    }
                                }
                            }
                        } else if (op >>> 8 === 0xba) {
                            a = r[(op >> 3) & 7];
                            b = (op >> 6) & 3;
                            if (b === 2) {
                                throw new Fault('undefined instruction', pc);
                            }
                            s = ((a >>> 8) & 0x00ff00ff) | ((a & 0x00ff00ff) << 8); // REV16
                            r[op & 7] = b === 1 ? s : b === 3 ? (s << 16) >> 16 : (s >>> 16) | (s << 16); // REVSH, REV
                        } else if (op >>> 8 === 0xbe) {
                            this.keep(nz, c, v, spent, done);
                            r[15] = next;
                            if (!chip.breakpoint(op & 0xff)) {
                                throw new Fault('breakpoint', pc);
                            }
                            spent = this.spent; // some take time
                            next = r[15] & ~1;
                        } else if (op >>> 8 === 0xbf && (op & 15) === 0) {
                            spent += (op === NOP ? 0 : 1) & extra;
                            this.hint((op >> 4) & 15);
                        } else {
                            throw new Fault('undefined instruction', pc);
                        }
                        break;
                    case 24: // STM
                        this.spent = spent;
                        this.done = done;
                        spent += this.storeMultiple((op >> 8) & 7, op & 0xff) & extra;
                        break;
                    case 25: // LDM
                        this.spent = spent;
                        this.done = done;
                        spent += this.loadMultiple((op >> 8) & 7, op & 0xff) & extra;
                        break;
                    case 26:
                    case 27: // B with a condition, SVC, UDF
                        switch ((op >> 8) & 15) {
                            case 0:
                                s = nz === 0;
                                break;
                            case 1:
                                s = nz !== 0;
                                break;
                            case 2:
                                s = c !== 0;
                                break;
                            case 3:
                                s = c === 0;
                                break;
                            case 4:
                                s = nz < 0;
                                break;
                            case 5:
                                s = nz >= 0;
                                break;
                            case 6:
                                s = v !== 0;
                                break;
                            case 7:
                                s = v === 0;
                                break;
                            case 8:
                                s = c !== 0 && nz !== 0;
                                break;
                            case 9:
                                s = c === 0 || nz === 0;
                                break;
                            case 10:
                                s = nz < 0 === (v !== 0);
                                break;
                            case 11:
                                s = nz < 0 !== (v !== 0);
                                break;
                            case 12:
                                s = nz !== 0 && nz < 0 === (v !== 0);
                                break;
                            case 13:
                                s = nz === 0 || nz < 0 !== (v !== 0);
                                break;
                            case 14:
                                throw new Fault('undefined instruction', pc);
                            default:
                                s = false;
                                this.pendingSVCall = true;
                                this.interruptsUpdated = true;
                                break;
                        }
                        if (s) {
                            next = pc + 4 + ((op << 24) >> 23);
                            spent += 1 & extra;
                        }
                        break;
                    case 28: // B
                        next = pc + 4 + ((op << 21) >> 20);
                        spent += 1 & extra;
                        break;
                    case 30: {
                        const low = chip.readUint16(pc + 2);
                        spent += 2 & extra;
                        if ((low & 0xd000) === 0xd000) {
                            // BL
                            const sign = (op >> 10) & 1;
                            const i1 = ~((low >> 13) ^ sign) & 1;
                            const i2 = ~((low >> 11) ^ sign) & 1;
                            const offset =
                                (-sign << 24) | (i1 << 23) | (i2 << 22) | ((op & 0x3ff) << 12) | ((low & 0x7ff) << 1);
                            r[14] = (pc + 4) | 1;
                            next = (pc + 4 + offset) | 0;
                        } else {
                            next = pc + 4;
                            this.keep(nz, c, v, spent, done);
                            this.special(op, low, pc);
                            nz = this.nz;
                            c = this.carry;
                            v = this.overflow;
                        }
                        break;
                    }
                    default: // 29 and 31
                        throw new Fault('undefined instruction', pc);
                }
                pc = next;
            }
            r[15] = pc;
            this.keep(nz, c, v, spent, done);
        } catch (problem) {
            this.keep(nz, c, v, spent, done);
            if (problem instanceof Fault) {
                this.chip.onFault(problem, pc);
                this.hardFault(pc);
            } else if (problem instanceof Violation) {
                problem.message += `, at pc ${hex(pc)}`;
                throw problem;
            } else {
                throw problem;
            }
        }
    }

    keep(nz, c, v, spent, done) {
        this.nz = nz;
        this.carry = c;
        this.overflow = v;
        this.spent = spent;
        this.done = done;
    }

    /** MSR, MRS and barriers. */
    special(op, low, pc) {
        if ((op & 0xfff0) === 0xf380 && (low & 0xff00) === 0x8800) {
            this.writeSpecialRegister(low & 0xff, this.registers[op & 15]);
        } else if (op === 0xf3ef && (low & 0xf000) === 0x8000) {
            this.registers[(low >> 8) & 15] = this.readSpecialRegister(low & 0xff);
        } else if (op !== 0xf3bf || (low & 0xff00) !== 0x8f00) {
            throw new Fault('undefined instruction', pc);
        }
    }

    /** NOP, YIELD, WFE, WFI, SEV. */
    hint(number) {
        if (number === 4) {
            this.eventRegistered = true;
        } else if (number === 2 && this.eventRegistered) {
            this.eventRegistered = false;
        } else if (number === 2 || number === 3) {
            this.waiting = true;
            this.interruptsUpdated = true;
        }
    }

    // Several registers; each returns how many they were.

    storeFrom(address, list) {
        let count = 0;
        for (let i = 0; i < 8; i++) {
            if (list & (1 << i)) {
                this.chip.writeUint32(address + 4 * count++, this.r[i]);
            }
        }
        return count;
    }

    loadFrom(address, list) {
        let count = 0;
        for (let i = 0; i < 8; i++) {
            if (list & (1 << i)) {
                this.r[i] = this.chip.readUint32(address + 4 * count++);
            }
        }
        return count;
    }

    push(list) {
        const { r } = this;
        let count = list >> 8;
        for (let i = 0; i < 8; i++) {
            count += (list >> i) & 1;
        }
        const bottom = r[13] - 4 * count;
        const low = this.storeFrom(bottom, list & 0xff);
        if (list & 0x100) {
            this.chip.writeUint32(bottom + 4 * low, r[14]);
        }
        r[13] = bottom;
        return count;
    }

    pop(list) {
        const count = this.loadFrom(this.r[13], list);
        this.r[13] += 4 * count;
        return count;
    }

    storeMultiple(base, list) {
        const count = this.storeFrom(this.r[base], list);
        this.r[base] += 4 * count;
        return count;
    }

    loadMultiple(base, list) {
        const address = this.r[base];
        const count = this.loadFrom(address, list);
        if (!(list & (1 << base))) {
            this.r[base] = address + 4 * count;
        }
        return count;
    }
}
