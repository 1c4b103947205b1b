#!/usr/bin/python3
"""Our Modbus server and client against mbpoll, pymodbus and libmodbus, over pty and TCP.

As a program it prints the table of docs/modbus.md: which server still hears its own request after the master has
polled an absent neighbour.  make test-programs && hosttest/test_modbus_peers.py
"""
# runs alone: it deals in real time

import contextlib
import os
import re
import select
import socket
import struct
import subprocess
import sys
import threading
import time
import tty
from pathlib import Path

import pytest
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.mei_message import ReadDeviceInformationRequest
from pymodbus.register_read_message import ReadWriteMultipleRegistersRequest

BUILD = Path(os.environ.get("CANOPY_BUILD", Path(__file__).resolve().parent.parent / "build"))
PEER = str(BUILD / "test" / "modbus_peer")
UNIT = 17
REGISTERS = 300


def initial(address):
    return (address * 7 + 0x1234) & 0xFFFF


def crc(frame):
    value = 0xFFFF
    for byte in frame:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return frame + struct.pack("<H", value)


# ---------------------------------------------------------------------------------------------------------------------
# Lines, ports and programs


@contextlib.contextmanager
def line():
    """A pty: its master's descriptor and the name of the other end."""
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        yield master, os.ttyname(slave)
    finally:
        os.close(slave)
        os.close(master)


@contextlib.contextmanager
def two_ended_line():
    """Two ptys with a relay between: the names of both ends."""
    with line() as (one, first), line() as (two, second):
        stop_read, stop_write = os.pipe()

        def relay():
            while True:
                ready, _, _ = select.select([one, two, stop_read], [], [])
                if stop_read in ready:
                    return
                for end in ready:
                    os.write(two if end == one else one, os.read(end, 4096))

        thread = threading.Thread(target=relay)
        thread.start()
        try:
            yield first, second
        finally:
            os.write(stop_write, b"x")
            thread.join()
            os.close(stop_read)
            os.close(stop_write)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return str(probe.getsockname()[1])


@contextlib.contextmanager
def server(role, kind, where):
    process = subprocess.Popen([PEER, role, kind, where], stdout=subprocess.PIPE)
    try:
        assert process.stdout.readline() == b"ready\n"
        yield process
        assert process.poll() is None, "the server ended by itself"
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def run(*command):
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


@contextlib.contextmanager
def our_server(kind):
    """The name by which a client reaches our server."""
    if kind == "tcp":
        port = free_port()
        with server("serve", "tcp", port):
            yield port
    else:
        with two_ended_line() as (near, far), server("serve", "rtu", near):
            yield far


KINDS = pytest.mark.parametrize("kind", ["tcp", "rtu"])

# ---------------------------------------------------------------------------------------------------------------------
# libmodbus


@KINDS
def test_libmodbus_asks_our_server(kind):
    with our_server(kind) as where:
        assert run(PEER, "libask", kind, where) == "ok 220\n"


@KINDS
def test_our_client_asks_libmodbus(kind):
    if kind == "tcp":
        port = free_port()
        with server("libserve", "tcp", port):
            assert run(PEER, "ask", "tcp", port) == "ok 220\n"
    else:
        with two_ended_line() as (near, far), server("libserve", "rtu", near):
            assert run(PEER, "ask", "rtu", far) == "ok 220\n"


@KINDS
def test_our_client_asks_our_server(kind):
    with our_server(kind) as where:
        assert run(PEER, "ask", kind, where) == "ok 220\n"


# ---------------------------------------------------------------------------------------------------------------------
# mbpoll


def mbpoll(kind, where, *options, values=()):
    common = ["mbpoll", "-a", str(UNIT), "-0", "-1", "-q", "-o", "2", *options]
    if kind == "tcp":
        return run(*common, "-m", "tcp", "-p", where, "127.0.0.1", *values)
    return run(*common, "-m", "rtu", "-b", "115200", "-P", "none", where, *values)


def shown(text):
    """The registers of mbpoll's lines `[address]: value`."""
    found = re.findall(r"^\[(\d+)\]:\s+(?:0x)?([0-9A-F]+)", text, re.M)
    return {int(address): int(value, 16) for address, value in found}


