"""Keys of palmfield.motion."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from palmfield.config.base import Config, NonNegative, Vector

TRACKER = ("tracking_up", "tracking_origin_m", "tracking_alignment", "ahead_s")
SOURCES = ("keyframes", "trajectory", "tracking", "function")


class MotionConfig(Config):
    plugin: ClassVar[str] = "palmfield.motion"
    about: ClassVar[str] = "Moves a hand by script: the mocap body that leads it, and the joints of an articulated one."

    body: str = Field("hand_target", description="mocap body that leads the hand, `[prefix]hand_target`, or is it")
    hand: str | None = Field(
        None, description="preset of an articulated hand, whose joints move too (default: the hand is in one piece)"
    )
    keyframes: str | None = Field(None, description="TOML file of poses at times (docs/motion.md)")
    trajectory: str | None = Field(None, description="CSV or NPZ file of wrist poses and joint angles over time")
    tracking: str | None = Field(None, description="CSV or NPZ file of a recorded OpenXR hand, which the hand follows")
    tracking_up: Literal["y", "z"] = Field("y", description="which axis of the tracker's space is up; OpenXR's is y")
    tracking_origin_m: Vector = Field((0.0, 0.0, 0.0), description="where the tracker's origin is in the scene")
    tracking_alignment: str | None = Field(
        None,
        description="JSON file of `palmfield track align`, where the tracker stands to the scene's first array, in "
        "place of tracking_up and tracking_origin_m",
    )
    ahead_s: NonNegative = Field(0.0, description="tracking: predicted by so much, as a live system must")
    function: str | None = Field(None, description="package.module:function of time [s] that gives a pose")
    start_s: float = Field(0.0, description="the motion's time 0 in the scene")
    follow: Literal["servo", "exact"] = Field(
        "servo",
        description="servo: springs and position servos lead the hand, which yields to forces; exact: it is put",
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        given = [key for key in SOURCES if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"{' and '.join(given) or 'no motion'} given; give one of: {', '.join(SOURCES)}")
        if self.tracking is not None and self.hand is None:
            raise ValueError("tracking moves an articulated hand: name its preset by key hand")
        if self.follow == "exact" and self.hand is None:
            raise ValueError("follow 'exact' puts an articulated hand: name its preset by key hand, or drop it")
        stray = [key for key in TRACKER if key in self.model_fields_set and self.tracking is None]
        if stray:
            raise ValueError(f"{stray[0]} belongs to tracking: drop it")
        placed = [key for key in ("tracking_up", "tracking_origin_m") if key in self.model_fields_set]
        if placed and self.tracking_alignment is not None:
            raise ValueError(f"{placed[0]} and tracking_alignment both place the tracker: drop one")
        return self
