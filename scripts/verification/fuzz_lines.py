"""Send hundreds of thousands of random and mutated lines to the listeners of live foci and tracked hands.

python scripts/verification/fuzz_lines.py --lines 1000000 --seed 1 --write docs/bench/fuzzing.md
"""

import argparse
import json
import math
import random
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from palmfield.drive.live_foci import KEYS, FocusListener
from palmfield.motion.joints import JOINTS
from palmfield.motion.line_listener import LineListener
from palmfield.motion.listening import Listener

HEADING = "## Lines that come in live"
BATCH = 10
"""Number of lines in transit at a time, so that none becomes too old."""
DOORS = ("foci", "hands")
LONGEST = 60000
KINDS = "none", "value", "key", "bytes", "cut", "joined", "noise", "deep"
SHARES = 1, 4, 2, 4, 2, 1, 2, 1
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 1e308, -1e308, 1e-320, math.nan, math.inf, -math.inf, 10**400, 10**5000, "", "0.1",
    "\ud800", "\x1b[2J", "é", [], {}, [[]], [0, 0], [0, 0, 0.15], [0, 0, 0, 0], [1, 0, 0, 0], {"x": 1}, [None] * 3,
)  # fmt: skip
"""Values that replace a value of a valid object."""
BYTES = b'{}[]",:\\-+.eE0123456789 truefalsn\x00\xff\r\t'


def good(door: str, number: int) -> dict[str, Any]:
    """Return a valid object."""
    if door == "foci":
        wobble = 0.01 * math.sin(0.1 * number)
        poses = {"position_m": [0.0, wobble, 0.14], "quaternion": [1, 0, 0, 0]}
        return [{"focus_m": [wobble, 0, 0.15], "level": 1}, poses, poses | {"focus_m": [0, 0, 0.01]}][number % 3]
    places = np.linspace((0.0, 0.2, 0.0), (0.05, 0.35, 0.02), len(JOINTS)).tolist()
    joints = {name: {"position": place, "radius": 0.01} for name, place in zip(JOINTS, places, strict=True)}
    return {"convention": "openxr", "time_s": 100.0 + number / 9000.0, "hand": "right", "joints": joints}


def drawn(door: str, count: int, seed: int) -> Iterator[tuple[str, list[bytes]]]:
    """Yield batches of lines, each with its change; equal for equal seeds."""
    rng = random.Random(f"{door} {seed}")
    number = 0
    while number < count:
        kind = rng.choices(KINDS, SHARES)[0]
        size = min(2 if kind == "deep" else BATCH, count - number)
        yield kind, [_changed(kind, good(door, number + n), rng) for n in range(size)]
        number += size


def _changed(kind: str, value: dict[str, Any], rng: random.Random) -> bytes:
    if kind == "value":
        _put(value, rng)
    elif kind == "key":
        _rename(value, rng)
    # NaN, Infinity and 5,000 digits are written as other programs may write them
    line = _text(value).encode("utf-8", "surrogatepass")
    if kind == "bytes":
        changed = bytearray(line)
        for _ in range(rng.choice((1, 1, 2, 5, 30))):
            at = rng.randrange(len(changed) + 1)
            changed[at : at + rng.randrange(3)] = bytes(rng.choices(BYTES, k=rng.randrange(4)))
        line = bytes(changed)
    elif kind == "cut":
        line = line[rng.randrange(20) :][: rng.randrange(1, len(line))]
    elif kind == "joined":
        line += line[: rng.randrange(1, len(line))]
    elif kind == "noise":
        line = rng.randbytes(rng.choice((1, 4, 30, 300)))
    elif kind == "deep":
        line = rng.choice((b"[", b'{"a":', b'{"focus_m":[', b'[{"joints":')) * rng.choice((100, 500, 5000))
    line = line.replace(b"\n", b" ")[:LONGEST]
    return line if line.strip() else b"0"


def _text(value: Any) -> str:
    before = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(0)
    try:
        return json.dumps(value, ensure_ascii=False)
    finally:
        sys.set_int_max_str_digits(before)


def _put(value: Any, rng: random.Random) -> None:
    """Replace a part of an object by another value."""
    while True:
        keys = list(value) if isinstance(value, dict) else range(len(value))
        key = rng.choice(keys)
        if isinstance(value[key], dict | list) and value[key] and rng.random() < 0.7:
            value = value[key]
            continue
        value[key] = rng.choice(VALUES)
        return


def _rename(value: dict[str, Any], rng: random.Random) -> None:
    """Omit, misspell or add a key."""
    key = rng.choice(list(value))
    moved = value.pop(key)
    if rng.random() < 0.7:
        value[rng.choice((key.upper(), key + "x", "\ud800", "", *KEYS, "convention", "joints"))] = moved


def is_focus(line: bytes) -> bool:
    """Return whether a line is a valid focus, by the words of docs/boards.md and Python's own numbers."""
    before = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(0)
    try:
        value = json.loads(line.decode())
    except (ValueError, RecursionError):
        return False
    finally:
        sys.set_int_max_str_digits(before)

    def numbers(key: str, count: int) -> bool:
        listed = value[key] if count > 1 else [value[key]]
        return isinstance(listed, list) and len(listed) == count and all(
            type(one) in (int, float) and abs(one) <= sys.float_info.max for one in listed
        )  # fmt: skip

    counts = {"focus_m": 3, "level": 1, "position_m": 3, "quaternion": 4}
    if not isinstance(value, dict) or not set(value) <= set(counts) or not {"focus_m", "position_m"} & set(value):
        return False
    if not all(numbers(key, counts[key]) for key in value) or not 0 <= value.get("level", 1) <= 1:
        return False
    turn = value.get("quaternion", [1, 0, 0, 0])
    return ("quaternion" not in value or "position_m" in value) and abs(math.hypot(*turn) - 1.0) <= 0.01


