# What make must know of the board: processor, family port, memory map, stack, budgets (make size, make stack), emulator.
BOARD_CPU := -mcpu=cortex-m3 -mthumb
BOARD_PORT := cortexm
BOARD_CHIP := mps2_an385
BOARD_STACK := 2048
# The station is built for 20 x 20 (canopy.elf) and for each of these grids (canopy-<grid>.elf).
BOARD_GRIDS := 10x10
# image:flash:ram in bytes, RAM with the stack
BOARD_BUDGETS := canopy:65536:40960 canopy-10x10:65536:16384
