// An RP2040 in software: runs an image of boards/rp2040_pico. `node run.mjs --help` says how.
import { parseArgs } from 'node:util';

import { Question } from './ask.mjs';
import { Memory, Scanner } from './devices.mjs';
import { Fault, Violation, hex } from './faults.mjs';
import { PowerCut } from './flash.mjs';
import { BadImage, loadImage } from './image.mjs';
import { Machine, TooLong } from './machine.mjs';
import { Monitor } from './monitor.mjs';
import { NoBoot } from './rom.mjs';
import { openEnd } from './serial.mjs';
import { Trace } from './trace.mjs';
import { Wire } from './wire.mjs';

const HELP = `Usage: node run.mjs IMAGE.elf|IMAGE.uf2 [options]

Runs an image on an emulated RP2040 (rp2040js and what this directory adds) from the boot ROM on. The image ends the run
by semihosting; its status is ours.

  --serial S           three times: line 0 (UART 0), line 1 (UART 1), console (UART 1 as well: its bytes go to both).
                       null, stdio, file:PATH, pty, unix:PATH,server=on,wait=on or unix:PATH,server=off. With a pty or
                       a socket the run keeps real time; without it runs as fast as it can, and always the same
  --count              one processor clock an instruction: canopy_board_instructions() is exact
  --scanner HOST:PORT  a profile scanner at 29h of the I2C bus, which shows what canopy-scanner --tcp serves there
  --memory ADDRESS     a memory with a pointer of one byte at this address of the bus
  --fault NAME[=VALUE] on the bus, from the start: absent, nak-byte=K (the Kth byte written), stretch=US|forever (each
                       byte), sda-low=CLOCKS|forever, scl-low=US|forever, flip=N (a bit of each Nth byte read), magic
                       (of another kind of scanner)
  --flash FILE         what the flash keeps; the image is loaded over it, and it is written back at the end
  --keep               do not load the image over --flash FILE where that exists
  --power-cut-after N  the power fails after N bytes erased or programmed: status 4
  --ask LINE:HEX       asks that on line 0 or 1 as soon as it listens, prints instructions and microseconds from the
                       reset to the answer's first byte, and ends
  --trace FILE         writes what happens on pins and wires
  --monitor S          orders over unix:PATH,server=on,wait=off; see monitor.mjs
  --limit SECONDS      of the chip's time: more is an error

Exit status: the image's; 2 bad input, 3 the image does what it must not or does not end, 4 the power failed, 64 usage.
`;

const OPTIONS = {
    serial: { type: 'string', multiple: true, default: [] },
    count: { type: 'boolean', default: false },
    scanner: { type: 'string' },
    memory: { type: 'string', multiple: true, default: [] },
    fault: { type: 'string', multiple: true, default: [] },
    flash: { type: 'string' },
    keep: { type: 'boolean', default: false },
    'power-cut-after': { type: 'string' },
    ask: { type: 'string' },
    trace: { type: 'string' },
    monitor: { type: 'string', default: 'none' },
    limit: { type: 'string' },
    help: { type: 'boolean', default: false },
};

const SDA_PIN = 4; // boards/rp2040_pico/board.h
const SCL_PIN = 5;

class Usage extends Error {}
class BadInput extends Error {}

function readArguments() {
    try {
        const { values, positionals } = parseArgs({ options: OPTIONS, allowPositionals: true });
        if (values.help) {
            process.stdout.write(HELP);
            process.exit(0);
        }
        if (positionals.length !== 1) {
            throw new Usage('give one image');
        }
        return { ...values, image: positionals[0] };
    } catch (problem) {
        throw new Usage(problem.message);
    }
}

function number(text, name, least = 0) {
    const value = Number(text);
    if (!Number.isInteger(value) || value < least) {
        throw new Usage(`--${name} ${text}: a whole number from ${least} is wanted`);
    }
    return value;
}

function endOf(text, name, label) {
    const end = openEnd(text, label);
    if (end === null) {
        throw new Usage(`--${name} ${text}: null, stdio, pty, file:PATH or unix:PATH,server=on,wait=on`);
    }
    return end;
}

