"""Every reader of a user's file against files that have no end, no content, too much depth or too long numbers."""

import os
from pathlib import Path

import pytest

from palmfield.acoustics.calibration_file import read_calibration
from palmfield.acoustics.transducer_file import read_transducers
from palmfield.errors import PalmfieldError, reason_of
from palmfield.hand.articulated import articulate
from palmfield.hand.meshfile import load_mesh
from palmfield.hand.preset import load_preset
from palmfield.hardware.decode import pieces_of
from palmfield.instruments.settings import read_settings
from palmfield.instruments.vibrometer import Vibrometer
from palmfield.motion.alignment import read_alignment, read_touches
from palmfield.motion.source import read_keyframes
from palmfield.motion.tracking import read_stream
from palmfield.motion.trajectory import read_trajectory
from palmfield.outputs.scan_files import read_scan
from palmfield.session.migrate import migrated
from palmfield.session.scene_text import read_scene_text
from palmfield.stimulus.adaptics import read_adaptics
from palmfield.stimulus.am_file import read_am_table
from palmfield.stimulus.autd3_stm import read_foci_stm
from palmfield.stimulus.focus_table_file import read_focus_table
from palmfield.stimulus.standard import read_stimulus
from palmfield.studies.experiment.design import read_design
from palmfield.studies.experiment.log import read_experiment_log
from palmfield.studies.sweeps.keys import _read_table
from palmfield.studies.trial.recording import read_recording

HAND = articulate(load_preset("open_women_p50"))
READERS = {
    "am_table.csv": read_am_table, "am_table.npz": read_am_table, "stm.json": read_foci_stm,
    "pattern.adaptics": read_adaptics,
    "standard.toml": read_stimulus, "foci.csv": read_focus_table, "log.log": lambda path: pieces_of(path, None),
    "calibration.json": read_calibration, "transducers.csv": read_transducers, "scan.csv": read_scan,
    "scan.uff": read_scan, "scan.mat": read_scan, "design.toml": read_design,
    "design.json": read_design, "experiment.jsonl": read_experiment_log, "recording.csv": read_recording,
    "settings.toml": lambda path: read_settings(path, Vibrometer), "sweep.csv": lambda path: _read_table(path, {}),
    "keys.toml": lambda path: read_keyframes(path, HAND, None),
    "trajectory.csv": lambda path: read_trajectory(path, HAND),
    "stream.csv": read_stream, "touches.csv": read_touches, "alignment.json": read_alignment,
    "preset.toml": load_preset,
    "scene.xml": read_scene_text, "old.xml": migrated, "mano.pkl": lambda path: load_mesh(path, "auto"),
    **{f"mesh.{kind}": lambda path: load_mesh(path, "auto") for kind in ("stl", "ply", "obj", "glb", "gltf")},
}  # fmt: skip
CONTENTS = {
    "nothing": b"", "zeros": bytes(4096), "noise": bytes(range(256)) * 16, "one line": b"1," * 200_000,
    "deep lists": b"a=" + b"[" * 5000, "deep JSON": b"[" * 5000, "deep tables": b'{"a":' * 5000,
    "closed lists": b"a=" + b"[" * 400 + b"]" * 400, "closed JSON": b"[" * 400 + b"]" * 400,
    "digits": b"a=" + b"9" * 5000, "digits in JSON": b'{"a": ' + b"9" * 5000 + b"}", "400 digits": b'a=' + b"9" * 400,
    "digits in a list": b'{"gain": [' + b"9" * 400 + b"]}", "digits in a column": b"time_s,x\n0," + b"9" * 5000,
    "digits in a head": b"# quantity: velocity\n# unit: " + b"9" * 5000 + b"\ntime_s,P1\n",
    "a long exponent": b"time_s,x\n0,1e" + b"9" * 5000,
}  # fmt: skip


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("content", CONTENTS)
def test_content_that_no_reader_takes(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(CONTENTS[content])
    with pytest.raises(PalmfieldError) as refused:
        READERS[name](path)
    assert name in str(refused.value) and "\n" not in str(refused.value) and len(str(refused.value)) < 1000


@pytest.mark.parametrize("name", READERS)
def test_what_is_no_regular_file_or_is_too_large(tmp_path, name):
    path = tmp_path / name
    for target in ("/dev/zero", "/dev/urandom", "/dev/stdin", str(tmp_path), str(tmp_path / "pipe"), "/nowhere"):
        if target.endswith("pipe"):
            os.mkfifo(target)
        path.symlink_to(target)
        with pytest.raises(PalmfieldError, match=name):
            READERS[name](path)
        path.unlink()
    with path.open("wb") as file:
        file.truncate(1 << 40)  # a hole, which takes no room
    with pytest.raises(PalmfieldError, match="MB"):
        READERS[name](path)


def test_a_path_with_a_zero_byte_is_refused():
    for name, read in READERS.items():
        with pytest.raises(PalmfieldError):
            read(Path(f"a\0{name}"))


def test_an_error_without_words_has_its_kind_as_reason():
    assert reason_of(MemoryError()) == "MemoryError"
    assert reason_of(FileNotFoundError(2, "No such file", "a.csv")) == "No such file"
    assert reason_of(ValueError("two\n  lines of it"), longest=9) == "two lines"
