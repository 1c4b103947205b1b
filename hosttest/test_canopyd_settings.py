"""canopyd --settings FILE: PLCs store what the next start takes, whatever becomes of the file and of the process."""

import os
import pwd
import random
import signal
import socket
import struct
import subprocess
import time

import pytest

from rtu import Client, NoAnswer
from test_canopyd import HOST, TABLE, Pty, canopyd, registers, scene, start, wait  # noqa: F401

ADDRESSES = {entry["name"]: entry for entry in TABLE["registers"]}
STORE, DEFAULTS, RESET = 4, 5, 6
NONE, STORED, MENDED, CORRUPT, NOWHERE, REFUSED = range(6)
UNDER_WAY, DONE = 1, 2


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def put(plc, name, value):
    """Writes a register by name; returns the exception, or 0."""
    entry = ADDRESSES[name]
    words = [value >> 16, value & 0xFFFF] if entry["words"] == 2 else [value]
    answer = plc.client.write(entry["address"], words)
    return answer[1] if answer[0] & 0x80 else 0


def order(plc, code):
    assert put(plc, "command", code) == 0
    return plc["command_result"]


def store(plc):
    assert order(plc, STORE) == 1
    wait(plc, "settings_stored", lambda stored: stored != UNDER_WAY)
    assert plc["settings_stored"] == DONE


def reach(port, seconds=10):
    end = time.monotonic() + seconds
    while True:
        try:
            return registers(port)
        except OSError:
            assert time.monotonic() < end
            time.sleep(0.02)


def run(start, scene, path, *words):
    daemon, port = canopyd(start, f"sim:{scene}", "--settings", str(path), *words)
    return daemon, registers(port)


def test_what_a_plc_stores_is_in_force_after_its_restart(start, scene, tmp_path):
    path, port = tmp_path / "settings", free_port()
    daemon, _ = canopyd(start, f"sim:{scene}", "--settings", str(path), "--interval", "300", modbus=f"tcp:127.0.0.1:{port}")
    plc = registers(port)
    assert (plc["settings_state"], plc["settings_generation"], plc["set_interval_ms"]) == (NONE, 0, 300)
    assert plc["selftests"] == plc["selftests_passed"] == 4
    assert put(plc, "set_stale_after_ms", 7000) == 0
    assert put(plc, "set_side", 1) == 0
    assert put(plc, "set_stale_after_ms", 9) == 3, "out of range"
    assert put(plc, "set_plc_baud", 9600) == 3, "there is no such line"
    assert (plc["stale_after_ms"], plc["side"]) == (5000, 0), "not before the next start"
    store(plc)
    assert order(plc, RESET) == 1
    with pytest.raises((EOFError, OSError)):
        for _ in range(1000):
            plc["magic"]
            time.sleep(0.01)
    plc = reach(port)
    assert (plc["stale_after_ms"], plc["side"], plc["set_interval_ms"]) == (7000, 1, 300)
    assert (plc["settings_state"], plc["settings_generation"], plc["settings_stored"]) == (STORED, 1, 0)
    wait(plc, "points", lambda points: points > 0)
    assert "restarted by a PLC" in daemon.text()
    assert order(plc, DEFAULTS) == 1
    assert plc["set_stale_after_ms"] == 5000
    wait(plc, "settings_stored", lambda stored: stored == DONE)
    assert daemon.end() == 0
    _, plc = run(start, scene, path, "--stale-after", "8000")
    assert (plc["stale_after_ms"], plc["side"], plc["settings_state"]) == (8000, 0, STORED), "defaults are the options"
    assert path.stat().st_size == 8192


def test_without_a_file_nothing_is_stored(start, scene):
    _, port = canopyd(start, f"sim:{scene}")
    plc = registers(port)
    assert plc["settings_state"] == NOWHERE
    assert put(plc, "set_stale_after_ms", 7000) == 0
    assert order(plc, STORE) == order(plc, DEFAULTS) == 2
    assert plc["settings_stored"] == 0


def test_options_beyond_a_settings_range_stay(start, scene, tmp_path):
    _, plc = run(start, scene, tmp_path / "settings", "--stale-after", "4000000", "--interval", "0", "--timeout", "60000")
    assert plc["set_scanner_timeout_ms"] == 60000
    assert put(plc, "set_scanner_timeout_ms", 1000) == 3
    assert put(plc, "set_interval_ms", 50) == 0
    store(plc)
    _, plc = run(start, scene, tmp_path / "copy", "--timeout", "60000")
    assert plc["settings_state"] == NONE


