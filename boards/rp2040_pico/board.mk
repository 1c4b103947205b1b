# What make must know of the board: compiler, processor, ports, memory map, stack.
BOARD_SETUP := firmware
BOARD_CROSS := arm-none-eabi-
# The boot ROM is at address 0: no access to low addresses is a mistake for that.
BOARD_CPU := -mcpu=cortex-m0plus -mthumb --param=min-pagesize=0
BOARD_SPECS := --specs=nano.specs
BOARD_PORTS := rp2040 cortexm
BOARD_CHIP := rp2040
BOARD_STACK := 2048
# The station is built for 20 x 20, Q = 4 (canopy.elf) and for each of these grids and Q (canopy-<grid>.elf).
BOARD_GRIDS := 10x10 10x10x2
# Of hosttest/firmware
BOARD_PROGRAMS := conformance count cycles query ray sandwich
# What a linked image still needs: the CRC of its boot block; it leaves a .uf2 beside it.
BOARD_FINISH := tools/uf2.py
