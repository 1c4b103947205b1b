// The emulator from npm, wherever `make` has put it: below $(BUILD), so that nothing else is written. CANOPY_NODE names
// the directory that has node_modules (default build/node).
import { existsSync } from 'node:fs';
import path from 'node:path';
import { fileURLToPath, pathToFileURL } from 'node:url';

const root = path.dirname(path.dirname(path.dirname(fileURLToPath(import.meta.url))));
const place = path.resolve(process.env.CANOPY_NODE ?? path.join(root, 'build', 'node'));
const modules = path.join(place, 'node_modules', 'rp2040js', 'dist', 'esm');

if (!existsSync(modules)) {
    process.stderr.write(`rp2040: ${modules} is not there: make node, or set CANOPY_NODE\n`);
    process.exit(2);
}

const load = (name) => import(pathToFileURL(path.join(modules, name)).href);

export const { RP2040 } = await load('rp2040.js');
export const { CortexM0Core } = await load('cortex-m0-core.js');
export const { SimulationClock } = await load('clock/simulation-clock.js');
export const { BasePeripheral } = await load('peripherals/peripheral.js');
export const { RPPLL } = await load('peripherals/pll.js');
export const { RPPPB } = await load('peripherals/ppb.js');
export const { IRQ } = await load('irq.js');
