// What happens on the pins, for tests: lines "microseconds name value" in a file, with three decimals.
import { closeSync, openSync, writeSync } from 'node:fs';

const HIGH = 1; // rp2040js' GPIOPinState.High

export class Trace {
    constructor(machine, file) {
        this.file = openSync(file, 'w');
        this.lines = [];
        this.last = new Map();
        const { chip } = machine;
        const note = (name, value) => this.note(chip.clock.nanos, name, value);
        chip.gpio.forEach((pin, i) => pin.addListener((value) => note(`gpio${i}`, value === HIGH ? 1 : 0)));
        chip.uart.forEach((uart, i) => {
            uart.onWire = (busy) => note(`uart${i}`, busy ? 1 : 0);
        });
        const before = chip.onReset;
        chip.onReset = (what) => {
            before(what);
            note('reset', what);
        };
        process.on('exit', () => {
            this.flush();
            closeSync(this.file);
        });
    }

    note(nanos, name, value) {
        if (this.last.get(name) === value && name !== 'reset') {
            return;
        }
        this.last.set(name, value);
        this.lines.push(`${(nanos / 1000).toFixed(3)} ${name} ${value}\n`);
        if (this.lines.length > 1000) {
            this.flush();
        }
    }

    flush() {
        writeSync(this.file, this.lines.join(''));
        this.lines = [];
    }
}
