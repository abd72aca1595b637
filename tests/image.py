"""Checks the Dockerfile without Docker: its style, its releases, and that it copies every file that the build needs.

usage: tests/image.py HADOLINT

HADOLINT is the program. The image itself is not built.
"""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def copied(dockerfile):
    """The paths of the repository that the COPY lines name."""
    paths = []
    for line in dockerfile.splitlines():
        words = line.split()
        if words[:1] == ["COPY"] and not any(word.startswith("--from=") for word in words):
            paths += [word for word in words[1:-1] if not word.startswith("--")]
    return paths


def in_context(path, ignore):
    """Whether a file is sent to Docker. The last matching line of .dockerignore decides; only `*` and paths are known."""
    is_sent = True
    for line in ignore.splitlines():
        if not line or line.startswith("#"):
            continue
        pattern = line.removeprefix("!")
        assert pattern == "*" or "*" not in pattern, f".dockerignore: the pattern `{line}` is not known here"
        if pattern == "*" or path == pattern or path.startswith(pattern + "/"):
            is_sent = line.startswith("!")
    return is_sent


def needed():
    """The files that Cargo and the compiler read: manifests, sources, what sources include, and what manifests name."""
    files = {"Cargo.toml", "Cargo.lock"}
    for path in (ROOT / "crates").rglob("*"):
        if path.is_file():
            files.add(path.relative_to(ROOT).as_posix())
    for manifest in (ROOT / "crates").glob("*/Cargo.toml"):
        table = tomllib.loads(manifest.read_text())
        targets = [table.get("lib", {}), *(t for kind in ["bin", "test", "bench", "example"] for t in table.get(kind, []))]
        for target in targets:
            if "path" in target:
                files.add((manifest.parent / target["path"]).resolve().relative_to(ROOT).as_posix())
    # Files that sources include, which may be outside of crates/.
    for source in (ROOT / "crates").rglob("*.rs"):
        for name in re.findall(r'include(?:_str|_bytes)?!\(\s*"([^"]+)"', source.read_text()):
            included = (source.parent / name).resolve()
            assert included.exists(), f"{source} includes {name}, which does not exist"
            files.add(included.relative_to(ROOT).as_posix())
    return files


def missing(dockerfile, ignore):
    """The needed files that do not get into the image of the build, and the copied paths that are not sent."""
    paths = copied(dockerfile)
    faults = []
    for file in needed():
        if not any(file == path or file.startswith(path + "/") for path in paths):
            faults.append(f"{file} is not copied")
    faults += [f"{file} is in .dockerignore" for file in needed() if not in_context(file, ignore)]
    for path in paths:
        assert (ROOT / path).exists(), f"Dockerfile: {path} does not exist"
        faults += [] if in_context(path, ignore) else [f"{path} is in .dockerignore"]
    return sorted(faults)


dockerfile = (ROOT / "Dockerfile").read_text()
ignore = (ROOT / ".dockerignore").read_text()
assert missing(dockerfile, ignore) == [], missing(dockerfile, ignore)
# A missing file is found.
assert missing(dockerfile.replace("COPY tests/main.rs tests/main.rs\n", ""), ignore) == ["tests/main.rs is not copied"]
assert missing(dockerfile, ignore.replace("!Cargo.lock\n", "")) == ["Cargo.lock is in .dockerignore"] * 2
for secret in [".git/config", "target/release/loopboost", "runs/a/run.json", "data/a.mcap"]:
    assert not in_context(secret, ignore), f"{secret} is sent to Docker"

# The images of Rust, here and in the workflows, have the release of rust-toolchain.toml.
release = tomllib.loads((ROOT / "rust-toolchain.toml").read_text())["toolchain"]["channel"]
named = [dockerfile, *(path.read_text() for path in (ROOT / ".github/workflows").glob("*.yml"))]
releases = [found for text in named for found in re.findall(r"\brust:([\w.]+)", text)]
assert releases and set(releases) == {release}, f"images of Rust {releases}, expected {release} (rust-toolchain.toml)"
# Both stages have the same release of Debian: the program needs the glibc that it was linked with, or a later one.
suites = re.findall(r"^FROM (?:rust:[\w.]+-slim-|debian:)(\w+)", dockerfile, re.MULTILINE)
assert len(suites) == 2 and suites[0] == suites[1], suites

linted = subprocess.run([sys.argv[1], "--format", "json", ROOT / "Dockerfile"], capture_output=True, text=True)
faults = json.loads(linted.stdout)
assert faults == [] and linted.returncode == 0, faults
# A fault is found: a last user that is root.
rooted = dockerfile.replace("USER 1000:1000", "USER 0")
linted = subprocess.run([sys.argv[1], "--format", "json", "-"], input=rooted, capture_output=True, text=True)
assert [fault["code"] for fault in json.loads(linted.stdout)] == ["DL3002"], linted
print(f"Dockerfile: {len(needed())} files, Rust {release}, Debian {suites[0]}")
