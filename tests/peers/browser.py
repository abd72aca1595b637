"""Opens a report in headless Chromium with a phone and a desktop screen, light and dark, and checks
that nothing is written to the console, that every figure is drawn inside the page, and that nothing
is wider than the screen.

usage: browser.py REPORT.html
"""

import base64
import itertools
import json
import os
import pathlib
import re
import select
import struct
import subprocess
import sys
import tempfile
import time
import socket
import urllib.request

report = pathlib.Path(sys.argv[1]).resolve()
FIGURES = ["first-rounds", "match-1", "non-match-1", "map-1", "ground-1"]
GROUPINGS = re.findall(r'id="error-curve-(\w+)"', report.read_text())
assert GROUPINGS, "no error curve"
FIGURES += [f"{figure}-{grouping}" for figure in ["error-curve", "precision-recall"] for grouping in GROUPINGS]

# Measures the page: the boxes of all figures, the width of the page, the smallest text, the colours.
MEASURE = """(() => {
  const box = e => { const b = e.getBoundingClientRect(); return [b.left, b.width, b.height]; };
  return JSON.stringify({
    figures: Object.fromEntries([...document.querySelectorAll('svg[id]')].map(e => [e.id, box(e)])),
    unnamed: [...document.querySelectorAll('svg[id]')].filter(e => !e.getAttribute('aria-label')).length,
    lines: Object.fromEntries([...document.querySelectorAll('svg.chart')].map(e =>
      [e.id, [...e.querySelectorAll('path.line')].filter(p => p.getTotalLength() > 0).length])),
    width: document.documentElement.scrollWidth, screen: innerWidth,
    smallest: Math.min(...[...document.querySelectorAll('svg.chart text')].map(t =>
      parseFloat(getComputedStyle(t).fontSize) * t.getScreenCTM().d).filter(s => s > 0)),
    paper: getComputedStyle(document.body).backgroundColor,
  });
})()"""


class Page:
    """A browser tab, controlled over the DevTools protocol (a WebSocket, RFC 6455)."""

    def __init__(self, address):
        host, port, path = re.match(r"ws://([^:/]+):(\d+)(/.*)", address).groups()
        self.socket = socket.create_connection((host, int(port)), timeout=60)
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall(
            f"GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        self.stream = self.socket.makefile("rb")
        while self.stream.readline() not in (b"\r\n", b""):
            pass
        self.numbers = itertools.count(1)
        self.events = []

    def receive(self):
        data = b""
        while True:
            first, second = self.stream.read(2)
            length = second & 127
            if length == 126:
                (length,) = struct.unpack(">H", self.stream.read(2))
            elif length == 127:
                (length,) = struct.unpack(">Q", self.stream.read(8))
            data += self.stream.read(length)
            if first & 128:
                return json.loads(data)

    def call(self, method, **params):
        number = next(self.numbers)
        text = json.dumps({"id": number, "method": method, "params": params}).encode()
        size = bytes([128 | len(text)]) if len(text) < 126 else b"\xfe" + struct.pack(">H", len(text))
        self.socket.sendall(b"\x81" + size + bytes(4) + text)  # masked with zeros
        while (answer := self.receive()).get("id") != number:
            self.events.append(answer)
        assert "error" not in answer, answer
        return answer["result"]

    def wait_for(self, method):
        while not any(event.get("method") == method for event in self.events):
            self.events.append(self.receive())


def check(page, width, height, scheme):
    page.events.clear()
    page.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600)
    page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    page.call("Page.navigate", url=report.as_uri())
    page.wait_for("Page.loadEventFired")
    seen = json.loads(page.call("Runtime.evaluate", expression=MEASURE)["result"]["value"])
    console = ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded")
    messages = [event for event in page.events if event.get("method") in console]
    assert not messages, f"console messages: {messages}"
    fetched = [e["params"]["request"]["url"] for e in page.events if e.get("method") == "Network.requestWillBeSent"]
    assert all(url == report.as_uri() for url in fetched), fetched
    for figure in FIGURES:
        assert figure in seen["figures"], f"figure {figure} is missing"
    for figure, (left, wide, high) in seen["figures"].items():
        assert wide > 100 and high > 50, f"{figure} is {wide} x {high} at width {width}"
        assert 0 <= left and left + wide <= width + 1, f"{figure} is outside the page at width {width}"
    for grouping in GROUPINGS:
        for figure in [f"error-curve-{grouping}", f"precision-recall-{grouping}"]:
            assert seen["lines"][figure] >= 3, f"{figure} has fewer than 3 lines"
    assert seen["unnamed"] == 0, "a figure has no aria-label"
    assert seen["width"] <= seen["screen"], f"the page is {seen['width']} px wide, the screen {seen['screen']} px"
    assert seen["smallest"] >= 8, f"text of {seen['smallest']} px at width {width}, expected 8 px or more"
    return seen


with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
    flags = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --remote-debugging-port=0"
    flags += " --disable-background-networking --disable-component-update --disable-sync"
    command = ["chromium", *flags.split(), f"--user-data-dir={profile}", "about:blank"]
    browser = subprocess.Popen(command, stderr=subprocess.PIPE)
    try:
        output, end = b"", time.monotonic() + 60
        while not (found := re.search(rb"DevTools listening on ws://([\d.:]+)/", output)):
            assert time.monotonic() < end, output.decode()
            if select.select([browser.stderr], [], [], 1)[0]:
                output += os.read(browser.stderr.fileno(), 65536)
        with urllib.request.urlopen(f"http://{found[1].decode()}/json/list") as answer:
            tab = next(tab for tab in json.load(answer) if tab["type"] == "page")
        page = Page(tab["webSocketDebuggerUrl"])
        for domain in ["Page", "Runtime", "Log", "Network"]:
            page.call(f"{domain}.enable")
        papers = set()
        for (width, height), scheme in itertools.product([(390, 844), (1280, 900)], ["light", "dark"]):
            seen = check(page, width, height, scheme)
            papers.add((scheme, seen["paper"]))
        assert len({paper for _, paper in papers}) == 2, f"the background is the same in light and dark mode: {papers}"
    finally:
        browser.terminate()
        browser.wait()
size = report.stat().st_size
assert size < 3_000_000, f"the report has {size} bytes, expected less than 3,000,000"
print(f"{report.name}: {len(seen['figures'])} figures checked at 390 and 1280 px, light and dark, no console messages, {size // 1000} kB")
