// An I2C controller (datasheet, 4.3: DW_apb_i2c) as a master: its FIFOs, its states and how a transfer ends. It moves
// whole bytes in the time they take on the wire, waits as long as somebody holds the bus, and never wedges the
// emulator.
import { BasePeripheral } from './library.mjs';
import { Violation } from './faults.mjs';

const CON = 0x00;
const TAR = 0x04;
const SAR = 0x08;
const DATA_CMD = 0x10;
const SS_HCNT = 0x14;
const SS_LCNT = 0x18;
const FS_HCNT = 0x1c;
const FS_LCNT = 0x20;
const INTR_STAT = 0x2c;
const INTR_MASK = 0x30;
const RAW_INTR_STAT = 0x34;
const RX_TL = 0x38;
const TX_TL = 0x3c;
const CLR_INTR = 0x40;
const ENABLE = 0x6c;
const STATUS = 0x70;
const TXFLR = 0x74;
const RXFLR = 0x78;
const SDA_HOLD = 0x7c;
const TX_ABRT_SOURCE = 0x80;
const DMA_CR = 0x88;
const SDA_SETUP = 0x94;
const ENABLE_STATUS = 0x9c;
const FS_SPKLEN = 0xa0;

// Reading one of these clears that interrupt.
const CLEARS = new Map([
    [0x44, 0],
    [0x48, 1],
    [0x4c, 3],
    [0x50, 5],
    [0x54, 6],
    [0x58, 7],
    [0x5c, 8],
    [0x60, 9],
    [0x64, 10],
    [0x68, 11],
]);

const CON_MASTER = 1 << 0;
const CON_SLAVE_DISABLE = 1 << 6;
const CON_10_BITS = 1 << 4;
const CON_RESTART = 1 << 5;
const CMD_READ = 1 << 8;
const CMD_STOP = 1 << 9;
const CMD_RESTART = 1 << 10;
const FIRST_BYTE = 1 << 11;
const INT_RX_UNDER = 1 << 0;
const INT_RX_OVER = 1 << 1;
const INT_RX_FULL = 1 << 2;
const INT_TX_OVER = 1 << 3;
const INT_TX_EMPTY = 1 << 4;
const INT_TX_ABRT = 1 << 6;
const INT_ACTIVITY = 1 << 8;
const INT_STOP_DET = 1 << 9;
const INT_START_DET = 1 << 10;
const ABRT_7B_ADDR = 1 << 0;
const ABRT_TXDATA = 1 << 3;
const ABRT_GCALL = 1 << 4;
const ABRT_NO_RESTART = 1 << 10;
const ABRT_LOST = 1 << 12;
const ABRT_USER = 1 << 16;
const FIFO = 16;
const FUNCTION = 3;

const RESET_VALUES = [
    [CON, 0x65],
    [TAR, 0x55],
    [SAR, 0x55],
    [SS_HCNT, 0x28],
    [SS_LCNT, 0x2f],
    [FS_HCNT, 6],
    [FS_LCNT, 13],
    [INTR_MASK, 0x8ff],
    [RX_TL, 0],
    [TX_TL, 0],
    [SDA_HOLD, 1],
    [DMA_CR, 0],
    [SDA_SETUP, 0x64],
    [FS_SPKLEN, 7],
];
// These may be written while the block is on; all others only while it is off.
const ALWAYS = new Set([INTR_MASK, RX_TL, TX_TL, DMA_CR]);

export class I2c extends BasePeripheral {
    constructor(chip, number, irq) {
        super(chip, `I2C${number}`);
        this.irq = irq;
        this.wire = null; // set by whoever lays wires to its pins
        this.alarm = chip.clock.createAlarm(() => this.then());
        this.restart();
    }

    restart() {
        this.alarm.cancel();
        this.registers = new Map(RESET_VALUES);
        this.enabled = this.aborting = false;
        this.tx = [];
        this.rx = [];
        this.sticky = 0;
        this.abortSource = 0;
        this.idle();
        this.checkInterrupts();
    }

    idle() {
        this.state = 'idle';
        this.then = () => {};
        this.reading = false;
        this.fresh = false; // the address has just been acknowledged
    }

    get(name) {
        return this.registers.get(name);
    }

    // ---- Time and wires

