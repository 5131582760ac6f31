"""Patterns of Adaptics as tables: against numbers by hand, and against a plain evaluator that goes moment by moment."""

import copy
import json
import math

import numpy as np
import pytest
from adaptics_patterns import LINEAR, STEP, frame, jump, number, pattern, written
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.errors import PalmfieldError, SceneError
from palmfield.stimulus.adaptics import Sampling, read_adaptics, table_of_pattern

STILL = frame(0, (0, 0, 0), intensity=1)
END = frame(100, kind="stop")


def played(content, *, rate_Hz=1000.0, **sampling):
    """Positions [mm] and intensities of all samples."""
    table = table_of_pattern(content, Sampling(rate_Hz=rate_Hz, **sampling))
    every = np.arange(table.length_samples) / table.rate_Hz
    return 1e3 * table.positions_at(every)[:, 0], table.intensities_at(every)[:, 0]


def test_a_circle_with_am():
    """Radius 5 mm, 100 turns a second, AM of 50 Hz. By hand: after 2.5 ms a quarter turn and an eighth period."""
    brush = "circle", {"radius": 5, "am_freq": 50, "stm_freq": 100}
    places, loud = played(pattern([frame(0, (10, 20, 3), intensity=0.8, brush=brush), END]), rate_Hz=2000.0)
    assert len(places) == 200
    by_hand = {0: (15, 20), 5: (10, 25), 10: (5, 20), 15: (10, 15), 20: (15, 20)}
    for row, (x, y) in by_hand.items():
        assert places[row] == pytest.approx([x, y, 203], abs=1e-9)
    eighth = 0.5 + 0.5 * math.sqrt(0.5)
    assert loud[[0, 5, 10, 20, 40]] == pytest.approx([0.8, 0.8 * eighth, 0.4, 0.0, 0.8], abs=1e-9)


def test_without_stm_a_brush_is_drawn_a_hundred_times_a_second():
    brush = "line", {"length": 8, "thickness": 3, "rotation": 90, "am_freq": 0}
    places, _ = played(pattern([frame(0, (0, 0, 0), brush=brush), END]))
    assert places[0] == pytest.approx([0, 8, 200], abs=1e-9) and places[5] == pytest.approx([0, -8, 200], abs=1e-9)
    assert places[1, 1] == pytest.approx(8 * math.cos(math.radians(36)), abs=1e-9) and abs(places[:, 0]).max() < 1e-9


def test_a_lissajous_brush():
    numbers = {
        "x_scale": 4,
        "y_scale": 2,
        "rotation": math.pi / 2,
        "a": 1,
        "b": 2,
        "d": 0,
        "am_freq": 0,
        "stm_freq": 50,
    }
    places, _ = played(pattern([frame(0, (0, 0, 0), brush=("lissajous", numbers)), END]))
    # After an eighth of a turn x is 4 sin(45 deg), y 2 sin(90 deg), then turned by 90 deg
    assert places[0] == pytest.approx([0, 0, 200], abs=1e-9)
    at = table_of_pattern(pattern([frame(0, (0, 0, 0), brush=("lissajous", numbers)), END]), Sampling(rate_Hz=400.0))
    assert 1e3 * at.positions[1, 0] == pytest.approx([-2, 4 * math.sqrt(0.5), 200], abs=1e-9)


def test_transitions():
    """Linear from 0 to 100 ms in position, intensity and radius; a step then."""
    circle = {"radius": 0, "am_freq": 0}
    frames = [
        frame(0, (0, 0, 0), intensity=1, brush=("circle", circle)),
        frame(100, (20, -10, 4), intensity=0.5, brush=("circle", circle | {"radius": 10}), transition=STEP),
        frame(200, (0, 0, 0), intensity=0.2, brush=("circle", circle | {"radius": 2}), transition=STEP),
        frame(300, kind="stop"),
    ]
    places, loud = played(pattern(frames))
    # At 30, 130 and 230 ms a brush of 100 Hz is at its first point
    assert places[30] == pytest.approx([6 + 3, -3, 201.2], abs=1e-9) and loud[30] == pytest.approx(0.85)
    assert places[130] == pytest.approx([20 + 10, -10, 204], abs=1e-9) and loud[130] == pytest.approx(0.5)
    assert places[230] == pytest.approx([2, 0, 200], abs=1e-9) and loud[230] == pytest.approx(0.2)
    assert loud[[99, 199, 200]] == pytest.approx([0.505, 0.5, 0.2]) and len(loud) == 300


