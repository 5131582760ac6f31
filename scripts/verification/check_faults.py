"""Test the player against faults of line, host and processes on virtual SonicSurfaces, and print a table.

    python scripts/verification/check_faults.py --write docs/bench/faults.md

It takes a minute. tests/drive/player/test_faults.py asserts the same faults.
"""

import argparse
import signal
from collections.abc import Callable
from pathlib import Path

import faults
from faults import Outcome

from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import processor

AFTER_S = 0.1
"""Time from which latency counts as that after a fault."""


def stalled(length_s: float, seconds: float) -> tuple[str, Outcome]:
    result = faults.stall(length_s, seconds)
    until_s = result.numbers["stalled_until_s"]
    if result.report is None:
        return f"{result.message}", result
    after = 1e3 * result.late_between(until_s + AFTER_S, until_s + 1.0)
    report = result.report
    return (
        f"{report.skipped} of {report.frames + report.skipped} due frames were omitted, "
        f"{'with' if report.warning else '**without**'} a warning; {1e3 * AFTER_S:.0f} ms after the fault, frames are "
        f"at most {after:.1f} ms late (a frame takes {1e3 * faults.FRAME_S:.1f} ms)",
        result,
    )  # fmt: skip


def full() -> tuple[str, Outcome]:
    result = faults.full_buffer()
    assert result.report is not None
    return (
        f"the system accepted only a part of {result.report.cut} frames; frames in the hidden buffer sound up to "
        f"{max(result.late_s):.1f} s late",
        result,
    )  # fmt: skip


def half() -> tuple[str, Outcome]:
    result = faults.half_frame_lost()
    numbers = result.numbers
    return f"{numbers['mixed']} of {numbers['frames']} frames had phases of other frames", result


def outcome_text(result: Outcome) -> tuple[str, Outcome]:
    return result.message.replace("|", "/"), result


def ended(number: signal.Signals, work: str = faults.BUSY) -> tuple[str, Outcome]:
    result = faults.caller_gets(number, work)
    return f"silent {1e3 * result.numbers['silent_after_s']:.0f} ms later", result


def paused(number: signal.Signals) -> tuple[str, Outcome]:
    result = faults.caller_pauses(number)
    again = "sounds again" if result.numbers["sounds_again"] else "stays silent"
    return f"silent {1e3 * result.numbers['silent_after_s']:.0f} ms later; after SIGCONT it {again}", result


def busy(realtime: bool) -> tuple[str, Outcome]:
    result = faults.host_at_100(5.0, realtime)
    report = result.report
    assert report is not None
    return (
        f"{report.skipped} of {report.frames + report.skipped} due frames omitted, 99 % within "
        f"{1e3 * report.late_p99_s:.2f} ms ({report.priority}); the machine paused "
        f"{result.numbers['pauses']:.0f} times for more than half a frame",
        result,
    )  # fmt: skip


CASES: list[tuple[str, Callable[[], tuple[str, Outcome]]]] = [
    ("the line accepts no bytes for 1 s", lambda: stalled(1.0, 3.0)),
    ("the line accepts no bytes for 4 s", lambda: stalled(4.0, 5.0)),
    ("the line stops for 1.5 s behind a hidden buffer, which fills up", full),
    ("100 bytes are lost on the line", half),
    ("unplugged and not plugged in again", lambda: outcome_text(faults.unplugged(None))),
    ("unplugged, then plugged in again after 0.4 s", lambda: outcome_text(faults.unplugged(0.4))),
    ("the player gets SIGKILL", lambda: outcome_text(faults.player_killed())),
    ("the caller gets SIGKILL", lambda: ended(signal.SIGKILL)),
    ("the caller gets SIGINT", lambda: ended(signal.SIGINT)),
    ("the caller gets SIGTERM", lambda: ended(signal.SIGTERM)),
    ("the caller gets SIGHUP", lambda: ended(signal.SIGHUP)),
    ("the caller gets SIGQUIT", lambda: ended(signal.SIGQUIT)),
    ("the caller gets SIGTERM in a long call of C", lambda: ended(signal.SIGTERM, faults.IN_C)),
    ("the caller gets SIGTSTP (Ctrl-Z)", lambda: paused(signal.SIGTSTP)),
    ("the caller gets SIGSTOP", lambda: paused(signal.SIGSTOP)),
    ("the host computes on all cores, player with priority", lambda: busy(True)),
    ("the host computes on all cores, player without priority", lambda: busy(False)),
]
HEAD = """# Faults

For everyone who drives hardware. Faults of the line, the host and its processes were caused on purpose, on a
virtual SonicSurface with 88 new frames a second. A torn frame is one that was played with a wrong number of bytes.

    python scripts/verification/check_faults.py --write docs/bench/faults.md

"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path, help="markdown file to write")
    args = parser.parse_args()
    lines = ["| fault | result | board off at the end | torn frames |", "|---|---|---|---|"]
    print("\n".join(lines))
    for name, measure in CASES:
        words, result = measure()
        lines.append(f"| {name} | {words} | {'yes' if result.off else '**no**'} | {result.torn} |")
        print(lines[-1], flush=True)
    if args.write is not None:
        args.write.write_text(f"{HEAD}{processor()}; commit {git_commit()}.\n\n" + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
