// A UART (datasheet, 4.2: Arm's PL011): FIFOs of 32 or single registers, levels, receive timeout, overrun, BUSY; each
// byte takes its time on the wire, in both directions. Bytes leave and come only where a pin has the UART's function.
import { BasePeripheral } from './library.mjs';
import { Violation } from './faults.mjs';

const DR = 0x00;
const RSR = 0x04;
const FR = 0x18;
const IBRD = 0x24;
const FBRD = 0x28;
const LCR_H = 0x2c;
const CR = 0x30;
const IFLS = 0x34;
const IMSC = 0x38;
const RIS = 0x3c;
const MIS = 0x40;
const ICR = 0x44;
const DMACR = 0x48;

const FR_BUSY = 1 << 3;
const FR_RXFE = 1 << 4;
const FR_TXFF = 1 << 5;
const FR_RXFF = 1 << 6;
const FR_TXFE = 1 << 7;
const LCR_PEN = 1 << 1;
const LCR_STP2 = 1 << 3;
const LCR_FEN = 1 << 4;
const CR_ENABLE = 1 << 0;
const CR_TXE = 1 << 8;
const CR_RXE = 1 << 9;
const INT_RX = 1 << 4;
const INT_TX = 1 << 5;
const INT_RT = 1 << 6;
const INT_OE = 1 << 10;
const DR_OVERRUN = 1 << 11;
const LEVELS = [4, 8, 16, 24, 28]; // of 32
const FUNCTION = 2;

export class Uart extends BasePeripheral {
    /** `number` 0 or 1; `name` for messages. */
    constructor(chip, number, irq) {
        super(chip, `UART${number}`);
        this.irq = irq;
        // 2.19.2: each UART's transmitters stand on every 16th pin from here, and from 12 on; receivers beside them.
        const first = number === 0 ? [0, 12, 16, 28] : [4, 8, 20, 24];
        this.sendPins = first;
        this.receivePins = first.map((pin) => pin + 1);
        this.onSent = () => {}; // a byte has left, its last stop bit included
        this.onWire = () => {}; // true: a byte begins; false: the wire has become idle
        this.sendAlarm = chip.clock.createAlarm(() => this.sent());
        this.receiveAlarm = chip.clock.createAlarm(() => this.received());
        this.timeoutAlarm = chip.clock.createAlarm(() => this.silent());
        this.arriving = []; // on their way over the wire
        this.lost = 0;
        this.restart();
    }

    restart() {
        this.sendAlarm.cancel();
        this.timeoutAlarm.cancel();
        this.out = [];
        this.shifting = -1;
        this.sends = false;
        this.in = [];
        this.overrun = false;
        this.ibrd = this.fbrd = this.lcr = this.mask = this.raw = 0;
        this.cr = CR_TXE | CR_RXE;
        this.ifls = 0x12;
        this.checkInterrupts();
    }

    /** The clock of the peripherals has changed: later bytes take another time. */
    clkPeriChanged() {}

    get depth() {
        return this.lcr & LCR_FEN ? 32 : 1;
    }

    get bitNanos() {
        const divisor = this.ibrd + this.fbrd / 64;
        return divisor >= 1 && this.rp2040.clkPeri > 0 ? (16 * divisor * 1e9) / this.rp2040.clkPeri : 0;
    }

    get byteNanos() {
        const data = 5 + ((this.lcr >> 5) & 3);
        return this.bitNanos * (1 + data + (this.lcr & LCR_PEN ? 1 : 0) + (this.lcr & LCR_STP2 ? 2 : 1));
    }

    checkInterrupts() {
        this.rp2040.setInterrupt(this.irq, (this.raw & this.mask) !== 0);
    }

    raise(bit) {
        this.raw |= bit;
        this.checkInterrupts();
    }

    // ---- Sending

    write(byte) {
        if (!(this.cr & CR_ENABLE) || !(this.cr & CR_TXE) || this.bitNanos === 0) {
            throw new Violation(`${this.name} is given a byte while it, its clock or its baud rate is off`);
        }
        if (this.out.length >= this.depth) {
            throw new Violation(`${this.name} is given a byte while it is full`);
        }
        this.out.push(byte);
        this.raw &= this.out.length > this.sendLevel ? ~INT_TX : ~0;
        this.shiftNext();
        this.checkInterrupts();
    }

    get sendLevel() {
        return this.lcr & LCR_FEN ? LEVELS[this.ifls & 7] : 0;
    }

    shiftNext() {
        if (this.shifting >= 0 || this.out.length === 0) {
            return;
        }
        this.shifting = this.out.shift();
        if (this.out.length === this.sendLevel || (this.out.length === 0 && this.depth === 1)) {
            this.raw |= INT_TX;
        }
        if (!this.sends) {
            this.sends = true;
            this.onWire(true);
        }
        this.sendAlarm.schedule(this.byteNanos);
    }

