"""Runs the commands of docs/tutorial.md, and compares the page with what they print and write.

usage: tutorial.py LOOPBOOST

LOOPBOOST is the program. `cargo install` is left out. The commands run in a temporary folder.
"""

import html
import os
import pathlib
import re
import subprocess
import sys
import tempfile

root = pathlib.Path(__file__).resolve().parents[2]
page = (root / "docs/tutorial.md").read_text(encoding="utf-8")
#: The run of one log ends with a warning, as the page says.
WARNING = "warning[one_class_left]"
PIPELINE = "first/first.toml"


def execute(commands, folder, environment):
    """Runs commands in bash. Returns the exit code, what was printed, and the folder after them."""
    script = f"set -e\n{commands}\npwd >&3"
    with tempfile.TemporaryFile() as place:
        done = subprocess.run(
            ["bash", "-c", f"exec 3>&{place.fileno()}\n{script}"], cwd=folder, env=environment, pass_fds=[place.fileno()],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )
        place.seek(0)
        return done.returncode, done.stdout, place.read().decode().strip() or folder


def check_lines(expected, printed):
    """The lines of the page are among those that were printed, in this order."""
    lines = iter(printed.splitlines())
    for line in expected.splitlines():
        assert not line or line in lines, f"the tutorial shows a line that was not printed, or in another order:\n{line}\n\nprinted:\n{printed}"


def main(program, work):
    (work / "bin").mkdir()
    (work / "bin/loopboost").symlink_to(program)
    (work / "pipelines").symlink_to(root / "pipelines")
    environment = dict(os.environ, PATH=f"{work / 'bin'}{os.pathsep}{os.environ['PATH']}")
    folder, printed, n_blocks, n_warnings, is_written = work, "", 0, 0, False
    for language, text in re.findall(r"^```(\w*)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL):
        if language == "sh" and not text.startswith("cargo "):
            code, printed, folder = execute(text, folder, environment)
            expected = 3 if WARNING in printed else 0
            n_warnings += expected == 3
            assert code == expected, f"exit code {code} of:\n{text}\n{printed}"
            n_blocks += 1
        elif language == "toml" and not is_written:
            # `inspect --write` wrote the first pipeline. The reader changes it into the second one.
            found = (work / PIPELINE).read_text(encoding="utf-8")
            assert found == text, f"the tutorial shows another {PIPELINE} than `inspect` wrote:\n{found}"
            is_written = True
        elif language == "toml":
            (work / PIPELINE).write_text(text, encoding="utf-8")
        elif not language:
            check_lines(text, printed)
    assert n_warnings == 1, f"{n_warnings} runs with a warning, expected that of the single log"
    report = (work / "first/runs/first/report.html").read_text(encoding="utf-8")
    headings = {html.unescape(heading) for heading in re.findall(r"<h2[^>]*>(.*?)</h2>", report)}
    sections = set(re.findall(r"\*\*(.+?)\*\*", page.partition("### Read the report")[2]))
    assert sections and sections <= headings, f"the report has no section {sections - headings}, only {headings}"
    print(f"{n_blocks} blocks of commands, {len(sections)} sections of the report")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        main(pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(temporary))