@KINDS
def test_mbpoll(kind):
    with our_server(kind) as where:
        for table in ("4:hex", "3:hex"):
            text = mbpoll(kind, where, "-t", table, "-r", "0", "-c", "125")
            assert shown(text) == {address: initial(address) for address in range(125)}
        mbpoll(kind, where, "-t", "4", "-r", "7", values=["4711"])
        mbpoll(kind, where, "-t", "4", "-r", "8", values=["1", "2", "3"])
        assert shown(mbpoll(kind, where, "-t", "4:hex", "-r", "7", "-c", "4")) == {7: 4711, 8: 1, 9: 2, 10: 3}
        with pytest.raises(AssertionError, match="Illegal data address"):
            mbpoll(kind, where, "-t", "4", "-r", "300", "-c", "1")
        with pytest.raises(AssertionError, match="Illegal function"):
            mbpoll(kind, where, "-t", "0", "-r", "0", "-c", "1")


# ---------------------------------------------------------------------------------------------------------------------
# pymodbus


@contextlib.contextmanager
def pymodbus(kind, where):
    if kind == "tcp":
        client = ModbusTcpClient("127.0.0.1", port=int(where), timeout=2)
    else:
        client = ModbusSerialClient(where, baudrate=115200, timeout=2)
    assert client.connect()
    try:
        yield client
    finally:
        client.close()


@KINDS
def test_pymodbus(kind):
    with our_server(kind) as where, pymodbus(kind, where) as client:
        want = [initial(address) for address in range(125)]
        assert client.read_holding_registers(0, 125, slave=UNIT).registers == want
        assert client.read_input_registers(0, 125, slave=UNIT).registers == want
        assert not client.write_register(3, 0xABCD, slave=UNIT).isError()
        assert not client.write_registers(4, list(range(123)), slave=UNIT).isError()
        got = client.read_holding_registers(3, 124, slave=UNIT).registers
        assert got == [0xABCD, *range(123)]
        # its readwrite_registers() forgets the unit
        exchange = ReadWriteMultipleRegistersRequest(read_address=0, read_count=5, write_address=1,
                                                     write_registers=[8, 9], unit=UNIT)
        got = client.execute(exchange).registers
        assert got == [initial(0), 8, 9, 0xABCD, 0]
        assert client.read_holding_registers(REGISTERS, 1, slave=UNIT).exception_code == 2
        assert client.write_register(7, 0xDEAD, slave=UNIT).exception_code == 3
        assert client.read_coils(0, 1, slave=UNIT).exception_code == 1
        assert client.write_coil(0, True, slave=UNIT).exception_code == 1


@KINDS
def test_pymodbus_identifies(kind):
    objects = {0: b"canopy", 1: b"peer", 2: b"1.0", 4: b"Modbus test peer"}
    with our_server(kind) as where, pymodbus(kind, where) as client:

        def ask(code, first):
            return client.execute(ReadDeviceInformationRequest(code, first, unit=UNIT))

        basic = ask(1, 0)
        assert basic.information == {key: objects[key] for key in (0, 1, 2)}
        assert (basic.conformity, basic.more_follows, basic.next_object_id) == (0x82, 0, 0)
        assert ask(2, 0).information == objects
        assert ask(2, 1).information == {key: objects[key] for key in (1, 2, 4)}
        assert ask(4, 4).information == {4: objects[4]}
        assert ask(4, 3).exception_code == 2
        assert client.read_holding_registers(0, 1, slave=UNIT).registers == [initial(0)]


@KINDS
def test_pymodbus_broadcasts(kind):
    """Over RTU unit 0 is all and nobody answers; over TCP it is this device."""
    with our_server(kind) as where, pymodbus(kind, where) as client:
        if kind == "tcp":
            assert not client.write_register(5, 99, slave=0).isError()
        else:
            client.socket.write(crc(struct.pack(">BBHH", 0, 6, 5, 99)))
            time.sleep(0.2)
            assert client.socket.in_waiting == 0
        assert client.read_holding_registers(5, 1, slave=UNIT).registers == [99]