def test_damaged_copies_are_shown_and_mended(start, scene, tmp_path):
    path = tmp_path / "settings"
    daemon, plc = run(start, scene, path)
    put(plc, "set_refresh_ms", 777)
    store(plc)
    assert daemon.end() == 0
    whole = path.read_bytes()

    def begin(damaged):
        data = bytearray(whole)
        for place in damaged:
            data[place] ^= 1
        path.write_bytes(data)
        return run(start, scene, path)

    for damaged in ([18], [4096 + 9], [4096]):
        daemon, plc = begin(damaged)
        assert (plc["settings_state"], plc["set_refresh_ms"]) == (MENDED, 777)
        assert "one copy is damaged" in daemon.text()
        store(plc)
        assert daemon.end() == 0
        daemon, plc = run(start, scene, path)
        assert plc["settings_state"] == STORED
        assert daemon.end() == 0
    daemon, plc = begin([20, 4096 + 40])
    assert (plc["settings_state"], plc["set_refresh_ms"], plc["settings_generation"]) == (CORRUPT, 500, 0)
    assert "both copies are damaged" in daemon.text()
    wait(plc, "points_accepted", lambda points: points > 500)
    time.sleep(1)
    assert (plc["points"], plc["status"] & 1) == (0, 0), "what had settings publishes nothing with others"
    store(plc)
    assert daemon.end() == 0
    daemon, plc = run(start, scene, path)
    assert plc["settings_state"] == STORED
    wait(plc, "points", lambda points: points > 0)
    assert daemon.end() == 0


def test_killed_while_storing_it_is_the_old_or_the_new(start, scene, tmp_path):
    path = tmp_path / "settings"
    daemon, plc = run(start, scene, path)
    put(plc, "set_refresh_ms", 1000)
    store(plc)
    force = 1000
    random.seed(3)
    for new in range(1001, 1013):
        assert put(plc, "set_refresh_ms", new) == 0
        assert order(plc, STORE) == 1
        time.sleep(0.048 + random.random() * 0.02)  # it begins 50 ms after the command
        daemon.end(signal.SIGKILL)
        daemon, plc = run(start, scene, path)
        assert plc["set_refresh_ms"] in (force, new)
        assert plc["settings_state"] in (STORED, MENDED)
        force = plc["set_refresh_ms"]


def test_the_line_to_the_plc_is_a_setting(start, scene, tmp_path):
    line = Pty()
    port = free_port()
    words = ["--settings", str(tmp_path / "settings"), "--modbus", f"tcp:127.0.0.1:{port}"]
    daemon, _ = canopyd(start, f"sim:{scene}", *words, modbus=f"rtu:{line.device},19200,8N1,3")
    assert Client(line, unit=3).read(0, 2) == struct.pack(">I", 0x434E5059)
    plc = registers(port)
    assert (plc["set_plc_unit"], plc["set_plc_baud"], plc["set_plc_format"]) == (3, 19200, 0)
    assert put(plc, "set_plc_unit", 44) == 0
    store(plc)
    assert order(plc, RESET) == 1
    time.sleep(0.5)
    plc = reach(port)
    assert plc["set_plc_unit"] == 44
    assert Client(line, unit=44).read(0, 2) == struct.pack(">I", 0x434E5059)
    with pytest.raises(NoAnswer):
        Client(line, unit=3, timeout=0.3).read(0, 2)
    # a rate that no serial line here knows is not taken
    assert put(plc, "set_plc_baud", 12345) == 0
    store(plc)
    assert order(plc, RESET) == 1
    time.sleep(0.5)
    plc = reach(port)
    assert (plc["settings_state"], plc["set_plc_baud"], plc["set_plc_unit"]) == (REFUSED, 19200, 3)
    assert Client(line, unit=3).read(0, 2) == struct.pack(">I", 0x434E5059)
    daemon.end()
    line.close()


# ---- Files that will not do


def refused(path, scene, **options):
    done = subprocess.run([HOST / "canopyd", "--scanner", f"sim:{scene}", "--modbus", "tcp:127.0.0.1:0", "--settings", path],
                          capture_output=True, text=True, timeout=20, **options)
    assert done.returncode == 2 and done.stdout == "", done
    assert done.stderr.startswith(f"canopyd: --settings {path}: ") and done.stderr.count("\n") == 1, done.stderr
    return done.stderr


def test_bad_files_are_refused(scene, tmp_path):
    assert "No such file or directory" in refused(tmp_path / "absent" / "settings", scene)
    assert not (tmp_path / "absent").exists()
    assert "no plain file" in refused("/dev/null", scene)
    assert "directory" in refused(tmp_path, scene).lower()
    short = tmp_path / "short"
    for length in (0, 1, 4096, 8191, 8193):
        short.write_bytes(b"\xff" * length)
        assert "another length" in refused(short, scene)
        assert short.stat().st_size == length, "it is left as it was"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scene.xyz", "short"], "nothing is left behind"


def test_a_file_that_may_not_be_written_is_refused(scene, tmp_path):
    """Permissions bind others than root: then it is run by somebody else, from where everybody may read."""
    home = tmp_path
    options = {}
    if os.geteuid() == 0:
        nobody = pwd.getpwnam("nobody")
        options = {"user": nobody.pw_uid, "group": nobody.pw_gid}
        for directory in [tmp_path, *tmp_path.parents]:
            if not directory.stat().st_mode & 0o005:
                directory.chmod(directory.stat().st_mode | 0o005)
    path = home / "settings"
    path.write_bytes(b"\xff" * 8192)
    path.chmod(0o444)
    assert "Permission denied" in refused(path, scene, **options)
    closed = home / "closed"
    closed.mkdir()
    closed.chmod(0o555)
    assert "Permission denied" in refused(closed / "settings", scene, **options)
    assert list(closed.iterdir()) == []


def test_one_file_for_one_canopyd(start, scene, tmp_path):
    path = tmp_path / "settings"
    run(start, scene, path)
    assert "another program has it" in refused(path, scene)
