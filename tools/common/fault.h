/// One line that says what is wrong and what to do about it.
///
/// Everything on the host that can fail on input takes a `struct canopy_fault *` and returns false after filling it.
/// The text has no newline and names the file, the line (or byte, or element) and the remedy.
#ifndef CANOPY_TOOLS_COMMON_FAULT_H
#define CANOPY_TOOLS_COMMON_FAULT_H

#include <stdbool.h>

struct canopy_fault {
    char text[512];
};

/// Writes the text, cut to what fits, with control characters of foreign input made visible. Always returns false.
bool canopy_fault_set(struct canopy_fault *fault, const char *format, ...) __attribute__((format(printf, 2, 3)));

/// Says that a fit has no memory, and what needs less. Always returns false.
bool canopy_fault_no_memory(struct canopy_fault *fault);

/// Puts "prefix: " before the text that is there. Always returns false.
bool canopy_fault_prefix(struct canopy_fault *fault, const char *format, ...) __attribute__((format(printf, 2, 3)));

#endif