# ---------------------------------------------------------------------------------------------------------------------
# TCP by hand


def receive(connection, length):
    got = b""
    while len(got) < length:
        try:
            part = connection.recv(length - len(got))
        except ConnectionResetError:
            break
        if not part:
            break
        got += part
    return got


def test_tcp_pipelined_byte_by_byte_and_lost():
    with our_server("tcp") as port:
        requests = b"".join(struct.pack(">HHHBBHH", n, 0, 6, UNIT, 3, n, 1) for n in range(100))
        replies = b"".join(struct.pack(">HHHBBBH", n, 0, 5, UNIT, 3, 2, initial(n)) for n in range(100))
        with socket.create_connection(("127.0.0.1", int(port)), timeout=5) as connection:
            connection.sendall(requests)
            assert receive(connection, len(replies)) == replies
        with socket.create_connection(("127.0.0.1", int(port)), timeout=5) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for byte in requests[:36]:
                connection.send(bytes([byte]))
                time.sleep(0.001)
            assert receive(connection, 33) == replies[:33]
            connection.sendall(struct.pack(">HHHBB", 1, 0, 4000, UNIT, 3))
            assert receive(connection, 1) == b""  # closed: there is no way back into step
        with socket.create_connection(("127.0.0.1", int(port)), timeout=5) as connection:
            connection.sendall(requests[:12])
            assert receive(connection, 11) == replies[:11]


# ---------------------------------------------------------------------------------------------------------------------
# A line with an absent neighbour


def heard_after_absent_neighbour(role, gap_s, times, wait_s):
    """How many of our requests are answered, and how many answers are not ours, when a neighbour that is not there was
    polled `gap_s` before each."""
    request = crc(struct.pack(">BBHH", UNIT, 3, 0, 2))
    answer = crc(struct.pack(">BBBHH", UNIT, 3, 4, initial(0), initial(1)))
    absent = crc(struct.pack(">BBHH", UNIT + 1, 3, 0, 8))
    answered = wrong = 0
    with line() as (master, name), server(role, "rtu", name):
        for _ in range(times):
            os.write(master, absent)
            time.sleep(gap_s)
            os.write(master, request)
            got, until = b"", time.monotonic() + wait_s
            while got != answer and select.select([master], [], [], max(0, until - time.monotonic()))[0]:
                got += os.read(master, 256)
            answered += got == answer
            wrong += got not in (b"", answer)
            time.sleep(0.05)
    return answered, wrong


@pytest.mark.parametrize("gap_ms", [50, 100, 300])
def test_we_are_heard_after_an_absent_neighbour(gap_ms):
    assert heard_after_absent_neighbour("serve", gap_ms / 1000, 20, 2.0) == (20, 0)


def test_a_request_in_a_neighbours_data_is_not_ours():
    evil = crc(struct.pack(">BBHH", UNIT, 6, 0, 666))
    poll = crc(struct.pack(">BBHH", UNIT + 1, 3, 0, 8))
    response = crc(struct.pack(">BBB", UNIT + 1, 3, 16) + evil + bytes(8))
    read = crc(struct.pack(">BBHH", UNIT, 3, 0, 1))
    with line() as (master, name), server("serve", "rtu", name):
        for gap in (0, 0.0005, 0.002, 0.05):
            os.write(master, poll)
            time.sleep(gap)
            os.write(master, response)
            assert not select.select([master], [], [], 0.2)[0]
        os.write(master, read)
        assert select.select([master], [], [], 2)[0]
        time.sleep(0.05)
        assert os.read(master, 256) == crc(struct.pack(">BBBH", UNIT, 3, 2, initial(0)))


def main():
    print("| server | " + " | ".join(f"{gap} ms" for gap in (50, 100, 300, 600)) + " |")
    print("| --- |" + " --- |" * 4)
    for name, role in (("canopy", "serve"), ("libmodbus", "libserve")):
        cells = []
        for gap in (50, 100, 300, 600):
            answered, wrong = heard_after_absent_neighbour(role, gap / 1000, 20, 0.7)
            cells.append(f"{answered}/20" + (f", {wrong} wrong" if wrong else ""))
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
