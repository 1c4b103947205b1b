"""The tables of `make bench`: Markdown that also reads well on a terminal. Times are medians of processor time."""

FIT_MOST, CERTIFICATE_MOST = 10, 15  # times the floor
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


def scene(result):
    floor = result["floor"]
    head = ["surface", "fit ms", "x floor", "certificate ms", "x floor", "all ms", "mean gap %", "max gap %", "wrong"]
    rows = [way_row(way) for way in result["ways"]] + [peer_row(peer) for peer in result["peers"]]
    field = [way["field_certificate"]["floors"] for way in result["ways"] if "field_certificate" in way]
    lines = [f"**{result['scene']}**: {result['points']:,} points, {result['grid'][0]} x {result['grid'][1]}, {result['side']}. "
             f"Floor {floor['median_us']:.1f} us, {floor['ns_per_point']:.2f} ns a point ({floor['way']}).", "",
             table(head, rows), ""]
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


def series(results, head, label):
    rows = []
    for result in results:
        for way in result["ways"]:
            rows.append([f"{label(result)}, {way['scalar']}", f"{result['floor']['ns_per_point']:.2f}",
                         milliseconds(way["fit"]["median_us"] / 1e3), f"{way['fit']['ns_per_point']:.2f}", times(way["fit"]["floors"]),
                         f"{way['certificate']['ns_per_point']:.2f}", times(way["certificate"]["floors"]),
                         f"{way['mean_gap_pct']:.2f}", way["solves"], way["unsettled"], way["wrong"] + way["outside"]])
    return table([head, "floor ns/pt", "fit ms", "fit ns/pt", "x floor", "cert. ns/pt", "x floor", "mean gap %", "solves",
                  "unsettled", "wrong"], rows)


def goals(result):
    """What was asked for, what was reached: [{"goal", "value", "limit", "met"}]."""
    found = []

    def goal(name, value, limit):
        found.append({"goal": name, "value": value, "limit": limit, "met": value <= limit})
    every = result["scenes"] + result["clouds"] + result["grids"]
    goal("points on the wrong side or outside, all of ours", sum(w["wrong"] + w["outside"] for r in every for w in r["ways"]), 0)
    scan = next((r for r in result["scenes"] if r["scene"] == "bun000"), None)
    if scan:
        literal = min(p["mean_gap_pct"] for p in scan["peers"] if p["name"].startswith("the paper"))
        for way in scan["ways"]:
            if way["field"] == 0:
                goal(f"bun000, {way['name']}: fit, x floor", way["fit"]["floors"], FIT_MOST)
                goal(f"bun000, {way['name']}: certificate, x floor", way["certificate"]["floors"], CERTIFICATE_MOST)
                goal(f"bun000, {way['name']}: ns a ray, a million a second", way["rays"]["ns_per_ray"], 1000)
                goal(f"bun000, {way['name']}: root-finder steps a cell", way["rays"]["most_steps"], 12)
                goal(f"bun000, {way['name']}: mean gap %, the paper's read literally", way["mean_gap_pct"], literal)
    for scalar in (0, 1) if len(result["clouds"]) > 1 else ():
        floors = {r["points"]: r["ways"][scalar]["fit"]["floors"] for r in result["clouds"]}
        goal(f"linear: floors a fit {('f32', 'fx')[scalar]} takes at 3M points over those at 100K", floors[3_000_000] / floors[100_000], 1)
    if result["firmware"]:
        counts, size = (result["firmware"][part] for part in ("instructions", "size"))
        goal("Cortex-M3: instructions to feed a point", max(v for k, v in counts.items() if k.endswith("feed_x100")) / 100, 45)
        goal("Cortex-M3: instructions of a refit with certificate, in the station",
             max(v for k, v in counts.items() if k.endswith("_refit")), 4_000_000)
        belt = result["firmware"]["belt"]
        goal("Cortex-M3: a new row of a 20 x 64 ring, certified, over a full refit",
             max(belt[f"{scene}_most_row"] / belt[f"{scene}_full"] for scene in ("hills", "boxes")), BELT_ROW_MOST)
        goal("Cortex-M3, 20 x 20: flash", size["canopy"]["flash"], 64 * 1024)
        goal("Cortex-M3, 20 x 20: RAM with stack", size["canopy"]["ram"], 40 * 1024)
        goal("Cortex-M3, 10 x 10: RAM with stack", size["canopy-10x10"]["ram"], 16 * 1024)
    return found


WORK = {"feed": "feed a point to the field", "fit": "fit, lines at the integers", "fit_solves": "  its solves",
        "fit_unsettled": "  of them lines lifted at the end", "fit_longest_step": "  its longest step",
        "certify": "certificate from the field", "fit_and_certify": "fit and certificate",
        "reading": "a reading, all the way through the station",
        "reading_again": "a reading where an envelope is published and nothing is new", "refit": "the station's refit, up to the publication",
        "refit_steps": "  its steps", "refit_longest_step": "  its longest step"}
BELT = {"row": "a new row: move, refit, certificate (mean)", "most_row": "  the dearest one", "move": "  moving what is in memory",
        "row_solves": "  its solves", "longest_step": "  its longest step", "publish": "envelope from the ring",
        "full": "full refit with certificate", "full_solves": "  its solves"}
REQUESTS = {"status": "8 live registers", "envelope": "the envelope's header, 44 registers",
            "block": "a block of 61 coefficients, 124 registers", "query": "a query by function 23: one height"}


def by_scene(counts, names):
    """Rows of names with a column for each scene, from {scene_name: count}."""
    scenes = list(dict.fromkeys(key.split("_", 1)[0] for key in counts))
    return table(["work", *scenes], [[text] + [f"{counts[f'{scene}_{name}']:,}" for scene in scenes] for name, text in names.items()])


def firmware(result):
    """What cycles.elf and belt.elf counted, and what the station's images take."""
    scenes, requests = {}, []
    for name, value in result["instructions"].items():
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
            table(["image, bytes", "flash", "RAM with stack", "worst-case stack", "stack"], images), ""]


def text(result):
    m = result["machine"]
    lines = [f"Measured {m['date']} at {m['commit']}: {m['cpu']}, {m['cores']} cores, {m['compiler']} {m['flags']}; SciPy "
             f"{m['scipy']}, NumPy {m['numpy']}, ALGLIB {m['alglib'] or 'absent'}.", ""]
    for one in result["scenes"]:
        lines += scene(one)
    lines += ["**Points**: two spheres, 20 x 20, from the points.", "",
              series(result["clouds"], "points", lambda r: f"{r['points']:,}"), "",
              "**Grids**: two spheres, 30,000 points, from the points.", "",
              series(result["grids"], "grid", lambda r: f"{r['grid'][0]} x {r['grid'][1]}"), ""]
    if result["firmware"]:
        lines += firmware(result["firmware"])
    lines += ["**Goals**", "", table(["goal", "measured", "at most", ""],
                                     [[g["goal"], f"{g['value']:,.3f}".rstrip("0").rstrip("."), f"{g['limit']:,.3f}".rstrip("0").rstrip("."),
                                       "met" if g["met"] else "MISSED"] for g in result["goals"]]), ""]
    return "\n".join(lines)
