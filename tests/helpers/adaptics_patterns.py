"""Small patterns of Adaptics, written for tests."""

import json

LINEAR, STEP = {"name": "linear", "params": {}}, {"name": "step", "params": {}}


def number(value):
    """A number, the name of a parameter, or a formula as (operation, term, term)."""
    if isinstance(value, str):
        return {"type": "param", "value": value}
    return {"type": "formula", "value": formula(value)} if isinstance(value, tuple) else {"type": "f64", "value": value}


def formula(term):
    if isinstance(term, tuple):
        terms = [formula(one) for one in term[1:]]
        return {"type": term[0], "value": terms[0] if term[0] == "negate" else terms}
    return {"type": "parameter" if isinstance(term, str) else "constant", "value": term}


def frame(time, place=None, *, intensity=None, brush=None, transition=LINEAR, jumps=(), kind=None):
    """A keyframe; a pause without place. intensity: a number or (min, max); brush: (name, numbers)"""
    if kind == "stop":
        return {"type": "stop", "time": time}
    one = {"type": "pause" if place is None else "standard", "time": time, "cjumps": list(jumps)}
    if place is not None:
        one["coords"] = {"coords": dict(zip("xyz", place, strict=True)), "transition": transition}
    if intensity is not None:
        name, params = "constant", {"value": intensity}
        if isinstance(intensity, list):
            name, params = "random", dict(zip(("min", "max"), intensity, strict=True))
        params = {key: number(value) for key, value in params.items()}
        one["intensity"] = {"intensity": {"name": name, "params": params}, "transition": transition}
    if brush is not None:
        params = {key: number(value) for key, value in brush[1].items()}
        one["brush"] = {"brush": {"name": brush[0], "params": params}, "transition": transition}
    return one


def jump(parameter, comparison, value, target):
    condition = {"parameter": parameter, "value": value, "operator": {"name": comparison, "params": {}}}
    return {"condition": condition, "jump_to": target}


def pattern(
    frames,
    *,
    translate=(0, 0, 200),
    scale=(1, 1, 1),
    rotation=0,
    factor=1,
    speed=1,
    revision="0.1.0-alpha.3",
    **defined,
):
    """A pattern. defined: default, min and max of parameters"""
    triples = {
        name: {axis: number(x) for axis, x in zip("xyz", three, strict=True)}
        for name, three in (("translate", translate), ("scale", scale))
    }
    return {
        "$DATA_FORMAT": "MidAirHapticsAnimationFileFormat",
        "$REVISION": revision,
        "name": "made for a test",
        "keyframes": frames,
        "pattern_transform": {
            "geometric_transforms": {**triples, "rotation": number(rotation)},
            "intensity_factor": number(factor),
            "playback_speed": number(speed),
        },
        "user_parameter_definitions": {
            name: {"default": default, "min": low, "max": high, "step": 0.1}
            for name, (default, low, high) in defined.items()
        },
    }


def written(path, content):
    path.write_text(json.dumps(content))
    return path