    /** A bit on the wire: 4.3.14.1. */
    get bitNanos() {
        const fast = ((this.get(CON) >> 1) & 3) !== 1;
        const high = fast ? this.get(FS_HCNT) : this.get(SS_HCNT);
        const low = fast ? this.get(FS_LCNT) : this.get(SS_LCNT);
        return (high + this.get(FS_SPKLEN) + 7 + low + 1) * this.rp2040.clock.cycleNanos;
    }

    get isConnected() {
        const { wire, rp2040 } = this;
        return (
            wire !== null && rp2040.pinHears(wire.numbers.sda, FUNCTION) && rp2040.pinHears(wire.numbers.scl, FUNCTION)
        );
    }

    /** Goes on with `then` after so many bits and whatever the device holds the clock for, if ever it lets it go. */
    after(bits, state, then) {
        const hold = this.wire.stretchNanos;
        this.state = state;
        this.then = then;
        this.pause = bits * this.bitNanos + hold;
        this.alarm.cancel();
        if (hold !== Infinity && this.wire.scl) {
            this.alarm.schedule(this.pause);
        }
    }

    /** A wire has moved: what has waited for it goes on. */
    linesMoved() {
        if (this.state === 'waiting') {
            this.begin();
        } else if (this.state === 'stopping') {
            this.stop();
        } else if (this.state !== 'idle' && this.state !== 'holding') {
            if (!this.wire.scl) {
                this.alarm.cancel();
            } else if (!this.alarm.scheduled && this.wire.stretchNanos !== Infinity) {
                this.alarm.schedule(this.pause);
            }
        }
    }

    // ---- A transfer

    begin() {
        if (!this.enabled || this.tx.length === 0 || this.sticky & INT_TX_ABRT) {
            this.idle();
            return;
        }
        if (!this.isConnected || !this.wire.isFree) {
            this.state = 'waiting';
            return;
        }
        this.start();
    }

    start() {
        this.reading = (this.tx[0] & CMD_READ) !== 0;
        this.sticky |= INT_START_DET | INT_ACTIVITY;
        this.after(10, 'address', () => this.addressed());
    }

    addressed() {
        if (!this.wire.sda) {
            this.loseArbitration();
            return;
        }
        const address = this.get(TAR) & 0x7f;
        if (!this.wire.select(address, this.reading)) {
            this.abort(address === 0 ? ABRT_GCALL : ABRT_7B_ADDR);
            this.stop();
            return;
        }
        this.fresh = true;
        this.next();
    }

    next() {
        if (this.aborting || !this.enabled) {
            if (this.aborting) {
                this.abort(ABRT_USER);
            }
            this.stop();
            return;
        }
        if (this.tx.length === 0) {
            this.state = 'holding'; // SCL stays low until there is a command
            return;
        }
        const command = this.tx[0];
        const turns = ((command & CMD_READ) !== 0) !== this.reading;
        if (!this.fresh && (turns || command & CMD_RESTART)) {
            if (!(this.get(CON) & CON_RESTART)) {
                this.abort(ABRT_NO_RESTART);
                this.stop();
            } else {
                this.start();
            }
            return;
        }
        this.tx.shift();
        this.after(9, 'byte', command & CMD_READ ? () => this.byteRead(command) : () => this.byteWritten(command));
        this.checkInterrupts();
    }

    byteWritten(command) {
        if (!this.wire.sda) {
            this.loseArbitration();
            return;
        }
        this.fresh = false;
        if (!this.wire.write(command & 0xff)) {
            this.abort(ABRT_TXDATA);
            this.stop();
        } else {
            this.endByte(command);
        }
    }

    byteRead(command) {
        const byte = this.wire.read();
        if (this.rx.length >= FIFO) {
            this.sticky |= INT_RX_OVER;
        } else {
            this.rx.push(byte | (this.fresh ? FIRST_BYTE : 0));
        }
        this.fresh = false;
        this.endByte(command);
    }

    endByte(command) {
        if (command & CMD_STOP) {
            this.stop();
        } else {
            this.next();
        }
        this.checkInterrupts();
    }

    stop() {
        if (!this.wire.isFree) {
            this.state = 'stopping'; // SDA cannot rise
            this.alarm.cancel();
            this.checkInterrupts();
            return;
        }
        this.after(1, 'stop', () => {
            this.wire.stop();
            this.sticky |= INT_STOP_DET;
            this.aborting = false;
            this.idle();
            this.begin();
            this.checkInterrupts();
        });
        this.checkInterrupts();
    }

    abort(reason) {
        this.abortSource = reason | (this.tx.length << 23);
        this.tx = [];
        this.sticky |= INT_TX_ABRT;
    }

