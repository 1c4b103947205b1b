"""How to run an image on each board's emulator: the one place that knows.

    argv(board, image, serials)        the command; `serials` are the board's lines 0, 1 and its console
    argv(board, image, ..., counting=True)   with repeatable instruction counts
    argv(board, image, ..., extra=[...])     with more of this emulator's own arguments

A serial is "null", "stdio" or "unix:PATH,server=on,wait=on" (on QEMU's boards also "pty"), as QEMU has them. The image ends
the emulator itself by canopy_board_exit (port/board.h): exit status 0 if it was good.
"""

from pathlib import Path

HERE = Path(__file__).resolve().parent
QUIET = ["-display", "none", "-monitor"]
SEMIHOSTING = ["-semihosting-config", "enable=on,target=native"]


def qemu(program, machine):
    def argv(image, serials, counting, monitor, extra):
        lines = [word for serial in serials for word in ("-serial", serial)]
        return [program, "-M", machine, *QUIET, monitor, *lines, *SEMIHOSTING,
                *(["-icount", "shift=0"] if counting else []), *extra, "-kernel", str(image)]
    return argv


def virt(image, serials, counting, monitor, extra):
    """One UART: line 0. Line 1 is there for who connects to it and leads nowhere; the console is semihosting's."""
    lines = []
    for number, serial in enumerate(serials):
        kind, _, rest = serial.partition(":")
        backend = {"unix": f"socket,path={rest}", "file": f"file,path={rest}"}.get(kind, kind)
        lines += ["-chardev", f"{backend},id=serial{number}"]
    return ["qemu-system-riscv32", "-M", "virt", "-bios", "none", *QUIET, monitor, *lines, "-serial", "chardev:serial0",
            "-semihosting-config", "enable=on,target=native,chardev=serial2",
            *(["-icount", "shift=0"] if counting else []), *extra, "-kernel", str(image)]


def rp2040(image, serials, counting, monitor, extra):
    """Debian's QEMU has no RP2040: npm's rp2040js and tools/rp2040. Its console is line 1 as well."""
    lines = [word for serial in serials for word in ("--serial", serial)]
    modules = Path(image).resolve().parent.parent / "node"
    return ["env", f"CANOPY_NODE={modules}", "node", str(HERE / "rp2040" / "run.mjs"), str(image), *lines,
            "--monitor", monitor, *(["--count"] if counting else []), *extra]


BOARDS = {
    "mps2_an385": qemu("qemu-system-arm", "mps2-an385"),
    "mps2_an386": qemu("qemu-system-arm", "mps2-an386"),
    "mps2_an500": qemu("qemu-system-arm", "mps2-an500"),
    "riscv_virt": virt,
    "rp2040_pico": rp2040,
}

CONSOLE_ONLY = ("null", "null", "stdio")


def argv(board, image, serials=CONSOLE_ONLY, counting=False, monitor="none", extra=()):
    return BOARDS[board](image, serials, counting, monitor, extra)
