"""The work on single logs as Ray tasks, then the merge.

usage: ingest.py PIPELINE.toml RUN [option of `loopboost plan` ...]

The pipeline, the run folder, the logs and `loopboost` must be at the same paths on all nodes. Each task needs one CPU.
A task whose worker or node dies, or that ends with 75 (trouble with storage or inputs), is tried again five times.
"""

import os
import re
import subprocess
import sys

import ray


class TryAgain(Exception):
    """Trouble with storage or inputs."""


@ray.remote(num_cpus=1, max_retries=5, retry_exceptions=[TryAgain])
def do_task(run, plan, index):
    command = ["loopboost", "task", run, "--plan", plan, "--index", str(index)]
    done = subprocess.run(command, env={**os.environ, "RAYON_NUM_THREADS": "1"}, stderr=subprocess.PIPE, text=True)
    if done.returncode == 75:
        raise TryAgain(done.stderr)
    if done.returncode != 0:
        raise RuntimeError(f"task {index} ended with {done.returncode}: {done.stderr}")


def main():
    pipeline, run = sys.argv[1:3]
    run = os.path.abspath(run)
    planned = subprocess.run(["loopboost", "plan", pipeline, "--out", run, *sys.argv[3:]],
                             check=True, capture_output=True, text=True)
    print(planned.stderr, end="", file=sys.stderr)
    plan, n_tasks = planned.stdout.strip(), int(re.search(r": (\d+) tasks?$", planned.stderr, re.M)[1])
    ray.init()
    for task in [do_task.remote(run, plan, index) for index in range(n_tasks)]:
        try:
            ray.get(task)
        except Exception as error:  # The merge lists what is missing.
            print(error, file=sys.stderr)
    sys.exit(subprocess.run(["loopboost", "merge", run, "--plan", plan]).returncode)


if __name__ == "__main__":
    main()
