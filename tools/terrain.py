#!/usr/bin/python3
"""Writes the demo's terrain as points: x = 30 * column, y = 30 * row, z = metres.

Usage: terrain.py OUT.xyz [--npz FILE] [--rows N] [--columns N]

The terrain is the Jacksboro fault elevation model (USGS, public domain) that Debian's python-matplotlib-data brings,
344 rows of 403 columns. --rows and --columns take only the first ones: a short demo.
"""
import argparse
import glob
import sys

import numpy as np

PLACES = ["/usr/share/matplotlib/mpl-data/sample_data/jacksboro_fault_dem.npz",
          "/usr/lib/python3/dist-packages/matplotlib/mpl-data/sample_data/jacksboro_fault_dem.npz"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", metavar="OUT.xyz", help="'-' for standard output")
    parser.add_argument("--npz", help="the elevation model, if it is elsewhere")
    parser.add_argument("--rows", type=int, default=None)
    parser.add_argument("--columns", type=int, default=None)
    args = parser.parse_args()
    found = [args.npz] if args.npz else [p for place in PLACES for p in glob.glob(place)]
    if not found:
        sys.exit(f"terrain.py: no jacksboro_fault_dem.npz in {', '.join(PLACES)}: install python-matplotlib-data or give --npz")
    try:
        elevation = np.load(found[0])["elevation"][:args.rows, :args.columns]
    except (OSError, KeyError, ValueError) as error:
        sys.exit(f"terrain.py: {found[0]}: {error}")
    rows, columns = elevation.shape
    x, y = np.meshgrid(30 * np.arange(columns), 30 * np.arange(rows))
    points = np.column_stack([x.ravel(), y.ravel(), elevation.ravel()])
    np.savetxt(sys.stdout if args.out == "-" else args.out, points, fmt="%d")


if __name__ == "__main__":
    main()
