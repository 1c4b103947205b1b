# canopy: one build graph for the library, the host programs, the tests and the firmware.
# Everything is written below $(BUILD); a directory's *.c is picked up by its place (docs: README.md).

BUILD ?= build
BOARD ?= mps2_an385
BOARDS := $(sort $(notdir $(patsubst %/,%,$(filter-out boards/common/,$(wildcard boards/*/)))))
ifeq (,$(filter $(BOARD),$(BOARDS)))
$(error BOARD=$(BOARD) is no board: give one of $(BOARDS))
endif
SECONDS ?= 60
PYTHON := /usr/bin/python3# Debian's own, which has the packages that tools/setup installs
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

LIB_SOURCES := $(sort $(wildcard lib/*.c lib/*/*.c))
TOOL_SHARED := $(sort $(wildcard tools/common/*.c))
TOOL_DIRS := $(sort $(filter-out common bench tightness,$(notdir $(patsubst %/,%,$(dir $(wildcard tools/*/*.c))))))
PORT_LINUX := $(sort $(wildcard port/linux/*.c))
CANOPYD := $(sort $(wildcard boards/linux/*.c))
UNIT_SOURCES := $(sort $(wildcard hosttest/unit/test_*.c))
UNIT_NAMES := $(patsubst hosttest/unit/test_%.c,unit_%,$(UNIT_SOURCES))
HOSTTEST_SOURCES := $(sort $(wildcard hosttest/test_*.c))
HOSTTEST_NAMES := $(patsubst hosttest/%.c,%,$(HOSTTEST_SOURCES))
FUZZ_NAMES := $(patsubst hosttest/%.c,%,$(sort $(wildcard hosttest/fuzz_*.c)))

# Generated C stands in $(BUILD)/gen, which is on the include path. Whoever adds a generator adds its outputs here.
GENERATED := $(addprefix $(BUILD)/gen/canopy_,registers.h register_table.h settings_table.h)
REGISTERS := $(GENERATED) $(addprefix $(BUILD)/registers.,json csv md)

# ---------------------------------------------------------------------------------------------------------------------
# Flags. No contraction and no x87: a float is a float everywhere, or the error bounds of the float path are void.

WARN := -Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Wdouble-promotion -Wvla -Werror
WARN_GCC := $(WARN) -Wcast-align=strict
WARN_CLANG := $(WARN) -Wcast-align
CFLAGS_ALL := -std=c11 -g -I. -I$(BUILD)/gen -ffp-contract=off -MMD -MP
HOST_DEFINES := -D_GNU_SOURCE
SSE := -msse2 -mfpmath=sse
SANITIZE := -fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer
HOST_LIBS := -Wl,--as-needed -lmodbus -lgmp -ljansson -llzf -lm -pthread

# ---------------------------------------------------------------------------------------------------------------------
# What must be installed: checked quickly before anything of its kind is built, installed only when missing.

NODE := $(BUILD)/node/node_modules/.package-lock.json# of the RP2040's emulator: `make node`
SETUP_GROUPS := host test firmware riscv emulator node demo python lint coverage fuzz bench
.PHONY: $(addprefix setup-,$(SETUP_GROUPS))
$(addprefix setup-,$(SETUP_GROUPS)): setup-%:
	@tools/setup $*

# ---------------------------------------------------------------------------------------------------------------------
# Targets for people

.PHONY: help
help:  ## print this list
	@awk -F':.*## ' '/^[a-z][a-z-]*:.*## /{printf "make %-12s %s\n", $$1, $$2}' $(firstword $(MAKEFILE_LIST))
	@echo "BOARD=x: $(BOARDS)"

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
	$$(Q)$(if $(filter %-elf-gcc %-eabi-gcc,$(2)),$(2:gcc=ar) rcsDT,ar rcsD) $$@ $$^
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

# How tight is tight, against the optimum: canopy-tightness ORACLE.json NAME=POINTS...
$(eval $(call program,$(HOST)/canopy-tightness,$(sort $(wildcard tools/tightness/*.c))))

# What `make bench` runs: the command's own fit against the floor, tight against an oracle, and the peers that are written
# in C++
$(eval $(call program,$(HOST)/canopy-bench,$(sort $(wildcard tools/bench/*.c))))
$(HOST)/canopy-bench-alglib: tools/bench/alglib.cpp | setup-bench
	@mkdir -p $(@D)
	$(if $(V),,@echo "g++ $<")
	$(Q)g++ -std=c++17 -O2 -Wall -Wextra -Wconversion -Wshadow -Werror $< -lalglib -o $@
# Of headers alone: half a minute
$(HOST)/canopy-bench-alphawrap: tools/bench/alphawrap.cpp | setup-bench
	@mkdir -p $(@D)
	$(if $(V),,@echo "g++ $<")
	$(Q)g++ -std=c++17 -O2 -DNDEBUG -Wall -Wextra $< -lgmp -lmpfr -o $@

.PHONY: tools
tools: $(PROGRAMS) $(HOST)/libcanopy.a $(REGISTERS)  ## the host programs: canopy, canopyd, canopy-scanner, canopy-plc

# ---------------------------------------------------------------------------------------------------------------------
# Tests on the host: every unit list in four variants; the host-only tests, which need Debian's 64-bit libraries, in two

TEST := $(BUILD)/test

# variant(directory, compiler, instrumentation, flags, runner, libraries): rules for its programs
define variant
$(call compile,$(1),$(2),-O1 $(3) $(HOST_DEFINES) $(4),setup-test)
$(1)/unit_%: $(1)/obj/hosttest/unit/test_%.o $(1)/obj/hosttest/unit/$(5).o $(1)/libcanopy.a
	$$(Q)$(2) $(3) $(4) $$^ $(6) -lm -o $$@
$(1)/test_%: $(1)/obj/hosttest/test_%.o $(1)/libtools.a $(1)/libport.a $(1)/libcanopy.a
	$$(Q)$(2) $(3) $(4) $$^ -lcmocka $(HOST_LIBS) -o $$@
endef
# GCC's instrumentation hides from its own conversion warnings that a shifted byte is small; the other builds have them.
WARN_SANITIZED := $(WARN_GCC) -Wno-conversion -Wno-sign-conversion
$(eval $(call variant,$(TEST)/gcc64,gcc,$(SANITIZE),$(WARN_SANITIZED),run_cmocka,-lcmocka))
$(eval $(call variant,$(TEST)/clang64,clang,$(SANITIZE),$(WARN_CLANG),run_cmocka,-lcmocka))
$(eval $(call variant,$(TEST)/gcc32,gcc,$(SANITIZE),-m32 $(SSE) $(WARN_SANITIZED),run_plain,))
$(eval $(call variant,$(TEST)/clang32,clang,$(SANITIZE),-m32 $(SSE) $(WARN_CLANG),run_plain,))
TEST_PROGRAMS := $(foreach v,gcc64 clang64,$(addprefix $(TEST)/$(v)/,$(UNIT_NAMES) $(HOSTTEST_NAMES))) \
    $(foreach v,gcc32 clang32,$(addprefix $(TEST)/$(v)/,$(UNIT_NAMES)))

# The other end for the Python tests that need one
TEST_PROGRAMS += $(TEST)/modbus_peer $(HOST)/canopy-bench
$(TEST)/modbus_peer: $(TEST)/gcc64/obj/hosttest/modbus_peer.o $(TEST)/gcc64/libcanopy.a
	$(Q)gcc $(SANITIZE) $^ $(HOST_LIBS) -o $@

# The conformance suite's program (hosttest/firmware/conformance.c) on the ports that run here: docs/conformance.md
TEST_PROGRAMS += $(TEST)/conformance_linux $(TEST)/conformance_template
CONFORMANCE := hosttest/firmware/conformance.c port/template/i2c.c
$(TEST)/conformance_linux: $(patsubst %.c,$(TEST)/gcc64/obj/%.o,$(CONFORMANCE) hosttest/conformance_linux.c) \
    $(TEST)/gcc64/libport.a $(TEST)/gcc64/libcanopy.a
	$(Q)gcc $(SANITIZE) $^ $(HOST_LIBS) -o $@
$(TEST)/conformance_template: $(patsubst %.c,$(TEST)/gcc64/obj/%.o,$(sort $(CONFORMANCE) port/common/crash_record.c \
    $(wildcard port/template/*.c)) hosttest/conformance_stdio.c) $(TEST)/gcc64/libcanopy.a
	$(Q)gcc $(SANITIZE) $^ -o $@

.PHONY: test-programs test
test-programs: $(TEST_PROGRAMS)
test: test-programs tools all-firmware $(NODE) | setup-python setup-emulator  ## every test: host variants, Python, firmware in its emulators
	@BUILD=$(BUILD) hosttest/run

# ---------------------------------------------------------------------------------------------------------------------
# Firmware: for every board with a board.mk the station (boards/<board>/main.c), every unit list, and those programs of
# hosttest/firmware that the board.mk names. Boards of one family share ports, all share port/common; each has its own
# objects.

FIRMWARE_BOARDS := $(sort $(notdir $(patsubst %/board.mk,%,$(wildcard boards/*/board.mk))))
FW_FLAGS := -ffunction-sections -fdata-sections -fno-common -fstack-usage -fcallgraph-info=su $(WARN_GCC)
FW_LINK := -nostartfiles -Llinker -Wl,--gc-sections -Wl,--fatal-warnings

