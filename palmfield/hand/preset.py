"""Measures of a hand, read from a TOML file."""

import tomllib
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from palmfield.data import folder
from palmfield.errors import SceneError

DIGITS = ("thumb", "index", "middle", "ring", "little")
Length = Annotated[float, Field(gt=0.0, lt=1.0)]


class Digit(BaseModel):
    """One digit.

    bones_m: metacarpal, then phalanges from the knuckle out [m]; three numbers for the thumb, four for a finger
    tip_m: soft tip beyond the last bone [m]
    breadth_m: skin breadth at the base of the first phalanx, at each further joint and at the tip [m]
    base_y_m: metacarpal base along y, against that of the middle finger [m]
    arch_m: how far the knuckle (thumb: the metacarpal base) lies towards the palm, against the middle one [m]
    spread_deg: direction in the plane of the palm, positive to the little finger's side
    palmar_deg: direction out of that plane, positive to the palmar side
    twist_deg: turn about the digit's own axis; positive turns the nail to the thumb's side
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
    """Measures and pose of a right hand; lengths in metres.

    length_m: wrist crease to the tip of the middle finger; palm_length_m: wrist crease to the base of that finger
    breadth_m: across the knuckles of index and little finger; thickness_m: palm to back at the metacarpals
    finger_depth_ratio: depth over breadth of a finger
    digits: thumb, index, middle, ring, little
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: str
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


def preset_names() -> list[str]:
    """Names of the presets that ship with palmfield, sorted."""
    return sorted(path.stem for path in folder("hand_models").glob("*.toml"))


def load_preset(name_or_path: str | Path) -> HandPreset:
    """Preset by its name, or from a user's TOML file (a path that ends in .toml).

    Raises SceneError for an unknown name, a missing or malformed file, and values out of range.
    """
    if str(name_or_path).endswith(".toml"):
        path = Path(name_or_path)
        if not path.is_file():
            raise SceneError(f"hand preset {path} does not exist; give a file, or one of: {', '.join(preset_names())}")
    elif str(name_or_path) in preset_names():
        path = folder("hand_models") / f"{name_or_path}.toml"
    else:
        raise SceneError(
            f"hand preset {str(name_or_path)!r} is unknown; use one of: {', '.join(preset_names())}, "
            "or the path of a .toml file"
        )
    try:
        return HandPreset.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SceneError(f"hand preset {path} cannot be read as TOML: {error}; mend the file") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise SceneError(f"hand preset {path}: {where}: {first['msg']}, got {_brief(first['input'])}") from error


def _brief(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
