#!/usr/bin/python3
"""The whole way, from a scanner to a PLC: a scene is swept into a device, and the PLC's view of it is checked.

Usage: [BUILD=dir] tools/demo.py [--board NAME] [--scene POINTS] [--unit U] [--short]

A scanner simulator sweeps the scene profile by profile and serves it over Modbus; the device (the firmware on an
emulated chip, or canopyd) reads it, covers it and publishes envelopes; a PLC client reads those. (riscv_virt is its
own scanner; what it plays to itself is known: tools/sweep.py.) In the end the envelope that the PLC holds is checked
against every reading the simulator has served, and drawn; then beside what the
tight method makes of the same readings on a host. Everything is left in BUILD/demo. Exit status: 0 the PLC's envelope is
safe; 1 anything else, with one line that says what, where, and what to do.
"""

import argparse
import ctypes
import json
import os
import re
import select
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import emulator
import sweep as built_in

ROOT = Path(__file__).resolve().parent.parent
BUILD = Path(os.environ.get("BUILD", "build"))
BUILD = BUILD if BUILD.is_absolute() else ROOT / BUILD
START_SECONDS = 30  # for a program to say that it is there
STALL_SECONDS = 30  # without a new profile
TIGHT_SECONDS = 10  # without a new envelope: a device that tightens in its spare time has ended, or gains nothing …
TIGHT_MOST = 60  # … and this is long enough in any case
SETTLE_SECONDS = 30  # from the last profile to an envelope that covers it
SHORT = {"rows": 40, "columns": 60}
BOARDS = {"mps2_an385": "Cortex-M3 firmware in QEMU (mps2-an385)",
          "mps2_an386": "Cortex-M4 firmware in QEMU (mps2-an386), in float",
          "mps2_an500": "Cortex-M7 firmware in QEMU (mps2-an500), in float", "linux": "canopyd on this machine",
          "riscv_virt": "RV32IMAC firmware in QEMU (virt)",
          "rp2040_pico": "Cortex-M0+ firmware on an RP2040 in rp2040js"}


class Failure(Exception):
    """What went wrong, where, and what to do."""


def shown(path):
    """A path as a person would type it."""
    try:
        return os.path.relpath(path)
    except ValueError:
        return str(path)


# ---------------------------------------------------------------------------------------------------------------------
# Children

def die_with_parent():
    """In the child: should this program be killed, it is killed too."""
    ctypes.CDLL(None, use_errno=True).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