def test_brushes_of_different_kinds_have_no_transition():
    line = "line", {"length": 6, "thickness": 1, "rotation": 0, "am_freq": 0}
    frames = [frame(0, (0, 0, 0), brush=("circle", {"radius": 4, "am_freq": 0})), frame(50, (0, 0, 0), brush=line), END]
    places, _ = played(pattern(frames))
    assert np.abs(np.hypot(*places[:50, :2].T) - 4).max() < 1e-9 and np.abs(places[50:, 1]).max() < 1e-9


def test_a_pause_holds_the_position_and_its_own_intensity():
    """Still until 40 ms, then on the way to 100 ms; the intensity passes through the pause."""
    frames = [STILL, frame(40, intensity=0.2), frame(100, (60, 0, 0), intensity=1), frame(120, kind="stop")]
    places, loud = played(pattern(frames))
    assert np.abs(places[:40, 0]).max() == 0.0 and places[[70, 99], 0] == pytest.approx([30, 59])
    assert loud[[20, 40, 70]] == pytest.approx([0.6, 0.2, 0.6])
    # Before a stop, too, nothing moves
    assert places[100:, 0] == pytest.approx([60] * 20)


def test_a_stop_ends_the_pattern_and_what_follows_needs_a_jump():
    later = [frame(150, (9, 0, 0)), frame(200, (9, 0, 0))]
    assert len(played(pattern([STILL, END, *later]))[0]) == 100
    jumped = [STILL, frame(50, jumps=[jump("go", "gt", 0, 150)]), END, *later]
    places, _ = played(pattern(jumped, go=(1, 0, 1)))
    assert len(places) == 100 and places[50:, 0] == pytest.approx([9] * 50)
    # To a moment after a stop: the end at once
    assert (
        len(played(pattern([STILL, frame(50, jumps=[jump("go", "gt", 0, 120)]), END, *later], go=(1, 0, 1)))[0]) == 50
    )


@pytest.mark.parametrize(("comparison", "taken"), [("lt", False), ("lt_eq", True), ("gt", False), ("gt_eq", True)])
def test_a_jump_is_taken_on_its_condition(comparison, taken):
    """From 60 back to 20 ms, for 100 ms in all: 60 ms, then 40 ms from the 20th on."""
    frames = [STILL, frame(60, (60, 0, 0), jumps=[jump("p", comparison, 0.5, 20)]), frame(100, (100, 0, 0)), END]
    places, _ = played(pattern(frames, p=(0.5, 0, 1)), duration_s=0.1)
    wanted = [*range(60), *range(20, 60)] if taken else range(100)
    assert places[:, 0] == pytest.approx(list(wanted), abs=1e-9)
    with_other, _ = played(pattern(frames, p=(0.9, 0, 1)), duration_s=0.1, parameters={"p": 0.5})
    assert np.array_equal(with_other, places)


def test_am_and_brush_go_on_over_a_jump():
    brush = "circle", {"radius": 5, "am_freq": 20, "stm_freq": 20}
    frames = [frame(0, (0, 0, 0), brush=brush), frame(60, (0, 0, 0), jumps=[jump("p", "gt", 0, 7)])]
    places, loud = played(pattern(frames, p=(1, 0, 1)), duration_s=0.2)
    time = np.arange(200) / 1e3
    assert places[:, 1] == pytest.approx(5 * np.sin(2 * np.pi * 20 * time), abs=1e-9)
    assert loud == pytest.approx(0.5 + 0.5 * np.cos(2 * np.pi * 20 * time), abs=1e-9)


