"""The tables of `make bench`: Markdown that also reads well on a terminal. Times are medians of processor time."""

FIT_MOST, CERTIFICATE_MOST = 10, 15  # times the floor
FIT_300K_MOST = 8                    # times the floor, at 300,000 points
NEAR, NEAR_AT_6 = 1.02, 1.4          # tight: times the optimum's gap, at its end and after 16 iterations, and after 6
FIELD_NEAR, FIELD_BYTES = 1.25, 96 * 1024
FASTER = 50                          # tight than HiGHS
PAPER_CLOUDS = {10_000: 14.5, 30_000: 42.5, 50_000: 71.0, 100_000: 141.0, 300_000: 445.0}  # its Table 1, ms, Pentium 4
PAPER_GRIDS = {10: 42.5, 20: 42.5, 30: 45.0, 40: 51.0, 50: 55.5, 60: 64.5}                  # its Table 2
BELT_ROW_MOST = 1 / 8  # of a full refit


def table(head, rows):
    """Aligned columns: the first to the left, the others to the right."""
    rows = [[str(cell) for cell in row] for row in rows]
    widths = [max(len(row[c]) for row in [head] + rows) for c in range(len(head))]

    def one(cells):
        return "| " + " | ".join(cell.ljust(w) if c == 0 else cell.rjust(w) for c, (cell, w) in enumerate(zip(cells, widths))) + " |"
    rule = "| " + " | ".join("-" * w if c == 0 else "-" * (w - 1) + ":" for c, w in enumerate(widths)) + " |"
    return "\n".join([one(head), rule] + [one(row) for row in rows])


def times(x):
    """A multiple: three digits."""
    return f"{x:,.0f}" if x >= 100 else f"{x:.1f}"


def milliseconds(ms):
    return f"{ms:,.0f}" if ms >= 100 else f"{ms:.2f}" if ms < 10 else f"{ms:.1f}"


def way_row(way):
    fit, certificate = way["fit"], way["certificate"]
    return [way["name"], milliseconds(fit["median_us"] / 1e3), times(fit["floors"]), milliseconds(certificate["median_us"] / 1e3),
            times(certificate["floors"]), milliseconds(way["whole"]["median_us"] / 1e3), f"{way['mean_gap_pct']:.2f}", f"{way['max_gap_pct']:.1f}", f"{way['wrong'] + way['outside']:,}"]


def peer_row(peer):
    before = peer.get("wrong_unlifted")
    wrong = f"{before:,} -> {peer['wrong']:,}" if before else f"{peer['wrong']:,}"
    return [peer["name"], milliseconds(peer["median_ms"]), times(peer["floors"]), "", "", "", f"{peer['mean_gap_pct']:.2f}",
            f"{peer['max_gap_pct']:.1f}", wrong]


def optimum_of(result):
    """The row of the linear program, if it is there."""
    return next((peer for peer in result["peers"] if peer["name"].startswith("linear program")), None)


def way_of(result, name):
    return next(way for way in result["ways"] if way["name"] == name)


def tight_rows(result):
    """Tight against the optimum of the same run: gap, time, what it proves, and what a field holds."""
    best, rows = optimum_of(result), []
    for way in result["ways"]:
        if way["tight"]:
            rows.append([way["name"], f"{way['field_bytes'] / 1024:,.0f}" if "field_bytes" in way else "",
                         milliseconds(way["fit"]["median_us"] / 1e3), f"1/{1e3 * best['median_ms'] / way['fit']['median_us']:,.0f}",
                         f"{way['solves']:.0f}", f"{way['mean_gap_pct'] / best['mean_gap_pct']:.3f}",
                         f"{way['proved_excess_pct']:.2f}", f"{way['wrong'] + way['outside']:,}"])
    return table(["surface", "field KB", "fit ms", "of HiGHS", "iterations", "x optimum's gap", "proved within %", "wrong"], rows)


