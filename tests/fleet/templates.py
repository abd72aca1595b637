"""The job templates in deploy/ are valid, and their commands give the tables of `loopboost run`.

usage: templates.py LOOPBOOST

LOOPBOOST is the program. Each template is filled in, checked against the schema of its service (Kubernetes: JSON schema
of the API; AWS: service model of botocore; Google: protocol buffers), and its command is started once per index, with
the folders that it mounts in a temporary folder. An index whose exit code the template retries is started again. One log
is away at the first attempts. Needs kubernetes-validate, botocore, google-cloud-batch and pyyaml.
"""

import fnmatch
import json
import os
import string
import subprocess
import sys
import tempfile
from pathlib import Path

import kubernetes_validate
import yaml
from botocore import session, validate
from google.cloud import batch_v1

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
LOGS = ["one", "two", "three", "four", "five"]
N_JOBS = 2
# Tables that tasks make.
TABLES = ["scans", "poses", "keyframes", "features"]


def filled(file, values):
    return string.Template((DEPLOY / file).read_text()).substitute(values)


def kubernetes(values):
    job = yaml.safe_load(filled("kubernetes/ingest.yaml", values))
    kubernetes_validate.validate(job, "1.33", strict=True)
    spec = job["spec"]
    assert spec["completionMode"] == "Indexed" and spec["completions"] == N_JOBS
    (container,) = spec["template"]["spec"]["containers"]
    rules = spec["podFailurePolicy"]["rules"]
    (given_up,) = [rule["onExitCodes"]["values"] for rule in rules if rule["action"] == "FailIndex"]
    mounts = [mount["mountPath"] for mount in container["volumeMounts"]]
    retries = lambda code: code not in given_up
    return container["command"], mounts, "JOB_COMPLETION_INDEX", retries


def aws(values):
    definition = json.loads(filled("aws/ingest.json", values))
    model = session.Session().get_service_model("batch")
    shape = model.operation_model("RegisterJobDefinition").input_shape
    report = validate.ParamValidator().validate(definition, shape)
    assert not report.has_errors(), report.generate_report()
    container = definition["containerProperties"]
    parameters = definition["parameters"] | {
        "run": values["RUN"], "plan": values["PLAN"], "jobs": str(N_JOBS)
    }
    command = [
        parameters[word.removeprefix("Ref::")] if word.startswith("Ref::") else word
        for word in container["command"]
    ]
    rules = definition["retryStrategy"]["evaluateOnExit"]
    assert len(rules) <= 5

    def action(code, reason, status):
        """Of the first rule whose patterns all match. Without one, AWS tries again."""
        found = {"onExitCode": code, "onReason": reason, "onStatusReason": status}
        matches = lambda key, pattern: fnmatch.fnmatchcase(found[key], pattern)
        for rule in rules:
            patterns = [(key, rule[key]) for key in found if key in rule]
            # A container that did not start has no exit code.
            if all(found[key] is not None and matches(key, pattern) for key, pattern in patterns):
                return rule["action"]
        return "RETRY"

    assert action(None, "CannotPullContainerError: x", "Task failed to start") == "EXIT"
    assert action(None, "", "Host EC2 (instance i-1) terminated.") == "RETRY"
    retries = lambda code: action(str(code), "", "Essential container in task exited") == "RETRY"

    mounts = [mount["containerPath"] for mount in container["mountPoints"]]
    return command, mounts, "AWS_BATCH_JOB_ARRAY_INDEX", retries


def google(values):
    text = filled("google/ingest.json", values)
    (group,) = batch_v1.Job.from_json(text, ignore_unknown_fields=False).task_groups
    assert group.task_count == N_JOBS
    task = group.task_spec
    container = task.runnables[0].container
    policies = task.lifecycle_policies
    fails = [p for p in policies if p.action == batch_v1.LifecyclePolicy.Action.FAIL_TASK]
    given_up = [code for policy in fails for code in policy.action_condition.exit_codes]
    assert len(fails) == len(policies) and 0 < task.max_retry_count
    mounts = [volume.split(":")[1] for volume in container.volumes]
    host = [volume.split(":")[0] for volume in container.volumes]
    assert host == [volume.mount_path for volume in task.volumes]
    command = [container.entrypoint, *container.commands]
    return command, mounts, "BATCH_TASK_INDEX", lambda code: code not in given_up