function layBus(machine, options) {
    const wire = new Wire(machine.chip, SDA_PIN, SCL_PIN);
    const controller = machine.chip.i2c[0];
    controller.wire = wire;
    wire.controllers.push(controller);
    for (const text of options.memory) {
        const address = number(text, 'memory', 8);
        wire.devices.set(address, new Memory(address, 1));
    }
    for (const text of options.fault) {
        const wrong = wire.setFault(text);
        if (wrong !== '') {
            throw new Usage(`--fault: ${wrong}`);
        }
    }
    return wire;
}

async function connectScanner(machine, wire, text) {
    const [, host, port] = text.match(/^(.+):(\d+)$/) ?? [];
    if (host === undefined) {
        throw new Usage(`--scanner ${text}: HOST:PORT is wanted`);
    }
    const scanner = new Scanner(machine, wire, host, Number(port));
    await scanner.ready.catch((problem) => {
        throw new BadInput(`--scanner ${text}: ${problem.message}: start canopy-scanner --tcp there first`);
    });
    wire.devices.set(scanner.address, scanner);
}

function ask(machine, text) {
    const [, line, digits] = text.match(/^([01]):((?:[0-9a-fA-F]{2})+)$/) ?? [];
    if (line === undefined) {
        throw new Usage(`--ask ${text}: LINE:HEX is wanted, as 1:010300000002C40B`);
    }
    return new Question(machine, machine.chip.uart[line], Buffer.from(digits, 'hex'), (instructions, micros) => {
        process.stdout.write(`instructions ${instructions}\nmicroseconds ${micros}\n`);
        process.exit(0);
    });
}

function load(machine, options) {
    const { flash } = machine;
    const hasOld = options.flash !== undefined && flash.loadFile(options.flash);
    if (!hasOld || !options.keep) {
        try {
            loadImage(options.image, flash);
        } catch (problem) {
            throw new BadInput(`${options.image}: ${problem instanceof BadImage ? problem.message : problem.code}`);
        }
    }
    if (options.flash !== undefined) {
        process.on('exit', () => flash.saveFile(options.flash));
    }
}

async function main() {
    const options = readArguments();
    const serials = [...options.serial, 'null', 'null', 'null'].slice(0, Math.max(3, options.serial.length));
    if (serials.length > 3) {
        throw new Usage('--serial: there are three');
    }
    const ends = serials.map((text, i) => endOf(text, 'serial', `serial${i}`));
    const cutAfter = options['power-cut-after'];
    const machine = new Machine({
        counting: options.count,
        paced: ends.some((end) => end.isPeer),
        cutAfter: cutAfter === undefined ? Infinity : number(cutAfter, 'power-cut-after'),
    });
    machine.limitNanos = options.limit === undefined ? Infinity : number(options.limit, 'limit', 1) * 1e9;
    load(machine, options);
    const wire = layBus(machine, options);
    if (options.trace !== undefined) {
        new Trace(machine, options.trace);
    }
    if (options.monitor !== 'none') {
        await new Monitor(machine, wire, endOf(options.monitor, 'monitor')).start();
    }
    if (options.scanner !== undefined) {
        await connectScanner(machine, wire, options.scanner);
    }
    if (options.ask !== undefined) {
        ask(machine, options.ask);
    }
    const { uart } = machine.chip;
    await Promise.all([uart[0], uart[1], uart[1]].map((line, i) => machine.connect(line, ends[i])));
    return machine.run();
}

function statusOf(problem) {
    if (problem instanceof Usage) {
        return 64;
    }
    if (problem instanceof PowerCut) {
        return 4;
    }
    return problem instanceof BadInput ? 2 : 3;
}

// What is kept is written down, however a run ends.
['SIGTERM', 'SIGINT', 'SIGHUP'].forEach((signal) => process.on(signal, () => process.exit(1)));

try {
    process.exitCode = await main();
    process.exit();
} catch (problem) {
    const known = [Usage, BadInput, PowerCut, Violation, NoBoot, TooLong].some((kind) => problem instanceof kind);
    const text =
        problem instanceof Fault
            ? `${problem.what} (pc ${hex(problem.address)})`
            : known
              ? problem.message
              : problem.stack;
    process.stderr.write(`rp2040: ${text}\n`);
    process.exit(statusOf(problem));
}