class Child:
    """A program under way; its standard error goes to a log, its standard output is read line by line."""

    def __init__(self, name, command, log):
        self.name, self.log, self.rest = name, log, b""
        self.errors = open(log, "wb")
        try:
            self.process = subprocess.Popen([str(word) for word in command], stdin=subprocess.DEVNULL,
                                            stdout=subprocess.PIPE, stderr=self.errors, preexec_fn=die_with_parent)
        except OSError as error:
            raise Failure(f"{command[0]}: {error.strerror}: run it by 'make demo', which builds it") from error

    def last_words(self):
        lines = self.log.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it said nothing"

    def failure(self, what):
        return Failure(f"{self.name} {what}: {self.last_words()} (all of it in {shown(self.log)})")

    def check(self):
        if self.process.poll() is not None:
            raise self.failure(f"ended with status {self.process.returncode}")

    def line(self, seconds):
        """The next line, None if none is whole within the time."""
        end = time.monotonic() + seconds
        while b"\n" not in self.rest:
            left = end - time.monotonic()
            piece = b""
            if select.select([self.process.stdout], [], [], max(left, 0))[0]:
                piece = os.read(self.process.stdout.fileno(), 65536)
            if not piece:  # the time is over, or the program
                time.sleep(max(min(left, 0.05), 0))
                return None
            self.rest += piece
        line, self.rest = self.rest.split(b"\n", 1)
        return line.decode(errors="replace")

    def wait_for(self, pattern, seconds=START_SECONDS):
        """The match of the next line that has the pattern."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            line = self.line(0.2)
            found = line is not None and re.search(pattern, line)
            if found:
                return found
            if line is None:
                self.check()
        raise self.failure(f"did not say '{pattern}' within {seconds} s")

    def stop(self):
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(5)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self.process.stdout.close()
        self.errors.close()
        return self.process.returncode


class Children:
    """All of them, in the order they were started; none outlives this program."""

    def __init__(self, place):
        self.place, self.running = place, []

    def start(self, name, command):
        child = Child(name, command, self.place / f"{name}.log")
        self.running.append(child)
        return child

    def check(self):
        for child in self.running:
            child.check()

    def stop(self):
        while self.running:
            self.running.pop().stop()


def run(name, command):
    """A program to its end: (status, output)."""
    try:
        done = subprocess.run([str(word) for word in command], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, errors="replace")
    except OSError as error:
        raise Failure(f"{name}: {command[0]}: {error.strerror}: run it by 'make demo', which builds it") from error
    return done.returncode, done.stdout.strip()


# ---------------------------------------------------------------------------------------------------------------------
# Devices: where the scanner and the PLC client connect to

def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Emulated:
    """The firmware in its emulator, a pseudo-terminal for each of its lines."""

    board, lines = "mps2_an385", 2
    tightens = False  # what it has published, when there is nothing else to do

    def __init__(self, children):
        self.name = BOARDS[self.board]
        image = BUILD / self.board / "canopy.elf"
        if not image.exists():
            raise Failure(f"{shown(image)} is not there: make firmware BOARD={self.board}")
        self.console = children.place / "console.txt"
        self.console.write_bytes(b"")
        serials = ["pty" if i < self.lines else "null" for i in range(2)]
        self.children = children
        self.command = emulator.argv(self.board, image, (*serials, f"file:{self.console}"))
        if shutil.which(self.program) is None:
            raise Failure(f"{self.program} is not installed: tools/setup emulator node")
        self.prepare()

    @property
    def program(self):
        return next(word for word in self.command if word != "env" and "=" not in word)

    def prepare(self):
        self.start()

    def start(self):
        child = self.children.start("device", self.command)
        self.connect([child.wait_for(rf"redirected to (\S+) \(label serial{i}\)").group(1) for i in range(self.lines)])

    def connect(self, lines):
        self.scanner_line = f"rtu:{lines[0]},115200,8N1,1"
        self.plc_url = f"rtu:{lines[1]},115200,8N1,1"
        self.wires = f"scanner on UART 0 ({lines[0]}), PLC on UART 1 ({lines[1]}), both Modbus RTU"

    def begin(self, scanner_device):
        """The firmware has begun by itself."""

    def check(self):
        text = self.console.read_text(errors="replace")
        if "crash" in text or text.count(" starts") > 1:
            raise Failure(f"the firmware has started anew (its words in {shown(self.console)}): "
                          "that is a defect of canopy")


class M4(Emulated):
    board, tightens = "mps2_an386", True


class M7(Emulated):
    board, tightens = "mps2_an500", True


class Virt(Emulated):
    """One line, the PLC's; the scanner is built in."""

    board, lines = "riscv_virt", 1

    def connect(self, lines):
        self.scanner_line = None
        self.plc_url = f"rtu:{lines[0]},115200,8N1,1"
        self.wires = f"scanner built in, PLC on the UART ({lines[0]}, Modbus RTU)"


class Pico(Emulated):
    """The scanner is a device on I2C, which shows what the simulator serves by Modbus TCP: so the simulator is first."""

    board, lines = "rp2040_pico", 1

    def prepare(self):
        self.scanner_line, self.wires = "tcp:127.0.0.1:0", "scanner on I2C, PLC on UART 0 (Modbus RTU)"

    def begin(self, scanner_device):
        self.command += ["--scanner", scanner_device]
        self.start()

    def connect(self, lines):
        self.plc_url = f"rtu:{lines[0]},115200,8N1,1"


class Linux:
    """canopyd: the scanner on a pseudo-terminal that the simulator makes, the PLC by TCP."""

    name, tightens = BOARDS["linux"], False

    def __init__(self, children):
        self.children, self.port = children, free_port()
        self.scanner_line = f"rtu:{children.place / 'scanner-line'},115200,8E1,1"
        self.plc_url = f"tcp:127.0.0.1:{self.port}"
        self.wires = f"scanner on a serial line (Modbus RTU), PLC on 127.0.0.1:{self.port} (Modbus TCP)"

    def begin(self, scanner_device):
        child = self.children.start("device", [BUILD / "host" / "canopyd", "--scanner",
                                               f"modbus-rtu:{scanner_device},115200,8E1,1",
                                               "--modbus", f"tcp:127.0.0.1:{self.port}"])
        child.wait_for("^ready$")

    def check(self):
        """Nothing that its exit status would not say."""


