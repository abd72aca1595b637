from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, final

from numpy.typing import NDArray

__all__ = ["Model", "Rows", "Table", "__version__", "feature_names", "featurize", "featurize_table", "main", "read_poses", "read_scans", "to_tum"]

__version__: str

def feature_names(set: str) -> list[str]:
    """The names of the features of a set, in order."""

def featurize(x_m: NDArray[Any], y_m: NDArray[Any], coverage_deg: float, set: str, gate_m: float) -> NDArray[Any]: ...
def featurize_table(scans: Any, set: str, gate_m: float) -> Rows: ...
def main(args: list[str]) -> int: ...
def read_poses(files: Sequence[str | PathLike[str]], options: str) -> Rows: ...
def read_scans(files: Sequence[str | PathLike[str]], options: str, progress: Callable[[int, int], Any] | None) -> Rows: ...
def to_tum(poses: Any, file: str | PathLike[str]) -> int: ...
@final
class Model:
    def __new__(cls, path: str | PathLike[str]) -> Model: ...
    @property
    def path(self) -> Path: ...
    @property
    def name(self) -> str: ...
    @property
    def version(self) -> str: ...
    @property
    def learner(self) -> str: ...
    @property
    def has_detector(self) -> bool: ...
    def section(self, name: str) -> str: ...
    def card(self) -> str: ...
    def featurize(self, x_m: NDArray[Any], y_m: NDArray[Any], coverage_deg: float) -> NDArray[Any]: ...
    def score_pairs(self, features: NDArray[Any], a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]: ...

@final
class Rows:
    """Rows in memory."""

    def __len__(self) -> int: ...
    @property
    def column_names(self) -> list[str]:
        """The names of the columns, in order."""
    @property
    def messages(self) -> list[str]:
        """Losses and notes with their codes, as lines."""
    def __arrow_c_stream__(self, requested_schema: Any | None = None) -> Any:
        """The rows as a stream of the Arrow C interface."""

@final
class Table:
    """Rows of one or more Parquet files with the same columns. They are read when they are needed."""

    def __new__(cls, files: Sequence[str | PathLike[str]]) -> Table: ...
    def __len__(self) -> int: ...
    @property
    def column_names(self) -> list[str]:
        """The names of the columns, in order."""
    @property
    def files(self) -> list[Path]:
        """The files, in the order of their rows."""
    def metadata(self) -> dict[Path, dict[str, str]]:
        """What each file says about itself, by file and key."""
    def __arrow_c_stream__(self, requested_schema: Any | None = None) -> Any:
        """The rows as a stream of the Arrow C interface."""
