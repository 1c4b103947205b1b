// The two ways in which an access goes wrong: what the chip itself answers with HardFault, and what it does not answer
// at all or the emulator does not have.

/** A bus or usage fault: the processor takes HardFault. */
export class Fault {
    constructor(what, address) {
        this.what = what;
        this.address = address >>> 0;
    }
}

/**
 * What right firmware never does (a register of a block in reset, flash while XIP is off, …) or what is modelled
 * nowhere. Such a run proves nothing any more: it ends, and says why.
 */
export class Violation extends Error {}

export const hex = (value) => (value >>> 0).toString(16).padStart(8, '0');
