"""Write errors and the log of the library to standard error."""

import logging
import sys

from palmfield.errors import SceneError, refuse_unknown

LEVELS = ("debug", "info", "warning", "error")


class _Lines(logging.Formatter):
    """Formats log records as `palmfield: text`. The level precedes warnings and errors."""

    def format(self, record: logging.LogRecord) -> str:
        level = "" if record.levelno == logging.INFO else f"{record.levelname.lower()}: "
        return f"palmfield: {level}{record.getMessage()}"


class _StandardError(logging.Handler):
    """Writes lines to the current sys.stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        print(self.format(record), file=sys.stderr)


def show_log(level: str) -> None:
    """Show the messages of logger `palmfield` from a level upwards. Raises SceneError for an unknown level."""
    refuse_unknown(SceneError, "--log-level has value {}", level, LEVELS)
    logger = logging.getLogger("palmfield")
    for handler in [handler for handler in logger.handlers if isinstance(handler, _StandardError)]:
        logger.removeHandler(handler)
    handler = _StandardError()
    handler.setFormatter(_Lines())
    logger.addHandler(handler)
    logger.setLevel(level.upper())
    # A program that calls the command line may have its own log
    logger.propagate = False


def print_message(text: str) -> None:
    """Print one line on standard error."""
    print(f"palmfield: {' '.join(text.split())}", file=sys.stderr)
