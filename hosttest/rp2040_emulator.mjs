// The RP2040 emulator itself: that it computes as the architecture says, and that it notices what firmware must not do.
// Prints TAP; hosttest/test_rp2040_emulator.py runs it. What is expected is computed here in big integers or written
// down.
import assert from 'node:assert/strict';

import { Violation } from '../tools/rp2040/faults.mjs';
import { PowerCut } from '../tools/rp2040/flash.mjs';
import { Machine } from '../tools/rp2040/machine.mjs';
import { crc32 } from '../tools/rp2040/rom.mjs';
import { Memory } from '../tools/rp2040/devices.mjs';
import { Wire } from '../tools/rp2040/wire.mjs';

const CODE = 0x20001000;
const STACK = 0x20008000;
const VECTORS = 0x20000000;
const HANDLER = 0x20002000;
const WORD = 1n << 32n;

/** A machine past its boot, with nothing in reset, about to execute these halfwords from RAM. */
function machineWith(...halfwords) {
    const machine = new Machine();
    const { chip } = machine;
    chip.needsBoot = false;
    chip.resets.set(0);
    chip.resets.released.fill(0);
    chip.core.restart(CODE, STACK);
    chip.core.VTOR = VECTORS;
    for (let i = 0; i < 48; i++) {
        chip.writeUint32(VECTORS + 4 * i, HANDLER | 1);
    }
    chip.writeUint16(HANDLER, 0xe7fe); // a branch to itself
    halfwords.forEach((code, i) => chip.writeUint16(CODE + 2 * i, code));
    return machine;
}

function steps(machine, count) {
    const { core, clock } = machine.chip;
    for (let i = 0; i < count; i++) {
        if (core.updated) {
            core.checkForInterrupts();
        }
        core.limit = core.spent + 1;
        core.slice();
        clock.settle();
    }
}

function violation(pattern, act) {
    assert.throws(act, (problem) => problem instanceof Violation && pattern.test(problem.message));
}

const signed = (value) => BigInt.asIntN(32, value);
const EDGES = [0n, 1n, 2n, 0x7ffffffen, 0x7fffffffn, 0x80000000n, 0x80000001n, 0xfffffffen, 0xffffffffn, 0x12345678n];

// ---- The processor

/** Sum, carry and overflow of a + b + carry (ARMv6-M, A2.2.1: AddWithCarry). */
function addWithCarry(a, b, carry) {
    const unsigned = a + b + carry;
    const value = BigInt.asUintN(32, unsigned);
    return { value, carry: unsigned >= WORD, overflow: signed(a) + signed(b) + carry !== signed(value) };
}

const not = (value) => BigInt.asUintN(32, ~value);
const ARITHMETIC = {
    ADCS: [0x4148, (a, b, c) => addWithCarry(a, b, c)], // adcs r0, r1
    SBCS: [0x4188, (a, b, c) => addWithCarry(a, not(b), c)],
    ADDS: [0x1840, (a, b) => addWithCarry(a, b, 0n)], // adds r0, r0, r1
    SUBS: [0x1a40, (a, b) => addWithCarry(a, not(b), 1n)],
    CMP: [0x4288, (a, b) => ({ ...addWithCarry(a, not(b), 1n), kept: a })],
    CMN: [0x42c8, (a, b) => ({ ...addWithCarry(a, b, 0n), kept: a })],
    RSBS: [0x4248, (a, b) => addWithCarry(not(b), 0n, 1n)], // rsbs r0, r1, #0
};

function shift(kind, a, by, carry) {
    if (by === 0n) {
        return { value: a, carry: carry === 1n };
    }
    const wide = BigInt(by > 33n ? 33n : by);
    if (kind === 'LSLS') {
        return { value: BigInt.asUintN(32, a << wide), carry: ((a << wide) >> 32n) % 2n === 1n };
    }
    const extended = kind === 'ASRS' ? signed(a) : a;
    return { value: BigInt.asUintN(32, extended >> wide), carry: BigInt.asUintN(1, extended >> (wide - 1n)) === 1n };
}