def pair_rows(result):
    rows = []
    for pair in result["pairs"]:
        rows.append([pair["name"], milliseconds(pair["fit"]["median_us"] / 1e3), times(pair["fit"]["floors"]),
                     *[f"{gap:.2f}" for both in zip(pair["mean_gap_pct"], pair["alone_mean_gap_pct"]) for gap in both],
                     "yes" if pair["alone_cross"] else "no", f"{pair['apart_pct']:.3f}", pair["wrong"] + pair["outside"]])
    return table(["both sides", "fit ms", "x floor", "above %", "alone %", "below %", "alone %", "alone they cross",
                  "apart at least %", "wrong"], rows)


def scene(result):
    floor = result["floor"]
    head = ["surface", "fit ms", "x floor", "certificate ms", "x floor", "all ms", "mean gap %", "max gap %", "wrong"]
    rows = [way_row(way) for way in result["ways"]] + [peer_row(peer) for peer in result["peers"]]
    field = [way["field_certificate"]["floors"] for way in result["ways"] if "field_certificate" in way]
    lines = [f"**{result['scene']}**: {result['points']:,} points, {result['grid'][0]} x {result['grid'][1]}, {result['side']}. "
             f"Floor {floor['median_us']:.1f} us, {floor['ns_per_point']:.2f} ns a point ({floor['way']}).", "",
             table(head, rows), ""]
    lines += [tight_rows(result), "", pair_rows(result), ""]
    if field:
        lines += [f"The certificate that a device takes from its field (Q = 4), without any point: {min(field):.2f} to "
                  f"{max(field):.2f} floors.", ""]
    for way in result["ways"]:
        if "rays" in way:
            rays = way["rays"]
            lines += [f"Rays, {way['scalar']}, on that surface: {rays['ns_per_ray']:,.0f} ns each, {rays['per_second'] / 1e6:.2f} million a "
                      f"second; {rays['hits_pct']:.0f} % hit, {rays['cells_per_ray']:.1f} cells a ray, at most "
                      f"{rays['most_steps']} root-finder steps in a cell.", ""]
    return lines


def series(results, head, label, paper):
    rows = []
    for result in results:
        for way in result["ways"]:
            rows.append([f"{label(result)}, {way['scalar']}", paper(result), f"{result['floor']['ns_per_point']:.2f}",
                         milliseconds(way["fit"]["median_us"] / 1e3), f"{way['fit']['ns_per_point']:.2f}", times(way["fit"]["floors"]),
                         f"{way['certificate']['ns_per_point']:.2f}", times(way["certificate"]["floors"]),
                         f"{way['mean_gap_pct']:.2f}", f"{way['solves']:.1f}", f"{way['unsettled']:.2f}", way["wrong"] + way["outside"]])
    return table([head, "paper ms", "floor ns/pt", "fit ms", "fit ns/pt", "x floor", "cert. ns/pt", "x floor", "mean gap %", "solves",
                  "unsettled", "wrong"], rows)


BINS = [(1, 1), (2, 2), (3, 3), (4, 4), (5, 5), (6, 10), (11, 20), (21, 60)]


def histogram_row(name, counts):
    """Per cent of the lines in each bin, from {solves: lines}; of those that did not end, in the last column."""
    total = sum(counts.values())
    counts = {int(k): v for k, v in counts.items()}
    shares = [sum(v for k, v in counts.items() if low <= k <= high) for low, high in BINS] + [counts.get(0, 0)]
    return [name, f"{total:,}", *[f"{100 * share / total:.1f}" if share else "" for share in shares], max(counts)]


def own_counts(solves):
    """{solves: lines} from canopy-bench's list."""
    return {k: count for k, count in enumerate(solves) if count}


def histograms(result):
    """The paper's Fig. 9, and what its Section 4 says of uniform data."""
    head = ["solves a line, % of the lines", "lines", *[str(low) if low == high else f"{low} - {high}" for low, high in BINS],
            "no end", "most"]
    rows, heuristics = [], result["heuristics"]
    for one in heuristics["scattered"]:
        rows.append(histogram_row(f"scattered, {one['points']:,} points, read literally", one["lines"]))
    for one in result["clouds"]:
        if one["points"] in [r["points"] for r in heuristics["scattered"]]:
            rows.append(histogram_row(f"scattered, {one['points']:,} points, canopy", own_counts(one["solves"]["lines"])))
    for one in heuristics["uniform"]:
        rows.append(histogram_row(f"uniform, n = {one['n']:,}, read literally", one["lines"]))
    for one in result["grids"]:
        rows.append(histogram_row(f"uniform, n = {one['grid'][0]}, canopy", own_counts(one["solves"]["columns"])))
    return table(head, rows)