def test_a_formula():
    """(2 + size) * 3 / -(1 - 4) = 2 + size."""
    terms = ("divide", ("multiply", ("add", 2, "size"), 3), ("negate", ("subtract", 1, 4)))
    brush = "circle", {"radius": terms, "am_freq": 0}
    places, _ = played(pattern([frame(0, (0, 0, 0), brush=brush), END], size=(5, 0, 9)))
    assert places[0, 0] == pytest.approx(7) and places[5, 0] == pytest.approx(-7)
    places, _ = played(pattern([frame(0, (0, 0, 0), brush=brush), END], size=(5, 0, 9)), parameters={"size": 1.5})
    assert places[0, 0] == pytest.approx(3.5)


def test_the_transform_scales_then_turns_then_moves_and_leaves_the_brush():
    circle = "circle", {"radius": 1, "am_freq": 0}
    content = pattern(
        [frame(0, (10, 20, 5), intensity=0.5, brush=circle), END], scale=(2, 3, 4), rotation=90, translate=(1, 2, 100),
        factor="loud", loud=(0.4, 0, 1),
    )  # fmt: skip
    places, loud = played(content)
    assert places[0] == pytest.approx([1 - 60 + 1, 2 + 20, 120], abs=1e-9) and loud[0] == pytest.approx(0.2)


def test_the_speed_is_of_the_pattern_and_not_of_am():
    brush = "circle", {"radius": 0, "am_freq": 25}
    places, loud = played(
        pattern([frame(0, (0, 0, 0), brush=brush), frame(80, (80, 0, 0)), frame(80, kind="stop")], speed=2)
    )
    assert len(places) == 40 and places[:, 0] == pytest.approx(2.0 * np.arange(40))
    assert loud[20] == pytest.approx(0.0, abs=1e-12)


def test_before_the_first_keyframe_and_after_the_last():
    places, loud = played(pattern([frame(20, (8, 0, 0), intensity=0.3), frame(40, (8, 4, 0))]), duration_s=0.06)
    assert places[:20] == pytest.approx(np.tile([0.0, 0, 200], (20, 1))) and np.all(loud[:20] == 1.0)
    assert places[40:] == pytest.approx(np.tile([8.0, 4, 200], (20, 1))) and loud[20:] == pytest.approx([0.3] * 40)


def test_random_intensities_are_within_their_range_and_repeat():
    content = pattern([frame(0, (0, 0, 0), intensity=[0.2, 0.6]), END])
    _, loud = played(content, rate_Hz=20000.0)
    assert 0.2 <= loud.min() < 0.21 and 0.59 < loud.max() <= 0.6 and loud.mean() == pytest.approx(0.4, abs=0.01)
    assert np.array_equal(loud, played(content, rate_Hz=20000.0)[1])


@pytest.mark.parametrize(
    ("brush", "rate_Hz"),
    [(None, 1000), ({"radius": 5, "am_freq": 0}, 1000), ({"radius": 5, "am_freq": 150}, 2000),
     ({"radius": 0, "am_freq": 0, "stm_freq": 900}, 1000), ({"radius": 1, "am_freq": 0, "stm_freq": 900}, 10e3),
     ({"radius": 1, "am_freq": 0, "stm_freq": 9000}, 40e3)],
)  # fmt: skip
def test_the_usual_rate_has_ten_samples_a_period(brush, rate_Hz):
    content = pattern([frame(0, (0, 0, 0), brush=brush and ("circle", brush)), END])
    assert table_of_pattern(content, Sampling()).rate_Hz == rate_Hz


@pytest.mark.parametrize("revision", ["0.0.10-alpha.1", "0.1.0-alpha.2", "0.1.0-alpha.3"])
def test_revisions(tmp_path, revision):
    content = pattern([frame(0, (0, 0, 0), intensity="level"), END], revision=revision, level=(0.5, 0, 1))
    if revision != "0.1.0-alpha.3":
        content["keyframes"][0]["intensity"]["intensity"]["params"]["value"]["type"] = "dynamic"
    table = read_adaptics(written(tmp_path / "a.adaptics", content))
    assert table.intensities[0, 0] == 0.5 and table.quantity == "amplitude" and table.frame == "array"


