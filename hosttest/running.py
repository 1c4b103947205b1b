"""A running emulated board with its serial lines as sockets, for tests against firmware."""

import os
import socket
import subprocess
import time
from pathlib import Path

import emulator

BUILD = Path(os.environ.get("CANOPY_BUILD", "build"))
IMAGES = BUILD / "mps2_an385"


class Emulator:
    """Lines 0 and 1 are the board's, 2 is its console."""

    def __init__(self, image, scratch, board="mps2_an385", counting=False, extra=()):
        self.scratch = scratch
        paths = [scratch / f"line{i}" for i in range(3)]
        command = emulator.argv(board, BUILD / board / image, [f"unix:{path},server=on,wait=on" for path in paths],
                                counting, f"unix:{scratch}/monitor,server=on,wait=off", extra)
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.lines = [self.connect(path) for path in paths]

    @staticmethod
    def connect(path):
        line = socket.socket(socket.AF_UNIX)
        line.settimeout(20)
        for _ in range(200):
            try:
                line.connect(str(path))
                return line
            except OSError:
                time.sleep(0.05)
        raise RuntimeError(f"the emulator does not offer {path}")

    def order(self, text):
        """What the emulator's monitor answers to an order."""
        monitor = self.connect(self.scratch / "monitor")
        self.until_prompt(monitor)
        monitor.sendall(text.encode() + b"\n")
        answer = self.until_prompt(monitor)
        monitor.close()
        return answer

    def memory(self, address, length):
        """Bytes of the board's memory, as the emulator's monitor saves them."""
        self.order(f'pmemsave {address:#x} {length} "{self.scratch}/memory"')
        return (self.scratch / "memory").read_bytes()

    @staticmethod
    def until_prompt(monitor):
        text = b""
        while not text.endswith(b"(qemu) "):
            text += monitor.recv(4096)
        return text.decode().removesuffix("(qemu) ").strip()

    def close(self):
        """Ends it; what the emulator keeps of the board it writes down then."""
        self.process.terminate()
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        for line in self.lines:
            line.close()