def against_oracle(rows):
    return table(["scene, grid, side", "optimum %", "stairs x", "fast x", "6 iterations", "10", "16", "end", "iterations", "proved %",
                  "to 1.02, ms", "arena KB", "wrong"],
                 [[f"{r['scene']} {r['grid']} x {r['grid']}, {r['side']}", f"{r['optimum_pct']:.2f}", f"{r['stairs']:.2f}", f"{r['fast']:.3f}",
                   *[f"{r[k]:.3f}" for k in ("after_6", "after_10")], *[f"{r[k]:.4f}" for k in ("after_16", "end")],
                   f"{r['iterations']:.0f}", f"{r['proved_excess_pct']:.2f}", f"{r['near_ms']:.1f}", f"{r['arena_bytes'] / 1024:,.0f}",
                   f"{r['wrong']:.0f}"] for r in rows])


def tight_goals(result, goal):
    """Of one scene: near the optimum, much faster than it was found, tighter than stairs, never worse than fast."""
    name, best = f"{result['scene']}, {result['side']}", optimum_of(result)
    tight, fast = way_of(result, "tight f32 from points"), way_of(result, "fast f32 from points")
    steps = min(peer["mean_gap_pct"] for peer in result["peers"] if peer["name"].startswith("stairs"))
    goal(f"{name}, tight f32 from points: gap, x the optimum's", tight["mean_gap_pct"] / best["mean_gap_pct"], NEAR)
    goal(f"{name}, tight f32 from points: HiGHS's time / {FASTER}, in ms", tight["fit"]["median_us"] / 1e3, best["median_ms"] / FASTER)
    goal(f"{name}, tight f32 from points: gap %, that of stairs of as many numbers", tight["mean_gap_pct"], steps)
    goal(f"{name}, tight f32 from points: gap %, that of fast", tight["mean_gap_pct"], fast["mean_gap_pct"])


def oracle_goals(rows, goal):
    name = f"every oracle scene ({len(rows)})"
    goal(f"{name}: tight after 6 iterations, x the optimum's gap", max(r["after_6"] for r in rows), NEAR_AT_6)
    goal(f"{name}: tight after 16 iterations, x the optimum's gap", max(r["after_16"] for r in rows), NEAR)
    goal(f"{name}: tight over stairs of as many numbers, gap", max(r["end"] / r["stairs"] for r in rows), 1)
    goal(f"{name}: tight over fast, gap", max(r["end"] / r["fast"] for r in rows), 1)