# image(board, stack bytes): the recipe that links $@ from $^ and keeps a map beside it
define image
	$(if $(V),,@echo "link $@")
	$(Q)$($(1)_LINK) -Wl,--defsym=canopy_stack_size=$(2) -Wl,-Map=$(@:.elf=.map) $(filter %.o,$^) $(filter %.a,$^) -lm -o $@
	$(Q)tools/flash_crc.py $@
	$(if $($(1)_FINISH),$(Q)$($(1)_FINISH) $@)
endef

# Of its ports a board takes every file, but board.c only of the first: the others' are for other boards.
other_board = $(if $(filter $(1),$(firstword $(BOARD_PORTS))),,port/$(1)/board.c)

# board_rules(board): after its board.mk has been read; every $(BOARD_...) is this board's
define board_rules
$(1)_LINK := $(BOARD_CROSS)gcc $(BOARD_CPU) $(BOARD_SPECS) $(FW_LINK) -Tlinker/$(BOARD_CHIP).ld
$(1)_SETUP := setup-$(BOARD_SETUP)
$(1)_FINISH := $(BOARD_FINISH)
$(1)_PARTS := $(patsubst %.c,$(BUILD)/$(1)/obj/%.o,$(sort \
    $(filter-out boards/$(1)/main.c,$(wildcard boards/common/*.c boards/$(1)/*.c)) \
    $(foreach p,common $(BOARD_PORTS),$(filter-out $(call other_board,$(p)),$(wildcard port/$(p)/*.c)))))
$(1)_STATIONS := $(patsubst %,$(BUILD)/$(1)/%.elf,$(if $(wildcard boards/$(1)/main.c),canopy $(BOARD_GRIDS:%=canopy-%)))
$(1)_UNITS := $(BOARD_UNITS:%=$(BUILD)/$(1)/%.elf)
$(1)_OTHERS := $(BOARD_PROGRAMS:%=$(BUILD)/$(1)/%.elf)
$(1)_FIRMWARE := $$($(1)_STATIONS) $$($(1)_UNITS) $$($(1)_OTHERS)

$(call compile,$(BUILD)/$(1),$(BOARD_CROSS)gcc,-Iboards/$(1) $(BOARD_CPU) $(BOARD_SPECS) $(BOARD_OPTIMISE) $(FW_FLAGS),setup-$(BOARD_SETUP))
$$($(1)_FIRMWARE): $(wildcard linker/*.ld) boards/$(1)/board.mk
$(BUILD)/$(1)/canopy.elf: $(BUILD)/$(1)/obj/boards/$(1)/main.o $$($(1)_PARTS) $(BUILD)/$(1)/libcanopy.a
	$$(call image,$(1),$(BOARD_STACK))
# the station for another grid: canopy-10x10.elf, and with another Q than 4: canopy-10x10x2.elf
$(BUILD)/$(1)/canopy-%.elf: $(BUILD)/$(1)/obj/boards/$(1)/main-%.o $$($(1)_PARTS) $(BUILD)/$(1)/libcanopy.a
	$$(call image,$(1),$(BOARD_STACK))
$(BUILD)/$(1)/obj/boards/$(1)/main-%.o: boards/$(1)/main.c | setup-$(BOARD_SETUP) $(GENERATED)
	@mkdir -p $$(@D)
	$$(Q)$(BOARD_CROSS)gcc $(CFLAGS_ALL) -Iboards/$(1) $(BOARD_CPU) $(BOARD_SPECS) $(BOARD_OPTIMISE) $(FW_FLAGS) \
	    -DSTATION_GRID_M=$$(word 1,$$(subst x, ,$$*)) -DSTATION_GRID_N=$$(word 2,$$(subst x, ,$$*)) \
	    $$(addprefix -DSTATION_CELLS=,$$(word 3,$$(subst x, ,$$*))) -c $$< -o $$@
$$($(1)_UNITS): $(BUILD)/$(1)/unit_%.elf: $(BUILD)/$(1)/obj/hosttest/unit/test_%.o \
    $(BUILD)/$(1)/obj/hosttest/unit/run_firmware.o $$($(1)_PARTS) $(BUILD)/$(1)/libcanopy.a
	$$(call image,$(1),16384)
$$($(1)_OTHERS): $(BUILD)/$(1)/%.elf: $(BUILD)/$(1)/obj/hosttest/firmware/%.o $$($(1)_PARTS) $(BUILD)/$(1)/libcanopy.a
	$$(call image,$(1),4096)
endef

define read_board
BOARD_FINISH :=
BOARD_UNITS := $(UNIT_NAMES)
BOARD_OPTIMISE := -Os
include boards/$(1)/board.mk
$$(eval $$(call board_rules,$(1)))
endef
$(foreach board,$(FIRMWARE_BOARDS),$(eval $(call read_board,$(board))))

FIRMWARE := $($(BOARD)_FIRMWARE)
ALL_FIRMWARE := $(foreach board,$(FIRMWARE_BOARDS),$($(board)_FIRMWARE))
# What is measured is measured of every board, unless one is asked for
BOARD_IS_GIVEN := $(filter command line environment,$(origin BOARD))
MEASURED_BOARDS := $(if $(BOARD_IS_GIVEN),$(filter $(BOARD),$(FIRMWARE_BOARDS)),$(FIRMWARE_BOARDS))
MEASURED := $(foreach board,$(MEASURED_BOARDS),$($(board)_STATIONS))

.PHONY: firmware all-firmware
firmware: $(FIRMWARE)  ## images for BOARD=x (default mps2_an385): build/<board>/*.elf
	$(if $(FIRMWARE),,@echo "firmware: BOARD=$(BOARD) has none")
all-firmware: $(ALL_FIRMWARE)  ## images for every board

# The RP2040's emulator comes from npm, into $(BUILD) and nowhere else
.PHONY: node
node: $(NODE)  ## what the RP2040's emulator needs from npm, into build/node
$(NODE): tools/rp2040/package.json tools/rp2040/package-lock.json | setup-node
	@mkdir -p $(@D)
	@cp $^ $(BUILD)/node
	@cd $(BUILD)/node && npm ci --ignore-scripts --no-audit --no-fund --no-update-notifier --loglevel=error --cache=cache
	@touch $@

# Against tools/budget.csv, with the difference to the last commit's values; RENEW=1 writes what is measured into it
BUDGET = $(if $(MEASURED_BOARDS),$(PYTHON) tools/budget.py $(1) --build $(BUILD) $(MEASURED_BOARDS:%=--board %) \
    $(if $(RENEW),--renew),echo "$(1): BOARD=$(BOARD) has no firmware")
PROGRAMS_COUNTED := $(foreach board,$(MEASURED_BOARDS),$(filter %/cycles.elf %/tight.elf,$($(board)_OTHERS)))
.PHONY: size stack cycles boards
size: $(MEASURED)  ## flash and RAM of the stations, all boards or BOARD=x; DETAILS=1: by section and by object
	@$(if $(DETAILS),$(PYTHON) tools/size.py $(MEASURED:.elf=.map))
	@$(call BUDGET,size)
stack: $(MEASURED)  ## their worst-case stack, from the call graph; DETAILS=1: the deepest paths
	@$(if $(DETAILS),$(PYTHON) tools/stack.py --calls tools/calls.txt $(MEASURED))
	@$(call BUDGET,stack)
cycles: $(MEASURED) $(PROGRAMS_COUNTED) | setup-emulator  ## instructions, counted in each board's emulator
	@$(call BUDGET,cycles)
cycles: $(if $(filter rp2040_pico,$(MEASURED_BOARDS)),$(NODE))
# Those that are asked for together go one after the other: each may write the table.
stack: | $(filter size,$(MAKECMDGOALS))
cycles: | $(filter size stack,$(MAKECMDGOALS))
boards:  ## the README's table of boards, from tools/budget.csv
	@$(PYTHON) tools/budget.py boards

# ---------------------------------------------------------------------------------------------------------------------
# Whole runs: scripts of tools/ that take what has been built

.PHONY: demo pictures bench
DEMO_IMAGE := $(filter %/canopy.elf,$($(BOARD)_STATIONS))
demo: tools $(DEMO_IMAGE) $(if $(filter rp2040_pico,$(BOARD)),$(NODE)) | setup-demo $(if $(DEMO_IMAGE),setup-emulator)
demo:  ## sweep a scene into the device and read the envelope as a PLC does: BOARD=x SCENE=file
	@BUILD=$(BUILD) $(PYTHON) tools/demo.py --board $(BOARD) $(if $(SCENE),--scene "$(SCENE)") $(DEMO)
pictures: tools | setup-demo  ## draw the README's pictures anew: build/pictures/*.png; docs/pictures has copies
	@BUILD=$(BUILD) tools/readme_pictures.sh $(BUILD)/pictures
bench: $(addprefix $(HOST)/canopy-,bench tightness bench-alglib bench-alphawrap) $(mps2_an385_STATIONS) $(mps2_an385_OTHERS)
bench: | setup-python setup-bench setup-emulator  ## compare with peers in one run: build/bench.json
	@BUILD=$(BUILD) $(PYTHON) tools/bench/bench.py $(BENCH)

# ---------------------------------------------------------------------------------------------------------------------
# Quality: style and rules, coverage, fuzzing

# What is formatted is everything; what is analysed is what ships. Shifts of negative numbers are what the library relies on:
# test_platform.c checks them on every compiler.
C_FILES := $(sort $(shell find lib port boards hosttest tools -name '*.[ch]' -o -name '*.inc'))
ANALYSED := $(filter-out tools/bench/%,$(C_FILES))
TIDY_HOST := $(filter lib/%.c port/linux/%.c boards/linux/%.c tools/%.c,$(ANALYSED))
CPPCHECK_FILES := $(filter-out hosttest/%,$(filter %.c,$(ANALYSED)))
TIDY_FLAGS := -std=c11 -I. -I$(BUILD)/gen $(HOST_DEFINES)

.PHONY: lint lint-format lint-rules lint-tidy lint-cppcheck
lint: lint-format lint-rules lint-tidy lint-cppcheck  ## format, clang-tidy, cppcheck, and the rules of the house
.PHONY: format
format: | setup-lint  ## lay out every C file as .clang-format says
	@clang-format -i $(C_FILES)
lint-format: | setup-lint
	@clang-format --dry-run -Werror $(C_FILES) && echo "format: $(words $(C_FILES)) files"
lint-rules: $(BUILD)/mps2_an385/libcanopy.a
	@$(PYTHON) tools/rules.py --archive $<
lint-tidy: $(GENERATED) | setup-lint
	@printf '%s\n' $(TIDY_HOST) | xargs -P $$(nproc) -n 1 sh -c 'clang-tidy --quiet "$$@" -- $(TIDY_FLAGS) 2>/dev/null' tidy \
	    && echo "clang-tidy: $(words $(TIDY_HOST)) files"
lint-cppcheck: $(GENERATED) | setup-lint
	@mkdir -p $(BUILD)/cppcheck
	@cppcheck --quiet -j $$(nproc) --std=c11 --language=c --enable=warning,performance,portability --inline-suppr \
	    --error-exitcode=1 --suppress=missingIncludeSystem --suppress=zerodivcond:lib/num/num_fx.h \
	    --suppress=shiftNegativeLHS --suppress=shiftNegative --cppcheck-build-dir=$(BUILD)/cppcheck -I. -I$(BUILD)/gen \
	    $(CPPCHECK_FILES) && echo "cppcheck: $(words $(CPPCHECK_FILES)) files"

COVERAGE := $(BUILD)/coverage
$(eval $(call variant,$(COVERAGE),gcc,--coverage,$(WARN_SANITIZED),run_cmocka,-lcmocka))
.PHONY: coverage
coverage: $(addprefix $(COVERAGE)/,$(UNIT_NAMES) $(HOSTTEST_NAMES)) | setup-coverage  ## what the C tests reach of lib/ and port/linux: build/coverage/index.html
	@find $(COVERAGE) -name '*.gcda' -delete
	@set -e; for program in $^; do $$program >$$program.log 2>&1 || { cat $$program.log; exit 1; }; done
	@gcovr --root . --object-directory $(COVERAGE) --filter lib/ --filter port/linux/ --branches \
	    --html-details $(COVERAGE)/index.html --print-summary --txt $(COVERAGE)/branches.txt >$(COVERAGE)/summary.txt
	@gcovr --root . --object-directory $(COVERAGE) --filter lib/ --filter port/linux/
	@tail -n 3 $(COVERAGE)/summary.txt; echo "$(COVERAGE)/index.html"

FUZZ := $(BUILD)/fuzz
FUZZ_FLAGS := -fsanitize=fuzzer-no-link,address,undefined -fno-sanitize-recover=all
$(eval $(call compile,$(FUZZ),clang,-O1 $(FUZZ_FLAGS) $(HOST_DEFINES) $(WARN_CLANG),setup-fuzz))
$(FUZZ)/fuzz_%: $(FUZZ)/obj/hosttest/fuzz_%.o $(FUZZ)/libtools.a $(FUZZ)/libcanopy.a
	$(Q)clang $(subst fuzzer-no-link,fuzzer,$(FUZZ_FLAGS)) $^ $(HOST_LIBS) -o $@
.PHONY: fuzz
fuzz: $(FUZZ_NAMES:%=$(FUZZ)/%)  ## fuzz each parser for SECONDS (default 60); finds are kept below build/fuzz
	@set -e; for program in $^; do mkdir -p $$program.corpus; echo "$$program for $(SECONDS) s"; \
	    $$program -max_total_time=$(SECONDS) -print_final_stats=1 -artifact_prefix=$$program- $$program.corpus \
	    >$$program.log 2>&1 || { tail -n 60 $$program.log; exit 1; }; \
	    grep -E 'number_of_executed_units|^Done' $$program.log; done

# ---------------------------------------------------------------------------------------------------------------------

.PHONY: all clean
all: tools test-programs all-firmware  ## build everything, run nothing
clean:  ## remove $(BUILD)
	rm -rf $(BUILD)

-include $(shell find -H $(BUILD) -name '*.d' 2>/dev/null)
