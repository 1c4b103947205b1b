#!/bin/sh
# Draws the pictures of the README from the demo's terrain. Usage: [BUILD=dir] tools/readme_pictures.sh OUTDIR
set -eu

build=${BUILD:-build}
place=$build/pictures
canopy=$build/host/canopy
mkdir -p "$place" "$1"

tools/terrain.py "$place/terrain.xyz"
"$canopy" fit "$place/terrain.xyz" --grid 20x20 --field 4 --scalar fx -o "$place/fast.json"
"$canopy" fit "$place/terrain.xyz" --grid 20x20 --scalar fx --frame "$place/fast.json" --method tight \
    -o "$place/tight.json"
"$canopy" plot "$place/fast.json" "$place/tight.json" "$place/terrain.xyz" --show gap --size 840x420 \
    -o "$1/fast-and-tight.png"
"$canopy" sandwich "$place/terrain.xyz" --grid 40x40 --method tight -o "$place/terrain"
"$canopy" plot "$place/terrain.above.json" "$place/terrain.below.json" "$place/terrain.xyz" --show section \
    --at y=4500 --size 1000x413 -o "$1/sandwich.png"

# a palette does, and a repository is no place for large files
/usr/bin/python3 - "$1" <<'END'
import sys
from PIL import Image
for name in ("fast-and-tight", "sandwich"):
    path = f"{sys.argv[1]}/{name}.png"
    picture = Image.open(path).convert("RGB")
    picture = picture.quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    picture.save(path, optimize=True)
END
