"""What every port promises about time: clock, sleep, T3.5, `sent`, watchdog (docs/conformance.md).

Where an emulator counts instructions its time is virtual and exact; elsewhere it is the host's, and the bounds are wide.
"""

import time

import pytest

import conformance
from conformance import Silence, WATCHDOG, on
from conformance import board, keeper, name  # noqa: F401  (fixtures)
from rtu import frame

# runs alone: the board's time is the host's


@on(lambda expected: expected.lines)
def test_clock_keeps_time(board):
    asked_first, first, had_first = time.monotonic(), board.ask("now")[0], time.monotonic()
    time.sleep(0.5)
    asked_last, last, had_last = time.monotonic(), board.ask("now")[0], time.monotonic()
    passed = (last - first) / 1e6
    assert board.expected.pace * (asked_last - had_first) - 0.02 <= passed <= had_last - asked_first + 0.02


@on(lambda expected: expected.lines)
def test_sleep_ends_when_it_is_due(board):
    least, most = board.ask("sleep", 1750, 20)
    if board.expected.exact:
        assert most <= board.expected.exact
    else:
        assert least <= 500, "the host's timers are not better, but as good as that"


def best(slept, bound_us, tries=4):
    """Whether a sleep is short in one of some tries: a busy host makes it longer, nothing makes it shorter."""
    return any(slept() < bound_us for _ in range(tries))


@on(lambda expected: expected.lines)
def test_a_sleep_lasts_a_tenth_of_a_second_at_most(board):
    board.ask("nap", 1000)  # what the answer before has left behind is over
    assert best(lambda: board.ask("nap", 10000000)[0], 110000)


def sleep_until_a_byte(board, number, busy_us):
    """A byte comes 20 ms after it is ready: how long it sleeps of 90 ms."""
    board.tell("wake", number, busy_us, 90000)
    assert board.orders.take_line() == "ready"
    time.sleep(0.02)
    board.lines[number].send(b"!")
    slept_us, count = board.numbers()
    if count == 0 and number == 0:  # the host was late: it is taken for an order
        assert board.ask_text("") == "no such order"
    elif count == 0:
        board.wait(20000)
        board.ask("look", number)
    return slept_us


@on(lambda expected: expected.lines)
def test_a_byte_ends_the_sleep(board):
    for number in range(len(board.lines)):
        assert best(lambda number=number: sleep_until_a_byte(board, number, 0), 60000)


@on(lambda expected: expected.lines)
def test_a_byte_that_came_before_the_sleep_prevents_it(board):
    for number in range(len(board.lines)):
        assert best(lambda number=number: sleep_until_a_byte(board, number, 80000), 20000)


@on(lambda expected: expected.emulated)
def test_masked_interrupts_come_when_they_are_let_in(board):
    line = board.lines[-1]
    board.tell("mask", 60000)
    assert board.orders.take_line() == "ready"
    time.sleep(0.02)
    line.send(b"!")
    assert board.numbers() == [0, 1, 1, 0]
    if line is not board.orders:
        assert board.ask("look", len(board.lines) - 1) == [1, 1, 0]


# ---- T3.5

READ = b"\x03\x00\x10\x00\x02"
ANSWER = frame(1, b"\x03\x04" + b"".join(((at * 7 + 3) & 0xFFFF).to_bytes(2, "big") for at in (16, 17)))
OTHER = b"\x03\x00\x20\x00\x01"
OTHER_ANSWER = frame(1, b"\x03\x02" + (32 * 7 + 3).to_bytes(2, "big"))
END = frame(1, b"\x06\x00\x00\x00\x00")
END_ANSWER = frame(1, b"\x86\x02")


class Server:
    """The board as a Modbus server that waits for a silence of so many microseconds."""

    def __init__(self, board, silence_us):
        self.board, self.silence, self.line = board, silence_us / 1e6 / board.expected.pace, board.lines[-1]
        board.tell("serve", len(board.lines) - 1, silence_us, 20000000)
        assert board.orders.take_line() == "ready"

    def ask(self, request, answer):
        """Until it answers: a busy host may put a silence into a request. No answer is wrong."""
        for _ in range(5):
            self.line.send(request)
            try:
                assert self.line.take(len(answer), 2) == answer
                return
            except Silence:
                time.sleep(2 * self.silence)
        raise Silence("five requests")

    def end(self):
        """Frames, errors, answers, shortest and longest time to an answer."""
        time.sleep(1.5 * self.silence)
        self.ask(END, END_ANSWER)
        return self.board.numbers()


@on(lambda expected: expected.lines)
def test_an_answer_comes_after_the_silence_and_not_before(board):
    silence_us = 4010  # 9600 baud
    server = Server(board, silence_us)
    for _ in range(10):
        server.ask(frame(1, READ), ANSWER)
    frames, _, answers, least, _ = server.end()
    assert (frames, answers) == (11, 11)
    assert silence_us <= least <= silence_us + 1000


@on(lambda expected: expected.lines)
def test_requests_closer_than_the_silence_are_not_taken_for_two(board):
    server = Server(board, 150000)
    server.line.send(frame(1, READ))
    time.sleep(0.02)
    server.line.send(frame(1, OTHER))
    assert server.line.take(len(OTHER_ANSWER)) == OTHER_ANSWER, "the master has stopped waiting for the other one"
    # A silence in the middle of a request: neither half is one
    request = frame(1, READ)
    server.line.send(request[:5])
    time.sleep(2 * server.silence)
    server.line.send(request[5:])
    frames, errors, answers, _, _ = server.end()
    assert (frames, answers) == (3, 2)
    assert errors > 0


# ---- Watchdog

@on(lambda expected: expected.watchdog)
def test_a_fed_watchdog_does_not_bite(board):
    assert board.ask("watch", 400000) == [1]
    board.wait(1300000)
    assert board.ask_text("crash") == "none"
    board.tell("reset")
    board.wait_started()


@on(lambda expected: expected.watchdog)
def test_a_period_that_no_watchdog_counts_is_refused(board):
    """Better none, and told, than another one than was asked for."""
    assert board.ask("watch", 0) == [0]
    assert board.ask("watch", 0xFFFFFFFF) == [0]
    board.wait(300000)  # nothing was started
    assert board.ask_text("crash") == "none"


@on(lambda expected: expected.watchdog)
def test_an_unfed_watchdog_bites_in_its_time(board):
    assert board.ask("watch", 300000) == [1]
    began = time.monotonic()
    board.tell("fault", conformance.FAULTS.index("hang"), 0)
    board.wait_started()
    assert 0.28 <= time.monotonic() - began <= 1.0 / board.expected.pace
    assert board.ask("crash")[0] == WATCHDOG


# ---- `sent`, to the microsecond

@pytest.fixture
def counting(name, tmp_path):
    running = conformance.start(name, tmp_path, counting=True)
    yield running
    running.close()


@on(lambda expected: expected.sending)
def test_sent_waits_for_the_last_bit(counting):
    for number, line in enumerate(counting.lines):
        for count in (1, 2, 50):
            counting.tell("write", number, count)
            line.take(count)
            at_once, took_us, stays = counting.numbers()
            assert (at_once, stays) == (0, 1)
            assert took_us >= 80, "a character takes 87 us at 115200"
