"""What every port promises, where time does not matter: clock, lines, I2C, flash, crashes (docs/conformance.md)."""

import random
import threading

import pytest

import bench_firmware
import conformance
from conformance import (BELOW_STACK, FAULTS, STATUS_ARGUMENT, STATUS_OK, STATUS_UNSUPPORTED, UNSUPPORTED, WATCHDOG, on,
                         pattern)
from conformance import board, keeper, name  # noqa: F401  (fixtures)
from running import BUILD


def test_every_board_with_firmware_is_expected_to_do_something():
    boards = {mk.parent.name for mk in (conformance.ROOT / "boards").glob("*/board.mk")}
    assert boards | {"linux", "template"} == set(conformance.BOARDS)


@on()
def test_it_has_what_is_expected_of_it(board):
    expected = board.expected
    assert board.ask("about") == [expected.lines, expected.i2c, *expected.flash]


# ---- Clock

@on()
def test_clock_never_goes_back(board):
    """Over its counter's turns, too: 1.4 s are two of SysTick's."""
    first, reads, steps = board.ask("now")[0], 0, []
    while reads < 2000000 or not steps or steps[-1][3] - first < 1400000 and board.expected.lines:
        steps.append(board.ask("clock", 250000, seconds=60))
        reads += 250000
    assert sum(back for back, _, _, _ in steps) == 0
    if board.expected.lines:
        assert min(smallest for _, smallest, _, _ in steps) == 1, "microseconds are resolved"


# ---- Serial lines

def each_line(board):
    return list(enumerate(board.lines))


def tell_and_loop(board, number, data, chunk):
    """What comes back from `echo`, in bursts that no ring is too small for."""
    board.tell("echo", number, len(data), chunk)
    got = b""
    for at in range(0, len(data), 60):
        board.lines[number].send(data[at:at + 60])
        got += board.lines[number].take(len(data[at:at + 60]))
    return got, board.numbers()


@on(lambda expected: expected.lines)
@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_every_byte_is_echoed_in_order(board, chunk):
    for number, _ in each_line(board):
        data = bytes(range(256)) * 2 + random.Random(chunk).randbytes(1000)
        got, (count, lost) = tell_and_loop(board, number, data, chunk)
        assert got == data
        assert (count, lost) == (len(data), 0)
        assert board.ask("look", number) == [0, 1, 0]


@on(lambda expected: expected.lines)
def test_all_lines_carry_both_directions_at_once(board):
    count, window = 3000, 100
    wrong = []

    def play(number, line):
        """Like the far end: never more than the window ahead of what has come."""
        sent, got = 0, b""
        while len(got) < count or sent < count:
            ready = min(count, len(got) + window)
            if sent < ready:
                line.send(pattern(ready - sent, number + sent))
                sent = ready
                continue
            heard = line.hear(20)
            if not heard:
                break
            got += heard
        line.got = got[count:] + line.got
        if got[:count] != pattern(count) or sent != count:
            wrong.append((number, sent, len(got)))

    board.tell("duplex", count, window)
    players = [threading.Thread(target=play, args=each) for each in each_line(board)]
    for player in players:
        player.start()
    for player in players:
        player.join()
    assert not wrong
    assert board.numbers() == [count, count, 0, 0] * board.expected.lines


@on(lambda expected: expected.lines)
def test_a_write_takes_what_fits_and_says_how_much(board):
    for number, line in each_line(board):
        board.tell("fill", number)
        if line is board.orders:
            heard, said = b"", None
            while b"\n" not in heard:
                heard += line.take(1)
            data = heard[:-1]
            said = board.numbers()
        else:
            assert board.orders.take_line() == ""
            said = board.numbers()
            data = line.take(said[0])
        taken, last, given = said
        assert last < given, "no more than there is room for"
        assert data == pattern(taken)
        assert board.ask("look", number) == [0, 1, 0]


def write_and_watch(board, number, count):
    """Whether it was sent at once, how long it was not, and whether it stayed sent."""
    line = board.lines[number]
    board.tell("write", number, count)
    if line is board.orders:
        assert line.take(count) == pattern(count)
        return board.numbers()
    said = board.numbers()
    # It was sent before it was said so: it is here, but for a pty's kernel thread. (Fewer bytes than a socket holds unread.)
    assert line.take(count, 0 if board.expected.emulated else 1) == pattern(count)
    return said


@on(lambda expected: expected.lines)
def test_sent_is_said_when_all_has_left_and_not_before(board):
    for number, _ in each_line(board):
        at_once, _, stay = zip(*[write_and_watch(board, number, count) for count in (1, 2, 50, 200, 1, 2)])
        assert all(stay)
        if board.expected.sending:
            assert not all(at_once), "a character takes its time"


