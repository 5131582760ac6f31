"""Dimensions of a hand, read from a TOML file."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from palmfield.data import folder
from palmfield.errors import SceneError, did_you_mean, fault_of
from palmfield.files import read_toml

DIGITS = ("thumb", "index", "middle", "ring", "little")
Length = Annotated[float, Field(gt=0.0, lt=1.0)]
LENGTHS_m, BREADTHS_m = (0.12, 0.26), (0.05, 0.12)
"""Allowed hand length and breadth for `sized`: from children of five to above the 99th percentile of men (ANSUR II:
193.3 +- 9.9 and 88.3 +- 4.4 mm)."""


class Digit(BaseModel):
    """One digit.

    bones_m: metacarpal, then phalanges from the knuckle out [m]; three numbers for the thumb, four for a finger
    tip_m: soft tip beyond the last bone [m]
    breadth_m: skin breadth at the base of the first phalanx, at each further joint and at the tip [m]
    base_y_m: metacarpal base along y, relative to that of the middle finger [m]
    arch_m: offset of the knuckle (thumb: metacarpal base) towards the palm, relative to the middle finger [m]
    spread_deg: direction in the plane of the palm, positive to the side of the little finger
    palmar_deg: direction out of that plane, positive to the palmar side
    twist_deg: rotation about the axis of the digit; positive rotates the nail to the side of the thumb
    flexion_deg: flexion at each joint from the knuckle on
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    bones_m: tuple[Length, ...]
    tip_m: Length
    breadth_m: tuple[Length, ...]
    base_y_m: float
    arch_m: float
    spread_deg: float = Field(ge=-90.0, le=90.0)
    palmar_deg: float = Field(default=0.0, ge=-45.0, le=80.0)
    twist_deg: float = Field(default=0.0, ge=-90.0, le=90.0)
    flexion_deg: tuple[Annotated[float, Field(ge=-45.0, le=100.0)], ...]

    @model_validator(mode="after")
    def _same_number_of_bones_and_joints(self) -> "Digit":
        phalanges = len(self.bones_m) - 1
        if phalanges < 2 or len(self.flexion_deg) != phalanges or len(self.breadth_m) != phalanges + 1:
            raise ValueError(
                f"{len(self.bones_m)} bones need {phalanges} flexion angles and {phalanges + 1} breadths, "
                f"got {len(self.flexion_deg)} and {len(self.breadth_m)}"
            )
        return self


