# What make must know of the board: compiler, processor, ports, memory map, stack.
BOARD_SETUP := riscv
BOARD_CROSS := riscv64-unknown-elf-
# The older specification: with rv32imac_zicsr, as the newer one calls it, the compiler picks a libgcc of 64 bits.
BOARD_CPU := -march=rv32imac -mabi=ilp32 -misa-spec=2.2
BOARD_SPECS := --specs=picolibc.specs
BOARD_PORTS := riscv template
BOARD_CHIP := riscv_virt
BOARD_STACK := 2048
# The station is built for 20 x 20 (canopy.elf) and for each of these grids (canopy-<grid>.elf).
BOARD_GRIDS := 10x10
# Of hosttest/firmware
BOARD_PROGRAMS := belt conformance count cycles query ray sandwich