@on(lambda expected: expected.lines)
def test_a_flood_is_counted_to_the_byte_and_leaves_no_trace(board):
    flood = 5000
    for number, line in each_line(board):
        lost_before = board.ask("look", number)[2]
        board.tell("deaf", number, 100000, flood)
        assert board.orders.take_line() == "ready"
        line.send(pattern(flood))
        count, right, lost = board.numbers()
        assert count + lost == flood
        assert right >= min(flood, 128), "what came first is what is kept"
        assert (lost > 0) == board.expected.loses
        assert board.ask("look", number)[2] == lost_before + lost
        data = bytes(range(256))
        got, (_, after) = tell_and_loop(board, number, data, 64)
        assert got == data
        assert after == lost_before + lost


@on()
def test_a_line_that_is_not_there_takes_and_gives_nothing(board):
    for number in range(board.expected.lines, 2):
        assert board.ask("look", number) == [0, 1, 0]
        board.tell("fill", number)
        assert board.orders.take_line() == ""
        assert board.numbers()[:2] == [0, 0]


@on(lambda expected: expected.console is not None)
def test_the_console_prints(board):
    board.console.drain()
    board.ask_text("put", "a word")
    assert board.console.take(6) == b"a word"


# ---- I2C

@on(lambda expected: not expected.i2c)
@pytest.mark.parametrize("sizes", ["0 0", "1 0", "0 1", "2 2"])
def test_without_i2c_every_transfer_is_unsupported(board, sizes):
    assert board.ask("bus") == [UNSUPPORTED, 0]
    outcome, _, _, stays = board.ask("i2c", 0x29, 0, 10000, sizes, 0)[:4]
    assert (outcome, stays) == (UNSUPPORTED, 1)
    assert board.ask("bus") == [UNSUPPORTED, 0]


# ---- Flash

@on(lambda expected: not expected.flash[0])
def test_without_flash_every_call_is_unsupported(board):
    assert board.ask_text("erase", 0) == STATUS_UNSUPPORTED
    assert board.ask_text("program", 0, 0, 0) == STATUS_UNSUPPORTED
    assert board.ask_text("program", 0, 0, 256) == STATUS_UNSUPPORTED
    assert board.ask_text("read", 0, 0, 16) == STATUS_UNSUPPORTED
    assert board.ask_text("early").split() == ["0", "0", "0", STATUS_UNSUPPORTED]


class Flash:
    """The board's, with a model of it beside: what is not written is what it was."""

    def __init__(self, board):
        self.board, (self.pages, self.page, self.unit) = board, board.expected.flash
        self.model = {}

    def erase(self, page):
        self.model[page] = bytearray(b"\xff" * self.page)
        assert self.board.ask_text("erase", page, seconds=60) == STATUS_OK
        assert self.board.ask("sum", page)[0] == 0, "all bytes are 0xFF"

    def program(self, page, offset, length, mark):
        data = bytes([mark, 0x80 + page, *(i & 255 for i in range(2, length))])[:length]
        self.model[page][offset:offset + length] = data
        assert self.board.ask_text("program", page, offset, length, data[:2].hex(), seconds=60) == STATUS_OK

    def read(self, page, offset, length):
        status, data = (self.board.ask_text("read", page, offset, length).split() + [""])[:2]
        assert status == STATUS_OK
        return bytes.fromhex(data)

    def assert_as_modelled(self):
        for page, data in self.model.items():
            written = sum(byte != 0xFF for byte in data)
            total = sum(byte * place for place, byte in enumerate(data, 1)) % 2 ** 32
            assert self.board.ask("sum", page) == [written, total]


@on(lambda expected: expected.flash[0])
def test_flash_keeps_what_is_written_through_reset_and_loss_of_power(board):
    flash = Flash(board)
    for page in range(flash.pages):
        flash.erase(page)
    for page in range(flash.pages):
        flash.program(page, 0, flash.unit, 1)
        flash.program(page, flash.page - flash.unit, flash.unit, 2)
        flash.program(page, 2 * flash.unit, 2 * flash.unit, 3)
    flash.assert_as_modelled()
    board.tell("reset")
    board.wait_started()
    flash.assert_as_modelled()
    board.power_off_and_on()
    flash.assert_as_modelled()
    early = board.ask_text("early").split()
    assert [int(word) for word in early[:3]] == [flash.pages, flash.page, flash.unit], "it is there before the start"
    assert (early[3], bytes.fromhex(early[4])) == (STATUS_OK, flash.model[0][:8])
    flash.erase(0)  # of the others nothing
    flash.assert_as_modelled()


