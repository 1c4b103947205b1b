// The flash chip: bytes that an erase sets to ones and programming can only clear. It may be a file, and its power may
// fail in the middle of an operation.
import { existsSync, readFileSync, writeFileSync } from 'node:fs';

export const SECTOR = 4096;
export const PAGE = 256;
const HALF = 0x5a;

/** The power has failed: the run ends here, and what is in the flash stays as it is. */
export class PowerCut extends Error {}

export class Flash {
    /** `bytes` is a power of two. `cutAfter`: bytes erased or programmed until the power fails. */
    constructor(memory, bytes, cutAfter = Infinity) {
        this.memory = memory.subarray(0, bytes);
        this.bytes = bytes;
        this.left = cutAfter;
        this.erases = 0;
        this.programs = 0;
        this.memory.fill(0xff);
    }

    /** Takes over what an earlier run has left; false where there is none. */
    loadFile(file) {
        const exists = existsSync(file);
        if (exists) {
            this.memory.set(readFileSync(file).subarray(0, this.bytes));
        }
        return exists;
    }

    saveFile(file) {
        writeFileSync(file, this.memory);
    }

    // Bytes change one after the other; that is how far an operation has come when the power fails, and half of the
    // next byte's bits.
    change(offset, length, of) {
        for (let i = offset; i < offset + length; i++) {
            if (this.left-- <= 0) {
                if (this.left === -1) {
                    this.memory[i] = of(i - offset, this.memory[i], HALF);
                }
                throw new PowerCut(`the power fails while the flash is written, at ${(0x10000000 + i).toString(16)}`);
            }
            this.memory[i] = of(i - offset, this.memory[i], 0xff);
        }
    }

    erase(offset, length) {
        this.erases++;
        this.change(offset, length, (i, old, bits) => old | bits);
    }

    program(offset, data) {
        this.programs++;
        this.change(offset, data.length, (i, old, bits) => old & (data[i] | ~bits));
    }
}
