"""docs/porting.md, followed literally: its first commands make a board that links; the template compiles everywhere."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "porting.md").read_text()
WARN = ["-std=c11", "-Wall", "-Wextra", "-Wconversion", "-Wsign-conversion", "-Wshadow", "-Wdouble-promotion", "-Wvla", "-Werror"]
# make's own variables of the run around this one are not for the tree's
ENVIRONMENT = {name: value for name, value in os.environ.items() if name not in ("BUILD", "BOARD", "MAKEFLAGS", "MFLAGS")}
COMPILERS = {
    "gcc": ["gcc", "-Wcast-align=strict"],
    "gcc32": ["gcc", "-m32"],
    "clang": ["clang"],
    "clang32": ["clang", "-m32"],
    "cortex-m0plus": ["arm-none-eabi-gcc", "-mcpu=cortex-m0plus", "-mthumb", "-Wcast-align=strict"],
    "cortex-m7": ["arm-none-eabi-gcc", "-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-sp-d16"],
    "rv32imac": ["riscv64-unknown-elf-gcc", "-march=rv32imac", "-mabi=ilp32", "-misa-spec=2.2", "--specs=picolibc.specs"],
}


def commands(heading):
    """The indented lines of the first block below a heading."""
    section = PAGE.split(f"\n## {heading}\n", 1)[1]
    return re.search(r"^(?:    .*\n)+", section, re.M).group(0).replace("\n    ", "\n").strip()


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A copy of what a board is built from."""
    place = tmp_path_factory.mktemp("tree")
    shutil.copy(ROOT / "Makefile", place)
    for name in ("lib", "port", "boards", "linker", "tools", "hosttest"):
        shutil.copytree(ROOT / name, place / name, ignore=shutil.ignore_patterns("__pycache__"))
    return place


def test_the_first_commands_make_a_board(tree):
    done = subprocess.run(["sh", "-ec", commands("1. Begin")], cwd=tree, env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    image = tree / "build" / "mine" / "canopy.elf"
    names = subprocess.run(["arm-none-eabi-nm", image], check=True, capture_output=True, text=True).stdout
    for name in ("canopy_reset", "canopy_stack_limit", "canopy_device_step"):
        assert re.search(rf" {name}$", names, re.M), name
    assert not re.search(r" U ", names)


def test_an_image_that_is_too_large_says_by_how_much(tree):
    script = tree / "linker" / "mychip.ld"
    text = script.read_text()
    script.write_text(text.replace("LENGTH = 64K", "LENGTH = 16K"))
    done = subprocess.run(["make", "firmware", "BOARD=mine"], cwd=tree, env=ENVIRONMENT, capture_output=True, text=True)
    script.write_text(text)
    assert done.returncode != 0
    assert re.search(r"region `FLASH' overflowed by \d{4,5} bytes", done.stderr), done.stderr[-2000:]


@pytest.mark.parametrize("compiler", COMPILERS)
def test_the_template_compiles(compiler, tmp_path):
    for source in sorted((ROOT / "port" / "template").glob("*.c")) + sorted((ROOT / "port" / "common").glob("*.c")):
        done = subprocess.run([*COMPILERS[compiler], *WARN, f"-I{ROOT}", "-c", source, "-o", tmp_path / "out.o"],
                              capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


def test_every_name_of_the_linker_is_on_the_page():
    names = set(re.findall(r"\bcanopy_\w+", (ROOT / "linker" / "sections.ld").read_text())) - {"canopy_reset"}
    assert names and not [name for name in names if f"`{name}`" not in PAGE]


def test_every_path_of_the_page_is_there():
    links = re.findall(r"\]\((\S+?)\)", PAGE)
    assert links and not [link for link in links if not (ROOT / "docs" / link).exists()]
    named = {path for path in re.findall(r"`((?:lib|port|boards|linker|hosttest|tools)/[\w./]+)`", PAGE)
             if "mine" not in path and "mychip" not in path}
    assert named and not [path for path in named if not (ROOT / path).exists()]
