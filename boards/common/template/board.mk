# What make must know of the board: compiler, processor, ports, memory map, stack. The group of tools/setup that installs
# the compiler; its prefix; what tells it the processor; the C library.
BOARD_SETUP := firmware
BOARD_CROSS := arm-none-eabi-
BOARD_CPU := -mcpu=cortex-m0plus -mthumb
BOARD_SPECS := --specs=nano.specs
# Directories of port/. The first has the board's board.c; template has what the chip lacks.
BOARD_PORTS := mychip template
# linker/<chip>.ld
BOARD_CHIP := mychip
BOARD_STACK := 2048
# The station is built for 20 x 20 (canopy.elf) and for each of these grids (canopy-<grid>.elf).
BOARD_GRIDS := 10x10
# The library's unit tests: none until the board can print. Delete the line then.
BOARD_UNITS :=
# Of hosttest/firmware: conformance count cycles …
BOARD_PROGRAMS :=
