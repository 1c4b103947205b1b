"""The house itself: a failing test must be seen as failed by each runner, and the guards of the build must bite."""

import importlib.machinery
import importlib.util
import os
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


def runner():
    path = str(ROOT / "hosttest" / "run")
    loader = importlib.machinery.SourceFileLoader("canopy_run", path)
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("canopy_run", loader))
    loader.exec_module(module)
    return module


def build(scratch, kind, text):
    """Compiles a list for one runner; returns the command that runs it."""
    source, program = scratch / "test_list.c", scratch / f"list_{kind}"
    source.write_text(text)
    if kind == "firmware":
        objects = [str(path) for folder in ("port", "boards") for path in (BUILD / "mps2_an385/obj" / folder).rglob("*.o")
                   if path.name != "main.o"]
        command = ["arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", "-nostartfiles", "--specs=nano.specs",
                   f"-L{ROOT}/linker", f"-T{ROOT}/linker/mps2_an385.ld", "-Wl,--gc-sections",
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
    return (runner().QEMU if kind == "firmware" else []) + [str(program)]


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
    for name in "demo test bench firmware size stack lint coverage fuzz clean all tools".split():
        assert name in names


def test_setup_refuses_what_it_does_not_know():
    done = subprocess.run([ROOT / "tools/setup", "nonsense"], capture_output=True, text=True)
    assert done.returncode == 64 and "nonsense" in done.stderr


def test_setup_is_silent_when_all_is_there():
    done = subprocess.run([ROOT / "tools/setup", "host", "test"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
