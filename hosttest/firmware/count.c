// The instruction counter against loops whose length is known: hosttest/test_conformance.py checks the numbers.
#include "hosttest/firmware/print.h"
#include "port/board.h"

// Two instructions a turn.
static void turn(uint32_t turns) {
#if defined __arm__
    __asm volatile(".syntax unified\n1:\tsubs %0, #1\n\tbne 1b" : "+r"(turns)::"cc");
#elif defined __riscv
    __asm volatile("1:\taddi %0, %0, -1\n\tbnez %0, 1b" : "+r"(turns));
#else
#error "a loop of two instructions a turn for this processor"
#endif
}

static void count_turns(const char *name, uint32_t turns) {
    const uint64_t start = canopy_board_instructions();
    turn(turns);
    print_result(name, (int64_t)(canopy_board_instructions() - start));
}

int main(void) {
    (void)canopy_board_start((const uint32_t[]){115200, 115200});
    const uint64_t start = canopy_board_instructions();
    print_result("nothing", (int64_t)(canopy_board_instructions() - start));
    count_turns("turns_1000", 1000);
    count_turns("turns_100000", 100000);
    count_turns("turns_10000000", 10000000);
    canopy_board_exit(true);
}
