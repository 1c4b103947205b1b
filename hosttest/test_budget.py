"""Budgets are checked: one that is too small fails, one that is missing too, and what the README says is what the table says."""

import csv
import os
import re
import subprocess
from pathlib import Path

import pytest

import stack

ROOT = Path(__file__).resolve().parent.parent
BUILD = Path(os.environ.get("CANOPY_BUILD", "build"))
BUILD = BUILD if BUILD.is_absolute() else ROOT / BUILD
TABLE = ROOT / "tools" / "budget.csv"
BOARDS = sorted(path.parent.name for path in (ROOT / "boards").glob("*/board.mk") if (path.parent / "main.c").exists())
BOARD = "mps2_an385"


def rows():
    with open(TABLE, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def doctored(scratch, change):
    """A copy of the table, in a directory that is no repository; change(row) may change a row, or drop it by False."""
    path = scratch / "budget.csv"
    kept = [row for row in rows() if change(row) is not False]
    path.write_text("\n".join([",".join(kept[0]), *(",".join(row.values()) for row in kept)]) + "\n")
    return path


def budget(*arguments):
    return subprocess.run(["/usr/bin/python3", ROOT / "tools/budget.py", *map(str, arguments)], capture_output=True, text=True)


def size_of(table, *more):
    return budget("size", "--build", BUILD, "--board", BOARD, "--table", table, *more)


def is_flash(row):
    return (row["board"], row["image"], row["quantity"]) == (BOARD, "canopy", "flash")


def flash_with(**values):
    return lambda row: row.update(values) if is_flash(row) else None


def test_what_fits_passes_and_a_budget_that_is_too_small_fails(tmp_path):
    assert size_of(doctored(tmp_path, lambda row: None)).returncode == 0
    done = size_of(doctored(tmp_path, flash_with(budget="1000")))
    assert done.returncode == 1 and "OVER BUDGET" in done.stdout
    assert re.search(rf"^budget: {BOARD} canopy flash: [\d,]+ of 1,000, [\d,]+ over its budget$", done.stderr, re.M)


def test_one_byte_decides(tmp_path):
    done = size_of(doctored(tmp_path, lambda row: None))
    used = int(re.search(rf"^{BOARD} +canopy +flash +([\d,]+)", done.stdout, re.M).group(1).replace(",", ""))
    for allowed, status in ((used, 0), (used - 1, 1)):
        table = doctored(tmp_path, flash_with(budget=str(allowed)))
        assert size_of(table).returncode == status


def test_an_image_without_a_budget_fails_and_so_does_a_budget_without_an_image(tmp_path):
    done = size_of(doctored(tmp_path, lambda row: not is_flash(row)))
    assert done.returncode == 1 and f"{BOARD} canopy flash: " in done.stderr and "no budget" in done.stderr
    done = size_of(doctored(tmp_path, flash_with(image="canopy-7x7")))
    assert done.returncode == 1 and f"{BOARD} canopy-7x7 flash: has a budget and was not measured" in done.stderr


@pytest.mark.parametrize("text, place", [("nonsense\n", ":1:"), ("board,image,quantity,budget,measured\na,b,weight,1,\n", ":2:"),
                                         ("board,image,quantity,budget,measured\na,b,flash,much,\n", ":2:"),
                                         ("board,image,quantity,budget,measured\na,b,ram,1,\na,b,ram,2,\n", ":3:")])
def test_a_table_that_is_none_is_named(tmp_path, text, place):
    (tmp_path / "budget.csv").write_text(text)
    done = size_of(tmp_path / "budget.csv")
    assert done.returncode == 2 and f"budget.csv{place}" in done.stderr and len(done.stderr.splitlines()) == 1


def test_the_difference_is_to_the_last_commit_and_renewing_writes_the_values(tmp_path):
    git = ["git", "-C", tmp_path, "-c", "user.name=test", "-c", "user.email=test@example.org"]
    path = doctored(tmp_path, lambda row: row.update(measured="1000"))
    subprocess.run([*git, "init", "-q"], check=True)
    subprocess.run([*git, "add", "budget.csv"], check=True)
    subprocess.run([*git, "commit", "-q", "-m", "values"], check=True)
    done = size_of(path, "--renew")
    used = int(re.search(rf"^{BOARD} +canopy +flash +([\d,]+)", done.stdout, re.M).group(1).replace(",", ""))
    assert f"{used},{used}" not in path.read_text() and re.search(rf"^{BOARD},canopy,flash,\d+,{used}$", path.read_text(), re.M)
    for again in (done, size_of(path)):  # the file has them now, the commit has not
        change = re.search(rf"^{BOARD} +canopy +flash .*?(\S+)$", again.stdout, re.M).group(1)
        assert change == f"+{used - 1000:,}"


def test_every_board_has_its_budgets():
    """The numbers that are promised: nobody may promise less by a larger budget."""
    have = {(row["board"], row["image"], row["quantity"]): int(row["budget"]) for row in rows()}
    for board in BOARDS:
        for image in ("canopy", "canopy-10x10"):
            if board not in ("mps2_an386", "mps2_an500"):  # which have megabytes, and tighten
                assert have[board, image, "flash"] <= 65536 and have[board, image, "ram"] <= 49152
            assert have[board, image, "stack"] <= 4096 and have[board, image, "boot"] <= 250_000
        assert {"feed", "line", "refit_10x10", "refit_20x20", "request"} <= {key[2] for key in have if key[0] == board}
    most = {"mps2_an385": (45, 4_000_000), "rp2040_pico": (100, 20_000_000)}
    for board, (feed, refit) in most.items():
        assert have[board, "cycles", "feed"] <= feed and have[board, "cycles", "refit_20x20"] <= refit


def test_no_image_has_a_heap():
    for board in BOARDS:
        images = sorted((BUILD / board).glob("*.elf"))
        assert images
        for image in images:
            names = subprocess.run(["nm", image], check=True, capture_output=True, text=True).stdout.split()
            assert not {name for name in names if re.fullmatch(r"_*(malloc|calloc|realloc|free|sbrk)(_r)?", name)}, image


def test_constants_behind_the_code_are_no_code():
    """libgcc's last function calls nothing, whatever the bytes behind it would mean."""
    image = stack.Image(BUILD / "riscv_virt" / "canopy.elf")
    assert image.instructions("__udivdi3")[1] == set()
    assert stack.Image(BUILD / BOARD / "canopy.elf").instructions("memcpy")[1] == set()


def test_the_readme_shows_the_table():
    done = budget("boards", "--check")
    assert done.returncode == 0, done.stderr


def test_a_readme_of_other_values_is_out_of_date(tmp_path):
    readme = tmp_path / "README.md"
    readme.write_text((ROOT / "README.md").read_text())
    table = doctored(tmp_path, flash_with(measured="65000"))
    assert budget("boards", "--check", "--table", table, "--readme", readme).returncode == 2
    assert budget("boards", "--table", table, "--readme", readme).returncode == 0
    assert "63.5 KB" in readme.read_text() and budget("boards", "--check", "--table", table, "--readme", readme).returncode == 0