def moment(content, known, place, at):
    """The engine's rules for one pattern time [ms], by search: position [mm] and intensity."""
    frames = sorted(content["keyframes"], key=lambda one: one["time"])
    before, after = [f for f in frames if f["time"] <= at], [f for f in frames if f["time"] > at]

    def value(term):
        return known[term["value"]] if term["type"] == "param" else term["value"]

    def mixed(old, new, start, end, transition):
        share = (at - start) / (end - start) if transition["name"] == "linear" else 0.0
        return np.asarray(old) * (1.0 - share) + np.asarray(new) * share

    if place == "intensity":
        olds, news = [f for f in before if "intensity" in f], [f for f in after if "intensity" in f]
        if not olds:
            return 1.0
        old = value(olds[-1]["intensity"]["intensity"]["params"]["value"])
        if not news:
            return old
        new = value(news[0]["intensity"]["intensity"]["params"]["value"])
        return mixed(old, new, olds[-1]["time"], news[0]["time"], olds[-1]["intensity"]["transition"])
    olds = [f for f in before if "coords" in f]
    if not olds:
        return np.zeros(3)
    old = list(olds[-1]["coords"]["coords"].values())
    if not after or after[0]["type"] != "standard":
        return np.array(old)
    return mixed(old, list(after[0]["coords"]["coords"].values()), before[-1]["time"], after[0]["time"],
                 olds[-1]["coords"]["transition"])  # fmt: skip


places_mm, shares, changes = st.integers(-50, 50), st.floats(0.0, 1.0), st.sampled_from([LINEAR, STEP])
keyframes = st.builds(
    lambda time, place, level, change: frame(time, place, intensity=level, transition=change),
    st.integers(0, 40),
    st.none() | st.tuples(places_mm, places_mm, places_mm),
    st.none() | shares | st.just("p"),
    changes,
)


@settings(max_examples=150, deadline=None)
@given(st.lists(keyframes, min_size=1, max_size=6, unique_by=lambda one: one["time"]), shares)
def test_keyframes_are_as_by_search(frames, level):
    content = pattern(frames, translate=(0, 0, 0), p=(level, 0, 1))
    content["keyframes"].append(frame(41, (1, 1, 1), intensity=0.5))
    places, loud = played(content, duration_s=0.05)
    for time in range(50):
        assert places[time] == pytest.approx(moment(content, {"p": level}, "coords", time), abs=1e-9)
        assert loud[time] == pytest.approx(moment(content, {"p": level}, "intensity", time), abs=1e-9)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 39), st.integers(0, 45), st.booleans()), max_size=5, unique_by=lambda j: j[0]))
def test_jumps_are_as_sample_by_sample(jumps):
    """With all times on samples the engine's rule is exact: the first jump between the last moment and this one."""
    frames = [frame(0, (0, 0, 0)), frame(40, (40, 0, 0))]
    frames += [frame(time, (time, 0, 0), jumps=[jump("p", "gt" if on else "lt", 0, to)]) for time, to, on in jumps]
    places, _ = played(pattern(frames, p=(1, 0, 1)), duration_s=0.15)
    last = at = 0.0
    for sample in range(150):
        at = at + (1.0 if sample else 0.0)
        taken = [to for time, to, on in sorted(jumps) if on and last < time <= at]
        at = float(taken[0]) if taken else at
        last = at
        assert places[sample, 0] == pytest.approx(min(at, 40.0), abs=1e-9)


trees = st.recursive(
    st.floats(-9, 9) | st.just("p"),
    lambda inner: (
        st.tuples(st.sampled_from(["add", "subtract", "multiply", "divide"]), inner, inner)
        | st.tuples(st.just("negate"), inner)
    ),
    max_leaves=12,
)


def by_python(term, p):
    if not isinstance(term, tuple):
        return p if term == "p" else term
    sides = [by_python(one, p) for one in term[1:]]
    if term[0] == "negate":
        return -sides[0]
    left, right = sides
    if term[0] == "divide":
        return left / right
    return {"add": left + right, "subtract": left - right, "multiply": left * right}[term[0]]