def goals(result):
    """What was asked for, what was reached: [{"goal", "value", "limit", "met"}]."""
    found = []

    def goal(name, value, limit):
        found.append({"goal": name, "value": value, "limit": limit, "met": value <= limit})
    every = result["scenes"] + result["clouds"] + result["grids"]
    goal("points on the wrong side or outside, all of ours",
         sum(w["wrong"] + w["outside"] for r in every for w in r["ways"] + r.get("pairs", [])) + sum(r["wrong"] for r in result["tightness"]), 0)
    for scene_result in result["scenes"]:
        tight_goals(scene_result, goal)
    if result["tightness"]:
        oracle_goals(result["tightness"], goal)
    scan = next((r for r in result["scenes"] if r["scene"] == "bun000" and r["side"] == "above"), None)
    if scan:
        way, best = way_of(scan, "tight f32 from field 16, packed"), optimum_of(scan)
        goal("bun000, tight from a packed field of 16: gap, x the optimum's", way["mean_gap_pct"] / best["mean_gap_pct"], FIELD_NEAR)
        goal("bun000, tight from a packed field of 16: bytes", way["field_bytes"], FIELD_BYTES)
        literal = min(p["mean_gap_pct"] for p in scan["peers"] if p["name"].startswith("the paper"))
        for way in scan["ways"]:
            if way["field"] == 0 and not way["tight"]:
                goal(f"bun000, {way['name']}: fit, x floor", way["fit"]["floors"], FIT_MOST)
                goal(f"bun000, {way['name']}: certificate, x floor", way["certificate"]["floors"], CERTIFICATE_MOST)
                goal(f"bun000, {way['name']}: ns a ray, a million a second", way["rays"]["ns_per_ray"], 1000)
                goal(f"bun000, {way['name']}: root-finder steps a cell", way["rays"]["most_steps"], 12)
                goal(f"bun000, {way['name']}: mean gap %, the paper's read literally", way["mean_gap_pct"], literal)
    for scalar in (0, 1) if len(result["clouds"]) > 1 else ():
        floors = {r["points"]: r["ways"][scalar]["fit"]["floors"] for r in result["clouds"]}
        goal(f"linear: floors a fit {('f32', 'fx')[scalar]} takes at 3M points over those at 100K", floors[3_000_000] / floors[100_000], 1)
        goal(f"300K moving points, 20 x 20: fit {('f32', 'fx')[scalar]}, x floor", floors[300_000], FIT_300K_MOST)
    if result["firmware"]:
        counts, size = (result["firmware"][part] for part in ("cycles", "size"))
        scenes = ("hills", "boxes")
        goal("Cortex-M3: instructions to feed a point", max(counts[f"{scene}_feed_x100"] for scene in scenes) / 100, 45)
        goal("Cortex-M3: instructions of a refit with certificate, in the station",
             max(v for k, v in counts.items() if k.endswith("_refit")), 4_000_000)
        belt = result["firmware"]["belt"]
        goal("Cortex-M3: a new row of a 20 x 64 ring, certified, over a full refit",
             max(belt[f"{scene}_most_row"] / belt[f"{scene}_full"] for scene in scenes), BELT_ROW_MOST)
        rays = result["firmware"]["ray"]
        goal("Cortex-M3: root-finder steps of a ray in a cell", max(rays[f"{scene}_steps"] for scene in scenes), 12)
        goal("Cortex-M3, 20 x 20: flash", size["canopy"]["flash"], 64 * 1024)
        goal("Cortex-M3, 20 x 20: RAM with stack", size["canopy"]["ram"], 40 * 1024)
        goal("Cortex-M3, 10 x 10: RAM with stack", size["canopy-10x10"]["ram"], 16 * 1024)
    return found


WORK = {"feed": "feed a point to the field", "fit": "fit, lines at the integers", "fit_solves": "  its solves",
        "fit_unsettled": "  of them lines lifted at the end", "fit_longest_step": "  its longest step",
        "certify": "certificate from the field", "fit_and_certify": "fit and certificate",
        "reading": "a reading, all the way through the station",
        "reading_again": "a reading where an envelope is published and nothing is new", "refit": "the station's refit, up to the publication",
        "refit_steps": "  its steps", "refit_longest_step": "  its longest step",
        "turned_feed": "turn a point into the frame and feed it", "turned_reading": "a reading of a turned frame",
        "uncertain_reading": "a reading with uncertainty, turned"}
BELT = {"row": "a new row: move, refit, certificate (mean)", "most_row": "  the dearest one", "move": "  moving what is in memory",
        "row_solves": "  its solves", "longest_step": "  its longest step", "publish": "envelope from the ring",
        "full": "full refit with certificate", "full_solves": "  its solves"}
SANDWICH = {"feed": "feed a point to both fields", "one": "one side alone: fit and certificate", "both": "both sides, certified, apart",
            "steps": "  its steps", "longest": "  its longest step", "check": "  apart over one row of knot cells",
            "raised": "  upper coefficients raised"}
RAY = {"mean": "first hit of a ray (mean)", "most": "  the dearest", "plumb": "a ray straight down", "free": "is a segment free, edge to edge",
       "steps": "most root-finder steps in a cell"}
QUERY = {"eval": "height at a place", "point": "height, gradient and normal", "window_end": "highest over 6 x 6 knot intervals, exact to 2 steps",
         "whole_end": "highest over the whole frame", "clearance_end": "clearance of two surfaces, whole frame",
         "plane_end": "clearance to a plane, whole frame", "volume": "volume over the whole frame"}
REQUESTS = {"status": "8 live registers", "envelope": "the envelope's header, 44 registers",
            "block": "a block of 61 coefficients, 124 registers", "query": "a query by function 23: one height"}


