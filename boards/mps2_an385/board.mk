# What make must know of the board: processor, family port, memory map, stack, budgets (make size, make stack), emulator.
BOARD_CPU := -mcpu=cortex-m3 -mthumb
BOARD_PORT := cortexm
BOARD_CHIP := mps2_an385
BOARD_STACK := 4096
BOARD_FLASH_BUDGET := 65536
BOARD_RAM_BUDGET := 40960
