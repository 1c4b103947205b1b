"""The RP2040 emulator itself (tools/rp2040): hosttest/rp2040_emulator.mjs has the tests, and this runs them."""

import os
import subprocess
from pathlib import Path

from running import BUILD

HERE = Path(__file__).resolve().parent


def test_the_emulator_computes_and_notices():
    environment = {**os.environ, "CANOPY_NODE": str((BUILD / "node").resolve())}
    done = subprocess.run(["node", HERE / "rp2040_emulator.mjs"], env=environment, stdin=subprocess.DEVNULL,
                          capture_output=True, text=True, timeout=100)
    lines = done.stdout.splitlines()
    promised = int(lines[0].removeprefix("1..")) if lines else 0
    passed = [line for line in lines if line.startswith("ok ")]
    assert done.returncode == 0 and promised > 10 and len(passed) == promised, done.stdout + done.stderr
