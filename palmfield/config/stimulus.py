"""Keys of palmfield.stimulus."""

import math
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from palmfield.config.base import Config, Decimals, Fraction, Names, NonNegative, Numbers, Positive, Vector, split

NEEDED: dict[str, tuple[str, ...]] = {
    "circle": ("path_diameter_m",),
    "line": ("path_width_m",),
    "lm": ("path_width_m",),
    "zigzag": ("path_width_m", "path_height_m"),
    "square": ("path_width_m",),
    "z": ("path_width_m", "path_height_m"),
    "lissajous": ("path_width_m", "path_height_m"),
    "letters": ("path_text", "path_height_m"),
    "polyline": ("path_through_m",),
    "sites": ("path_sites",),
    "file": ("path_file",),
}
"""Keys that each path shape requires."""
ZIGZAG = ("path_zigzag_width_m", "path_zigzag_speed_m_s")
"""Keys of a zigzag along an open path."""
OPTIONAL: dict[str, tuple[str, ...]] = {
    "line": ZIGZAG,
    "polyline": ZIGZAG,
    "sites": ZIGZAG,
    "lm": ("path_step_m", "path_direction_deg"),
    "zigzag": ("path_corners",),
    "lissajous": ("path_ratio", "path_phase_deg"),
}
AM_WAVEFORMS: dict[str, tuple[str, ...]] = {
    "sine": (),
    "rectangle": ("am_waveform_duty",),
    "hann": (),
    "burst": ("am_burst_length_s", "am_burst_period_s"),
    "file": ("am_file",),
}
"""Keys that each modulation waveform requires."""
AM_OPTIONAL: dict[str, tuple[str, ...]] = {"hann": ("am_waveform_duty",), "burst": ("am_burst_phase_deg",)}
OF_WAVEFORMS = ("am_waveform_duty", "am_burst_length_s", "am_burst_period_s", "am_burst_phase_deg", "am_file")
AM_KEYS = ("am_quantity", "am_frequency_Hz", "am_depth", "am_waveform", "am_normalisation", *OF_WAVEFORMS)
FARTHEST_FOCUS_M = 10.0
"""Largest distance of a focus from the origin [m]. Over 10 m, air absorbs 13 dB at 40 kHz."""
Extent = Annotated[float, Field(gt=0.0, le=2.0 * FARTHEST_FOCUS_M)]
"""Extent of a path [m]. The limit is the diameter of the region of allowed foci."""
USUAL_FOCUS_M = 0.2
MOVING = ("path_rate_Hz", "path_speed_m_s", "path_end", "path_points")
STEPS = 1e-6
"""Tolerance for the width of a path, which must be a whole number of steps: largest relative deviation."""
PATH_KEYS = (*MOVING, *{key for keys in (*NEEDED.values(), *OPTIONAL.values()) for key in keys})


def too_far(focus_m: tuple[float, float, float]) -> str | None:
    """Return an error text, with the likely unit, for a focus [m] that is not finite or too far away; else None."""
    if not all(map(math.isfinite, focus_m)):
        return "which is not a position; allowed: three finite numbers, in metres"
    distance = math.dist(focus_m, (0.0, 0.0, 0.0))
    if distance <= FARTHEST_FOCUS_M:
        return None
    units = {"millimetres": 1e-3, "centimetres": 1e-2}
    unit = min(units, key=lambda name: abs(math.log(distance * units[name] / USUAL_FOCUS_M)))
    metres = " ".join(f"{x * units[unit]:.6g}" for x in focus_m)
    return (
        f"which is {distance:g} m away; allowed: metres, at most {FARTHEST_FOCUS_M:g} from the origin; if these are "
        f"{unit}, give {metres}"
    )