def by_scene(counts, names):
    """Rows of names with a column for each scene, from {scene_name: count}."""
    scenes = list(dict.fromkeys(key.split("_", 1)[0] for key in counts if f"{key.split('_', 1)[0]}_{next(iter(names))}" in counts))
    return table(["work", *scenes], [[text] + [f"{counts[f'{scene}_{name}']:,}" for scene in scenes] for name, text in names.items()])


def firmware(result):
    """What cycles.elf and belt.elf counted, and what the station's images take."""
    scenes, requests = {}, []
    for name, value in result["cycles"].items():
        kind, rest = name.split("_", 1)
        value, rest = (value / 100, rest[:-5]) if rest.endswith("_x100") else (value, rest)
        if kind == "request":
            requests.append([REQUESTS.get(rest, rest), f"{value:,}"])
        else:
            scenes.setdefault(kind, {})[rest] = f"{value:,}"
    names = list(dict.fromkeys(name for rows in scenes.values() for name in rows))
    images = [[name, f"{size['flash']:,}", f"{size['ram']:,}", f"{result['stack'][name]['worst']:,}", f"{result['stack'][name]['size']:,}"]
              for name, size in result["size"].items()]
    return ["**Cortex-M3**, instructions on the emulated board, fixed point, 20 x 20, Q = 4 (hosttest/firmware/cycles.c).", "",
            table(["work", *scenes], [[WORK.get(name, name)] + [rows.get(name, "") for rows in scenes.values()] for name in names]), "",
            table(["Modbus request, first byte to whole reply", "instructions"], requests), "",
            "A belt: a ring of 20 coefficients across and 64 along, Q = 4 (hosttest/firmware/belt.c).", "",
            by_scene(result["belt"], BELT), "",
            "Both sides, rays and questions (hosttest/firmware/sandwich.c, ray.c, query.c).", "",
            by_scene(result["sandwich"], SANDWICH), "", by_scene(result["ray"], RAY), "", by_scene(result["query"], QUERY), "",
            table(["image, bytes", "flash", "RAM with stack", "worst-case stack", "stack"], images), ""]


def text(result):
    m = result["machine"]
    lines = [f"Measured {m['date']} at {m['commit']}: {m['cpu']}, {m['cores']} cores, {m['compiler']} {m['flags']}; SciPy "
             f"{m['scipy']}, NumPy {m['numpy']}, ALGLIB {m['alglib'] or 'absent'}, CGAL {m['cgal'] or 'absent'}.", ""]
    for one in result["scenes"]:
        lines += scene(one)
    lines += ["**Points**: the paper's Table 1, two moving spherical clouds, 20 x 20, 10 configurations x 20 fits (1M: 4, 3M: 2). A fit takes "
              "in points, box and field included. Its own milliseconds are of a Pentium 4 at 2.4 GHz.", "",
              series(result["clouds"], "points", lambda r: f"{r['points']:,}", lambda r: PAPER_CLOUDS.get(r["points"], "")), "",
              f"**Grids**: the paper's Table 2, the same with {result['grids'][0]['points']:,} points.", "",
              series(result["grids"], "grid", lambda r: f"{r['grid'][0]} x {r['grid'][1]}", lambda r: PAPER_GRIDS.get(r["grid"][0], "")), "",
              "**Solves**: the paper's Fig. 9. *Scattered* is its Heuristic(sigma, b, lambda) on the lines along v, *uniform* its "
              "Heuristic(sigma, b): canopy's on the columns of the fits above, read literally on random lines. Canopy's lines end at 12 at "
              "the latest.", "",
              histograms(result), ""]
    if result["tightness"]:
        lines += ["**Tight** against the optima of `data/oracle.json`, from points, f32; all gaps over the optimum's.", "",
                  against_oracle(result["tightness"]), ""]
    if result["firmware"]:
        lines += firmware(result["firmware"])
    lines += ["**Goals**", "", table(["goal", "measured", "at most", ""],
                                     [[g["goal"], f"{g['value']:,.3f}".rstrip("0").rstrip("."), f"{g['limit']:,.3f}".rstrip("0").rstrip("."),
                                       "met" if g["met"] else "MISSED"] for g in result["goals"]]), ""]
    return "\n".join(lines)