DEVICES = {"mps2_an385": Emulated, "mps2_an386": M4, "mps2_an500": M7, "linux": Linux, "riscv_virt": Virt, "rp2040_pico": Pico}


# ---------------------------------------------------------------------------------------------------------------------
# The scene and its scanner

def make_terrain(to, short):
    command = [ROOT / "tools" / "terrain.py", to]
    if short:
        command += [word for name, value in SHORT.items() for word in (f"--{name}", value)]
    status, output = run("terrain.py", [sys.executable, *command])
    if status != 0:
        raise Failure(output.splitlines()[-1] if output else "terrain.py failed")


class Scanner:
    """The simulator, and how far it is."""

    def __init__(self, children, scene, line, shape):
        self.served_file = children.place / "served.xyz"
        kind, where = line.split(":", 1)
        command = [BUILD / "host" / "canopy-scanner", f"--{kind}", where, "--served", self.served_file, "--progress"]
        self.child = children.start("scanner", command + shape + [scene])
        self.device = self.child.wait_for(rf"^{kind} (\S+)$").group(1)
        scene = self.child.wait_for(r"profiles (\d+) columns (\d+) unit (\S+)")
        self.profiles, self.columns, self.unit = int(scene.group(1)), int(scene.group(2)), float(scene.group(3))
        self.profile, self.served, self.over, self.read, self.plc = 0, 0, None, 0, None

    def look(self):
        """Reads what the log has to say since the last look."""
        with open(self.child.log, "rb") as log:
            log.seek(self.read)
            text = log.read()
        text = text[:text.rfind(b"\n") + 1]
        self.read += len(text)
        for line in text.decode(errors="replace").splitlines():
            progress = re.match(r"profile (\d+)/(\d+) valid (\d+)", line)
            over = re.match(r"sweep over: .* (\d+) readings served, (\d+) doubtful, (\d+) missed", line)
            if progress:
                self.profile, self.served = int(progress.group(1)), int(progress.group(3))
            if over:
                self.over = [int(number) for number in over.groups()]
                self.served = self.over[0]

    def settle(self, points):
        """How many readings were served when the PLC has an envelope of so many."""
        return self.served


