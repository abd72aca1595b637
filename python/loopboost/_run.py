"""Run folders."""

from __future__ import annotations

import html
import json
from os import PathLike
from pathlib import Path
from typing import Any

from loopboost._errors import ArgumentError, InputError
from loopboost._loopboost import Table
from loopboost._model import Model

#: Tables with one file per log.
PER_LOG = ("scans", "poses", "keyframes", "features", "registered", "odometry", "truth")
#: Tables with one file per run.
PER_RUN = (
    "pairs",
    "feature_stability",
    "feature_usefulness",
    "scores",
    "rounds",
    "retrieval",
    "grid",
    "candidates",
    "closures",
    "trajectory",
    "graph",
)


class Run:
    """A run folder. Tables are opened when they are asked for, and read when another library takes them.

    A table goes into polars, pyarrow or DuckDB: `polars.DataFrame(run.closures)`, `pyarrow.table(run.closures)`, or after
    `closures = run.closures`, `duckdb.sql("FROM closures")`.
    """

    def __init__(self, folder: str | PathLike[str]):
        self.folder = Path(folder)
        if not (self.folder / "run.json").is_file():
            raise InputError(f"{self.folder} has no run.json; expected the folder of `loopboost run` or `loopboost.run`")
        #: The lines that the command wrote to stderr: losses and notes with their codes. Empty for a folder that was only opened.
        self.messages: list[str] = []

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r})"

    def _repr_html_(self) -> str:
        rows = ""
        for name in self.tables:
            try:
                n_rows = f"{len(self.table(name)):,}"
            except InputError:
                n_rows = "cannot be read"
            rows += f"<tr><td><code>{name}</code></td><td style='text-align:right'>{n_rows}</td></tr>"
        messages = "".join(f"<li>{html.escape(line)}</li>" for line in self.messages)
        folder, report = html.escape(str(self.folder)), html.escape(str(self.report))
        return (
            f"<b>loopboost run</b> <code>{folder}</code><table><tr><th>table</th><th>rows</th></tr>{rows}</table>"
            f"report: <code>{report}</code><ul>{messages}</ul>"
        )

    @property
    def tables(self) -> list[str]:
        """The names of the tables that the folder has."""
        present = [name for name in PER_LOG if (self.folder / name).is_dir() and self._files(name)]
        return present + [name for name in PER_RUN if (self.folder / f"{name}.parquet").is_file()]

    @property
    def logs(self) -> list[str]:
        """The names of the logs of the last run. The folder can have tables of earlier logs, too."""
        # Keyframes are kept for logs of the last run only.
        folder = self.folder / "keyframes"
        if not folder.is_dir():
            folder = self.folder / "scans"
        return sorted(file.relative_to(folder).with_suffix("").as_posix() for file in folder.rglob("*.parquet"))

    def _files(self, name: str) -> list[Path]:
        files = [self.folder / name / f"{log}.parquet" for log in self.logs]
        return [file for file in files if file.is_file()]

    def table(self, name: str, log: str | None = None) -> Table:
        """The table `name`: of one log, or of all logs together.

        docs/tables.md in the repository explains the columns. The files are read each time a library takes the table.
        """
        if name not in PER_LOG + PER_RUN:
            raise ArgumentError(f"no table {name!r}, expected one of: {', '.join(PER_LOG + PER_RUN)}")
        if log is None:
            files = self._files(name) if name in PER_LOG else [self.folder / f"{name}.parquet"]
        elif name in PER_RUN and name != "trajectory":
            raise ArgumentError(f"the table {name!r} is one for all logs; leave out `log`")
        else:
            files = [self.folder / name / f"{log}.parquet"]
        missing = [file for file in files if not file.is_file()]
        if missing or not files:
            where = missing[0] if missing else self.folder / name
            have = f"logs: {', '.join(self.logs)}" if log is not None else f"tables: {', '.join(self.tables)}"
            raise InputError(f"{where} does not exist; the run has these {have}")
        return Table(files)

    def scans(self, log: str | None = None) -> Table:
        """One row per scan: time, returns `x_m` and `y_m` in the lidar frame [m], angle covered [deg]."""
        return self.table("scans", log)

    @property
    def keyframes(self) -> Table:
        """One row per keyframe, with its pose."""
        return self.table("keyframes")

    @property
    def features(self) -> Table:
        """One row per keyframe, one column per feature."""
        return self.table("features")

    @property
    def pairs(self) -> Table:
        """One row per labelled pair of keyframes."""
        return self.table("pairs")

    @property
    def closures(self) -> Table:
        """One row per loop closure, accepted or rejected, with the reason."""
        return self.table("closures")

    @property
    def trajectory(self) -> Table:
        """One row per keyframe, with its optimized pose. `table("trajectory", log)` has one row per scan."""
        return self.table("trajectory")

    @property
    def report(self) -> Path:
        """The path of the report, an HTML file."""
        return self.folder / "report.html"

    @property
    def models(self) -> dict[str, Path]:
        """The paths of the models that the run trained, by name. Of several versions, the newest one."""
        files = sorted((self.folder / "models").glob("*/*/model.json"), key=_version)
        return {file.parent.parent.name: file for file in files}

    def model(self, name: str) -> Model:
        """A model that the run trained."""
        models = self.models
        if name not in models:
            raise InputError(f"{self.folder} has no model {name!r}, only: {', '.join(models) or 'none'}")
        return Model(models[name])

    @property
    def info(self) -> dict[str, Any]:
        """The contents of run.json: inputs, outputs, losses and notes of every task."""
        return json.loads((self.folder / "run.json").read_text(encoding="utf-8"))

    @property
    def g2o(self) -> Path:
        """The path of the pose graph, a g2o file."""
        return self.folder / "graph.g2o"

    def tum(self, log: str) -> Path:
        """The path of the trajectory of a log, a TUM file with a pose for every scan."""
        return self.folder / "trajectory" / f"{log}.tum"


def _version(file: Path) -> list[int]:
    return [int(part) if part.isdigit() else 0 for part in file.parent.name.split(".")]