const tests = {
    flags_of_sums_and_differences() {
        const machine = machineWith(0);
        const { chip } = machine;
        const { core } = chip;
        for (const [name, [code, model]] of Object.entries(ARITHMETIC)) {
            chip.writeUint16(CODE, code);
            for (const a of EDGES) {
                for (const b of EDGES) {
                    for (const c of [0n, 1n]) {
                        core.registers[0] = Number(a);
                        core.registers[1] = Number(b);
                        core.registers[15] = CODE;
                        core.carry = Number(c);
                        steps(machine, 1);
                        const wanted = model(a, b, c);
                        const seen = [
                            BigInt(core.registers[0]),
                            core.nz < 0,
                            core.nz === 0,
                            core.carry === 1,
                            core.overflow === 1,
                        ];
                        const right = [
                            wanted.kept ?? wanted.value,
                            signed(wanted.value) < 0n,
                            wanted.value === 0n,
                            wanted.carry,
                            wanted.overflow,
                        ];
                        assert.deepEqual(seen, right, `${name} ${a} ${b} ${c}`);
                    }
                }
            }
        }
    },

    flags_of_shifts() {
        const machine = machineWith(0);
        const { core } = machine.chip;
        for (const [kind, code] of [
            ['LSLS', 0x4088],
            ['LSRS', 0x40c8],
            ['ASRS', 0x4108],
        ]) {
            machine.chip.writeUint16(CODE, code);
            for (const a of EDGES) {
                for (const by of [0n, 1n, 2n, 31n, 32n, 33n, 255n, 256n]) {
                    core.registers[0] = Number(a);
                    core.registers[1] = Number(by);
                    core.registers[15] = CODE;
                    core.carry = 1;
                    steps(machine, 1);
                    const wanted = shift(kind, a, by % 256n, 1n);
                    const seen = [BigInt(core.registers[0]), core.nz < 0, core.nz === 0, core.carry === 1];
                    assert.deepEqual(
                        seen,
                        [wanted.value, signed(wanted.value) < 0n, wanted.value === 0n, wanted.carry],
                        `${kind} ${a} ${by}`,
                    );
                }
            }
        }
    },

    branches_go_where_they_say() {
        const machine = machineWith(0xd0fe, 0xe7fd); // beq to itself; b to one before
        machine.chip.core.nz = 1;
        steps(machine, 1);
        assert.equal(machine.chip.core.PC, CODE + 2);
        steps(machine, 1);
        assert.equal(machine.chip.core.PC, CODE);
        const far = machineWith(0xf7ff, 0xfffe, 0xf000, 0xf802); // bl to itself; bl four further
        steps(far, 1);
        assert.deepEqual([far.chip.core.PC, far.chip.core.LR], [CODE, CODE + 5]);
        far.chip.core.PC = CODE + 4;
        steps(far, 1);
        assert.deepEqual([far.chip.core.PC, far.chip.core.LR], [CODE + 12, CODE + 9]);
    },

    a_fault_says_where() {
        const cases = [
            [0x6808, { 1: 0xf0000000 }], // ldr r0, [r1]: nothing there
            [0x6808, { 1: 0x20000002 }], // no multiple of four
            [0x8808, { 1: 0x20000001 }], // ldrh
            [0x6008, { 1: 0x10000000 }], // str to the flash
            [0x6008, { 1: 0x00000010 }], // str to the ROM
            [0x6808, { 1: 0x20042000 }], // behind the RAM
            [0xde00, {}], // undefined
            [0xbe01, {}], // a breakpoint without a debugger
        ];
        for (const [code, registers] of cases) {
            const machine = machineWith(0xbf00, code);
            const { core } = machine.chip;
            Object.entries(registers).forEach(([i, value]) => (core.registers[i] = value));
            steps(machine, 2);
            assert.equal(core.IPSR, 3, code.toString(16));
            assert.equal(machine.chip.readUint32(core.SP + 24), CODE + 2);
            assert.equal(core.PC & ~1, HANDLER);
        }
    },

    a_fault_in_a_fault_locks_up() {
        const machine = machineWith(0xde00);
        machine.chip.writeUint16(HANDLER, 0xde00);
        steps(machine, 2);
        assert.equal(machine.chip.core.locked, true);
        const full = machineWith(0xb500); // push {lr}
        full.chip.core.SP = 0x20000000;
        steps(full, 1);
        assert.equal(full.chip.core.locked, true, 'no room for the frame');
    },

    a_masked_interrupt_ends_a_sleep_and_is_not_taken() {
        const machine = machineWith(0xb672, 0xbf30, 0xbf00, 0xb662, 0xbf00); // cpsid i; wfi; nop; cpsie i; nop
        const { chip } = machine;
        chip.core.enabledInterrupts = 1 << 20;
        steps(machine, 2);
        assert.equal(chip.core.waiting, true);
        chip.setInterrupt(20, true);
        chip.core.checkForInterrupts();
        assert.equal(chip.core.waiting, false);
        chip.core.PC = CODE + 4;
        steps(machine, 2);
        assert.equal(chip.core.IPSR, 0);
        steps(machine, 1);
        assert.equal(chip.core.IPSR, 16 + 20);
    },

    instructions_are_counted() {
        const machine = machineWith(0x2064, 0x3801, 0xd1fd, 0xbf30); // movs r0, #100; 1: subs r0, #1; bne 1b; wfi
        machine.chip.core.run();
        assert.equal(machine.chip.core.instructions, 1 + 200 + 1);
    },

    systick_counts_cycles() {
        const machine = machineWith(...new Array(200).fill(0xbf00));
        const { chip } = machine;
        chip.writeUint32(0xe000e014, 99);
        chip.writeUint32(0xe000e018, 5);
        chip.writeUint32(0xe000e010, 7);
        assert.equal(chip.core.pendingSystick, false, 'a written 0 is no tick');
        steps(machine, 40);
        assert.equal(chip.readUint32(0xe000e018), 60);
        steps(machine, 59);
        assert.equal(chip.core.pendingSystick, false);
        steps(machine, 1);
        assert.equal(chip.readUint32(0xe000e018), 0);
        assert.equal(chip.core.pendingSystick, true);
    },

    // ---- What firmware must not do

    blocks_in_reset_are_not_used() {
        const machine = machineWith(0xbf00);
        machine.chip.writeUint32(0x4000e000, 1 << 22); // UART 0, by the alias that sets
        violation(/UART0 .* reset/, () => machine.chip.readUint32(0x40034018));
        machine.chip.writeUint32(0x4000f000, 1 << 22);
        violation(/UART0 .* reset/, () => machine.chip.readUint32(0x40034018));
        assert.equal(machine.chip.readUint32(0x4000c008) & (1 << 22), 0, 'it is not done at once');
        machine.chip.pass(1000);
        assert.notEqual(machine.chip.readUint32(0x4000c008) & (1 << 22), 0);
        machine.chip.readUint32(0x40034018);
    },

    clocks_are_waited_for() {
        const { chip } = machineWith(0xbf00);
        violation(/before it is stable/, () => chip.writeUint32(0x40008030, 2));
        chip.writeUint32(0x40008030, 0);
        violation(/not locked/, () => chip.writeUint32(0x4000803c, 1));
        chip.writeUint32(0x4000803c, 0);
        violation(/less than a millisecond/, () => chip.writeUint32(0x40024000, 0xfabaa0));
        violation(/makes no tick/, () => chip.readUint32(0x40054028));
    },

    a_watchdog_that_resets_nothing_is_noticed() {
        const { chip } = machineWith(0xbf00);
        violation(/PSM_WDSEL/, () => chip.writeUint32(0x4005a000, 0x80000000));
    },

    a_uart_without_pin_or_speed_is_noticed() {
        const { chip } = machineWith(0xbf00);
        violation(/baud rate is off/, () => chip.writeUint32(0x40034000, 65));
        chip.clkPeri = 125e6;
        chip.writeUint32(0x40034024, 67);
        chip.writeUint32(0x40034030, 0x301);
        chip.writeUint32(0x40034000, 65);
        chip.pass(1e6);
        violation(/no pin/, () => chip.clock.settle());
    },

    // ---- The flash

    the_boot_block_has_a_known_check_sum() {
        assert.equal(crc32(Buffer.from('123456789')), 0x0376e6e7); // CRC-32/MPEG-2
    },

    flash_functions_need_what_they_need() {
        const order = ['IF', 'EX', 'RE'];
        const call = (machine, name, ...values) => {
            values.forEach((value, i) => (machine.chip.core.registers[i] = value));
            machine.rom.call(machine.rom.names.indexOf(name));
        };
        const ready = () => {
            const machine = machineWith(0xbf00);
            machine.chip.core.LR = CODE | 1;
            machine.chip.core.PM = true;
            order.slice(0, 2).forEach((name) => call(machine, name));
            return machine;
        };
        const good = ready();
        call(good, 'RE', 0x1000, 4096);
        assert.equal(good.flash.erases, 1);
        violation(/has not been flushed/, () => call(good, 'CX'));
        call(good, 'FC');
        call(good, 'CX');
        violation(/before connect/, () => call(good, 'RE', 0x1000, 4096));

        violation(/whole units/, () => call(ready(), 'RE', 0x1001, 4096));
        violation(/whole units/, () => call(ready(), 'RP', 0x1000, CODE, 255));
        violation(/not RAM/, () => call(ready(), 'RP', 0x1000, 0x10000000, 256));
        const outside = ready();
        outside.chip.core.LR = 0x10000201;
        violation(/not RAM/, () => call(outside, 'RE', 0x1000, 4096));
        const open = ready();
        open.chip.core.PM = false;
        violation(/interrupts on/, () => call(open, 'RE', 0x1000, 4096));
        const loud = ready();
        loud.chip.core.interruptNMIMask = 2;
        violation(/non-maskable/, () => call(loud, 'RE', 0x1000, 4096));
        violation(/cannot be/, () => ready().chip.readUint32(0x10000000));
    },

    programming_only_clears_bits_and_power_may_fail() {
        const machine = new Machine({ cutAfter: 4096 + 300 });
        const { flash } = machine;
        flash.erase(0, 4096);
        flash.program(
            0,
            Uint8Array.from({ length: 256 }, () => 0x0f),
        );
        assert.throws(
            () =>
                flash.program(
                    0,
                    Uint8Array.from({ length: 256 }, () => 0xf0),
                ),
            PowerCut,
        );
        assert.equal(flash.memory[43], 0);
        assert.equal(flash.memory[44], 0x05, 'half of its bits');
        assert.equal(flash.memory[45], 0x0f);
        assert.throws(() => flash.erase(4096, 4096), PowerCut, 'without power nothing changes');
    },

    // ---- Wires

    a_uart_takes_its_time_and_overruns() {
        const { chip } = machineWith(0xbf00);
        chip.clkPeri = 125e6;
        chip.writeUint32(0x40034024, 67);
        chip.writeUint32(0x40034028, 52);
        chip.writeUint32(0x4003402c, 0x60);
        chip.writeUint32(0x40034030, 0x301);
        chip.writeUint32(0x40014004, 2);
        chip.writeUint32(0x4001400c, 2);
        const uart = chip.uart[0];
        const got = [];
        uart.onSent = (byte) => got.push(byte);
        chip.writeUint32(0x40034000, 65);
        chip.writeUint32(0x40034000, 66);
        violation(/full/, () => chip.writeUint32(0x40034000, 67));
        chip.pass(86e3);
        chip.clock.settle();
        assert.deepEqual(got, []);
        chip.pass(2e3);
        chip.clock.settle();
        assert.deepEqual(got, [65]);
        assert.equal(chip.readUint32(0x40034018) & 8, 8, 'busy with the second');
        chip.pass(87e3);
        chip.clock.settle();
        assert.deepEqual(got, [65, 66]);
        assert.equal(chip.readUint32(0x40034018) & 8, 0);
        uart.feed([1, 2, 3]);
        chip.pass(300e3);
        chip.clock.settle();
        assert.equal(chip.readUint32(0x4003403c) & (1 << 10), 1 << 10, 'overrun');
        assert.equal(chip.readUint32(0x40034000), 1);
        assert.equal(uart.lost, 2);
    },

    a_held_bus_does_not_wedge_the_controller() {
        const { chip } = machineWith(0xbf00);
        const wire = new Wire(chip, 4, 5);
        chip.i2c[0].wire = wire;
        wire.controllers.push(chip.i2c[0]);
        wire.devices.set(0x50, new Memory(0x50, 1));
        for (const pin of [4, 5]) {
            chip.writeUint32(0x40014004 + 8 * pin, 3);
        }
        const put = (offset, value) => chip.writeUint32(0x40044000 + offset, value);
        const get = (offset) => chip.readUint32(0x40044000 + offset);
        const write = (address, ...commands) => {
            put(0x6c, 0);
            put(0x04, address);
            put(0x6c, 1);
            commands.forEach((command) => put(0x10, command));
            chip.pass(10e6);
            chip.clock.settle();
        };
        write(0x50, 7, 0x200 | 0x5a);
        assert.equal(wire.devices.get(0x50).bytes[7], 0x5a);
        assert.equal(get(0x34) & 0x240, 0x200, 'a STOP, no abort');
        get(0x40);
        write(0x50, 7, 0x700); // pointer, then restart, read and STOP
        assert.equal(get(0x10) & 0xff, 0x5a);
        get(0x40);
        write(0x51, 0x200);
        assert.equal(get(0x80) & 0x1ff, 1, 'nobody at that address');
        get(0x54);
        for (const fault of ['scl-low=forever', 'sda-low=forever']) {
            wire.setFault(fault);
            write(0x50, 7, 0x200);
            assert.notEqual(get(0x70) & 0x20, 0, 'it waits');
            put(0x6c, 0);
            assert.equal(get(0x9c) & 1, 0);
            wire.setFault('none');
            get(0x40);
            write(0x50, 9, 0x200 | 1);
            assert.equal(wire.devices.get(0x50).bytes[9], 1, fault);
            get(0x40);
        }
        wire.setFault('sda-low=3');
        assert.equal(wire.sda, false);
        for (let clock = 0; clock < 3; clock++) {
            wire.hold({ scl: true });
            wire.hold({ scl: false });
        }
        assert.equal(wire.sda, true);
    },
};

console.log(`1..${Object.keys(tests).length}`);
let failed = 0;
Object.entries(tests).forEach(([name, test], i) => {
    try {
        test();
        console.log(`ok ${i + 1} - ${name}`);
    } catch (problem) {
        failed++;
        console.log(`not ok ${i + 1} - ${name}\n${problem.stack.replace(/^/gm, '# ')}`);
    }
});
process.exit(failed > 0 ? 1 : 0);
