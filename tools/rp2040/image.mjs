// What a build makes, as pieces of flash: ELF (by physical addresses) and UF2 (as it is dragged onto the board).
import { readFileSync } from 'node:fs';

export class BadImage extends Error {}

const FLASH = 0x10000000;
const RP2040_FAMILY = 0xe48bff56;

function* elfPieces(file) {
    if (file[4] !== 1 || file[5] !== 1 || file.readUInt16LE(18) !== 40) {
        throw new BadImage('no little-endian ELF file of 32 bits for Arm');
    }
    const table = file.readUInt32LE(28);
    const size = file.readUInt16LE(42);
    const count = file.readUInt16LE(44);
    for (let at = table; at < table + count * size; at += size) {
        const length = file.readUInt32LE(at + 16);
        if (file.readUInt32LE(at) === 1 && length > 0) {
            const start = file.readUInt32LE(at + 4);
            yield { address: file.readUInt32LE(at + 12), data: file.subarray(start, start + length) };
        }
    }
}

function* uf2Pieces(file) {
    const count = file.readUInt32LE(24);
    if (file.length !== 512 * count) {
        throw new BadImage(`${file.length} bytes, but ${count} blocks of 512`);
    }
    for (let at = 0, number = 0; at < file.length; at += 512, number++) {
        const word = (i) => file.readUInt32LE(at + 4 * i);
        if (word(0) !== 0x0a324655 || word(1) !== 0x9e5d5157 || file.readUInt32LE(at + 508) !== 0x0ab16f30) {
            throw new BadImage(`block ${number} is none of UF2`);
        }
        if (!(word(2) & 0x2000) || word(7) !== RP2040_FAMILY) {
            throw new BadImage(`block ${number} is not for the RP2040: the chip ignores it`);
        }
        if (word(4) !== 256 || word(3) % 256 !== 0 || word(5) !== number || word(6) !== count) {
            throw new BadImage(`block ${number} has not 256 bytes for a page of flash, or a wrong number`);
        }
        yield { address: word(3), data: file.subarray(at + 32, at + 32 + 256) };
    }
}

/** Reads `path` into flash; throws BadImage for what the chip would not take. */
export function loadImage(path, flash) {
    const file = readFileSync(path);
    const magic = file.length >= 512 ? file.readUInt32LE(0) : 0;
    if (magic !== 0x464c457f && magic !== 0x0a324655) {
        throw new BadImage('neither ELF nor UF2');
    }
    for (const { address, data } of magic === 0x464c457f ? elfPieces(file) : uf2Pieces(file)) {
        const offset = address - FLASH;
        if (offset < 0 || offset + data.length > flash.bytes) {
            throw new BadImage(
                `${data.length} bytes at ${address.toString(16)} are not in ${flash.bytes} bytes of flash`,
            );
        }
        flash.memory.set(data, offset);
    }
}