class BuiltIn:
    """A board's own scanner: what it plays is known, and how far it is says the PLC. It goes on for ever."""

    device, columns, unit = None, built_in.COLUMNS, built_in.UNIT

    def __init__(self, children, short):
        self.served_file = children.place / "served.xyz"
        self.profiles = built_in.PROFILES * (1 if short else 1 + max(part[0] for part in built_in.PARTS))
        self.profile, self.over, self.plc = 0, None, None

    def look(self):
        seen = self.plc.seen.get("profiles", 0)
        self.profile = min(seen, self.profiles)
        if seen >= self.profiles:
            whole = (built_in.sweep_points(number) for number in range(self.profiles // built_in.PROFILES))
            self.over = [sum(map(len, whole)), 0, 0]

    def settle(self, points):
        built_in.write(points, self.served_file)
        return points


# ---------------------------------------------------------------------------------------------------------------------
# The PLC

class Plc:
    """The client, looking on while the sweep goes on; what it saw last."""

    def __init__(self, children, url):
        self.url, self.seen = url, {}
        self.child = children.start("plc", [BUILD / "host" / "canopy-plc", url, "watch", "--json", "--interval", "0.25",
                                            "--answer-timeout", "1000"])

    def look(self):
        while (line := self.child.line(0.1)) is not None:
            try:
                self.seen = json.loads(line)
            except ValueError as error:
                raise Failure(f"canopy-plc prints '{line}', which is no JSON: that is a defect of canopy") from error

    def explain(self, profiles):
        """Raises if the device has fewer profiles than there are: its line to the scanner has failed, not the PLC's."""
        status, output = run("canopy-plc", [BUILD / "host" / "canopy-plc", self.url, "status", "--json"])
        has = json.loads(output.splitlines()[-1]) if status == 0 else {}
        if has.get("profiles", profiles) < profiles and has["scan_errors"] > 0:
            raise Failure(f"the device has {has['profiles']} of {profiles} profiles, for it has met "
                          f"{has['scan_errors']} errors on its line to the scanner: run it again while the machine is "
                          "less busy")

    def read(self, points, profiles, to):
        """The whole envelope of all profiles and so many readings, from registers alone, as a surrogate file."""
        self.child.stop()
        status, output = run("canopy-plc", [BUILD / "host" / "canopy-plc", self.url, "read", "--json", "-o", to,
                                            "--until-points", points, "--timeout", SETTLE_SECONDS,
                                            "--answer-timeout", "1000"])
        if status != 0:
            self.explain(profiles)
            raise Failure(f"the PLC could not read the envelope: {output} (what it saw before: {self.seen})")
        return json.loads(output.splitlines()[-1])


# ---------------------------------------------------------------------------------------------------------------------
# What a person sees

class Progress:
    """A bar that moves on a terminal; elsewhere a line for each tenth."""

    def __init__(self, total):
        self.total, self.tenth, self.moving = total, -1, sys.stdout.isatty()

    def show(self, done, seen):
        width = 24
        bar = "#" * (width * done // self.total)
        text = f"[{bar:<{width}}] {done:{len(str(self.total))}}/{self.total} profiles"
        if seen:
            text += (f"   PLC sees: sequence {seen['sequence']}, {seen['points']} points, "
                     f"{seen['coverage_pct']} % covered, {seen['status_text']}")
        if self.moving:
            columns = shutil.get_terminal_size().columns
            print("\r" + text[:columns - 1].ljust(columns - 1), end="", flush=True)
        elif 10 * done // self.total > self.tenth:
            self.tenth = 10 * done // self.total
            print(text, flush=True)

    def end(self):
        if self.moving:
            print(flush=True)


def sweep(scanner, plc, device, children):
    """Until the sweep is over."""
    progress, moved, last = Progress(scanner.profiles), time.monotonic(), -1
    try:
        while scanner.over is None:
            children.check()
            device.check()
            scanner.look()
            plc.look()
            progress.show(scanner.profile, plc.seen)
            if scanner.profile != last:
                last, moved = scanner.profile, time.monotonic()
            elif time.monotonic() - moved > STALL_SECONDS:
                raise Failure(f"the scanner stands at profile {scanner.profile} of {scanner.profiles} for "
                              f"{STALL_SECONDS} s: the device does not read it; see {shown(children.place)}/*.log")
    finally:
        progress.end()
    served, doubtful, missed = scanner.over
    if doubtful or missed:
        raise Failure(f"{doubtful} readings were served too late and {missed} not at all, so that nobody knows which "
                      "the device has: run it again while the machine is less busy")
    return served


def wait_for_tight(plc, device, children):
    """Until the device has published nothing for a while."""
    began = changed = time.monotonic()
    last = None
    while time.monotonic() - changed < TIGHT_SECONDS and time.monotonic() - began < TIGHT_MOST:
        children.check()
        device.check()
        plc.look()
        time.sleep(0.1)
        if plc.seen.get("sequence") != last:
            last, changed = plc.seen.get("sequence"), time.monotonic()


def check(surrogate, served_file):
    """The verdict of `canopy check`, which is exact."""
    status, output = run("canopy check", [BUILD / "host" / "canopy", "check", surrogate, served_file])
    if status != 0:
        raise Failure(f"the PLC's envelope is not above every reading, or could not be checked: {output} "
                      f"({shown(surrogate)}, {shown(served_file)}): that is a defect of canopy")
    return output


def draw(surrogates, served_file, to):
    status, output = run("canopy plot", [BUILD / "host" / "canopy", "plot", *surrogates, served_file, "-o", to])
    if status != 0:
        raise Failure(f"canopy plot: {output}: tools/setup demo")


def fit_tight(envelope, surrogate, served_file, to):
    """What a host makes of the same readings in the same frame, with all the time it wants: its line."""
    status, output = run("canopy fit", [BUILD / "host" / "canopy", "fit", served_file, "--method", "tight",
                                        "--grid", f"{envelope['grid_m']}x{envelope['grid_n']}", "--side",
                                        envelope["side"], "--scalar", envelope["scalar"], "--frame", surrogate,
                                        "-o", to])
    if status != 0:
        raise Failure(f"canopy fit --method tight: {output}: that is a defect of canopy")
    return output


def report(envelope, served, verdict, tight, seconds):
    gap = re.search(r"mean gap (\S+)% of [^,]*, max (\S+)%", verdict)
    least = re.search(r"mean gap (\S+)% and max gap (\S+)%", tight)
    rows = [("grid", f"{envelope['grid_m']} x {envelope['grid_n']} coefficients, {envelope['scalar']}, "
                     f"{envelope['side']}, unit {envelope['unit']:.9g}"),
            ("sequence", f"{envelope['sequence']} publications"),
            ("points", f"{envelope['points']}, every one of the {served} valid readings served"),
            ("coverage", f"{envelope['coverage_pct']} % of the knot cells"),
            ("margin", f"{envelope['margin'] * envelope['unit']:.6g} certified above every field cell"),
            ("gap", "mean {:.2f} %, largest {:.1f} % of the height range".format(*map(float, gap.groups()))),
            ("status", envelope["status_text"]),
            ("check", verdict)]
    print(f"\nWhat the PLC read, from registers alone, after {seconds:.0f} s:")
    for name, value in rows:
        print(f"  {name:9} {value}")
    print("\nWhat --method tight makes of the same readings on this machine, with as many coefficients:\n"
          "  gap       mean {:.2f} %, largest {:.1f} %".format(*map(float, least.groups())))


# ---------------------------------------------------------------------------------------------------------------------

def fresh_place():
    """build/demo without what an earlier run left there."""
    place = BUILD / "demo"
    place.mkdir(parents=True, exist_ok=True)
    for old in place.iterdir():
        if old.is_file() or old.is_symlink():
            old.unlink()
    return place


def start_scanner(arguments, children, device):
    """(scanner, title of what it sees)."""
    if device.scanner_line is None:
        if arguments.scene is not None or arguments.unit is not None:
            raise Failure(f"{arguments.board} is its own scanner: leave --scene and --unit out")
        return BuiltIn(children, arguments.short), "parts on a floor, sweep upon sweep"
    scene, title, shape = arguments.scene, "the Jacksboro fault terrain", []
    if scene is None:
        scene = children.place / "scene.xyz"
        make_terrain(scene, arguments.short)
    else:
        title = shown(scene)
        if arguments.short:
            shape = ["--profiles", SHORT["rows"], "--columns", SHORT["columns"]]
    if arguments.unit is not None:
        shape += ["--unit", arguments.unit]
    return Scanner(children, scene, device.scanner_line, shape), title


def play(arguments, children):
    began, place = time.monotonic(), children.place
    device = DEVICES[arguments.board](children)
    scanner, title = start_scanner(arguments, children, device)
    print(f"canopy: {title}, {scanner.profiles} profiles of {scanner.columns} columns, unit {scanner.unit:.9g},\n"
          f"  into {device.name}:\n  {device.wires}", flush=True)
    device.begin(scanner.device)
    plc = scanner.plc = Plc(children, device.plc_url)
    served = sweep(scanner, plc, device, children)
    surrogate, tight = place / "surrogate.json", place / "tight.json"
    picture, comparison = place / "picture.png", place / "tight.png"
    if device.tightens:
        wait_for_tight(plc, device, children)
    envelope = plc.read(served, scanner.profiles, surrogate)
    device.check()
    served = scanner.settle(envelope["points"])
    if envelope["points"] != served:
        raise Failure(f"the PLC's envelope covers {envelope['points']} readings, and {served} were served: that is a "
                      f"defect of canopy; see {shown(place)}")
    children.stop()
    verdict = check(surrogate, scanner.served_file)
    seconds = time.monotonic() - began
    report(envelope, served, verdict, fit_tight(envelope, surrogate, scanner.served_file, tight), seconds)
    draw([surrogate], scanner.served_file, picture)
    draw([surrogate, tight], scanner.served_file, comparison)
    print(f"\n  surrogate {shown(surrogate)}\n  readings  {shown(scanner.served_file)}\n  picture   {shown(picture)}"
          f"\n  and tight {shown(comparison)} ({shown(tight)})")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", choices=sorted(DEVICES), default="mps2_an385")
    parser.add_argument("--scene", type=Path, help="points to sweep, .xyz or .ply, instead of the terrain")
    parser.add_argument("--unit", help="input units a device unit; a scene far from zero needs a larger one")
    parser.add_argument("--short", action="store_true", help="fewer profiles and columns")
    arguments = parser.parse_args()
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: sys.exit(1))
    try:
        children = Children(fresh_place())
        try:
            play(arguments, children)
        finally:
            children.stop()
    except Failure as failure:
        print(f"demo: {failure}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"demo: {error.filename or shown(BUILD)}: {error.strerror}: make room or give rights there",
              file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\ndemo: stopped", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
