"""What the command line says on standard error: the library's log, and errors."""

import logging
import sys

from palmfield.errors import SceneError, refuse_unknown

LEVELS = ("debug", "info", "warning", "error")


class _Lines(logging.Formatter):
    """`palmfield: text`, with the level's name before warnings."""

    def format(self, record: logging.LogRecord) -> str:
        level = "" if record.levelno == logging.INFO else f"{record.levelname.lower()}: "
        return f"palmfield: {level}{record.getMessage()}"


class _StandardError(logging.Handler):
    """Lines on whatever sys.stderr is at the time."""

    def emit(self, record: logging.LogRecord) -> None:
        print(self.format(record), file=sys.stderr)


def show_log(level: str) -> None:
    """Show the log of logger `palmfield` from a level on. Raises SceneError for an unknown level."""
    refuse_unknown(SceneError, "--log-level has value {}", level, LEVELS)
    logger = logging.getLogger("palmfield")
    for handler in [handler for handler in logger.handlers if isinstance(handler, _StandardError)]:
        logger.removeHandler(handler)
    handler = _StandardError()
    handler.setFormatter(_Lines())
    logger.addHandler(handler)
    logger.setLevel(level.upper())
    # A program that calls the command line may log by itself
    logger.propagate = False


def complain(text: str) -> None:
    """One line on standard error."""
    print(f"palmfield: {' '.join(text.split())}", file=sys.stderr)