class StimulusConfig(Config):
    plugin: ClassVar[str] = "palmfield.stimulus"
    about: ClassVar[str] = "Position and strength of the focus over time."
    files: ClassVar[tuple[str, ...]] = ("am_file", "path_file")
    renamed: ClassVar[dict[str, str]] = {"am_of": "am_quantity", "am_quantity=pressure": "amplitude"}

    arrays: Names = Field(
        (),
        description="instances of palmfield.array driven by this stimulus (default: all instances that no other "
        "stimulus names)",
    )
    focus_m: Vector = Field((0.0, 0.0, 0.2), description="position of the focus, or centre of its path, in `frame`")
    frame: str = Field("array", description="`array`, or the name of a site in whose frame focus and path are given")
    path: Literal[
        "point", "circle", "line", "lm", "zigzag", "square", "z", "lissajous", "letters", "polyline", "sites", "file"
    ] = Field(
        "point",
        description="path of the focus around focus_m, in the x-y plane of the frame; lm: lateral modulation, "
        "back and forth on a short line; sites: through sites on the skin; file: positions and levels of one or "
        "more foci from a table",
    )
    path_on: Literal["plane", "skin"] = Field(
        "plane",
        description="surface that contains the path; skin: the path is around the skin point nearest to focus_m in the "
        "reference pose, and its x direction is that of the key frame",
    )
    on_skin: str | None = Field(
        None, description="instance of palmfield.skin for path_on and path_sites (default: the only one)"
    )
    path_diameter_m: Extent | None = Field(None, description="diameter of the circle")
    path_width_m: Extent | None = Field(
        None,
        description="extent along x: length of a line or of lm, side of a square, width of zigzag, z and lissajous",
    )
    path_height_m: Extent | None = Field(None, description="extent along y: height of zigzag, z, lissajous and letters")
    path_step_m: Extent | None = Field(
        None,
        description="lm: distance between the points at which the focus stops; path_width_m: it stops at the two ends; "
        "without this key the focus moves continuously",
    )
    path_zigzag_width_m: Extent | None = Field(
        None, description="line, polyline, sites: width of a zigzag of the focus about the path"
    )
    path_zigzag_speed_m_s: Positive | None = Field(
        None, description="speed of that zigzag across the path; path_speed_m_s is the speed along the path"
    )
    path_direction_deg: float = Field(0.0, description="lm: direction of the line, from x towards y of the frame")
    path_corners: Annotated[int, Field(ge=1, le=1000)] = Field(3, description="corners of the zigzag between its ends")
    path_ratio: Numbers = Field((1, 2), description="lissajous: oscillations along x and along y per turn")
    path_phase_deg: float = Field(0.0, description="lissajous: phase lead of the oscillation along x")
    path_text: str | None = Field(None, description="letters A-Z and 0-9 to write; the sound is off between strokes")
    path_through_m: Decimals = Field((), description="polyline: x and y of each corner")
    path_sites: Names = Field(
        (), description="path sites: two or more sites of the body of the skin, on or near the surface"
    )
    path_file: str | None = Field(
        None, description="path file: CSV table of foci over time, played once from start_s (docs/stimuli.md)"
    )
    path_rate_Hz: Positive | None = Field(
        None, description="turns per second; with path_end back, a turn of an open path is back and forth"
    )
    path_speed_m_s: Positive | None = Field(None, description="speed along the path, in place of path_rate_Hz")
    path_end: Literal["back", "jump", "stop"] = Field(
        "back",
        description="at the end of an open path: go back, jump to the start, or stop (silence; closed paths stop "
        "after one round); a file is played once (stop) unless set to jump",
    )
    path_points: Annotated[int, Field(ge=0, le=100000)] = Field(
        0, description="points per turn, each held until the next; 0: continuous motion"
    )
    foci_m: Decimals = Field((), description="several foci at once: x, y, z of each relative to focus_m and its path")
    foci_arp: Annotated[tuple[NonNegative, ...], BeforeValidator(split)] = Field(
        (), description="relative ARP of each of foci_m: 0 or more, at least one above 0 (default: equal)"
    )
    modulation: Literal["none", "am"] = Field("none", description="none, or amplitude modulation (docs/stimuli.md)")
    am_quantity: Literal["duty", "amplitude", "arp"] | None = Field(
        None,
        description="quantity that follows the waveform: duty cycle of the pulses (by key duty_exponent of the "
        "driver), amplitude of the sound pressure, or radiation pressure (ARP)",
    )
    am_waveform: Literal["sine", "rectangle", "hann", "burst", "file"] = Field(
        "sine",
        description="waveform w, from -1 to 1; the quantity is proportional to 1 + m w: sine; rectangle; Hann pulses; "
        "bursts of a sine under a Hann window; or from a file",
    )
    am_frequency_Hz: Annotated[float, Field(gt=0, le=2000)] | None = Field(
        None, description="modulation frequency, or frequency of the sine in a burst"
    )
    am_depth: Fraction | None = Field(None, description="modulation depth m: the quantity is proportional to 1 + m w")
    am_normalisation: Literal["peak", "carrier", "mean"] = Field(
        "peak",
        description="drive_amplitude is the amplitude at the loudest moment (peak), at w = 0 (carrier), or of a steady "
        "sound with the same mean ARP (mean)",
    )
    am_waveform_duty: Annotated[float, Field(gt=0, le=1)] | None = Field(
        None,
        description="share of the period during which a rectangle is high (below 1) or a Hann pulse lasts (default 1)",
    )
    am_burst_length_s: Positive | None = Field(None, description="length of a burst of the sine of the modulation")
    am_burst_period_s: Positive | None = Field(
        None,
        description="time from the start of one such burst to the start of the next; the carrier continues "
        "between bursts",
    )
    am_burst_phase_deg: Annotated[float, Field(ge=-360, le=360)] | None = Field(
        None,
        description="phase of the sine in the middle of a burst: 90 is a crest, -90 a trough (default: the sine "
        "starts at phase 0 with the burst)",
    )
    am_file: str | None = Field(
        None,
        description="CSV file: columns turn (0..1) and w for one period, or time_s and w for a course from start_s",
    )
    arp_peak_Pa: Positive | None = Field(
        None, description="sets the level: |p|^2/(rho c^2) at the focus at the loudest moment; excludes drive_amplitude"
    )
    drive_amplitude: Fraction | None = Field(
        None, description="sets the level: pressure amplitude of each transducer relative to full drive (default 1)"
    )
    burst_window: Literal["none", "rectangular", "hann"] = Field(
        "none", description="window of the ARP in bursts, from start_s"
    )
    burst_length_s: Positive | None = Field(None, description="length of a burst")
    burst_period_s: Positive | None = Field(
        None, description="time from the start of one burst to the start of the next"
    )
    burst_count: Annotated[int, Field(ge=1)] | None = Field(None, description="number of bursts (default: no end)")
    start_s: NonNegative = Field(0.0, description="start time of the sound")
    stop_s: Positive | None = Field(None, description="stop time of the sound (default: never)")
    ramp_s: NonNegative = Field(0.0, description="raised-cosine ramp of the ARP after start_s")
    control_rate_Hz: Annotated[float, Field(ge=0, le=40e3)] = Field(
        0.0, description="rate of new frames to the board, each held until the next; 0: one for each step of the skin"
    )

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.modulation == "am":
            self._check_modulation()
        if len(set(self.arrays)) < len(self.arrays):
            raise ValueError(f"arrays are '{' '.join(self.arrays)}': name each once")
        if self.on_skin is not None and self.path_on != "skin":
            raise ValueError(
                f"on_skin applies to a path on the skin, but path_on is '{self.path_on}': remove the key, or set "
                "path_on"
            )
        if (far := too_far(self.focus_m)) is not None:
            raise ValueError(f"key 'focus_m' has value '{' '.join(f'{x:g}' for x in self.focus_m)}', {far}")
        self._check_path()
        self._check_foci_and_bursts()
        if self.arp_peak_Pa is not None and self.drive_amplitude is not None:
            raise ValueError("arp_peak_Pa and drive_amplitude both set the level; give one")
        if self.stop_s is not None and self.stop_s <= self.start_s:
            raise ValueError(f"stop_s {self.stop_s} must be later than start_s {self.start_s}")
        return self

    def _check_path(self) -> None:
        used = {key for key in PATH_KEYS if key in self.model_fields_set}
        if self.path == "point":
            if used or self.path_on == "skin":
                key = min(used) if used else "path_on"
                raise ValueError(f"{key} applies to a moving path, but path is 'point': remove the key, or set path")
            return
        needed = NEEDED[self.path]
        missing = [key for key in needed if not getattr(self, key)]
        if self.path != "file" and (self.path_rate_Hz is None) == (self.path_speed_m_s is None):
            missing.append("path_rate_Hz (or path_speed_m_s, not both)")
        if missing:
            raise ValueError(f"path '{self.path}' needs {' and '.join(missing)}")
        stray = sorted(used - set(needed) - set(MOVING) - set(OPTIONAL.get(self.path, ())))
        if stray:
            raise ValueError(f"{stray[0]} does not apply to path '{self.path}', which takes {', '.join(needed)}")
        if self.path == "file":
            self._check_file()
        if self.path == "sites" and (self.path_on != "skin" or len(self.path_sites) < 2):
            raise ValueError("path 'sites' needs path_on 'skin' and two or more path_sites: set path_on to skin")
        if len(self.path_ratio) != 2 or min(self.path_ratio) < 1:
            raise ValueError(f"path_ratio is {self.path_ratio}; give two whole numbers of 1 or more")
        if self.path == "lm":
            self._check_steps()
        if any(getattr(self, key) is not None for key in ZIGZAG):
            self._check_zigzag()
        if len(self.path_through_m) % 2:
            raise ValueError(f"path_through_m has {len(self.path_through_m)} numbers; give x and y of each corner")

    def _check_file(self) -> None:
        for key in ("focus_m", "foci_m", "foci_arp", "path_rate_Hz", "path_speed_m_s", "path_points"):
            if key in self.model_fields_set:
                raise ValueError(
                    f"{key} does not apply to path 'file', whose table has positions and times: remove the key"
                )
        if "path_end" in self.model_fields_set and self.path_end == "back":
            raise ValueError("path_end is 'back'; allowed with path 'file': stop, jump (begins again)")
        if self.path_on == "skin":
            raise ValueError(
                "path_on is 'skin', but the table of path 'file' has positions in space: set path_on to plane"
            )

    def _check_zigzag(self) -> None:
        missing = [key for key in (*ZIGZAG, "path_speed_m_s") if getattr(self, key) is None]
        if missing:
            raise ValueError(
                f"a zigzag about path '{self.path}' needs {' and '.join(missing)}; allowed: width, speed across and "
                "speed along the path together"
            )

    def _check_steps(self) -> None:
        if self.path_step_m is None:
            return
        if "path_points" in self.model_fields_set:
            raise ValueError(f"path_step_m and path_points {self.path_points} both set where path 'lm' rests; give one")
        if self.path_end != "back":
            raise ValueError(f"path_end is '{self.path_end}'; allowed with path_step_m: back")
        width = self.path_width_m or 0.0
        count = width / self.path_step_m
        if round(count) < 1 or abs(count - round(count)) > STEPS * count:
            raise ValueError(
                f"path_width_m {width:g} must be a whole number of steps of path_step_m {self.path_step_m:g}, but it "
                f"is {count:g} steps; for example, set path_step_m to {width / max(1, round(count)):g}"
            )

    def _check_modulation(self) -> None:
        needed = ["am_quantity", "am_frequency_Hz", "am_depth", *AM_WAVEFORMS[self.am_waveform]]
        if self.am_waveform == "file":
            # The file defines whether it holds one period, which needs a frequency, or a course in seconds
            needed.remove("am_frequency_Hz")
        missing = [key for key in needed if getattr(self, key) is None]
        if missing:
            of = "" if self.am_waveform == "sine" else f" of am_waveform '{self.am_waveform}'"
            raise ValueError(f"modulation 'am'{of} needs {', '.join(missing)}")
        applicable = (*AM_WAVEFORMS[self.am_waveform], *AM_OPTIONAL.get(self.am_waveform, ()))
        stray = [key for key in OF_WAVEFORMS if getattr(self, key) is not None and key not in applicable]
        if stray:
            raise ValueError(
                f"{stray[0]} does not apply to am_waveform '{self.am_waveform}', which takes "
                f"{', '.join(applicable) or 'no such key'}"
            )
        if self.am_waveform == "rectangle" and self.am_waveform_duty == 1.0:
            raise ValueError("am_waveform_duty is 1, so the rectangle is always high; allowed: above 0, below 1")
        if self.am_waveform == "burst":
            self._check_am_bursts()
        if self.arp_peak_Pa is not None and self.am_normalisation != "peak":
            raise ValueError(
                f"am_normalisation is '{self.am_normalisation}', but arp_peak_Pa {self.arp_peak_Pa:g} sets the loudest "
                "moment; allowed: peak, or drive_amplitude in place of arp_peak_Pa"
            )
        if self.arp_peak_Pa is not None and self.am_quantity == "duty":
            raise ValueError(
                "am_quantity is 'duty', for which the waveform of the ARP depends on the level, so arp_peak_Pa "
                f"{self.arp_peak_Pa:g} cannot set it; allowed: drive_amplitude in place of arp_peak_Pa"
            )

    def _check_am_bursts(self) -> None:
        length, period, frequency = self.am_burst_length_s, self.am_burst_period_s, self.am_frequency_Hz
        assert length is not None and period is not None and frequency is not None
        if length > period:
            raise ValueError(f"am_burst_length_s {length:g} is longer than am_burst_period_s {period:g}")
        if length * frequency < 1.0:
            raise ValueError(
                f"am_burst_length_s {length:g} holds {length * frequency:.3g} periods of am_frequency_Hz "
                f"{frequency:g}; allowed: one or more, {1.0 / frequency:g} s"
            )

    def _check_foci_and_bursts(self) -> None:
        if len(self.foci_m) % 3 or len(self.foci_m) == 3:
            raise ValueError(f"foci_m has {len(self.foci_m)} numbers; give x, y and z of two foci or more")
        if self.foci_arp and (3 * len(self.foci_arp) != len(self.foci_m) or max(self.foci_arp) == 0.0):
            raise ValueError(
                f"key 'foci_arp' has value '{' '.join(f'{x:g}' for x in self.foci_arp)}'; allowed: "
                f"{len(self.foci_m) // 3} numbers, one for each of foci_m, 0 or more, and one above 0"
            )
        if self.foci_m and self.path_on == "skin":
            raise ValueError(
                "foci_m are offsets along the axes of the frame and cannot follow the skin: set path_on to plane"
            )
        burst = [key for key in ("burst_length_s", "burst_period_s", "burst_count") if getattr(self, key) is not None]
        if self.burst_window == "none" and burst:
            raise ValueError(
                f"{burst[0]} applies to bursts, but burst_window is 'none': remove the key, or set burst_window"
            )
        if self.burst_window != "none":
            if self.burst_length_s is None or self.burst_period_s is None:
                raise ValueError(f"burst_window '{self.burst_window}' needs burst_length_s and burst_period_s")
            if self.burst_length_s > self.burst_period_s:
                raise ValueError(
                    f"burst_length_s {self.burst_length_s:g} is longer than burst_period_s {self.burst_period_s:g}"
                )
