"""Loop closures from the drive logs of robots: features, models, maps.

`inspect` describes a log and suggests a pipeline file. `run` makes scans, keyframes, features, labels, models and a report.
`detect` finds loop closures in new logs with a model. Both return a `Run`, whose tables go into polars, pyarrow or DuckDB.
`read_scans` and `read_poses` read logs into memory. `featurize`, `featurize_table` and `Model` work on arrays and tables, without
files.
"""

from __future__ import annotations

import html
import json
from collections.abc import Callable, Iterable
from os import PathLike
from pathlib import Path
from typing import Any

from loopboost._errors import ArgumentError, CommandError, InputError, LoopboostError
from loopboost._logs import read_poses, read_scans, to_tum
from loopboost._loopboost import Rows, Table, __version__, feature_names
from loopboost._model import Model, featurize, featurize_table
from loopboost._run import Run

__all__ = [
    "ArgumentError",
    "CommandError",
    "InputError",
    "LoopboostError",
    "Model",
    "Rows",
    "Run",
    "Survey",
    "Table",
    "__version__",
    "detect",
    "feature_names",
    "featurize",
    "featurize_table",
    "inspect",
    "read_poses",
    "read_scans",
    "run",
    "to_tum",
]


def _execute(arguments: list[Any], progress: Callable[[str], None] | None = None) -> tuple[list[str], list[str]]:
    # The modules that it needs take a third of the time of `import loopboost`.
    from loopboost._command import execute

    return execute(arguments, progress)


class Survey(dict[str, Any]):
    """What `inspect` found in a log: the same contents as `loopboost inspect --json`."""

    @property
    def pipeline(self) -> str | None:
        """The suggested pipeline, as TOML; None if the log has no scans that can be used. `problems` says what it lacks."""
        return self["pipeline"]

    @property
    def problems(self) -> list[str]:
        """Why `run` would refuse the suggested pipeline; empty if it would not."""
        found = [f"missing: {missing}" for missing in self["missing"]]
        return found + [f"refused: {self[key]}" for key in ("refused", "too_few_pairs") if self[key]]

    def _repr_html_(self) -> str:
        problems = "".join(f"<li><b>{html.escape(line)}</b></li>" for line in self.problems)
        notes = "".join(f"<li>{html.escape(line)}</li>" for line in self.messages)
        pipeline = html.escape(self.pipeline or "none")
        return f"<b>{html.escape(str(self['log']))}</b><ul>{problems}{notes}</ul>suggested pipeline:<pre>{pipeline}</pre>"

    #: Losses and notes with their codes, as lines.
    messages: tuple[str, ...] = ()


def inspect(log: str | PathLike[str], track_m: float | None = None) -> Survey:
    """Describes a log, reports all problems that a run would report, and suggests a pipeline.

    log: an MCAP file, or the folder of a split drive. track_m: fuse wheels and IMU with this track width [m].
    """
    options: list[Any] = [] if track_m is None else ["--track-m", track_m]
    lines, messages = _execute(["inspect", log, "--json", *options])
    survey = Survey(json.loads("\n".join(lines)))
    survey.messages = tuple(messages)
    return survey


def run(
    pipeline: str | PathLike[str],
    out: str | PathLike[str],
    overrides: dict[str, Any] | None = None,
    force: str | Iterable[str] = (),
    strict: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Run:
    """Runs all stages of a pipeline file, and returns the `Run`. Only what changed is computed again.

    pipeline: the path of a pipeline file. out: the run folder.
    overrides: keys and values that replace those of the file, such as `{"label.positive_radius_m": 2}`. force: stages to repeat.
    strict: stop at a log that cannot be used, instead of leaving it out. progress: called with each line that says what is done.

    Ctrl-C stops it, as does an exception in `progress`. The same call then continues from there.
    """
    force = [force] if isinstance(force, str) else force
    options = [option for stage in force for option in ("--force", stage)]
    return _pipeline("run", pipeline, out, overrides, strict, options, progress)


def detect(
    pipeline: str | PathLike[str],
    model: Model | str | PathLike[str],
    out: str | PathLike[str],
    overrides: dict[str, Any] | None = None,
    strict: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Run:
    """Finds loop closures in the logs of a pipeline file, and returns the `Run`, with `closures` and `trajectory`.

    model: a `Model`, a model.json, or a folder with one model. The other arguments are those of `run`.
    """
    model = model.path if isinstance(model, Model) else model
    return _pipeline("detect", pipeline, out, overrides, strict, ["--model", model], progress)


def _pipeline(
    command: str,
    pipeline: str | PathLike[str],
    out: str | PathLike[str],
    overrides: dict[str, Any] | None,
    strict: bool,
    options: list[Any],
    progress: Callable[[str], None] | None,
) -> Run:
    if isinstance(pipeline, str) and "\n" in pipeline:
        raise ArgumentError("`pipeline` is a text, expected the path of a pipeline file; write the text to a file first")
    for key, value in (overrides or {}).items():
        options += ["--set", f"{key}={_toml(value)}"]
    if strict:
        options.append("--strict")
    _, messages = _execute([command, pipeline, "--out", out, *options], progress)
    done = Run(out)
    done.messages = messages
    return done


def _toml(value: Any) -> str:
    """A value as TOML."""
    if hasattr(value, "tolist"):
        # A number or an array of numpy.
        value = value.tolist()
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key, ensure_ascii=False)} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, Path):
        value = str(value)
    if isinstance(value, float):
        return float.__repr__(value)
    if isinstance(value, (str, bool, int)):
        return json.dumps(value, ensure_ascii=False)
    raise ArgumentError(f"cannot write {value!r} as an option; expected a text, number, bool, list or dict")
