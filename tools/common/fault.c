#include "tools/common/fault.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/// A file name or a broken line may hold anything; the message stays one printable line.
static void make_printable(char *text) {
    for (; *text; text++) {
        if ((unsigned char)*text < ' ' || *text == 0x7f) {
            *text = '?';
        }
    }
}

bool canopy_fault_set(struct canopy_fault *fault, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(fault->text, sizeof fault->text, format, arguments);
    va_end(arguments);
    make_printable(fault->text);
    return false;
}

bool canopy_fault_no_memory(struct canopy_fault *fault) {
    return canopy_fault_set(fault, "out of memory: choose a smaller --grid or --field, or fewer points");
}

bool canopy_fault_prefix(struct canopy_fault *fault, const char *format, ...) {
    const struct canopy_fault tail = *fault;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(fault->text, sizeof fault->text, format, arguments);
    va_end(arguments);
    const size_t used = strlen(fault->text);
    snprintf(fault->text + used, sizeof fault->text - used, ": %s", tail.text);
    make_printable(fault->text);
    return false;
}
