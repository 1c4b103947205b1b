# What make must know of the board: compiler, processor, ports, memory map, stack.
BOARD_SETUP := firmware
BOARD_CROSS := arm-none-eabi-
BOARD_CPU := -mcpu=cortex-m3 -mthumb
BOARD_SPECS := --specs=nano.specs
BOARD_PORTS := mps2 cortexm template
BOARD_CHIP := mps2
BOARD_STACK := 2048
# The station is built for 20 x 20 (canopy.elf) and for each of these grids (canopy-<grid>.elf).
BOARD_GRIDS := 10x10
# Of hosttest/firmware
BOARD_PROGRAMS := belt conformance count cycles query ray sandwich
