"""Commands of the program, in a process of their own."""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from loopboost._errors import ArgumentError, CommandError

_USAGE = 2
_NEEDS_ATTENTION = 3
#: How often signals are looked for while the command works, and how long it may take to end [s].
_POLL_SECS = 0.1
_WAIT_SECS = 10


def execute(arguments: list[Any], progress: Callable[[str], None] | None = None) -> tuple[list[str], list[str]]:
    """Runs a command. Returns the lines that it wrote to stdout and to stderr.

    A process of its own can be stopped at any moment: Ctrl-C, and an exception in `progress`, end it. What it had finished
    is kept, and the same command continues from there.
    """
    if not sys.executable:
        raise ArgumentError("Python does not know its own program (sys.executable), which the commands start")
    # This package, wherever it was found.
    folders = [str(Path(__file__).resolve().parent.parent), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, folders))}
    command = [sys.executable, "-m", "loopboost", *map(str, arguments)]
    child = subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        errors="replace",
    )
    outputs: list[tuple[Any, list[str]]] = [(child.stdout, []), (child.stderr, [])]
    arrived: queue.SimpleQueue[Any] = queue.SimpleQueue()
    readers = [threading.Thread(target=_read, args=(*output, arrived), daemon=True) for output in outputs]
    for reader in readers:
        reader.start()
    (_, lines), (_, log) = outputs
    try:
        n_open, n_reported = len(outputs), 0
        while n_open:
            try:
                pipe = arrived.get(timeout=_POLL_SECS)
            except queue.Empty:
                # A wait without end could not be interrupted by a signal that another thread got.
                continue
            if pipe is None:
                n_open -= 1
            elif pipe is child.stdout and progress is not None:
                progress(lines[n_reported])
                n_reported += 1
        exit_code = child.wait()
    except BaseException:
        _stop(child)
        raise
    finally:
        for reader in readers:
            reader.join(_WAIT_SECS)
    if exit_code in (0, _NEEDS_ATTENTION):
        # The last line counts those before it.
        return lines, [line for line in log if not line.startswith("done with ")]
    message = "\n".join(_error_of(log)) or f"`{' '.join(command)}` ended with exit code {exit_code}"
    if exit_code == _USAGE:
        raise ArgumentError(message)
    raise CommandError(message, exit_code, log)


def _read(pipe: Any, lines: list[str], arrived: queue.SimpleQueue[Any]) -> None:
    """Appends the lines of a pipe, and announces each one, and the end with None."""
    try:
        with pipe:
            for line in pipe:
                lines.append(line.rstrip("\n"))
                arrived.put(pipe)
    finally:
        arrived.put(None)


def _stop(child: subprocess.Popen[str]) -> None:
    child.terminate()
    try:
        child.wait(_WAIT_SECS)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()


def _error_of(log: list[str]) -> list[str]:
    """The lines from the last error on."""
    starts = [number for number, line in enumerate(log) if line.startswith("error: ")]
    if not starts:
        return log[-5:]
    return [log[starts[-1]].removeprefix("error: "), *log[starts[-1] + 1 :]]
