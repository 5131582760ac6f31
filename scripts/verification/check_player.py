#!/usr/bin/env python3
"""Measure the delay of the player during a running solver, with and without real-time priority.

python scripts/verification/check_player.py [--seconds 60] [--write docs/bench/player.md] [--load WORDS] [--commit HASH]

It is compared with a plain writer thread. There are four runs of --seconds: AUTD packets at 2 kHz and SonicSurface
frames at line rate, each with and without priority. The exit code is 1 if a goal is missed.
"""

import argparse
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from player_runs import AutdRun, Late, SonicRun, Stream, play_sonic, stream_autd, svds

from palmfield import Simulation
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import processor

ROOT = Path(__file__).resolve().parents[2]
SCENE = ROOT / "mjcf" / "scenes" / "follow_fingertip.xml"
P99_S = 200e-6
SHARE_OF_THREAD = 1.0 / 3.0
UNSENT = 0.01
ABOUT = """One thread of the busy caller steps scene `follow_fingertip`, and another computes singular values. AUTD
packets (9 bytes, 2,000 a second) are sent to a pseudo-terminal by the player, and to a second one by a plain thread,
which skips no packet. If the player is late by a packet or more, it sends the newest packet and skips earlier ones. A
process of higher priority counts the packets that were due in pauses of the virtual machine.

*Line* is the delay of the last byte of a packet. *Hand-over* is the delay until the system had the packet. *Lost*
packets were handed over but not received. AUTD packets use 78 % of their line, so it takes four times the length of
a delay to catch up. SonicSurface frames use the whole line, so a delay does not decrease again."""


def ms(late: Late) -> str:
    return f"{1e3 * late.p99_s:.3f} | {1e3 * late.worst_s:.3f}"


def stream_row(how: str, one: Stream) -> str:
    return f"| {how} | {ms(one.line)} | {ms(one.handed)} | {one.sent} | {one.skipped} | {one.lost} |"


def sonic_row(how: str, run: SonicRun) -> str:
    report = run.report
    line, handed = Late(report.late_p99_s, report.late_s), Late(report.write_p99_s, report.write_worst_s)
    due = report.frames + report.skipped
    return (
        f"| {how} | {due} | {report.skipped} ({100 * report.unsent:.2f} %) | {run.whole} | {ms(line)} | {ms(handed)} |"
    )


def goals(autd: tuple[AutdRun, AutdRun], sonic: tuple[SonicRun, SonicRun]) -> list[tuple[str, str, bool]]:
    """Return each goal, the measured value, and whether it is met; the first of each pair is with priority."""
    p99, pauses = autd[0].player.line.p99_s, autd[0].pauses
    missing = autd[0].player.skipped + autd[0].player.lost
    mine, threads = autd[1].player.line.p99_s, autd[1].thread.line.p99_s
    unsent, unsent_without = sonic[0].report.skipped, sonic[1].report.unsent
    share = mine / threads
    return [
        ("AUTD, priority: p99 of the line at most 0.2 ms", f"{1e3 * p99:.3f} ms", p99 <= P99_S),
        (
            "AUTD, priority: packets skipped or lost only while the machine was paused",
            f"{missing}; {pauses} were due in pauses of the machine",
            missing <= pauses,
        ),
        (
            "AUTD, no priority: p99 of the line at most 1/3 of that of the thread",
            f"{share:.3f}",
            share <= SHARE_OF_THREAD,
        ),
        ("SonicSurface, priority: all due frames sent", f"{unsent} not sent", unsent == 0),
        ("SonicSurface, no priority: at most 1 % not sent", f"{100 * unsent_without:.2f} %", unsent_without <= UNSENT),
    ]


def page(seconds: float, load: str, commit: str) -> tuple[str, bool]:
    """Return the page, and whether all goals are met."""
    simulation = Simulation(SCENE)
    simulation.step()

    def stepping(ended: threading.Event) -> None:
        while not ended.is_set():
            simulation.step()

    works: list[Callable[[threading.Event], None]] = [stepping, svds]
    autd = stream_autd(seconds, works, True), stream_autd(seconds, works, False)
    sonic = play_sonic(seconds, works, True), play_sonic(seconds, works, False)
    goals_met = goals(autd, sonic)
    lines = [
        "# Delays of the player", "",
        "For everyone who drives hardware. Written by `python scripts/verification/check_player.py --seconds "
        f"{seconds:g} --write docs/bench/player.md`, commit {commit}, {processor()}; other load on the machine: "
        f"{load}. The priority of the player was {autd[0].report.priority}.",
        "", ABOUT, "", f"## AUTD at 2 kHz for {seconds:g} s", "",
        "| sender | line p99 [ms] | largest | hand-over p99 [ms] | largest | sent | skipped | lost |",
        "|---|---|---|---|---|---|---|---|",
        stream_row("player with priority", autd[0].player), stream_row("thread, in the same run", autd[0].thread),
        stream_row("player without", autd[1].player), stream_row("thread, in the same run", autd[1].thread),
        "", f"## SonicSurface at line rate for {seconds:g} s", "",
        "| player | due | not sent | received | line p99 [ms] | largest | hand-over p99 [ms] | largest |",
        "|---|---|---|---|---|---|---|---|",
        sonic_row("with priority", sonic[0]), sonic_row("without", sonic[1]),
        "", "## Goals", "", "| goal | result | met |", "|---|---|---|",
        *(f"| {what} | {came} | {'yes' if met else '**no**'} |" for what, came, met in goals_met),
    ]  # fmt: skip
    return "\n".join(lines) + "\n", all(met for _, _, met in goals_met)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each of the four runs")
    parser.add_argument("--write", type=Path, help="the page")
    parser.add_argument("--load", default="not stated", help="other load on the machine, in words")
    parser.add_argument("--commit", default="", help="for the head, where no git is [default: git's]")
    args = parser.parse_args()
    print(f"four runs of {args.seconds:g} s, some {4 * args.seconds + 15:.0f} s in all", file=sys.stderr, flush=True)
    text, met = page(args.seconds, args.load, args.commit or git_commit())
    print(text)
    if args.write is not None:
        args.write.write_text(text)
    return int(not met)


if __name__ == "__main__":
    sys.exit(main())
