"""The work on single logs as Ray tasks, then the merge.

usage: ingest.py PIPELINE.toml RUN [option of `loopboost plan` ...]

The pipeline, the run folder, the logs and `loopboost` must be at the same paths on all nodes. Each task needs one CPU.
A task whose worker or node dies is tried again five times, and so is one that ends with 75 (trouble with storage or
inputs), after 2, 4, 8, ... s.
"""

import os
import re
import subprocess
import sys
import time

import ray


RETRIES = 5


@ray.remote(num_cpus=1, max_retries=RETRIES)
def do_task(run, plan, index):
    command = ["loopboost", "task", run, "--plan", plan, "--index", str(index)]
    for attempt in range(RETRIES + 1):
        time.sleep(2**attempt if attempt else 0)
        done = subprocess.run(command, env={**os.environ, "RAYON_NUM_THREADS": "1"}, stderr=subprocess.PIPE, text=True)
        # Only trouble with storage or inputs can go away.
        if done.returncode != 75:
            break
    return None if done.returncode == 0 else f"task {index} ended with {done.returncode}: {done.stderr}"


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    pipeline, run = sys.argv[1], os.path.abspath(sys.argv[2])
    planned = subprocess.run(["loopboost", "plan", pipeline, "--out", run, *sys.argv[3:]], capture_output=True, text=True)
    print(planned.stderr, end="", file=sys.stderr)
    if planned.returncode != 0:
        sys.exit(planned.returncode)
    plan, n_tasks = planned.stdout.strip(), int(re.search(r": (\d+) tasks?$", planned.stderr, re.M)[1])
    ray.init()
    for task in [do_task.remote(run, plan, index) for index in range(n_tasks)]:
        try:
            failed = ray.get(task)
        except ray.exceptions.RayError as error:
            failed = str(error)
        if failed:  # The merge lists what is missing.
            print(failed, file=sys.stderr)
    sys.exit(subprocess.run(["loopboost", "merge", run, "--plan", plan]).returncode)


if __name__ == "__main__":
    main()
