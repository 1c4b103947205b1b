#!/usr/bin/python3
"""A pseudo-terminal for a program that cannot make one: what comes on standard input is what a terminal's user sees, what
the user types goes to standard output. Its name is the first line of standard error. It ends with its standard input."""

import os
import select
import sys
import tty


def main():
    master, slave = os.openpty()
    tty.setraw(slave)  # held open, so that users may come and go
    print(os.ttyname(slave), file=sys.stderr, flush=True)
    other = {0: master, master: 1}
    while True:
        for source in select.select(list(other), [], [])[0]:
            data = os.read(source, 4096)
            if not data:
                return
            os.write(other[source], data)


if __name__ == "__main__":
    main()
