// What an image may ask of an emulator (Arm's semihosting): the end of the run, and how many instructions there have
// been.
import { Violation, hex } from './faults.mjs';

const WRITE0 = 0x04;
const EXIT = 0x18;
const EXIT_EXTENDED = 0x20;
const ELAPSED = 0x30;
const APPLICATION_EXIT = 0x20026;

/** The image has ended the run. */
export class End extends Error {
    constructor(status) {
        super(`status ${status}`);
        this.status = status;
    }
}

export function semihosting(chip) {
    const { registers } = chip.core;
    const argument = registers[1];
    switch (registers[0]) {
        case EXIT:
            throw new End(argument === APPLICATION_EXIT ? 0 : 1);
        case EXIT_EXTENDED:
            throw new End(chip.readUint32(argument) === APPLICATION_EXIT ? chip.readUint32(argument + 4) & 0xff : 1);
        case ELAPSED: {
            const { instructions } = chip.core;
            chip.writeUint32(argument, instructions >>> 0);
            chip.writeUint32(argument + 4, Math.floor(instructions / 2 ** 32));
            registers[0] = 0;
            break;
        }
        case WRITE0:
            for (let at = argument, byte; (byte = chip.readUint8(at)) !== 0; at++) {
                process.stderr.write(String.fromCharCode(byte));
            }
            break;
        default:
            throw new Violation(`semihosting call ${hex(registers[0])}`);
    }
}
