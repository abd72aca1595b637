"""What the work on single logs costs, from measured seconds per GB.

usage: costs.py LOOPBOOST [LENGTH_M]

Simulates a drive of LENGTH_M (default 300) with all 32 lasers, with each compression of MCAP, and does its task: once
without and once with `register` (a pipeline with `[detect]`). Prints CPU seconds and the size of the tables per GB of
the log, and what follows for 1 and 100 TB. CPU seconds are those of the task and its threads (user and system).
"""

import resource
import subprocess
import sys
import tempfile
from pathlib import Path


def cpu_secs():
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def main():
    program = str(Path(sys.argv[1]).resolve())
    length_m = float(sys.argv[2]) if 2 < len(sys.argv) else 300.0
    print("| compression | work | CPU seconds per GB | tables per GB of log | 1 TB: CPU hours | tables | 100 TB: CPU hours | tables |")
    print("|---|---|---|---|---|---|---|---|")
    for compression in ("none", "lz4", "zstd"):
        with tempfile.TemporaryDirectory() as folder:
            data = Path(folder)

            def run(*words):
                done = subprocess.run([program, *words], cwd=data, capture_output=True, text=True)
                assert done.returncode in (0, 3), (words, done.stderr)
                return done.stdout.strip()

            (data / "simulate.toml").write_text(
                "seed = 5\n[simulate]\n"
                f'logs = ["drive"]\nlength_m = {length_m}\nlasers = "all"\ncompression = "{compression}"\n'
            )
            ingest = '[ingest]\nlogs = ["made/logs"]\npose.topic = "/ground_truth"\n'
            run("simulate", "simulate.toml", "--out", "made")
            n_bytes = sum(file.stat().st_size for file in (data / "made/logs").iterdir())
            for work, more in (("scans, keyframes, features", ""), ("and register", "[detect]\n")):
                (data / "fleet.toml").write_text(ingest + more)
                out = "run-register" if more else "run"
                plan = run("plan", "fleet.toml", "--out", out)
                before = cpu_secs()
                run("task", out, "--plan", plan, "--index", "0")
                secs_per_gb = (cpu_secs() - before) / (n_bytes / 1e9)
                n_out = sum(file.stat().st_size for file in (data / out / "objects").iterdir())
                share = n_out / n_bytes
                cells = [compression, work, f"{secs_per_gb:.1f}", f"{1e3 * share:.0f} MB"]
                for n_tb in (1, 100):
                    cells += [f"{secs_per_gb * n_tb * 1e3 / 3600:.1f}", f"{1e3 * share * n_tb:.0f} GB"]
                print("| " + " | ".join(cells) + " |", flush=True)


main()
