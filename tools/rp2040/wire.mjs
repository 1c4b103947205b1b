// An I2C bus: two wires with pull-ups, pulled low by whoever wants to, the devices on it, and what can go wrong.
//
// The controller of the chip moves whole bytes (i2c.mjs); the wires themselves matter where somebody holds one, and
// where the firmware moves them as pins to free the bus.
const GPIO_LOW = 0; // rp2040js' GPIOPinState.Low
const NANOS = 1000;
const NOTED = 4096;

/** name[=value] of a fault: what it does is said in `node run.mjs --help`. */
const FAULTS = {
    absent: 'flag',
    'nak-byte': 'number',
    stretch: 'micros',
    'sda-low': 'number',
    'scl-low': 'micros',
    flip: 'number',
    magic: 'flag',
};

function parseValue(kind, text) {
    if (kind === 'flag') {
        return text === undefined ? true : NaN;
    }
    return text === 'forever' ? Infinity : text === undefined || text === '' ? NaN : Number(text);
}

export class Wire {
    constructor(chip, sdaPin, sclPin) {
        this.chip = chip;
        this.pins = { sda: chip.gpio[sdaPin], scl: chip.gpio[sclPin] };
        this.numbers = { sda: sdaPin, scl: sclPin };
        this.devices = new Map();
        this.controllers = [];
        this.faults = {};
        this.held = { sda: 0, scl: false }; // clocks that SDA stays low for; SCL low
        this.before = { sda: true, scl: true };
        this.release = chip.clock.createAlarm(() => this.hold({ scl: false }));
        this.selected = null;
        this.written = 0;
        this.readBytes = 0;
        this.recoveryClocks = 0;
        this.heard = []; // what a bus monitor notes; see note()
        this.isOpen = false; // between START and STOP
        for (const pin of Object.values(this.pins)) {
            pin.addListener(() => this.update());
        }
        this.update();
    }

    // ---- The wires

    get sda() {
        return this.held.sda === 0 && this.pins.sda.value !== GPIO_LOW;
    }

    get scl() {
        return !this.held.scl && this.stretchNanos !== Infinity && this.pins.scl.value !== GPIO_LOW;
    }

    /** True if a controller on these pins sees both wires high. */
    get isFree() {
        return this.sda && this.scl;
    }

    hold(what) {
        Object.assign(this.held, what);
        this.update();
    }

    /** After anything that may move a wire: its level reaches pins, devices and controllers. */
    update() {
        const { before } = this;
        const now = { sda: this.sda, scl: this.scl };
        if (now.sda === before.sda && now.scl === before.scl) {
            this.showLevels(now);
            return;
        }
        this.before = now;
        this.showLevels(now);
        if (now.scl && !before.scl) {
            this.clocked();
        }
        if (now.scl && before.scl && now.sda !== before.sda) {
            this.stop(); // a START or STOP by hand ends whatever a device was at
        }
        this.controllers.forEach((controller) => controller.linesMoved());
    }

    showLevels(now) {
        this.pins.sda.setInputValue(now.sda);
        this.pins.scl.setInputValue(now.scl);
    }

    // A device in the middle of a byte sends its next bit: after so many it lets SDA go.
    clocked() {
        this.recoveryClocks++;
        if (this.held.sda > 0) {
            this.held.sda--;
            this.update();
        }
    }

    // ---- Faults

    /** Sets a fault, `none` takes all back. Returns what is wrong with the text, or nothing. */
    setFault(text) {
        if (text === 'none') {
            this.faults = {};
            this.release.cancel();
            this.hold({ sda: 0, scl: false });
            this.controllers.forEach((controller) => controller.linesMoved());
            return '';
        }
        const [name, value] = text.split('=');
        const kind = FAULTS[name];
        const parsed = kind === undefined ? NaN : parseValue(kind, value);
        if (Number.isNaN(parsed)) {
            return `no fault '${text}': ${Object.keys(FAULTS).join(', ')}, none`;
        }
        this.faults[name] = parsed;
        if (name === 'sda-low') {
            this.hold({ sda: parsed });
        } else if (name === 'scl-low') {
            this.hold({ scl: true });
            if (parsed !== Infinity) {
                this.release.schedule(parsed * NANOS);
            }
        }
        return '';
    }

    // ---- Bytes, as a controller moves them

    /**
     * S START, R repeated START, both with address and r or w; w and r bytes; P STOP; ! behind what was not
     * acknowledged.
     */
    note(kind, byte, isAcknowledged = true) {
        const hex = byte === undefined ? '' : byte.toString(16).padStart(2, '0');
        this.heard.push(`${kind}${hex}${isAcknowledged ? '' : '!'}`);
        if (this.heard.length > 2 * NOTED) {
            this.heard = this.heard.slice(-NOTED);
        }
    }

    /** What was noted since the last of these, the last part of it. */
    takeHeard() {
        const heard = this.heard.slice(-NOTED);
        this.heard = [];
        return heard.join(' ');
    }

    /** The device of an address is asked: true if it answers. */
    select(address, reading) {
        this.selected?.stop();
        this.selected = this.faults.absent ? null : (this.devices.get(address) ?? null);
        this.written = 0;
        const answers = this.selected !== null && this.selected.start(reading);
        this.note(`${this.isOpen ? 'R' : 'S'}${reading ? 'r' : 'w'}`, address, answers);
        this.isOpen = true;
        return answers;
    }

    write(byte) {
        this.written++;
        const isTaken = this.written !== this.faults['nak-byte'] && this.selected.write(byte);
        this.note('w', byte, isTaken);
        return isTaken;
    }

    read() {
        this.readBytes++;
        const byte = this.selected === null ? 0xff : this.selected.read();
        const turned = this.faults.flip > 0 && this.readBytes % this.faults.flip === 0 ? 1 << (this.readBytes % 8) : 0;
        const seen = this.sda ? byte ^ turned : 0;
        this.note('r', seen);
        return seen;
    }

    stop() {
        if (this.isOpen) {
            this.note('P');
        }
        this.isOpen = false;
        this.selected?.stop();
        this.selected = null;
    }

    /** How long the device holds the clock after a byte, in nanoseconds. */
    get stretchNanos() {
        return this.selected !== null && this.faults.stretch > 0 ? this.faults.stretch * NANOS : 0;
    }
}
