"""What one stage of a step hands to the next is a type of its own, whose parts are typed as well."""

import dataclasses
from typing import Any, get_args, get_type_hints

import pytest

from palmfield.acoustics.arp import SurfaceSound
from palmfield.drive.array_drive import ArrayDrive
from palmfield.drive.transducer_response import EmittedCourse
from palmfield.motion.pose import HandPose
from palmfield.simulation.backend import Frames, StepTrace
from palmfield.simulation.emission import Emission
from palmfield.simulation.posed_scene import PosedScene, posed_scene
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.sensors import SkinReading, skin_reading
from palmfield.simulation.step import Steps
from palmfield.skin.stepper import Reader, SkinStepper, SurfaceLoads
from palmfield.stimulus.focal_points import FocalPoints
from palmfield.stimulus.focus_table import FocusTable
from palmfield.stimulus.schedule import Moments


@pytest.mark.parametrize(
    ("stage", "takes", "gives"),
    [
        (posed_scene, {PosedScene}, {PosedScene}),
        (ArrayDrive.unit_drives, {FocalPoints}, set()),
        (Emission.over, {PosedScene}, {Moments, EmittedCourse}),
        (Radiation.on, {PosedScene}, {SurfaceSound}),
        (Radiation.patterns, {PosedScene, EmittedCourse}, set()),
        (SkinStepper.step, {SurfaceLoads, Reader}, set()),
        (skin_reading, set(), {SkinReading}),
        (Steps.begin, {Frames}, set()),
    ],
)
def test_stages_meet_in_types_of_their_own(stage, takes, gives):
    hints = get_type_hints(stage)
    given = hints.pop("return")
    taken = {part for hint in hints.values() for part in (hint, *get_args(hint))}
    assert takes <= taken
    assert gives <= {given, *get_args(given)}
    assert Any not in taken | {given, *get_args(given)}


@pytest.mark.parametrize(
    "handed",
    [EmittedCourse, Frames, FocalPoints, HandPose, Moments, SkinReading, StepTrace, SurfaceLoads, SurfaceSound],
)
def test_what_is_handed_on_is_immutable_with_typed_parts(handed):
    # Modules that few scenes need are not imported for their types
    fields = get_type_hints(handed, localns={FocusTable.__name__: FocusTable})
    if dataclasses.is_dataclass(handed):
        assert handed.__dataclass_params__.frozen
        names = [field.name for field in dataclasses.fields(handed)]
    else:
        assert issubclass(handed, tuple)
        names = handed._fields
    assert names and set(names) <= set(fields)
    assert not [name for name in names if fields[name] is Any]
