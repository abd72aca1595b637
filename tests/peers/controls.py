"""Loop detection where no closure exists, or where false ones are tempting.

usage: controls.py LOOPBOOST LOGS OUT [--only NAME,...] [--write docs/detection.md]

LOOPBOOST is the program. LOGS is a folder with hdl32e-*.mcap, intel-lab.mcap, austin-aces.mcap and
mit-csail.mcap. Logs, pipelines, models and run folders are written into OUT; a command that is
interrupted resumes there. `--only` selects controls. `--write` replaces the table between the
`controls` comments in a file. The script needs numpy, pyarrow, mcap, rosbags, blake3 and the packages that
encode.py and street.py import.

Each control runs with a model that was trained on other sites, as in detection.py: with the `odometry` and
`drift` of its detector as they were learned, and with both four times as large and four times as small.

The command exits with 1 if a false closure is accepted, or any closure where none exists. The drives
through identical copies of a wing do not count: docs/detection.md states this limit.
"""

import json
import re
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import blake3
import numpy as np
import pyarrow.parquet as pq
from buildings import symmetric_ring, wings_in_line, wings_side_by_side, write_drive
from cuts import Log, before_revisit_ns
from detection import (
    FULL_CIRCLE,
    HALF_CIRCLE,
    Benchmark,
    arguments,
    chosen,
    measures,
    pipeline,
    replace,
    rule,
    run,
)

FACTORS = {"as learned": 1.0, "x 4": 4.0, "/ 4": 0.25}
COLUMNS = "| log | noise | candidates (wrong) | accepted | false | trajectory equals scan matching |"
# The north campus, in one direction, and without the lasers that a planar scan does not need.
SIMULATED = ["simulate.length_m=300", 'simulate.logs=["day-1"]', 'simulate.lasers="three"']
# A submap has the scans of so much path before and after its place.
SUBMAP_M = 5.0


@dataclass
class Control:
    """How to make a log, and what is known about it."""

    make: callable
    family: list
    # Sites in the log.
    sites: tuple = ()
    # Packets and wheels, as in the hdl32e logs, or scans and odometry.
    packets: bool = False
    has_closures: bool = False
    # False closures are reported, but are not a failure.
    is_known_limit: bool = False


def truth_topic(log):
    return "/ground_truth" if log.stem in FULL_CIRCLE or log.stem.startswith("day-") else "/pose"


def before_revisit(source, target):
    """The part of a log before its first revisit."""
    log = Log(target)
    log.add(source, before_revisit_ns(source, truth_topic(source)))
    log.finish()


def two_buildings(first, second, target):
    """The part of a log before its first revisit, followed by another log. Only the second one keeps its
    ground truth. Returns the stamp of the last message of the first one."""
    log, topic = Log(target), truth_topic(first)
    join_ns = log.add(first, before_revisit_ns(first, topic), without=[topic])
    log.add(second)
    log.finish()
    target.with_suffix(".join").write_text(str(join_ns))


def controls(benchmark):
    """The controls, by name."""
    logs = benchmark.logs

    def simulated(seed):
        def make(target):
            north_campus = Path(__file__).resolve().parents[2] / "pipelines/north-campus.toml"
            out = benchmark.out / f"campus-{seed}"
            options = [part for key in [f"seed={seed}", *SIMULATED] for part in ("--set", key)]
            run([benchmark.program, "simulate", north_campus, "--out", out, *options], f"{out}.txt")
            before_revisit(out / "logs/day-1.mcap", target)

        return Control(make, FULL_CIRCLE, packets=True)

    def first_part(name, site, family):
        make = lambda target: before_revisit(logs / f"{name}.mcap", target)
        return Control(make, family, (site,), packets=family is FULL_CIRCLE)

    def whole(name, site, family):
        make = lambda target: shutil.copyfile(logs / f"{name}.mcap", target)
        return Control(make, family, (site,), packets=family is FULL_CIRCLE, has_closures=True)

    def joined(first, second, family):
        make = lambda target: two_buildings(logs / f"{first}.mcap", logs / f"{second}.mcap", target)
        sites = ("Austin ACES", "MIT CSAIL")
        return Control(make, family, sites, packets=family is FULL_CIRCLE, has_closures=True)

    def building(walls_and_path, scanner, **known):
        make = lambda target: write_drive(target, walls_and_path, scanner)
        return Control(make, FULL_CIRCLE if scanner == "full" else HALF_CIRCLE, **known)

    found = {
        "austin-aces-before-revisit": first_part("austin-aces", "Austin ACES", HALF_CIRCLE),
        "hdl32e-aces-before-revisit": first_part("hdl32e-aces", "Austin ACES", FULL_CIRCLE),
        "hdl32e-killian-before-revisit": first_part("hdl32e-killian", "Killian Court", FULL_CIRCLE),
        "campus-7-before-revisit": simulated(7),
        "campus-11-before-revisit": simulated(11),
        "austin-aces": whole("austin-aces", "Austin ACES", HALF_CIRCLE),
        "austin-aces-and-mit-csail": joined("austin-aces", "mit-csail", HALF_CIRCLE),
        "hdl32e-aces-and-hdl32e-csail": joined("hdl32e-aces", "hdl32e-csail", FULL_CIRCLE),
    }
    for scanner in ("half", "full"):
        found |= {
            f"symmetric-{scanner}-circle": building(symmetric_ring(100), scanner),
            f"symmetric-laps-{scanner}-circle": building(symmetric_ring(192), scanner, has_closures=True),
            f"copies-in-line-{scanner}-circle": building(wings_in_line(), scanner, is_known_limit=True),
            f"copies-side-by-side-{scanner}-circle": building(
                wings_side_by_side(), scanner, has_closures=True, is_known_limit=True
            ),
        }
    return found


