/// What is left of a crash: a record that survives the reset, and a line on the console.
///
/// Any exception that has no handler, and the watchdog's warning, ends in canopy_fault_entry (startup.h). It takes a
/// fresh stack, fills the record, prints `fault N pc X lr X cfsr X address X`, and resets. The next start finds the
/// record.
#ifndef CANOPY_PORT_CORTEXM_FAULT_H
#define CANOPY_PORT_CORTEXM_FAULT_H

#include <stdint.h>

enum canopy_fault_kind {  // the exception's number, or 16 + irq for an interrupt without a handler
    CANOPY_FAULT_WATCHDOG = 2,
    CANOPY_FAULT_HARD = 3,
    CANOPY_FAULT_MEMORY = 4,
    CANOPY_FAULT_BUS = 5,
    CANOPY_FAULT_USAGE = 6
};

struct canopy_fault {
    uint32_t magic;
    uint32_t kind;     ///< enum canopy_fault_kind
    uint32_t pc;       ///< the instruction that faulted or was interrupted; 0 when the stack could not be read
    uint32_t lr;       ///< its return address; 0 likewise
    uint32_t psr;      ///< program status; 0 likewise
    uint32_t sp;       ///< the stack pointer at the exception
    uint32_t cfsr;     ///< configurable fault status: why
    uint32_t hfsr;     ///< hard fault status
    uint32_t address;  ///< the address that could not be accessed, 0 when the processor does not know it
    uint32_t count;    ///< faults since power-on, this one included
    uint32_t check;    ///< exclusive or of all before it
};

/// The record of the fault that ended the run before this one, or NULL. It stays until canopy_fault_forget.
const struct canopy_fault *canopy_fault_last(void);
void canopy_fault_forget(void);

/// Link-time seams for boards. The default of the first drops the character, of the second resets the processor.
void canopy_fault_put(char character);
_Noreturn void canopy_fault_end(void);

#endif