    loseArbitration() {
        this.abort(ABRT_LOST);
        this.wire.stop();
        this.idle();
        this.checkInterrupts();
    }

    // ---- Registers

    get rawInterrupts() {
        return (
            this.sticky |
            (this.rx.length > this.get(RX_TL) ? INT_RX_FULL : 0) |
            (this.enabled && this.tx.length <= this.get(TX_TL) ? INT_TX_EMPTY : 0)
        );
    }

    checkInterrupts() {
        this.rp2040.setInterrupt(this.irq, (this.rawInterrupts & this.get(INTR_MASK)) !== 0);
    }

    clear(bits) {
        const had = this.sticky & bits ? 1 : 0;
        this.sticky &= ~bits;
        if (bits & INT_TX_ABRT) {
            this.abortSource = 0;
        }
        this.checkInterrupts();
        return had;
    }

    get status() {
        const active = this.state !== 'idle' && this.state !== 'waiting';
        return (
            (active || this.state === 'waiting' ? 0x21 : 0) |
            (this.tx.length < FIFO ? 2 : 0) |
            (this.tx.length === 0 ? 4 : 0) |
            (this.rx.length > 0 ? 8 : 0) |
            (this.rx.length === FIFO ? 16 : 0)
        );
    }

    readUint32(offset) {
        if (CLEARS.has(offset)) {
            return this.clear(1 << CLEARS.get(offset));
        }
        switch (offset) {
            case DATA_CMD:
                return this.take();
            case INTR_STAT:
                return this.rawInterrupts & this.get(INTR_MASK);
            case RAW_INTR_STAT:
                return this.rawInterrupts;
            case CLR_INTR:
                return this.clear(~0);
            case ENABLE:
                return (this.enabled ? 1 : 0) | (this.aborting ? 2 : 0);
            case STATUS:
                return this.status;
            case TXFLR:
                return this.tx.length;
            case RXFLR:
                return this.rx.length;
            case TX_ABRT_SOURCE:
                return this.abortSource;
            case ENABLE_STATUS: // on until the transfer under way has ended
                return this.enabled || (this.state !== 'idle' && this.state !== 'waiting') ? 1 : 0;
            default:
                return this.registers.get(offset) ?? super.readUint32(offset);
        }
    }

    take() {
        if (this.rx.length === 0) {
            this.sticky |= INT_RX_UNDER;
            return 0;
        }
        const value = this.rx.shift();
        this.checkInterrupts();
        return value;
    }

    give(command) {
        if (!this.enabled) {
            throw new Violation(`${this.name} is given a command while it is off`);
        }
        if (this.sticky & INT_TX_ABRT) {
            return; // flushed until the abort is cleared
        }
        if (this.tx.length >= FIFO) {
            this.sticky |= INT_TX_OVER;
        } else {
            this.tx.push(command & 0x7ff);
            if (this.state === 'idle') {
                this.begin();
            } else if (this.state === 'holding') {
                this.next();
            }
        }
        this.checkInterrupts();
    }

    enable(value) {
        this.enabled = (value & 1) !== 0;
        if (!this.enabled) {
            this.tx = [];
            this.rx = [];
            if (this.state === 'waiting') {
                this.idle();
            }
        }
        if (value & 2 && this.state !== 'idle' && this.state !== 'waiting') {
            this.aborting = true;
        }
        if (this.state === 'holding') {
            this.next();
        }
        this.checkInterrupts();
    }

    configure(offset, value) {
        if (this.enabled && !ALWAYS.has(offset)) {
            throw new Violation(`register ${offset.toString(16)} of ${this.name} is written while it is on`);
        }
        if (offset === CON && (value & CON_10_BITS || !(value & CON_MASTER) || !(value & CON_SLAVE_DISABLE))) {
            throw new Violation(`${this.name} is to be no master with 7-bit addresses: nothing else is modelled`);
        }
        if (offset === FS_SPKLEN && value === 0) {
            throw new Violation(`${this.name} is given no spike suppression`);
        }
        this.registers.set(offset, value);
        this.checkInterrupts();
    }

    writeUint32(offset, value) {
        if (offset === DATA_CMD) {
            this.give(value);
        } else if (offset === ENABLE) {
            this.enable(value);
        } else if (this.registers.has(offset)) {
            this.configure(offset, value);
        } else {
            super.writeUint32(offset, value);
        }
    }
}