class HandPreset(BaseModel):
    """Dimensions and pose of a right hand in metres and degrees; a left hand is the mirror image.

    length_m: wrist crease to the tip of the middle finger; palm_length_m: wrist crease to the base of that finger
    breadth_m: across the knuckles of index and little finger; thickness_m: palm to back at the metacarpals
    finger_depth_ratio: depth over breadth of a finger; digits: thumb, index, middle, ring, little
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: str
    side: Literal["right", "left"] = "right"
    length_m: Length
    breadth_m: Length
    palm_length_m: Length
    wrist_circumference_m: Length
    thickness_m: Length
    finger_depth_ratio: float = Field(gt=0.3, le=1.2)
    digits: dict[str, Digit]

    @model_validator(mode="after")
    def _five_digits(self) -> "HandPreset":
        if tuple(self.digits) != DIGITS:
            raise ValueError(f"digits must be {', '.join(DIGITS)} in this order, got {', '.join(self.digits)}")
        return self


def sized(
    preset: HandPreset,
    length_m: float | None = None,
    breadth_m: float | None = None,
    palm_length_m: float | None = None,
    wrist_circumference_m: float | None = None,
) -> HandPreset:
    """Return a hand of other dimensions [m] in the same pose.

    Bones, tips and palm scale with the length; breadths, arch, thickness and wrist scale with the breadth. Length and
    breadth of hands are only weakly correlated (0.57 in ANSUR II). Palm and wrist are not scaled if they are passed.
    Raises SceneError for a length outside LENGTHS_m and a breadth outside BREADTHS_m.
    """
    requested = {"length_m": (length_m, LENGTHS_m), "breadth_m": (breadth_m, BREADTHS_m)}
    ratios = []
    for name, (value, (least, most)) in requested.items():
        if value is not None and not least <= value <= most:
            raise SceneError(f"hand: {name} is {value}; give {least} to {most} m")
        own: float = getattr(preset, name)
        ratios.append(1.0 if value is None else value / own)
    long, wide = ratios
    digits = {
        name: digit.model_copy(
            update={
                "bones_m": tuple(long * bone for bone in digit.bones_m),
                "tip_m": long * digit.tip_m,
                "breadth_m": tuple(wide * breadth for breadth in digit.breadth_m),
                "base_y_m": long * digit.base_y_m,
                "arch_m": wide * digit.arch_m,
            }
        )
        for name, digit in preset.digits.items()
    }
    return preset.model_copy(
        update={
            "length_m": long * preset.length_m,
            "breadth_m": wide * preset.breadth_m,
            "palm_length_m": palm_length_m or long * preset.palm_length_m,
            "wrist_circumference_m": wrist_circumference_m or wide * preset.wrist_circumference_m,
            "thickness_m": wide * preset.thickness_m,
            "digits": digits,
        }
    )


def mirrored(preset: HandPreset) -> HandPreset:
    """Return the mirror image of a hand."""
    return preset.model_copy(update={"side": "left" if preset.side == "right" else "right"})


class _Resized(BaseModel):
    """A preset file that changes dimensions of another preset; see `sized`."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: str
    based_on: str
    side: Literal["right", "left"] | None = None
    length_m: Length | None = None
    breadth_m: Length | None = None
    palm_length_m: Length | None = None
    wrist_circumference_m: Length | None = None


def preset_names() -> list[str]:
    """Return the sorted names of the presets in palmfield."""
    return sorted(path.stem for path in folder("hand_models").glob("*.toml"))


def load_preset(name_or_path: str | Path) -> HandPreset:
    """Load a preset by name, or from a user's TOML file (a path that ends in .toml).

    A file with `based_on` names another preset and contains only the dimensions that differ, see `sized`.
    Raises SceneError for an unknown name, a missing or malformed file, and values out of range.
    """
    if str(name_or_path).endswith(".toml"):
        path = Path(name_or_path)
        if not path.is_file():
            raise SceneError(f"hand preset {path} does not exist; give a file, or one of: {', '.join(preset_names())}")
    elif str(name_or_path) in preset_names():
        path = folder("hand_models") / f"{name_or_path}.toml"
    else:
        near = did_you_mean(str(name_or_path), preset_names())
        raise SceneError(
            f"hand preset {str(name_or_path)!r} is unknown{near}; use one of: {', '.join(preset_names())}, or the path "
            "of a .toml file"
        )
    try:
        data = read_toml(path)
        return _resized(data) if "based_on" in data else HandPreset.model_validate(data)
    except ValidationError as error:
        raise SceneError(f"hand preset {path}: {fault_of(error)}") from error
    except (OSError, ValueError) as error:
        raise SceneError(f"hand preset {path} cannot be read as TOML: {error}; correct the file") from error


def _resized(data: dict[str, Any]) -> HandPreset:
    resized = _Resized.model_validate(data)
    if resized.based_on not in preset_names() or resized.based_on == resized.name:
        others = ", ".join(name for name in preset_names() if name != resized.name)
        raise SceneError(f"hand preset '{resized.name}': based_on is '{resized.based_on}'; use one of: {others}")
    base = load_preset(resized.based_on)
    measures = resized.model_dump(exclude={"name", "based_on", "side"}, exclude_none=True)
    return sized(base, **measures).model_copy(update={"name": resized.name, "side": resized.side or base.side})
