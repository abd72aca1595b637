"""The command line: `loopboost`, or `python -m loopboost`."""

import signal
import sys

from loopboost import _loopboost


def main() -> int:
    """Does what the command line asks for, and returns the exit code."""
    # Python would only note an interrupt, and act after the command. A shell ignores it for commands in the background.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Python ignores it, for its own output.
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    return _loopboost.main(["loopboost", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
