// Orders to a running machine over a socket, with QEMU's prompt, so that a test need not know which emulator it talks
// to:
//
//     pmemsave ADDRESS LENGTH "FILE"   saves memory        fault NAME[=VALUE]   sets one (fault none: takes all back)
//     counters                         one line of JSON    quit
//     bus                              what was heard on the I2C bus since the last of these (wire.mjs, note)
//     write ADDRESS HALFWORD           jump ADDRESS: the next instruction comes from there (to see how a crash ends)
import { writeFileSync } from 'node:fs';

const PROMPT = '(qemu) ';

export class Monitor {
    constructor(machine, wire, end) {
        this.machine = machine;
        this.wire = wire;
        this.end = end;
        this.text = '';
    }

    async start() {
        await this.end.start((data) => this.take(data.toString()));
        this.end.server.on('connection', () => setImmediate(() => this.say('')));
    }

    say(text) {
        this.end.send(Buffer.from(`${text}${text ? '\n' : ''}${PROMPT}`));
    }

    take(text) {
        this.text += text;
        for (let end; (end = this.text.indexOf('\n')) >= 0;) {
            const line = this.text.slice(0, end).trim();
            this.text = this.text.slice(end + 1);
            this.say(this.obey(line));
        }
        this.machine.wake();
    }

    obey(line) {
        const [order, ...words] = line.split(' ');
        const { chip } = this.machine;
        switch (order) {
            case 'pmemsave':
                return this.save(
                    Number(words[0]),
                    Number(words[1]),
                    line.slice(line.indexOf('"') + 1, line.lastIndexOf('"')),
                );
            case 'fault':
                return this.setFault(words[0] ?? '');
            case 'write':
                chip.writeUint16(Number(words[0]), Number(words[1]));
                return '';
            case 'jump':
                chip.core.PC = Number(words[0]);
                chip.core.waiting = false;
                return '';
            case 'counters':
                return JSON.stringify(this.counters);
            case 'bus':
                return this.wire.takeHeard();
            case 'quit':
                process.exit(0);
                return '';
            default:
                return `no order '${order}'`;
        }
    }

    setFault(text) {
        let wrong = '';
        this.machine.arrive(() => (wrong = this.wire.setFault(text)));
        return wrong;
    }

    save(address, length, file) {
        const { chip } = this.machine;
        writeFileSync(
            file,
            Uint8Array.from({ length }, (_, i) => chip.readUint8(address + i)),
        );
        return '';
    }

    get counters() {
        const { chip, flash } = this.machine;
        return {
            instructions: chip.core.instructions,
            cycles: chip.core.cycleCount,
            micros: Math.floor(chip.clock.nanos / 1000),
            resets: this.machine.resets,
            erases: flash.erases,
            programs: flash.programs,
            recoveryClocks: this.wire.recoveryClocks,
            lost: chip.uart.map((uart) => uart.lost),
        };
    }
}
