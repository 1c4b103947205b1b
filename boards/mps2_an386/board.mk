# What make must know of the board: compiler, processor, ports, memory map, stack.
BOARD_SETUP := firmware
BOARD_CROSS := arm-none-eabi-
BOARD_CPU := -mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard
BOARD_SPECS := --specs=nano.specs
# Memory is plenty: speed it is
BOARD_OPTIMISE := -O3
BOARD_PORTS := mps2 cortexm template
BOARD_CHIP := mps2
BOARD_STACK := 4096
BOARD_GRIDS := 10x10
# Of hosttest/firmware
BOARD_PROGRAMS := belt conformance count cycles query ray sandwich tight
