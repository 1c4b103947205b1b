"""The house itself: a failing test must be seen as failed by each runner, and the guards of the build must bite."""

import importlib.machinery
import importlib.util
import json
import os
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BUILD = Path(os.environ.get("CANOPY_BUILD", "build"))

FAILING = """
#include "hosttest/unit/unit.h"
static int32_t square(int32_t x) { CHECK(x < 10); return x * x; }
UNIT(passes) { CHECK_EQ(square(3), 9); CHECK_NEAR(0.5f, 0.5, 0); CHECK_BYTES("ab", "ab", 2); }
UNIT(condition) { (void)square(10); }
UNIT(integers) { CHECK_EQ(-7, 8); }
UNIT(numbers) { CHECK_NEAR(1.5, 2.5, 0.5); }
UNIT(not_a_number) { const double zero = 0; CHECK_NEAR(zero / zero, 1, 1e30); }
UNIT(bytes) { CHECK_BYTES("ab", "ac", 2); }
UNIT(passes_too) { CHECK(true); }
UNIT_LIST(failing, passes, condition, integers, numbers, not_a_number, bytes, passes_too)
"""
DYING = """
#include "hosttest/unit/unit.h"
UNIT(passes) { CHECK(true); }
UNIT(dies) { *(volatile uint32_t *)(uintptr_t)0xF0000000u = 1; }
UNIT(never_runs) { CHECK(true); }
UNIT_LIST(dying, passes, dies, never_runs)
"""
HEAP = """
#include <stdlib.h>
int main(void) { return malloc(4) != NULL; }
"""


def load(path):
    loader = importlib.machinery.SourceFileLoader(f"canopy_{path.stem}", str(path))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(loader.name, loader))
    loader.exec_module(module)
    return module


def runner():
    return load(ROOT / "hosttest" / "run")


def build(scratch, kind, text):
    """Compiles a list for one runner; returns the command that runs it."""
    source, program = scratch / "test_list.c", scratch / f"list_{kind}"
    source.write_text(text)
    if kind == "firmware":
        objects = [str(path) for folder in ("port", "boards") for path in (BUILD / "mps2_an385/obj" / folder).rglob("*.o")
                   if not path.name.startswith("main")]
        command = ["arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", "-nostartfiles", "--specs=nano.specs",
                   f"-L{ROOT}/linker", f"-T{ROOT}/linker/mps2.ld", "-Wl,--gc-sections",
                   "-Wl,--defsym=canopy_stack_size=4096", *objects]
    else:
        command = ["gcc"] + (["-m32"] if kind == "plain" else [])
    if text != HEAP:
        command.append(str(ROOT / f"hosttest/unit/run_{kind}.c"))
    command += ["-std=c11", "-Os", f"-I{ROOT}", str(source), "-o", str(program)]
    if kind == "cmocka":
        command.append("-lcmocka")
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(done.stderr)
    return load(ROOT / "tools/emulator.py").argv("mps2_an385", program) if kind == "firmware" else [str(program)]


@pytest.mark.parametrize("kind", ["cmocka", "plain", "firmware"])
def test_failed_checks_are_seen_and_the_rest_goes_on(tmp_path, kind):
    result = runner().run_program("job", build(tmp_path, kind, FAILING))
    assert result.passed == ["job: passes", "job: passes_too"]
    assert result.failed == ["job: condition", "job: integers", "job: numbers", "job: not_a_number", "job: bytes"]
    assert "test_list.c:3: x < 10" in result.output
    assert "-7 is not 8" in result.output


@pytest.mark.parametrize("kind", ["cmocka", "plain", "firmware"])
def test_a_list_that_dies_has_failed(tmp_path, kind):
    result = runner().run_program("job", build(tmp_path, kind, DYING))
    assert "job: passes" in result.passed
    assert "job: dies" not in result.passed
    assert result.failed


def test_a_program_without_tests_has_failed():
    assert runner().run_program("job", ["true"]).failed == ["job: (ran no test)"]
    assert runner().run_program("job", ["echo", "1..0"]).failed == ["job: (ran no test)"]


def test_a_heap_does_not_link(tmp_path):
    with pytest.raises(RuntimeError, match="sbrk|heap"):
        build(tmp_path, "firmware", HEAP)