@on(lambda expected: expected.flash[0])
def test_flash_is_read_at_any_place_and_length(board):
    flash = Flash(board)
    page = flash.pages - 1
    flash.erase(page)
    for offset in range(0, 4 * flash.unit, flash.unit):
        flash.program(page, offset, flash.unit, offset // flash.unit)
    for offset, length in ((0, 0), (0, 1), (1, 3), (flash.unit - 1, 2), (flash.unit, flash.unit), (3, 3 * flash.unit),
                           (flash.page - 1, 1), (flash.page, 0)):
        assert flash.read(page, offset, length) == flash.model[page][offset:offset + length]


@on(lambda expected: expected.flash[0])
def test_flash_outside_of_its_pages_is_refused_and_nothing_changes(board):
    flash = Flash(board)
    for page in range(flash.pages):
        flash.erase(page)
    flash.program(0, 0, flash.unit, 9)
    last, end, far = flash.pages - 1, flash.page, 2 ** 32
    for page in (flash.pages, flash.pages + 1, far // flash.page, far - 1):
        assert board.ask_text("erase", page) == STATUS_ARGUMENT
        assert board.ask_text("program", page, 0, flash.unit) == STATUS_ARGUMENT
        assert board.ask_text("read", page, 0, 1) == STATUS_ARGUMENT
    for offset, length in ((end, flash.unit), (end - flash.unit, 2 * flash.unit), (far - flash.unit, flash.unit),
                           (flash.unit, far - flash.unit)):
        assert board.ask_text("program", last, offset, length) == STATUS_ARGUMENT
    for offset, length in ((end, 1), (end - 1, 2), (far - 1, 1), (far - 1, 2)):
        assert board.ask_text("read", last, offset, length) == STATUS_ARGUMENT
    if flash.unit > 1:
        for offset, length in ((1, flash.unit), (0, 1), (flash.unit - 1, 1), (0, flash.unit + 1)):
            assert board.ask_text("program", last, offset, length) == STATUS_ARGUMENT
    assert board.ask_text("program", last, 0, 0) == STATUS_OK
    flash.assert_as_modelled()


@on(lambda expected: expected.flash[0] and expected.watchdog)
def test_a_watchdog_waits_for_the_flash(board):
    flash = Flash(board)
    assert board.ask("watch", 20000) == [1]  # half of what an erase takes
    flash.erase(0)
    flash.program(0, 0, flash.unit, 1)
    assert board.ask_text("crash") == "none"
    flash.assert_as_modelled()
    board.tell("reset")
    board.wait_started()


# ---- Crashes

def crash(board, kind):
    """Makes it crash; the console's line and the record that the next start finds."""
    if board.console:
        board.console.drain()
    wanted = board.expected.crashes[kind]
    if wanted.kind == WATCHDOG:
        assert board.ask("watch", 300000) == [1]
    board.tell("fault", FAULTS.index(kind), board.expected.nowhere)
    board.wait_started()
    console = ""
    while board.console and (wanted.kind != WATCHDOG or wanted.place) and not console.startswith("crash"):
        console = board.console.take_line(5)
    return console, dict(zip(("kind", "pc", "lr", "sp", "status", "address", "count"), board.ask("crash")))


@on(lambda expected: expected.crashes)
@pytest.mark.parametrize("kind", FAULTS)
def test_a_crash_says_where_and_why_and_survives_the_reset(board, kind):
    if kind not in board.expected.crashes:
        pytest.skip(f"{board.name} does not notice: {kind}")
    console, record = crash(board, kind)
    wanted = board.expected.crashes[kind]
    assert record["kind"] == wanted.kind
    assert record["status"] & wanted.status == wanted.status
    if wanted.address == BELOW_STACK:
        limit = board.symbol("canopy_stack_limit").start
        assert limit - 65536 <= record["address"] < limit
    else:
        assert record["address"] == wanted.address
    if wanted.place:
        assert record["pc"] in board.symbol({"hang": "fault_by_hanging"}.get(kind, f"fault_by_{kind}"))
    else:
        assert record["pc"] == 0, "there is no frame to read"
    if console:
        assert console.startswith(f"crash {record['kind']:08x} pc {record['pc']:08x} lr {record['lr']:08x} ")
    assert board.ask_text("forget") == ""
    assert board.ask_text("crash") == "none"


@on(lambda expected: expected.crashes)
def test_crashes_are_counted_over_resets(board):
    counts = []
    for kind in ("instruction", "address", "hang"):
        if kind in board.expected.crashes:
            counts.append(crash(board, kind)[1]["count"])
            board.ask_text("forget")
    assert counts == list(range(counts[0], counts[0] + len(counts)))


@on(lambda expected: expected.lines)
def test_a_reset_is_a_new_start_and_no_crash(board):
    board.tell("reset")
    board.wait_started()
    assert board.ask_text("crash") == "none"
    data = bytes(range(256))
    assert tell_and_loop(board, len(board.lines) - 1, data, 64) == (data, [256, 0])


@on(lambda expected: not expected.watchdog)
def test_without_a_watchdog_it_says_so(board):
    assert board.ask("watch", 100000) == [0]
    assert board.ask_text("crash") == "none"


# ---- Counted instructions, which budgets rest on

@on(lambda expected: expected.emulated)
def test_instruction_counts_are_right_and_repeatable(name):
    image = BUILD / name / "count.elf"
    first = bench_firmware.count(image)
    assert first == bench_firmware.count(image)
    assert first["nothing"] <= 120  # the call, and a tick
    for turns in (1000, 100000, 10000000):
        interrupts = 2 * turns / 1e6 * 40
        assert 0 <= first[f"turns_{turns}"] - 2 * turns <= 120 + interrupts
