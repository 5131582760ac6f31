"""Keys of palmfield.motion."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from palmfield.config.base import Config, NonNegative, Vector

TRACKER = ("tracking_up", "tracking_origin_m", "tracking_alignment", "ahead_s")
SOURCES = ("keyframes", "trajectory", "tracking", "function")


class MotionConfig(Config):
    plugin: ClassVar[str] = "palmfield.motion"
    about: ClassVar[str] = "Moves a hand by script: its mocap body and, for an articulated hand, its joints."
    files: ClassVar[tuple[str, ...]] = ("keyframes", "trajectory", "tracking", "tracking_alignment")

    body: str = Field(
        "hand_target", description="mocap body that leads the hand; for a hand with a prefix: `[prefix]hand_target`"
    )
    hand: str | None = Field(
        None, description="preset of an articulated hand, whose joints move as well (default: rigid hand)"
    )
    keyframes: str | None = Field(None, description="TOML file of poses at times (docs/motion.md)")
    interpolation: Literal["monotone", "smooth"] = Field(
        "monotone",
        description="keyframes: cubics, whose acceleration jumps at keys (monotone), or degree 5, with "
        "acceleration 0 at keys (smooth)",
    )
    trajectory: str | None = Field(None, description="CSV or NPZ file of wrist poses and joint angles over time")
    tracking: str | None = Field(None, description="CSV or NPZ file of a recorded OpenXR hand, which the hand follows")
    tracking_up: Literal["y", "z"] = Field("y", description="vertical axis of the space of the tracker; y for OpenXR")
    tracking_origin_m: Vector = Field((0.0, 0.0, 0.0), description="position of the origin of the tracker in the scene")
    tracking_alignment: str | None = Field(
        None,
        description="JSON file of `palmfield track align` with the pose of the tracker relative to the first "
        "array, in place of tracking_up and tracking_origin_m",
    )
    ahead_s: NonNegative = Field(0.0, description="tracking: prediction time, which a live system needs")
    function: str | None = Field(None, description="package.module:function of time [s] that gives a pose")
    start_s: float = Field(0.0, description="scene time at which the motion begins")
    follow: Literal["servo", "exact"] = Field(
        "servo",
        description="servo: springs and position servos move the hand, which yields to forces; exact: the pose is set "
        "directly",
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        sources = [key for key in SOURCES if getattr(self, key) is not None]
        if len(sources) != 1:
            raise ValueError(
                f"sources of the motion: {' and '.join(sources) or 'none'}; give exactly one of: {', '.join(SOURCES)}"
            )
        if self.interpolation == "smooth" and self.keyframes is None:
            raise ValueError("interpolation 'smooth' applies to keyframes only: remove it")
        if self.tracking is not None and self.hand is None:
            raise ValueError("tracking needs an articulated hand: name its preset by key hand")
        if self.follow == "exact" and self.hand is None:
            raise ValueError(
                "follow 'exact' needs an articulated hand: name its preset by key hand, or remove key follow"
            )
        stray = [key for key in TRACKER if key in self.model_fields_set and self.tracking is None]
        if stray:
            raise ValueError(f"{stray[0]} applies to tracking only: remove it")
        placed = [key for key in ("tracking_up", "tracking_origin_m") if key in self.model_fields_set]
        if placed and self.tracking_alignment is not None:
            raise ValueError(f"{placed[0]} and tracking_alignment both place the tracker: remove one")
        return self