def test_make_alone_lists_the_targets():
    done = subprocess.run(["make", "-s"], cwd=ROOT, capture_output=True, text=True, check=True)
    names = [line.split()[1] for line in done.stdout.splitlines()]
    for name in "demo test bench firmware size stack cycles boards lint coverage fuzz clean all tools".split():
        assert name in names


def test_setup_refuses_what_it_does_not_know():
    done = subprocess.run([ROOT / "tools/setup", "nonsense"], capture_output=True, text=True)
    assert done.returncode == 64 and "nonsense" in done.stderr


def test_setup_is_silent_when_all_is_there():
    done = subprocess.run([ROOT / "tools/setup", "host", "test"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


CALLS = """
#include <stdint.h>
static volatile uint32_t sink;
__attribute__((noinline)) static void leaf(uint32_t x) { volatile uint32_t bulk[100]; bulk[x % 100] = x; sink = bulk[0]; }
__attribute__((noinline)) static void shallow(uint32_t x) { sink = x; }
#ifdef RECURSION
__attribute__((noinline)) static uint32_t again(uint32_t x) { return x == 0 ? 0 : 1 + sink * again(x - 1); }
#endif
struct hook { void (*act)(uint32_t x); } volatile hook = {shallow};
int main(void) {
    for (;;) {
        if (sink) leaf(sink);
#ifdef POINTER
        hook.act(sink);
#endif
#ifdef RECURSION
        sink = again(sink);
#endif
    }
}
"""


def stack_of(scratch, defines, table):
    """Runs tools/stack.py on a small image; returns what it did."""
    source, image = scratch / "calls.c", scratch / "calls.elf"
    (scratch / "obj").mkdir(exist_ok=True)
    source.write_text(CALLS)
    (scratch / "table.txt").write_text((ROOT / "tools/calls.txt").read_text() + table)
    flags = ["-mcpu=cortex-m3", "-mthumb", "-Os", "-ffunction-sections", "-fcallgraph-info=su", f"-I{ROOT}"]
    objects = [str(path) for folder in ("port", "boards") for path in (BUILD / "mps2_an385/obj" / folder).rglob("*.o")
               if not path.name.startswith("main")]
    subprocess.run(["arm-none-eabi-gcc", *flags, *defines, "-c", str(source), "-o", str(scratch / "obj/calls.o")], check=True,
                   cwd=scratch)
    subprocess.run(["arm-none-eabi-gcc", *flags, "-nostartfiles", "--specs=nano.specs", f"-L{ROOT}/linker",
                    f"-T{ROOT}/linker/mps2.ld", "-Wl,--gc-sections", "-Wl,--defsym=canopy_stack_size=1024",
                    f"-Wl,-Map={scratch}/calls.map", str(scratch / "obj/calls.o"), *objects, "-o", str(image)], check=True)
    return subprocess.run(["/usr/bin/python3", ROOT / "tools/stack.py", "--calls", scratch / "table.txt", "--json",
                           scratch / "stack.json", image], capture_output=True, text=True, cwd=ROOT)


def test_stack_adds_up_the_deepest_path(tmp_path):
    done = stack_of(tmp_path, [], "")
    assert done.returncode == 0, done.stderr
    parts = json.loads((tmp_path / "stack.json").read_text())["calls"]["parts"]
    assert 400 + 8 <= parts["program"] <= 400 + 60
    assert 36 < parts["interrupt"] < 200 and 36 < parts["fault or watchdog"] < 200


def test_stack_follows_pointers_by_the_table_alone(tmp_path):
    refused = stack_of(tmp_path, ["-DPOINTER"], "")
    assert refused.returncode == 1 and "call through 'act'" in refused.stderr
    assert stack_of(tmp_path, ["-DPOINTER"], "call act -> shallow\n").returncode == 0


def test_stack_refuses_recursion(tmp_path):
    done = stack_of(tmp_path, ["-DRECURSION"], "")
    assert done.returncode == 1 and "recursion: again -> again" in done.stderr


def test_size_adds_up_to_the_sections():
    image = BUILD / "mps2_an385/conformance.elf"
    sections, owners = load(ROOT / "tools/size.py").read(image.with_suffix(".map"))
    table = subprocess.run(["arm-none-eabi-size", "-A", image], capture_output=True, text=True, check=True).stdout
    for row in table.splitlines():
        words = row.split()
        if words and words[0] in (".text", ".data", ".bss", ".noinit", ".stack"):
            assert sections[words[0]] == int(words[1])
    text = sum(parts.get(".text", 0) for parts in owners.values())
    assert abs(text / sections[".text"] - 1) < 0.02, "padding and merged strings aside, every byte has an owner"


@pytest.mark.parametrize("room, system, name, right", [
    ("plc", False, "lib/cover/envelope.h", True), ("cover", False, "lib/plc/plc.h", False),
    ("scan", False, "lib/modbus/rtu.h", False), ("num", True, "stdio.h", False), ("num", True, "stdint.h", True),
    ("plc", False, "port/linux/clock.h", False), ("plc", False, "plc.h", False),
])
def test_rooms_include_only_what_stands_below(room, system, name, right):
    rules = load(ROOT / "tools/rules.py")
    assert (rules.check_library_include(ROOT / "lib" / room / "x.c", system, name) is None) == right


def test_rules_see_a_heap():
    rules = load(ROOT / "tools/rules.py")
    assert rules.FORBIDDEN.search(rules.without_comments("x = malloc(4);"))
    assert not rules.FORBIDDEN.search(rules.without_comments("// no malloc(4) here\n\"printf(\""))


def test_the_fixed_point_library_is_freestanding(tmp_path):
    """All but the float path compiles without a hosted C library, and what it then still asks for are the four functions
    that GCC may call by itself, a comparison of strings, and 64-bit division. What it calls of the float path asks no more."""
    allowed = {"memcpy", "memmove", "memset", "memcmp", "strcmp", "__aeabi_ldivmod", "__aeabi_uldivmod"}
    sources = [path for path in sorted((ROOT / "lib").glob("*/*.c")) if not path.stem.endswith("_f32")]
    assert len(sources) > 20
    objects = []
    for path in sources:
        objects.append(tmp_path / f"{path.parent.name}_{path.stem}.o")
        subprocess.run(["arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", "-std=c11", "-ffreestanding", "-Os", "-Wall",
                        "-Wextra", "-Wdouble-promotion", "-Werror", f"-I{ROOT}", f"-I{BUILD}/gen", "-c", path,
                        "-o", objects[-1]], check=True)
        names = subprocess.run(["arm-none-eabi-nm", "-u", objects[-1]], check=True, capture_output=True, text=True).stdout
        wanted = {row.split()[-1] for row in names.splitlines() if row.strip()}
        assert not {name for name in wanted if not name.startswith("canopy_")} - allowed, path
    whole = tmp_path / "whole.o"
    archive = BUILD / "mps2_an385" / "libcanopy.a"
    subprocess.run(["arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", "-nostdlib", "-r", *objects, archive, "-lgcc",
                    "-o", whole], check=True)
    names = subprocess.run(["arm-none-eabi-nm", "-u", whole], check=True, capture_output=True, text=True).stdout
    assert {row.split()[-1] for row in names.splitlines()} <= allowed


@pytest.mark.parametrize("board", ["mps2_an386", "mps2_an500"])
def test_floating_point_is_single_precision(board):
    """These boards' units have no other (the Cortex-M7's may): no instruction on doubles, none in software."""
    image = BUILD / board / "canopy.elf"
    code = subprocess.run(["arm-none-eabi-objdump", "-d", image], check=True, capture_output=True, text=True).stdout
    assert "vfma.f32" in code and ".f64" not in code
    names = subprocess.run(["arm-none-eabi-nm", image], check=True, capture_output=True, text=True).stdout.split()
    assert not [name for name in names if re.match(r"__(aeabi_(d|[a-z]+2d$|[a-z]+2f$|f)|\w+[ds]f[23]$)", name)]


def test_interrupts_of_a_board_with_floating_point_push_its_registers():
    found = subprocess.run(["/usr/bin/python3", ROOT / "tools/stack.py", "--calls", ROOT / "tools/calls.txt",
                            BUILD / "mps2_an500" / "canopy.elf", BUILD / "mps2_an385" / "canopy.elf"], cwd=ROOT,
                           check=True, capture_output=True, text=True).stdout
    assert found.count("(108 of it pushed by the processor)") == found.count("(36 of it pushed by the processor)") == 2


def test_a_board_that_is_none_is_named():
    done = subprocess.run(["make", "-n", "-C", ROOT, "firmware", "BOARD=nope"], capture_output=True, text=True)
    assert done.returncode != 0 and "BOARD=nope is no board: give one of linux mps2_an385" in done.stderr
