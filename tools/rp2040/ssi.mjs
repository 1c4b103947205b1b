// The serial interface of the flash (datasheet, 4.10) with the flash behind it, as far as a second stage of the boot
// and reading code need them: the commands that set the flash up, and whether an access to the address space of the
// flash (XIP) works with what has been set up.
import { BasePeripheral } from './library.mjs';
import { Violation, hex } from './faults.mjs';

const CTRLR0 = 0x00;
const CTRLR1 = 0x04;
const SSIENR = 0x08;
const SER = 0x10;
const BAUDR = 0x14;
const SR = 0x28;
const DR0 = 0x60;
const RX_SAMPLE_DLY = 0xf0;
const SPI_CTRLR0 = 0xf4;
const SR_TFNF = 1 << 1;
const SR_TFE = 1 << 2;
const SR_RFNE = 1 << 3;
const READ_EEPROM = 3;

export class Ssi extends BasePeripheral {
    constructor(chip) {
        super(chip, 'SSI');
        this.statusRegister2 = 0; // of the flash; kept without power, and as the maker delivers it
        this.restart();
    }

    restart() {
        this.registers = new Map([
            [CTRLR0, 0],
            [CTRLR1, 0],
            [SSIENR, 0],
            [SER, 0],
            [BAUDR, 0],
            [RX_SAMPLE_DLY, 0],
            [SPI_CTRLR0, 0],
        ]);
        this.continuous = false; // the flash waits for an address without an instruction
        this.stale = false; // the cache may hold what has been erased or programmed since
        this.writeEnabled = false;
        this.sent = []; // of the transaction under way
        this.got = [];
        this.update();
    }

    /**
     * As the boot ROM has it when it calls the second stage, or a function of the flash has ended: commands, no XIP.
     */
    enterCommandMode() {
        this.registers.set(SSIENR, 0);
        this.registers.set(SER, 1);
        this.continuous = false;
        this.update();
    }

    /** Slow reading with 03h, as the ROM's flash_enter_cmd_xip sets it up. */
    enterSlowReading() {
        this.registers.set(SSIENR, 1);
        this.registers.set(CTRLR0, (31 << 16) | (READ_EEPROM << 8));
        this.registers.set(SPI_CTRLR0, ((3 << 24) | (2 << 8) | (6 << 2)) >>> 0);
        this.update();
    }

    get(name) {
        return this.registers.get(name);
    }

    /** Whether an access by address gives what the flash holds. */
    get reads() {
        const control = this.get(CTRLR0);
        const spi = this.get(SPI_CTRLR0);
        if (
            this.get(SSIENR) !== 1 ||
            this.get(SER) !== 1 ||
            ((control >> 8) & 3) !== READ_EEPROM ||
            ((control >> 16) & 31) !== 31
        ) {
            return false;
        }
        const format = (control >> 21) & 3;
        const shape = [format, spi & 3, (spi >> 2) & 15, (spi >> 8) & 3, (spi >> 11) & 31].join();
        if (this.continuous) {
            // No instruction, 32 bits of address and mode on four wires, then four cycles: Fast Read Quad I/O goes on.
            return shape === '2,2,8,0,4' && ((spi >>> 28) & 15) === 0xa;
        }
        return shape === '0,0,6,2,0' && spi >>> 24 === 3;
    }

    update() {
        if (this.reads && this.stale) {
            throw new Violation('the flash has changed and its cache has not been flushed');
        }
        this.rp2040.setXip(this.reads);
    }

    // The chip select falls with the first byte and rises when the transmitter runs empty: somebody looks whether it
    // has.
    endTransaction() {
        const [command, value] = this.sent;
        if (command === 0x06) {
            this.writeEnabled = true;
        } else if (command === 0x31 || command === 0x01) {
            if (!this.writeEnabled) {
                throw new Violation('the status of the flash is written without a write enable');
            }
            this.statusRegister2 = command === 0x31 ? value : (this.sent[2] ?? 0);
            this.writeEnabled = false;
        }
        this.sent = [];
    }

    exchange(value) {
        this.sent.push(value & 0xff);
        const answers = { 0x05: 0, 0x35: this.statusRegister2, 0x06: 0, 0x31: 0, 0x01: 0 };
        const answer = answers[this.sent[0]];
        if (answer === undefined) {
            throw new Violation(`the flash is given the command ${hex(this.sent[0])}, which is not modelled`);
        }
        this.got.push(this.sent.length > 1 ? answer : 0xff);
    }

    // The first read by hand: an instruction, then address and mode.
    readByHand(value) {
        this.sent.push(value);
        if (this.sent.length < 2) {
            return;
        }
        const [command, address] = this.sent;
        if (command !== 0xeb || !(this.statusRegister2 & 2)) {
            throw new Violation(
                `the flash is read by ${hex(command)} with its quad mode ${this.statusRegister2 & 2 ? 'on' : 'off'}`,
            );
        }
        this.continuous = (address & 0xf0) === 0xa0;
        this.got.push(0);
        this.sent = [];
    }

    readUint32(offset) {
        switch (offset) {
            case SR:
                this.endTransaction();
                return SR_TFNF | SR_TFE | (this.got.length > 0 ? SR_RFNE : 0);
            case DR0:
                if (this.got.length === 0) {
                    throw new Violation('the flash is asked for a byte that it has not sent');
                }
                return this.got.shift();
            default:
                return this.registers.get(offset) ?? super.readUint32(offset);
        }
    }

    writeUint32(offset, value) {
        if (offset === DR0) {
            if (this.get(SSIENR) !== 1) {
                throw new Violation('the interface of the flash is given a byte while it is off');
            }
            if (((this.get(CTRLR0) >> 8) & 3) === READ_EEPROM) {
                this.readByHand(value >>> 0);
            } else {
                this.exchange(value);
            }
            return;
        }
        if (!this.registers.has(offset)) {
            super.writeUint32(offset, value);
            return;
        }
        if (this.get(SSIENR) === 1 && offset !== SSIENR && offset !== SER) {
            throw new Violation('the interface of the flash is set up while it is on');
        }
        this.registers.set(offset, value >>> 0);
        if (offset === SSIENR && value === 0) {
            this.sent = [];
            this.got = [];
        }
        this.update();
    }
}