@settings(max_examples=200, deadline=None)
@given(trees, st.floats(-5, 5))
def test_formulas_are_as_in_python(term, p):
    content = pattern([STILL, END], translate=(("add", 0.0, term), 0, 200), p=(p, -5, 5))
    try:
        wanted = by_python(term, p)
    except (ZeroDivisionError, OverflowError):
        wanted = math.inf
    try:
        places, _ = played(content)
    except SceneError as error:
        told = str(error)
        assert ("no finite result" in told and not abs(wanted) < 1e300) or ("m away" in told and abs(wanted) > 9e3)
    else:
        assert places[0, 0] == pytest.approx(wanted, rel=1e-12, abs=1e-9)


def changed(path, value):
    content = pattern([frame(0, (0, 0, 0), intensity=1, brush=("circle", {"radius": 5, "am_freq": 0}),
                             jumps=[jump("p", "gt", 5, 0)]), END], p=(1, 0, 9))  # fmt: skip
    content = copy.deepcopy(content)
    *way, last = path.split("/")
    part = content
    for name in way:
        part = part[int(name) if isinstance(part, list) else name]
    if value is ...:
        del part[last]
    else:
        part[int(last) if isinstance(part, list) else last] = value
    return content


RADIUS = "keyframes/0/brush/brush/params/radius"


@pytest.mark.parametrize(
    ("path", "value", "told"),
    [
        ("$DATA_FORMAT", "Other", r'\$DATA_FORMAT: "Other"; allowed: MidAirHapticsAnimationFileFormat'),
        ("$REVISION", "0.2.0", r'\$REVISION: "0.2.0"; allowed: 0.1.0-alpha.3 \| 0.1.0-alpha.2 \| 0.0.10-alpha.1'),
        ("keyframes", [], r"keyframes: \[\]; allowed: one or more keyframes"),
        ("keyframes/0/time", -1, r"keyframes.0.time: -1; allowed: a finite number of at least 0"),
        ("keyframes/0/time", True, r"keyframes.0.time: true; allowed: a finite number"),
        ("keyframes/0/type", "wait", r'keyframes.0.type: "wait"; allowed: standard \| pause \| stop'),
        ("keyframes/0/coords", ..., r"keyframes.0.coords: missing; allowed: type, time, coords"),
        ("keyframes/0/coords/coords/x", "1", r'keyframes.0.coords.coords.x: "1"; allowed: a finite number'),
        ("keyframes/0/coords/transition/name", "cubic", r'transition.name: "cubic"; allowed: linear \| step'),
        ("keyframes/0/brush/brush/name", "square", r'brush.brush.name: "square"; allowed: circle \| line \| lissajous'),
        ("keyframes/0/brush/brush/params/stm_frq", number(1), r"params.stm_frq: unknown .did you mean 'stm_freq'"),
        (RADIUS, 5, r"radius: 5; allowed: an object with type, value"),
        (RADIUS, {"type": "sin", "value": 1}, r'radius.type: "sin"; allowed: f64 \| param .* add \| subtract'),
        (RADIUS, number(("add", 1, ("divide", 1, "q"))), r'value.value.1.value.1.value: "q"; allowed: p; or give'),
        (RADIUS, number(("divide", "p", ("subtract", "p", 1))), r"radius.value: divide of 1 and 0 has no finite"),
        (RADIUS, {"type": "formula", "value": {"type": "add", "value": [1]}}, r"value.value: \[1\]; allowed: a list"),
        ("keyframes/0/cjumps/0/jump_to", -3, r"cjumps.0.jump_to: -3; allowed: a finite number of at least 0"),
        ("keyframes/0/cjumps/0/condition/parameter", "q", r'condition.parameter: "q"; allowed: p; or give --set'),
        ("keyframes/0/cjumps/0/condition/operator/name", "eq", r'operator.name: "eq"; allowed: lt \| lt_eq \| gt'),
        ("keyframes/0/intensity/intensity/params/value", number(1.5), r"at 0 ms, intensity: 1.5; allowed: 0"),
        ("pattern_transform/playback_speed", number(0), r"pattern_transform.playback_speed: 0; allowed: above 0"),
        ("user_parameter_definitions/p/default", None, r"definitions.p.default: null; allowed: a finite"),
        ("extra", 1, r"extra: unknown; allowed: \$DATA_FORMAT, "),
    ],
)  # fmt: skip
def test_bad_files_are_refused_with_place_value_and_what_is_allowed(tmp_path, path, value, told):
    file = written(tmp_path / "bad.adaptics", changed(path, value))
    with pytest.raises(SceneError, match=f"bad.adaptics: .*{told}"):
        read_adaptics(file)


