"""Features of scans, and models.

numpy is imported where it is used: it takes longer than the rest of the package.
"""

from __future__ import annotations

import html
import json
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopboost import _loopboost
from loopboost._errors import ArgumentError
from loopboost._streams import stream_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from loopboost._run import Run

#: The gate between groups of returns of the feature set `paper16` [m].
GATE_M = 2.5


def _coordinates(name: str, values: ArrayLike) -> NDArray[Any]:
    import numpy as np

    values = np.asarray(values)
    if values.ndim != 1 or values.dtype.kind not in "fiu":
        raise ArgumentError(f"{name} has shape {values.shape} and type {values.dtype}, expected one row of numbers")
    return np.ascontiguousarray(values, dtype=np.float32)


def _returns(x_m: ArrayLike, y_m: ArrayLike) -> tuple[NDArray[Any], NDArray[Any]]:
    x_m, y_m = _coordinates("x_m", x_m), _coordinates("y_m", y_m)
    if len(x_m) != len(y_m):
        raise ArgumentError(f"x_m has {len(x_m)} returns and y_m has {len(y_m)}, expected the same number")
    return x_m, y_m


def featurize(
    x_m: ArrayLike, y_m: ArrayLike, coverage_deg: float = 360.0, set: str = "campus", gate_m: float = GATE_M
) -> NDArray[Any]:
    """Features of a planar scan.

    x_m, y_m: `(n_returns,)`, the returns in the lidar frame [m], in firing order; x is forward and y is left. They are rounded
    to 32 bits, as in the tables. coverage_deg: the angle that the scan covers [deg], with or without returns. set: `paper16`
    or `campus`. gate_m: for `paper16`, two neighbouring returns more than this far apart belong to different groups [m].

    Returns `(n_features,)`, float64, the same bits as in the table of the program. `feature_names(set)` has the names.
    """
    return _loopboost.featurize(*_returns(x_m, y_m), float(coverage_deg), set, float(gate_m))


def featurize_table(scans: Any, set: str = "campus", gate_m: float = GATE_M) -> _loopboost.Rows:
    """Features of all scans of a table, see `featurize`.

    scans: a table with the columns `x_m` and `y_m`, lists of numbers, and `coverage_deg`, as from `read_scans` or `Run.scans`;
    any object that gives an Arrow stream, such as a table of polars, pyarrow or DuckDB. set, gate_m: as for `featurize`.

    Returns the other columns of the table, and one column per feature. The features of a scan from which none can be computed,
    such as one with two returns, are null. `Rows.messages` counts such scans.
    """
    return _loopboost.featurize_table(stream_of("scans", scans), set, float(gate_m))


class Model:
    """A trained classifier of pairs of scans: a `model.json`, or a folder with one model."""

    def __init__(self, path: str | PathLike[str]):
        self._model = _loopboost.Model(path)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Model:
        """The same as `Model(path)`."""
        return cls(path)

    def __repr__(self) -> str:
        return f"<Model {self.name} {self.version}: {self.learner}, {len(self.feature_names)} features of {self.feature_set}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path,)

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self.card())}</pre>"

    @property
    def path(self) -> Path:
        """The file."""
        return self._model.path

    @property
    def name(self) -> str:
        """The name."""
        return self._model.name

    @property
    def version(self) -> str:
        """The version, such as `1.0.0`."""
        return self._model.version

    @property
    def learner(self) -> str:
        """`discrete`, `gentle_stump`, `gentle_line` or `logit_trees`."""
        return self._model.learner

    @property
    def has_detector(self) -> bool:
        """Whether `detect` can use the model."""
        return self._model.has_detector

    def _section(self, name: str) -> Any:
        return json.loads(self._model.section(name))

    @property
    def feature_set(self) -> str:
        """The name of the feature set."""
        return self._section("features")["set"]

    @property
    def feature_names(self) -> list[str]:
        """The names of the features, in order."""
        return self._section("features")["names"]

    @property
    def scans(self) -> dict[str, Any]:
        """The scans that the model was trained on: angle covered [deg] and range limits [m]."""
        return self._section("scans")

    @property
    def operating_points(self) -> list[dict[str, Any]]:
        """Named thresholds with their cross-validated precision, recall and false alarms."""
        return self._section("operating_points")

    @property
    def measured(self) -> list[dict[str, Any]]:
        """Cross-validated errors, by grouping."""
        return self._section("measured")

    def detect(self, pipeline: str | PathLike[str], out: str | PathLike[str], **options: Any) -> Run:
        """Finds loop closures in the logs of a pipeline file, see `loopboost.detect`, which has the same options."""
        from loopboost import detect

        return detect(pipeline, self, out, **options)

    def card(self) -> str:
        """The card of the model, as text."""
        return self._model.card()

    def featurize(self, x_m: ArrayLike, y_m: ArrayLike, coverage_deg: float = 360.0) -> NDArray[Any]:
        """The features that the model needs, `(n_features,)`, see `loopboost.featurize`. A scan of another kind than those that
        the model was trained on, such as a half circle instead of a full one, is an error."""
        return self._model.featurize(*_returns(x_m, y_m), float(coverage_deg))

    def score(self, a: ArrayLike, b: ArrayLike) -> float:
        """Confidence that two scans with the features `a` and `b`, each `(n_features,)`, show the same place."""
        import numpy as np

        a, b = np.asarray(a), np.asarray(b)
        if a.shape != b.shape:
            raise ArgumentError(f"a has shape {a.shape} and b has shape {b.shape}, expected the same")
        return float(self.score_pairs(np.stack([a, b]), [[0, 1]])[0])

    def score_pairs(self, features: ArrayLike, pairs: ArrayLike) -> NDArray[Any]:
        """Confidences of pairs, `(n_pairs,)`, float64.

        features: `(n_scans, n_features)`, with the columns in the order of `feature_names`. pairs: `(n_pairs, 2)`, row numbers.
        A confidence of 0 or more means *same place*; `operating_points` has other thresholds.
        """
        import numpy as np

        features = np.asarray(features)
        n_features = len(self.feature_names)
        if features.ndim != 2 or features.shape[1] != n_features or features.dtype.kind not in "fiu":
            raise ArgumentError(f"features has shape {features.shape} and type {features.dtype}, expected numbers of shape (n_scans, {n_features})")
        pairs = np.asarray(pairs)
        if pairs.size == 0:
            pairs = pairs.astype(np.int64).reshape(0, 2)
        if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "iu":
            raise ArgumentError(f"pairs has shape {pairs.shape} and type {pairs.dtype}, expected whole numbers of shape (n_pairs, 2)")
        features = np.ascontiguousarray(features, dtype=np.float64)
        if not np.isfinite(features).all():
            raise ArgumentError("features contains a value that is not finite; leave out scans without features")
        if len(pairs) and not (0 <= pairs.min() and pairs.max() < len(features)):
            raise ArgumentError(f"pairs has row numbers from {pairs.min()} to {pairs.max()}, but features has {len(features)} rows")
        a, b = (np.ascontiguousarray(column, dtype=np.uint64) for column in pairs.T)
        return self._model.score_pairs(features, a, b)
