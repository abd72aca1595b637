"""The command line: `loopboost`, or `python -m loopboost`."""

import signal
import sys

from loopboost import _loopboost


def main() -> int:
    """Does what the command line asks for, and returns the exit code."""
    # Python would only note these signals, and act after the command.
    for name in ("SIGINT", "SIGPIPE"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)
    return _loopboost.main(["loopboost", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
