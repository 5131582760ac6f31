"""Make sliders with ranges for numbers of a scene, and the texts of changed keys."""

from collections.abc import Iterable, Mapping

from palmfield.config import StimulusConfig
from palmfield.session.open_scene import as_text
from palmfield.simulation.spec import StimulusSpec
from palmfield.studies.view.messages import Place, Slider

MM = ("mm", 1e3)
AXES = "xyz"
ASIDE_mm, NEARER_mm = 60.0, 120.0
"""Range of a focus across the axis of the array, and along it."""
PLAIN = ("", 1.0)


def stimulus_sliders(stimuli: Iterable[StimulusSpec]) -> tuple[Slider, ...]:
    """Return sliders for focus, modulation, path and level of each stimulus, if it has them."""
    sliders: list[Slider] = []
    for stimulus in stimuli:
        sliders += _of(stimulus.name, stimulus.config)
    return tuple(sliders)


def _of(name: str, config: StimulusConfig) -> list[Slider]:
    def one(
        folder: str, key: str, label: str, span: tuple[float, float, float], unit: tuple[str, float] = PLAIN
    ) -> Slider:
        value = getattr(config, key)
        return Slider(("key", f"{name}.{key}", None), f"{folder}: {name}", label, *span, unit[1] * value, *unit)

    found = []
    if config.path != "file":
        for axis, value in enumerate(config.focus_m):
            at, reach = 1e3 * value, NEARER_mm if axis == 2 else ASIDE_mm
            low = max(at - reach, min(at, 10.0)) if axis == 2 else at - reach
            place: Place = ("key", f"{name}.focus_m", axis)
            found.append(Slider(place, f"Focus: {name}", AXES[axis], low, at + reach, 0.5, at, *MM))
    if config.modulation == "am":
        found.append(one("Modulation", "am_frequency_Hz", "frequency", (1.0, 2000.0, 1.0), ("Hz", 1.0)))
        found.append(one("Modulation", "am_depth", "depth", (0.0, 1.0, 0.01)))
    for key, label in (
        ("path_diameter_m", "diameter"), ("path_width_m", "width"), ("path_height_m", "height"),
    ):  # fmt: skip
        if getattr(config, key) is not None:
            # The smallest step of a slider is 0.1 mm, for any path
            most = 3e3 * getattr(config, key)
            found.append(one("Path", key, label, (min(1.0, most / 10), most, 0.1), MM))
    for key, label, unit in (("path_rate_Hz", "turns a second", "Hz"), ("path_speed_m_s", "speed", "m/s")):
        value = getattr(config, key)
        if value is not None:
            found.append(one("Path", key, label, (0.05 * value, 3.0 * value, 0.01 * value), (unit, 1.0)))
    if config.arp_peak_Pa is not None:
        top = 2.0 * config.arp_peak_Pa
        found.append(one("Level", "arp_peak_Pa", "peak ARP", (0.01 * top, top, 0.005 * top), ("Pa", 1.0)))
    elif config.drive_amplitude is not None:
        found.append(one("Level", "drive_amplitude", "of full drive", (0.01, 1.0, 0.01)))
    else:
        place = ("key", f"{name}.drive_amplitude", None)
        found.append(Slider(place, f"Level: {name}", "of full drive", 0.01, 1.0, 0.01, 1.0, *PLAIN))
    return found


def value_of(slider: Slider, stimuli: Iterable[StimulusSpec]) -> float:
    """Return the value of the slider of a key, in its unit."""
    _, name, axis = slider.place
    instance, _, key = name.rpartition(".")
    value = next(getattr(one.config, key) for one in stimuli if one.name == instance)
    if value is None:
        # Of the keys with a slider only the level may be missing
        value = 1.0
    return float(slider.scale * (value if axis is None else value[axis]))


def turned(
    sliders: Mapping[Place, Slider], turns: Mapping[Place, float], stimuli: Iterable[StimulusSpec]
) -> dict[str, str]:
    """Return the texts of keys, by INSTANCE.key, for changed sliders. turns: values in the units of the sliders"""
    listed = list(stimuli)
    texts = {}
    for group, name, _ in turns:
        if group != "key" or name in texts:
            continue
        parts = [
            turns.get(place, value_of(slider, listed)) / slider.scale
            for place, slider in sliders.items()
            if place[:2] == (group, name)
        ]
        texts[name] = as_text([float(f"{part:.9g}") for part in parts])
    return texts