def tables(folder):
    files = [file for kind in TABLES for file in (folder / kind).glob("*.parquet")]
    return {str(file.relative_to(folder)): file.read_bytes() for file in files}


def check(name, of_service, program, data, expected):
    """Does the tasks of a plan as the service would, and compares the tables."""
    run = lambda *words: subprocess.run([program, *words], cwd=data, capture_output=True, text=True)
    folder = f"run-{name}"
    planned = run("plan", "fleet.toml", "--out", folder)
    assert planned.returncode == 0, planned.stderr
    plan = planned.stdout.strip()
    values = {
        "PLAN": plan, "PLAN_SHORT": plan[:12], "RUN": f"/data/{folder}", "IMAGE": "loopboost:1",
        "CLAIM": "drives", "N_JOBS": N_JOBS, "N_AT_ONCE": N_JOBS, "FILE_SYSTEM": "fs-12345678",
        "NFS_SERVER": "10.0.0.2", "NFS_PATH": "/drives",
    }
    command, mounts, variable, retries = of_service(values)
    assert command[0] == "loopboost"
    with tempfile.TemporaryDirectory() as scratch:
        # A container sees the folders that it mounts, and its own /tmp.
        folders = {mount: scratch for mount in [*mounts, "/tmp"]} | {"/data": str(data)}

        def local(word):
            if not word.startswith("/"):
                return word
            mount = next(m for m in folders if word == m or word.startswith(f"{m}/"))
            return folders[mount] + word[len(mount):]

        def attempt(index):
            environment = {**os.environ, variable: str(index)}
            words = [program, *map(local, command[1:])]
            return subprocess.run(words, env=environment, capture_output=True, text=True)

        log = data / "made/logs/two.mcap"
        log.rename(data / "away")
        first = [attempt(index).returncode for index in range(N_JOBS)]
        assert sorted(first) == [0, 75], first
        assert retries(75) and not any(retries(code) for code in (1, 2, 70))
        assert run("merge", folder, "--plan", plan).returncode == 1
        (data / "away").rename(log)
        for index, code in enumerate(first):
            if code != 0:
                again = attempt(index)
                assert again.returncode == 0, again.stderr
    merged = run("merge", folder, "--plan", plan)
    assert merged.returncode == 0, merged.stderr
    found = tables(data / folder)
    assert found == expected, sorted(found.keys() ^ expected.keys())
    print(f"{name}: valid; {len(LOGS)} logs in {N_JOBS} jobs, {len(found)} tables as those of one process")


def main():
    program = str(Path(sys.argv[1]).resolve())
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder)
        logs = ", ".join(f'"{log}"' for log in LOGS)
        (data / "simulate.toml").write_text(
            f"seed = 3\n[simulate]\nlogs = [{logs}]\nlength_m = 12.0\npeople = 0\n"
        )
        (data / "fleet.toml").write_text(
            '[ingest]\nlogs = ["made/logs"]\npose.topic = "/ground_truth"\n'
        )
        steps = [["simulate", "simulate.toml", "--out", "made"]]
        steps += [[stage, "fleet.toml", "--out", "whole"] for stage in ("ingest", "subsample", "featurize")]
        for step in steps:
            done = subprocess.run([program, *step], cwd=data, capture_output=True, text=True)
            assert done.returncode == 0, (step, done.stderr)
        expected = tables(data / "whole")
        assert len(expected) == len(LOGS) * len(TABLES), sorted(expected)
        for of_service in (kubernetes, aws, google):
            check(of_service.__name__, of_service, program, data, expected)


main()
