/// Numbers that stand behind an option of the command line. What is none is a fault that names the option and the
/// range.
#ifndef CANOPY_TOOLS_COMMON_OPTION_H
#define CANOPY_TOOLS_COMMON_OPTION_H

#include <stdbool.h>
#include <stdint.h>

#include "tools/common/fault.h"

/// A finite number from `low` to `high`. `name` is the option's, without dashes.
bool canopy_option_real(const char *name, const char *text, double low, double high, double *to,
                        struct canopy_fault *fault);

/// A whole number from `low` to `high`, in as many bits as it is kept in. What is none leaves the narrow ones as they
/// are.
bool canopy_option_whole(const char *name, const char *text, uint64_t low, uint64_t high, uint64_t *to,
                         struct canopy_fault *fault);
bool canopy_option_whole32(const char *name, const char *text, uint32_t low, uint32_t high, uint32_t *to,
                           struct canopy_fault *fault);
bool canopy_option_whole16(const char *name, const char *text, uint16_t low, uint16_t high, uint16_t *to,
                           struct canopy_fault *fault);

/// MxN: two whole numbers with an x between them, and nothing else. What is none, the caller says in its own words.
bool canopy_option_grid(const char *text, uint32_t size[2]);

/// X,Y,…: `count` finite numbers with commas between them, and nothing else; likewise.
bool canopy_option_numbers(const char *text, int count, double *to);

#endif
