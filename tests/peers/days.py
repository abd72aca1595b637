"""Days that are added to a map one after the other: closures, errors, time and memory of each added day.

usage: days.py LOOPBOOST LOGS OUT [--days 10] [--only SEED,...] [--write docs/maps.md]

LOOPBOOST is the program, and LOGS the folder that detection.py needs for the model. The days are simulated drives
around the campus of pipelines/north-campus.toml, in opposite directions. The first one makes a map, and each of
the others is added to the runs before it (`detect.maps`). The model is one of recorded logs, and is used
without its classifier. Processor time and peak memory are those of the whole command: from the log of the day to its
closures, with the measurements against the ground truth. The processor time counts all threads, so that other
programs on the machine change it little. `--only` selects seeds, and `--write` replaces the
table between the `days` comments in a file. The script needs numpy, pyarrow and mcap.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

from detection import CAMPUS_SEEDS, FULL_CIRCLE, Benchmark, arguments, chosen, replace, rule

PIPELINE = Path(__file__).resolve().parents[2] / "pipelines/north-campus.toml"
COLUMNS = "| seed | day | accepted between days | false | revisits closed | ATE of the map | processor time | peak memory |"


def measured(command, log_file):
    """Runs the program. Returns the processor time in seconds and the peak memory in bytes."""
    with open(log_file, "w") as file:
        child = subprocess.Popen([str(part) for part in command], stdout=file, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode not in (0, 3):
        sys.exit(f"{' '.join(map(str, command))} failed:\n{Path(log_file).read_text()[-3000:]}")
    return usage.ru_utime + usage.ru_stime, 1024 * usage.ru_maxrss


class Days(Benchmark):
    def simulate(self, seed, names):
        out = self.out / f"days-{seed}"
        settings = ["--set", f"seed={seed}", "--set", f"simulate.logs={json.dumps(names)}"]
        measured([self.program, "simulate", PIPELINE, "--out", out, *settings], f"{out}.txt")
        return [(out / "logs" / f"{name}.mcap").resolve() for name in names]

    def add(self, seed, log, before):
        """Solves the log of a day. `before` are the runs of the days before it."""
        model = self.model_without([], FULL_CIRCLE)
        name = f"days-{seed}-{log.stem}"
        text = PIPELINE.read_text()
        ingest = text[text.index("[ingest]") : text.index("[label]")]
        ingest = ingest.replace("[ingest]\n", f"[ingest]\nlogs = [{json.dumps(str(log))}]\n", 1)
        maps = ", ".join(json.dumps(str(run.resolve())) for run in before)
        file = self.out / f"{name}.toml"
        file.write_text(
            f'name = "{name}"\nseed = {seed}\n{ingest}[detect]\nclassifier = false\nmaps = [{maps}]\n'
            '[evaluate]\ntruth = { topic = "/ground_truth" }\n'
        )
        out = self.out / name
        secs, n_bytes = measured([self.program, "detect", file, "--model", model, "--out", out], f"{out}.txt")
        return out, secs, n_bytes


def rows(days, seed, n_days):
    runs = []
    for log in days.simulate(seed, [f"day-{k + 1}" for k in range(n_days)]):
        run, secs, n_bytes = days.add(seed, log, runs)
        sites = json.loads((run / "evaluation/summary.json").read_text())["sites"]
        site = sites[0] if sites else None
        truth = (site or {}).get("truth") or {}
        share = f"{truth['n_closed']} of {truth['n_revisits']} ({truth['n_closed'] / truth['n_revisits']:.3f})" if truth else "-"
        cells = [
            f"{seed}",
            log.stem.removeprefix("day-"),
            f"{site['n_accepted']}" if site else "-",
            f"{truth['n_false']} of {truth['n_judged']}" if truth else "-",
            share,
            ", ".join(f"{of_map['ate_rmse_m']:.3f} m" for of_map in site["maps"]) if site else "-",
            f"{secs:.0f} s",
            f"{n_bytes / 1e9:.1f} GB",
        ]
        yield f"| {' | '.join(cells)} |"
        runs.append(run)


def main():
    parser = arguments(__doc__)
    parser.add_argument("--days", type=int, default=10)
    options = parser.parse_args()
    days = Days(options.program, options.logs, options.out)
    made = [COLUMNS, rule(COLUMNS)]
    print("\n".join(made))
    for seed in chosen(options, [str(seed) for seed in (*CAMPUS_SEEDS, 13)]):
        for row in rows(days, int(seed), options.days):
            made.append(row)
            print(row, flush=True)
    if options.write:
        replace(options.write, "days", "\n".join(made))


if __name__ == "__main__":
    main()