@pytest.mark.parametrize(
    ("sampling", "told"),
    [
        (Sampling(parameters={"q": 1.0}), "--set-parameter names 'q'; allowed: p"),
        (Sampling(parameters={"p": 9.5}), "--set-parameter p has value 9.5; allowed: finite, from 0 to 9"),
        (Sampling(parameters={"p": math.nan}), "--set-parameter p has value nan"),
        (Sampling(rate_Hz=50e3), "--rate has value 50000; allowed: above 0, at most 40000"),
        (Sampling(rate_Hz=math.nan), "--rate has value nan"),
        (Sampling(duration_s=-1.0), "--duration has value -1; allowed: seconds above 0"),
        (
            Sampling(parameters={"p": 7.0}),
            r"keyframes.1.cjumps: the jump from 50 to 20 ms repeats without end .*--duration",
        ),
        (Sampling(parameters={"p": 7.0}, duration_s=3000.0, rate_Hz=1e3), "samples .*; allowed: 1 to 1000000"),
        (
            Sampling(parameters={"p": 3.0}, duration_s=1.0, rate_Hz=1e3),
            "from 50 to 49.5 ms repeats without progress of time",
        ),
    ],
)
def test_what_cannot_be_sampled(sampling, told):
    jumps = [jump("p", "gt", 5, 20), jump("p", "gt", 2, 49.5)]
    with pytest.raises(SceneError, match=told):
        table_of_pattern(pattern([STILL, frame(50, jumps=jumps), END], p=(1, 0, 9)), sampling)


def test_a_pattern_of_one_moment_needs_a_duration():
    with pytest.raises(SceneError, match=r"the pattern has 0 samples .0 ms at 1000 Hz.; .* give another --duration"):
        table_of_pattern(pattern([STILL]), Sampling())
    assert table_of_pattern(pattern([STILL]), Sampling(duration_s=0.25)).length_s == 0.25


def test_parameters_need_no_definition():
    content = pattern([frame(0, (0, 0, 0), intensity="press"), END])
    with pytest.raises(
        SceneError, match=r'params.value.value: "press"; allowed: no parameter; or give --set-parameter'
    ):
        table_of_pattern(content, Sampling())
    with pytest.raises(SceneError, match="--set-parameter names 'a', but the pattern has no parameters; omit it"):
        table_of_pattern(pattern([STILL, END]), Sampling(parameters={"a": 1.0}))
    assert table_of_pattern(content, Sampling(parameters={"press": 0.5})).intensities[0, 0] == 0.5


junk = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 3) | st.floats() | st.sampled_from(["p", "f64", "linear", "x"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["type", "value", "name", "params", "time", "x"]), inner, max_size=3)
    ),
    max_leaves=6,
)


@settings(max_examples=300, deadline=None)
@given(st.data(), junk)
def test_any_other_content_is_refused_in_words(data, value):
    """One value anywhere in a file is replaced."""
    content = copy.deepcopy(changed(RADIUS, number(("add", "p", 1))))
    part = content
    while True:
        key = data.draw(st.sampled_from(sorted(part) if isinstance(part, dict) else range(len(part))))
        if not isinstance(part[key], dict | list) or not part[key] or data.draw(st.booleans()):
            break
        part = part[key]
    part[key] = value
    try:
        table_of_pattern(json.loads(json.dumps(content)), Sampling(duration_s=0.05))
    except PalmfieldError as error:
        assert "allowed" in str(error) or "no finite result" in str(error) or "silence" in str(error)
