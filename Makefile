# canopy: one build graph for the library, the host programs, the tests and the firmware.
# Everything is written below $(BUILD); a directory's *.c is picked up by its place (docs: README.md).

BUILD ?= build
BOARD ?= mps2_an385
SECONDS ?= 60
Q := $(if $(V),,@)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SECONDARY:
MAKEFLAGS += --no-builtin-rules --no-print-directory
ifeq (,$(filter -j% --jobserver%,$(MAKEFLAGS)))
MAKEFLAGS += -j$(shell nproc)
endif

# ---------------------------------------------------------------------------------------------------------------------
# Sources, by place

LIB_SOURCES := $(sort $(wildcard lib/*/*.c))
TOOL_SHARED := $(sort $(wildcard tools/common/*.c))
TOOL_DIRS := $(sort $(filter-out common,$(notdir $(patsubst %/,%,$(dir $(wildcard tools/*/*.c))))))
PORT_LINUX := $(sort $(wildcard port/linux/*.c))
CANOPYD := $(sort $(wildcard boards/linux/*.c))
UNIT_SOURCES := $(sort $(wildcard hosttest/unit/test_*.c))
UNIT_NAMES := $(patsubst hosttest/unit/test_%.c,unit_%,$(UNIT_SOURCES))
HOSTTEST_SOURCES := $(sort $(wildcard hosttest/test_*.c))
HOSTTEST_NAMES := $(patsubst hosttest/%.c,%,$(HOSTTEST_SOURCES))
FUZZ_NAMES := $(patsubst hosttest/%.c,%,$(sort $(wildcard hosttest/fuzz_*.c)))

# Generated C stands in $(BUILD)/gen, which is on the include path. Whoever adds a generator adds its outputs here.
GENERATED := $(BUILD)/gen/canopy_registers.h $(BUILD)/gen/canopy_register_table.h
REGISTERS := $(GENERATED) $(addprefix $(BUILD)/registers.,json csv md)

# ---------------------------------------------------------------------------------------------------------------------
# Flags. No contraction and no x87: a float is a float everywhere, or the error bounds of the float path are void.

WARN := -Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Wdouble-promotion -Werror
WARN_GCC := $(WARN) -Wcast-align=strict
WARN_CLANG := $(WARN) -Wcast-align
CFLAGS_ALL := -std=c11 -g -I. -I$(BUILD)/gen -ffp-contract=off -MMD -MP
HOST_DEFINES := -D_GNU_SOURCE
SSE := -msse2 -mfpmath=sse
SANITIZE := -fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer
HOST_LIBS := -Wl,--as-needed -lmodbus -lgmp -ljansson -lm -pthread

# ---------------------------------------------------------------------------------------------------------------------
# What must be installed: checked quickly before anything of its kind is built, installed only when missing.

SETUP_GROUPS := host test firmware emulator python lint coverage fuzz
.PHONY: $(addprefix setup-,$(SETUP_GROUPS))
$(addprefix setup-,$(SETUP_GROUPS)): setup-%:
	@tools/setup $*

# ---------------------------------------------------------------------------------------------------------------------
# Targets for people

.PHONY: help
help:  ## print this list
	@awk -F':.*## ' '/^[a-z][a-z-]*:.*## /{printf "make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

# The register map: C tables, JSON, CSV and page from one table. docs/registers.md is the page, kept in the tree; a test
# says when it is out of date (tools/registers.py --page docs/registers.md).
$(REGISTERS) &: lib/plc/registers.csv tools/registers.py | setup-host
	@tools/registers.py --out $(BUILD)

.PHONY: registers
registers: $(REGISTERS)  ## the register map: registers.json, .csv and .md

# compile(variant directory, compiler, flags): a rule from any C file of the tree to an object of that variant.
define compile
$(1)/obj/%.o: %.c | $(4) $$(GENERATED)
	@mkdir -p $$(@D)
	$$(if $$(V),,@echo "$(notdir $(2)) $$< ($$(notdir $(1)))")
	$$(Q)$(2) $(CFLAGS_ALL) $(3) -c $$< -o $$@
# the same from generated C
$(1)/obj/gen/%.o: $(BUILD)/gen/%.c | $(4) $$(GENERATED)
	@mkdir -p $$(@D)
	$$(Q)$(2) $(CFLAGS_ALL) $(3) -c $$< -o $$@
$(1)/libcanopy.a: $(addprefix $(1)/obj/,$(LIB_SOURCES:.c=.o))
$(1)/libtools.a: $(addprefix $(1)/obj/,$(TOOL_SHARED:.c=.o))
$(1)/libport.a: $(addprefix $(1)/obj/,$(PORT_LINUX:.c=.o))
$(1)/lib%.a:
	@mkdir -p $$(@D)
	@rm -f $$@
	$$(Q)$(if $(filter arm-%,$(2)),arm-none-eabi-)ar rcsD $$@ $$^
endef

# ---------------------------------------------------------------------------------------------------------------------
# Host: the library, the programs of tools/ and canopyd

HOST := $(BUILD)/host
HOST_ARCHIVES := $(HOST)/libtools.a $(HOST)/libport.a $(HOST)/libcanopy.a
$(eval $(call compile,$(HOST),gcc,-O2 $(WARN_GCC) $(HOST_DEFINES),setup-host))

program_name = $(if $(filter canopy,$(1)),canopy,canopy-$(1))
PROGRAMS := $(foreach t,$(TOOL_DIRS),$(HOST)/$(call program_name,$(t))) $(if $(CANOPYD),$(HOST)/canopyd)

# program(path, sources)
define program
$(1): $(patsubst %.c,$(HOST)/obj/%.o,$(2)) $(HOST_ARCHIVES)
	$$(if $$(V),,@echo "link $$@")
	$$(Q)gcc $$^ $(HOST_LIBS) -o $$@
endef
$(foreach t,$(TOOL_DIRS),$(eval $(call program,$(HOST)/$(call program_name,$(t)),$(sort $(wildcard tools/$(t)/*.c)))))
$(eval $(call program,$(HOST)/canopyd,$(CANOPYD)))

.PHONY: tools
tools: $(PROGRAMS) $(HOST)/libcanopy.a $(REGISTERS)  ## the host programs: canopy, canopyd, canopy-scanner, canopy-plc

# ---------------------------------------------------------------------------------------------------------------------
# Tests on the host: every unit list in four variants; the host-only tests, which need Debian's 64-bit libraries, in two

TEST := $(BUILD)/test

# variant(name, compiler, flags, runner, libraries, host-only tests)
define variant
$(call compile,$(TEST)/$(1),$(2),-O1 $(SANITIZE) $(HOST_DEFINES) $(3),setup-test)
$(TEST)/$(1)/unit_%: $(TEST)/$(1)/obj/hosttest/unit/test_%.o $(TEST)/$(1)/obj/hosttest/unit/$(4).o \
    $(TEST)/$(1)/libcanopy.a
	$$(Q)$(2) $(SANITIZE) $(3) $$^ $(5) -lm -o $$@
$(TEST)/$(1)/test_%: $(TEST)/$(1)/obj/hosttest/test_%.o $(TEST)/$(1)/libtools.a $(TEST)/$(1)/libport.a \
    $(TEST)/$(1)/libcanopy.a
	$$(Q)$(2) $(SANITIZE) $(3) $$^ -lcmocka $(HOST_LIBS) -o $$@
TEST_PROGRAMS += $(addprefix $(TEST)/$(1)/,$(UNIT_NAMES) $(6))
endef
$(eval $(call variant,gcc64,gcc,$(WARN_GCC),run_cmocka,-lcmocka,$(HOSTTEST_NAMES)))
$(eval $(call variant,clang64,clang,$(WARN_CLANG),run_cmocka,-lcmocka,$(HOSTTEST_NAMES)))
$(eval $(call variant,gcc32,gcc,-m32 $(SSE) $(WARN_GCC),run_plain,,))
$(eval $(call variant,clang32,clang,-m32 $(SSE) $(WARN_CLANG),run_plain,,))

.PHONY: test-programs test
test-programs: $(TEST_PROGRAMS)
test: test-programs tools | setup-python  ## every test: host variants, Python, firmware under QEMU
	+@BUILD=$(BUILD) hosttest/run

# ---------------------------------------------------------------------------------------------------------------------
# Firmware of BOARD: the station (boards/<board>/main.c), every unit list, and each program of hosttest/firmware

include boards/$(BOARD)/board.mk

FW := $(BUILD)/$(BOARD)
FW_FLAGS := -Iboards/$(BOARD) $(BOARD_CPU) -Os -ffunction-sections -fdata-sections -fno-common -fstack-usage -fcallgraph-info=su $(WARN_GCC)
FW_LINK := $(BOARD_CPU) -nostartfiles --specs=nano.specs -Llinker -Tlinker/$(BOARD_CHIP).ld -Wl,--gc-sections \
    -Wl,--fatal-warnings
FW_BOARD_SOURCES := $(sort $(filter-out boards/$(BOARD)/main.c,$(wildcard boards/$(BOARD)/*.c)) \
    $(wildcard port/$(BOARD_PORT)/*.c))
FW_BOARD := $(addprefix $(FW)/obj/,$(FW_BOARD_SOURCES:.c=.o))
FW_MAIN := $(wildcard boards/$(BOARD)/main.c)
FW_UNITS := $(UNIT_NAMES:%=$(FW)/%.elf)
FW_OTHERS := $(patsubst hosttest/firmware/%.c,$(FW)/%.elf,$(sort $(wildcard hosttest/firmware/*.c)))
FW_STATIONS := $(if $(FW_MAIN),$(FW)/canopy.elf)
FIRMWARE := $(FW_STATIONS) $(FW_UNITS) $(FW_OTHERS)

$(eval $(call compile,$(FW),arm-none-eabi-gcc,$(FW_FLAGS),setup-firmware))

# image(stack bytes): the recipe that links $@ from $^ and keeps a map beside it
define image
	$(if $(V),,@echo "link $@")
	$(Q)arm-none-eabi-gcc $(FW_LINK) -Wl,--defsym=canopy_stack_size=$(1) -Wl,-Map=$(@:.elf=.map) $(filter %.o,$^) \
	    $(filter %.a,$^) -lm -o $@
endef

$(FIRMWARE): linker/cortexm.ld linker/$(BOARD_CHIP).ld boards/$(BOARD)/board.mk
$(FW)/canopy.elf: $(FW)/obj/boards/$(BOARD)/main.o $(FW_BOARD) $(FW)/libcanopy.a
	$(call image,$(BOARD_STACK))
$(FW_UNITS): $(FW)/unit_%.elf: $(FW)/obj/hosttest/unit/test_%.o $(FW)/obj/hosttest/unit/run_firmware.o $(FW_BOARD) \
    $(FW)/libcanopy.a
	$(call image,16384)
$(FW_OTHERS): $(FW)/%.elf: $(FW)/obj/hosttest/firmware/%.o $(FW_BOARD) $(FW)/libcanopy.a
	$(call image,$(BOARD_STACK))

.PHONY: firmware
firmware: $(FIRMWARE)  ## images for BOARD (default mps2_an385): build/<board>/*.elf

# ---------------------------------------------------------------------------------------------------------------------

.PHONY: all clean
all: tools test-programs firmware  ## build everything, run nothing
clean:  ## remove $(BUILD)
	rm -rf $(BUILD)

-include $(shell find $(BUILD) -name '*.d' 2>/dev/null)