    sent() {
        const byte = this.shifting;
        this.shifting = -1;
        this.shiftNext();
        if (this.shifting < 0) {
            this.sends = false;
            this.onWire(false);
        }
        if (!this.sendPins.some((pin) => this.rp2040.pinHas(pin, FUNCTION))) {
            throw new Violation(`${this.name} sends and no pin has its function`);
        }
        this.onSent(byte);
        this.checkInterrupts();
    }

    // ---- Receiving

    /** Bytes come over the wire, behind those that are still coming. */
    feed(bytes) {
        this.arriving.push(...bytes);
        if (!this.receiveAlarm.scheduled) {
            this.expect();
        }
    }

    // A receiver without baud rate hears nothing: what comes at the usual one is lost.
    expect() {
        if (this.arriving.length > 0) {
            this.receiveAlarm.schedule(this.byteNanos || 86806);
        }
    }

    received() {
        const byte = this.arriving.shift();
        this.expect();
        const listens = (this.cr & CR_ENABLE) !== 0 && (this.cr & CR_RXE) !== 0 && this.bitNanos > 0;
        if (!listens || !this.receivePins.some((pin) => this.rp2040.pinHears(pin, FUNCTION))) {
            this.lost++;
            return;
        }
        if (this.in.length >= this.depth) {
            this.overrun = true;
            this.lost++;
            this.raise(INT_OE);
            return;
        }
        this.in.push(byte | (this.overrun ? DR_OVERRUN : 0));
        this.overrun = false;
        this.timeoutAlarm.cancel();
        if (this.in.length >= (this.lcr & LCR_FEN ? LEVELS[(this.ifls >> 3) & 7] : 1)) {
            this.raise(INT_RX);
        }
        if (this.lcr & LCR_FEN) {
            this.timeoutAlarm.schedule(32 * this.bitNanos);
        }
    }

    silent() {
        this.raise(INT_RT);
    }

    take() {
        const value = this.in.shift() ?? 0;
        if (this.in.length < (this.lcr & LCR_FEN ? LEVELS[(this.ifls >> 3) & 7] : 1)) {
            this.raw &= ~INT_RX;
        }
        if (this.in.length === 0) {
            this.raw &= ~INT_RT;
            this.timeoutAlarm.cancel();
        }
        this.checkInterrupts();
        return value;
    }

    // ---- Registers

    get flags() {
        return (
            (this.shifting >= 0 || this.out.length > 0 ? FR_BUSY : 0) |
            (this.in.length === 0 ? FR_RXFE : 0) |
            (this.out.length >= this.depth ? FR_TXFF : 0) |
            (this.in.length >= this.depth ? FR_RXFF : 0) |
            (this.out.length === 0 ? FR_TXFE : 0)
        );
    }

    readUint32(offset) {
        switch (offset) {
            case DR:
                return this.take();
            case RSR:
                return this.overrun ? 8 : 0;
            case FR:
                return this.flags;
            case IBRD:
                return this.ibrd;
            case FBRD:
                return this.fbrd;
            case LCR_H:
                return this.lcr;
            case CR:
                return this.cr;
            case IFLS:
                return this.ifls;
            case IMSC:
                return this.mask;
            case RIS:
                return this.raw;
            case MIS:
                return this.raw & this.mask;
            case ICR:
            case DMACR:
                return 0;
            default:
                return super.readUint32(offset);
        }
    }

    writeUint32(offset, value) {
        switch (offset) {
            case DR:
                this.write(value & 0xff);
                break;
            case RSR:
                this.overrun = false;
                break;
            case IBRD:
                this.ibrd = value & 0xffff;
                break;
            case FBRD:
                this.fbrd = value & 0x3f;
                break;
            case LCR_H:
                this.changeFormat(value & 0xff);
                break;
            case CR:
                this.cr = value & 0xffff;
                break;
            case IFLS:
                this.ifls = value & 0x3f;
                break;
            case IMSC:
                this.mask = value & 0x7ff;
                this.checkInterrupts();
                break;
            case ICR: // writing ones clears, hence the value as it was written
                this.raw &= ~this.rawWriteValue;
                this.checkInterrupts();
                break;
            case DMACR:
                if (value !== 0) {
                    throw new Violation(`${this.name} is to use DMA, which is not modelled for it`);
                }
                break;
            default:
                super.writeUint32(offset, value);
        }
    }

    changeFormat(value) {
        if (this.cr & CR_ENABLE && this.flags & FR_BUSY) {
            throw new Violation(`the format of ${this.name} is changed while it sends`);
        }
        if (!(value & LCR_FEN)) {
            this.in.length = Math.min(this.in.length, 1);
        }
        this.lcr = value;
    }
}
