// Devices on the I2C bus. Each has an address; start(reading) acknowledges it or not, write(byte) acknowledges a byte,
// read() gives one, stop() ends it all.
import net from 'node:net';

const GENERIC_ADDRESS = 0x29;
const READ_HOLDING = 3;
const MAGIC_FAULT = 0x00ff;
const REQUEST_BYTES = 4;

/** CRC-16/MODBUS of lib/num/crc.h, bit by bit: it shares nothing with that one. */
function crc16(bytes) {
    let crc = 0xffff;
    for (const byte of bytes) {
        crc ^= byte;
        for (let i = 0; i < 8; i++) {
            crc = crc & 1 ? (crc >> 1) ^ 0xa001 : crc >> 1;
        }
    }
    return crc;
}

/** A Modbus TCP client with one read at a time: the registers as bytes, or null for an exception. */
class RegisterSource {
    constructor(host, port) {
        this.socket = net.createConnection({ host, port });
        this.socket.setNoDelay(true);
        this.got = Buffer.alloc(0);
        this.transaction = 0;
        this.answer = null;
        this.isClosed = false;
        this.socket.on('data', (data) => this.take(data));
        this.connected = new Promise((resolve, reject) => {
            this.socket.on('connect', resolve);
            this.socket.on('error', reject);
        });
        this.socket.on('close', () => {
            this.isClosed = true; // from now on the device does not acknowledge
            this.answer?.(null);
        });
    }

    take(data) {
        this.got = Buffer.concat([this.got, data]);
        if (this.got.length < 6 || this.got.length < 6 + this.got.readUInt16BE(4)) {
            return;
        }
        const pdu = this.got.subarray(7, 6 + this.got.readUInt16BE(4));
        this.got = this.got.subarray(7 + pdu.length);
        this.answer?.(pdu[0] === READ_HOLDING ? [...pdu.subarray(2, 2 + pdu[1])] : null);
        this.answer = null;
    }

    read(address, count) {
        if (this.isClosed) {
            return Promise.resolve(null);
        }
        const frame = Buffer.alloc(12);
        this.transaction = (this.transaction + 1) & 0xffff;
        frame.writeUInt16BE(this.transaction, 0);
        frame.writeUInt16BE(6, 4);
        frame[6] = 1;
        frame[7] = READ_HOLDING;
        frame.writeUInt16BE(address, 8);
        frame.writeUInt16BE(count, 10);
        this.socket.write(frame);
        return new Promise((resolve) => (this.answer = resolve));
    }
}

/**
 * The profile scanner of lib/scan/generic.h, as a register file on I2C. What it shows comes from canopy-scanner by
 * Modbus TCP: one program makes sweeps, with its faults and its record of what was served. The chip's time stands
 * still while the registers are fetched.
 */
export class Scanner {
    constructor(machine, wire, host, port) {
        this.machine = machine;
        this.wire = wire;
        this.source = new RegisterSource(host, port);
        this.address = GENERIC_ADDRESS;
        this.request = [];
        this.answer = null;
    }

    get ready() {
        return this.source.connected;
    }

    start(reading) {
        if (!reading) {
            this.request = [];
            this.answer = null;
            return true;
        }
        const isServed = this.request.length === REQUEST_BYTES && this.answer !== null;
        this.request = []; // it is answered once
        return isServed;
    }

    write(byte) {
        this.request.push(byte);
        if (this.request.length === REQUEST_BYTES) {
            this.fetch(...this.request);
        }
        return this.request.length <= REQUEST_BYTES;
    }

    fetch(high, low, count, tag) {
        if (count < 1 || count > 125) {
            return;
        }
        const pointer = (high << 8) | low;
        const head = [this.address << 1, high, low, count, tag, (this.address << 1) | 1];
        const arrived = this.source.read(pointer, count).then((registers) => {
            if (registers === null) {
                return;
            }
            if (this.wire.faults.magic && pointer === 0) {
                registers[1] ^= MAGIC_FAULT;
            }
            const crc = crc16([...head, ...registers]);
            this.answer = [...registers, crc & 0xff, crc >> 8];
        });
        this.machine.freeze(arrived);
    }

    read() {
        return this.answer?.shift() ?? 0xff;
    }

    stop() {}
}

/** Bytes behind a pointer of one or two bytes, high first; it goes on with each byte, and STOP keeps it. */
export class Memory {
    constructor(address, pointerBytes) {
        this.address = address;
        this.pointerBytes = pointerBytes;
        this.bytes = new Uint8Array(1 << (8 * pointerBytes));
        this.pointer = 0;
        this.given = 0;
    }

    start(reading) {
        this.given = reading ? this.pointerBytes : 0;
        return true;
    }

    write(byte) {
        if (this.given < this.pointerBytes) {
            this.pointer = ((this.given++ === 0 ? 0 : this.pointer << 8) | byte) & (this.bytes.length - 1);
        } else {
            this.bytes[this.next()] = byte;
        }
        return true;
    }

    read() {
        return this.bytes[this.next()];
    }

    next() {
        const at = this.pointer;
        this.pointer = (at + 1) & (this.bytes.length - 1);
        return at;
    }

    stop() {}
}