def with_noise(model, factor, target):
    """Writes a model whose noise of odometry and drift is larger by a factor. The rest of the text stays the
    same. The digest is that of the text with an empty digest."""
    text = model.read_text()
    before, detector = text.split('"detector": {', 1)

    def scaled(part):
        number = lambda n: n[1] + np.format_float_positional(factor * float(n[2]), trim="0")
        return re.sub(r"(: )([-+.e\d]+)", number, part[0])

    for part in ("odometry", "drift"):
        detector = re.sub(rf'"{part}": {{[^}}]*}}', scaled, detector, count=1)
    text = re.sub(r'"digest": "\w+"', '"digest": ""', f'{before}"detector": {{{detector}', count=1)
    digest = blake3.blake3(text.encode()).hexdigest()
    target.write_text(text.replace('"digest": ""', f'"digest": "{digest}"', 1))
    was, now = (json.loads(file.read_text())["detector"] for file in (model, target))
    for part in ("odometry", "drift"):
        for key, value in was[part].items():
            assert np.isclose(now[part][key], factor * value, rtol=1e-9), (part, key)
    return target


def wrong_without_truth(folder, join_ns):
    """A test of pairs that evaluate cannot judge: it is true within the first of two buildings, which has no
    revisit, and between the buildings."""
    registered = pq.read_table(next((folder / "registered").glob("*.parquet")))
    stamp_ns = registered["stamp_ns"].to_numpy()
    # The path of each segment begins with 0.
    travel_m = np.cumsum(np.maximum(np.diff(registered["travel_m"].to_numpy(), prepend=0.0), 0.0))
    join_m = travel_m[stamp_ns <= join_ns].max(initial=-np.inf)
    of_scan = dict(zip(registered["scan"].to_pylist(), travel_m))
    scans = lambda pair: (pair["query_scan"], pair["reference_scan"])
    errors = pq.read_table(folder / "evaluation/closure_errors.parquet").to_pylist()
    has_truth = {scans(error) for error in errors if error["verdict"]}

    def is_wrong(pair):
        if scans(pair) in has_truth:
            return False
        reference_m, query_m = of_scan[pair["reference_scan"]], of_scan[pair["query_scan"]]
        # The submap of a place near the join has scans of both buildings.
        is_join = reference_m < join_m - SUBMAP_M and join_m + SUBMAP_M < query_m
        return is_join or query_m <= join_m

    return is_wrong


def result(folder, join_ns):
    """Numbers of candidates, wrong candidates, accepted and false closures, and whether the poses are those
    of scan matching."""
    is_wrong = wrong_without_truth(folder, join_ns)
    candidates = pq.read_table(folder / "candidates.parquet").to_pylist()
    accepted = [c for c in pq.read_table(folder / "closures.parquet").to_pylist() if c["accepted"]]
    (of_log,) = measures(folder).values()
    poses = [pq.read_table(folder / name) for name in ("odometry", "trajectory.parquet")]
    return {
        "candidates": len(candidates),
        "wrong": of_log.get("candidates_false", 0) + sum(map(is_wrong, candidates)),
        "accepted": len(accepted),
        "false": of_log.get("n_false_by_pose", 0) + sum(map(is_wrong, accepted)),
        "same": all(poses[0][name].equals(poses[1][name]) for name in ("scan", "x_m", "y_m", "heading_rad")),
        "revisits": of_log.get("revisits", 0),
    }


def check(benchmark, name, control):
    """Runs a control with each noise. Returns rows of the table, and failures."""
    log = benchmark.out / "logs" / f"{name}.mcap"
    if not log.exists():
        log.parent.mkdir(exist_ok=True)
        unfinished = log.with_suffix(".unfinished")
        control.make(unfinished)
        unfinished.rename(log)
    join = log.with_suffix(".join")
    join_ns = int(join.read_text()) if join.exists() else 0
    model = benchmark.model_without(list(control.sites), control.family)
    rows, failures = [], []
    for noise, factor in FACTORS.items():
        out = benchmark.out / f"{name}-{factor:g}"
        file = Path(f"{out}.toml")
        file.write_text(pipeline(name, [log], packets=control.packets))
        used = model if factor == 1 else with_noise(model, factor, Path(f"{out}-model.json"))
        run([benchmark.program, "detect", file, "--model", used, "--out", out], f"{out}.txt")
        r = result(out, join_ns)
        if r["revisits"] and not control.has_closures:
            sys.exit(f"{out}: {r['revisits']:.0f} revisits, expected a drive without revisits")
        same = "yes" if r["same"] else "no"
        rows.append(
            f"| {name} | {noise} | {r['candidates']} ({r['wrong']:.0f}) | {r['accepted']} | {r['false']:.0f} | {same} |"
        )
        print(rows[-1], flush=True)
        is_wrong = r["false"] or (r["accepted"] or not r["same"]) and not control.has_closures
        if is_wrong and not control.is_known_limit:
            failures.append(f"{out}: {r['accepted']} accepted closures, {r['false']:.0f} false")
    return rows, failures


def main():
    options = arguments(__doc__).parse_args()
    benchmark = Benchmark(options.program, options.logs, options.out)
    all_controls = controls(benchmark)
    names = chosen(options, list(all_controls))
    rows, failures = [COLUMNS, rule(COLUMNS)], []
    print("\n".join(rows))
    for name in names:
        of_control, failed = check(benchmark, name, all_controls[name])
        rows += of_control
        failures += failed
    if options.write:
        replace(options.write, "controls", "\n".join(rows))
    if failures:
        sys.exit("\n".join(["closures that should not be accepted:", *failures]))


if __name__ == "__main__":
    main()
