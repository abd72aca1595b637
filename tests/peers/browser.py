"""Opens a report in headless Chromium: no word on the console, every figure drawn.

usage: browser.py REPORT.html
"""

import pathlib
import re
import subprocess
import sys
import tempfile

FIGURES = ["error-curve", "precision-recall"]
report = pathlib.Path(sys.argv[1]).resolve()
with tempfile.TemporaryDirectory() as profile:
    flags = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run"
    flags += " --disable-background-networking --disable-component-update --disable-sync"
    command = ["chromium", *flags.split(), f"--user-data-dir={profile}", "--enable-logging=stderr"]
    page = subprocess.run(
        [*command, "--dump-dom", report.as_uri()], capture_output=True, text=True, timeout=120
    )
console = [line for line in page.stderr.splitlines() if ":CONSOLE" in line]
assert page.returncode == 0, page.stderr
assert not console, console
for figure in FIGURES:
    svg = re.search(rf'<svg id="{figure}".*?</svg>', page.stdout, re.S)
    assert svg, f"no figure {figure}"
    assert len(re.findall(r'class="line" d="M', svg[0])) >= 3, f"{figure} has fewer than 3 lines"
n_maps = page.stdout.count('class="map"')
assert n_maps > 0, "no map"
print(f"{report.name}: {len(FIGURES)} charts and {n_maps} maps, nothing on the console")
