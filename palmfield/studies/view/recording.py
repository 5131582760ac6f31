"""Record the run of a scene with constant keys in a result folder like that of `palmfield run`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palmfield.errors import OutputError
from palmfield.outputs.store import Store, open_result, write_json
from palmfield.outputs.summary import summary
from palmfield.session.recorded_run import ending, initial_block, recorder_of, result_attributes
from palmfield.session.simulation import Simulation
from palmfield.studies.view.messages import Replay
from palmfield.studies.view.periods import Blocks, replay, steps_watched

KEYS_FILE = "keys.json"


class Recording:
    """Writes each step to a folder until `finish`. If the process is killed, `palmfield recover` assembles the written
    data.

    out: the folder
    """

    def __init__(self, sim: Simulation, out: Path, scene: str, keys: Mapping[str, object]) -> None:
        """scene: file of the scene; keys: those that differ from the file. Raises OutputError as `Store` does."""
        self.out, self._sim = out, sim
        self._store = Store(out, initial_block(sim), result_attributes(sim))
        self._blocks = Blocks(steps_watched(sim), self._store)
        self._recorder = recorder_of(sim, self._blocks)
        # Each recording has one set of keys, so that this command reproduces it
        start: dict[str, Any] = {"scene": scene, "keys": dict(keys), "begun_s": sim.time}
        write_json(out / KEYS_FILE, start)
        self._recorder.start()
        self._blocks.kept.clear()

    def step(self) -> None:
        """Record a step. Raises OutputError if the disk is full."""
        self._recorder.step()

    def last_periods(self) -> Replay | None:
        """Return the last periods; None in the first steps."""
        blocks = list(self._blocks.kept)
        return None if len(blocks) < (self._blocks.kept.maxlen or 0) else replay(self._sim, blocks, self._recorder)

    def finish(self, reason: str) -> Path:
        """Write result.nc and summary.json; returns the folder. Raises OutputError if the disk is full.

        reason: reason of the end
        """
        self._recorder.stop()
        self._store.append(self._recorder.surfaces())
        path = self._store.finish({"reason": reason}, complete=True)
        with open_result(path) as tree:
            write_json(self.out / "summary.json", summary(tree, ending(tree)))
            lost = self._store.lost
        if lost is not None:
            raise lost
        return self.out


def next_folder(out: Path) -> Path:
    """Return the first of recording-001, recording-002, ... that does not exist. Raises OutputError after 999."""
    for number in range(1, 1000):
        folder = out / f"recording-{number:03d}"
        if not folder.exists():
            return folder
    raise OutputError(f"{out} contains 999 recordings; choose another folder with --out")
