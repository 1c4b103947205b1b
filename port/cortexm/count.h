/// Counts the instructions of a piece of firmware, repeatably: for benchmarks under `qemu-system-arm -icount shift=0`.
///
/// There an instruction takes one nanosecond of virtual time whatever the host does, and SysTick runs at 25 MHz of it:
/// a tick is 40 instructions. So the resolution is 40 instructions; to see finer, repeat the piece inside one count and
/// divide. Interrupts are counted too: SysTick's own take about 20 in 671 million. On hardware the numbers are ticks
/// times 40, not instructions. hosttest/firmware/count.c shows the use; hosttest/bench_firmware.py runs images and
/// collects results.
#ifndef CANOPY_PORT_CORTEXM_COUNT_H
#define CANOPY_PORT_CORTEXM_COUNT_H

#include "port/cortexm/clock.h"

#define CANOPY_INSTRUCTIONS_PER_TICK 40u

/// Instructions since the clock was started. Two calls with nothing between them differ by 0 or 40.
static inline uint64_t canopy_instructions(void) { return canopy_cortexm_ticks() * CANOPY_INSTRUCTIONS_PER_TICK; }

#endif