class Sender:
    """A listener, and a connection to it that is renewed if the listener closes it on a busy machine.

    outcomes: results of lines, by their change; faults: failures; again: number of batches sent again
    """

    def __init__(self, door: str) -> None:
        self.door, self.again = door, 0
        self.listener: LineListener = FocusListener(np.zeros(3), by="tcp") if door == "foci" else Listener(by="tcp")
        self.outcomes: Counter[tuple[str, str]] = Counter()
        self.faults: list[str] = []
        self._out: socket.socket | None = None

    def give(self, kind: str, lines: list[bytes], number: int) -> None:
        """Send lines and check that each is counted. number: of a valid line that may precede them"""
        for _ in range(10):
            if self._send(kind, lines, number):
                return
            self.again += 1
            if self._out is not None:
                self._out.close()
            self._out = None
        self.faults.append(f"not counted once each after ten times: {lines[0][:80]!r} ...")

    def _send(self, kind: str, lines: list[bytes], number: int) -> bool:
        listener = self.listener
        try:
            if self._out is None:
                self._out = socket.create_connection((listener.host, listener.port), 10.0)
                if self._counted([_text(good(self.door, number - 1)).encode()]) is None:
                    return False
            counted = self._counted(lines)
        except ConnectionError:
            return False
        if counted is None:
            return False
        came = counted["taken"]
        self.outcomes.update({(kind, name): count for name, count in counted.items()})
        if self.door == "foci" and came != sum(map(is_focus, lines)):
            self.faults.append(f"{came} of these were taken, and {sum(map(is_focus, lines))} tell a focus: {lines}")
        return True

    def _counted(self, lines: list[bytes]) -> Counter[str] | None:
        """Return the counts of lines; None if some waited too long or there was no report of them."""
        listener, ends = self.listener, time.monotonic() + 10.0
        received, bad = listener.received, Counter(listener.bad)
        assert self._out is not None
        self._out.sendall(b"".join(line + b"\n" for line in lines))
        while time.monotonic() < ends:
            listener.check()
            counted = Counter({"taken": listener.received - received}) + (listener.bad - bad)
            if counted["stale"] or counted["second sender"] or counted.total() > len(lines):
                return None
            if counted.total() == len(lines):
                return counted
            time.sleep(2e-4)
        return None


def sent(door: str, count: int, seed: int) -> tuple[Counter[tuple[str, str]], list[str], int]:
    """Send lines by TCP; return their results by change, failures, and the number of batches sent again."""
    sender, number = Sender(door), 1
    with sender.listener as listener:
        for kind, lines in drawn(door, count - 15, seed):
            sender.give(kind, lines, number)
            number += len(lines)
            if len(sender.faults) > 20:
                break
        # After all of them a good line counts
        received = listener.received
        sender.give("none", [_text(good(door, number + 9000 + n)).encode() for n in range(15)], number)
        if listener.received == received:
            sender.faults.append(f"good lines of {door} were not taken: {listener.reported[-3:]}")
    outcomes, faults = sender.outcomes, sender.faults
    for text in listener.reported:
        if not text.isprintable() or len(text) > 1000:
            faults.append(f"told: {text!r}")
    return outcomes, faults, sender.again


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lines", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", type=Path, help="markdown page whose part is written anew")
    arguments = parser.parse_args()
    start = time.monotonic()
    rows: dict[str, list[str]] = {}
    faults, again = [], 0
    for door in DOORS:
        outcomes, own, repeated = sent(door, arguments.lines // len(DOORS), arguments.seed)
        faults, again = faults + own, again + repeated
        for kind in sorted({kind for kind, _ in outcomes}):
            received = outcomes.get((kind, "taken"), 0)
            bad = sum(count for (own_kind, _), count in outcomes.items() if own_kind == kind) - received
            rows.setdefault(kind, []).append(f"{received}, {bad}")
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout.strip()
    part = [
        HEADING,
        "",
        f"    python scripts/verification/fuzz_lines.py --lines {arguments.lines} --seed {arguments.seed} "
        "--write docs/bench/fuzzing.md",
        "",
        f"Commit {commit}, {time.monotonic() - start:.0f} s. Half of the lines are sent by TCP to the listener of "
        "`drive --live` (foci), half to that of `trial --live` and `track record` (hands). Each line must be "
        "counted once, as accepted or refused. For foci, an independent reader checks the decision. At the end the "
        f"listener must accept a good line. {again} batches of {BATCH} lines were sent again, because they had "
        f"waited for 0.1 s. {f'Faults: {len(faults)}' if faults else 'No faults were found'}.",
        "",
        f"| change of the line | {' | '.join(f'{door}: accepted, refused' for door in DOORS)} |",
        "|---" * (1 + len(DOORS)) + "|",
        *(f"| {kind} | {' | '.join(counts)} |" for kind, counts in rows.items()),
        "",
    ]
    print("\n".join([*part, *faults]))
    if arguments.write is not None:
        before = arguments.write.read_text().partition(HEADING)[0]
        arguments.write.write_text(before.rstrip("\n") + "\n\n" + "\n".join(part))
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
