"""Tables of other libraries."""

from __future__ import annotations

from typing import Any

from loopboost._errors import ArgumentError


def stream_of(name: str, table: Any) -> Any:
    """The rows of a table as a stream of the Arrow PyCapsule interface. `name` is that of the argument."""
    if not hasattr(table, "__arrow_c_stream__"):
        raise ArgumentError(f"{name} is a {type(table).__name__}, expected a table that gives an Arrow stream (`__arrow_c_stream__`)")
    return table.__arrow_c_stream__()
