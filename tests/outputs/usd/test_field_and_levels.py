"""The sound field and levels above threshold in USD, against the field and the levels themselves."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from palmfield.acoustics import layout, pressure
from palmfield.config.array import ArrayConfig
from palmfield.config.stimulus import StimulusConfig
from palmfield.errors import OutputError
from palmfield.outputs.motion import normal_component
from palmfield.outputs.schema import instances, tree
from palmfield.outputs.usd import Shown, validate_usd, write_usd
from palmfield.outputs.usd.field import isosurface
from palmfield.perception.maps import level_map
from palmfield.perception.observers import OBSERVERS
from palmfield.types import Air

PALM = "/Scene/Bodies/hand/Skins/palm"
OF_ARRAYS = "transducer_position", "drive_amplitude", "drive_phase", "pose"


@pytest.fixture(scope="module")
def result(whole, keep):
    keys = {"modulation": "am", "am_quantity": "amplitude", "am_frequency_Hz": 200.0, "am_depth": 1.0}
    told = {
        "/body/palm": {"body": "hand"},
        "/array/below": {"config": ArrayConfig(layout="uhev1").model_dump_json()},
        "/stimulus/pulse": {"config": StimulusConfig(**keys).model_dump_json()},
    }
    kept = {path: dict(variables) for path, variables in keep(whole, ("palm",), ("below",), ("pulse",)).items()}
    # The transducers are those of the layout then, as of results of earlier versions
    kept["/array/below"] = {name: kept["/array/below"][name] for name in OF_ARRAYS}
    return tree(kept, told)


@pytest.fixture(scope="module")
def stage(result, tmp_path_factory):
    path = tmp_path_factory.mktemp("field") / "s.usdc"
    shown = Shown("level", field=("slice", "points", "isosurface"), field_times_s=(0.01, 0.02), magnify=0.0)
    write_usd(result, path, shown)
    assert validate_usd(path) == []
    return Usd.Stage.Open(str(path))


def _amplitude(points):
    """Of all transducers of the array at full drive and phase 0, as the synthetic run drives them [Pa]."""
    return np.abs(pressure(points, layout("uhev1"), np.ones(256, complex), Air(), device="cpu", warn=False).pressure)


def test_a_field_after_the_run_is_refused(result, tmp_path):
    with pytest.raises(OutputError, match="--field-time has value 9000 ms; allowed: 0 to"):
        write_usd(result, tmp_path / "s.usdc", Shown(field=("slice",), field_times_s=(9.0,)))


def test_the_slice_is_the_field(stage):
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Field/Slice"))
    points = np.array(mesh.GetPointsAttr().Get(), float)
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("pressure")
    chosen = slice(None, None, 50)
    bound = primvar.GetAttr().GetCustomDataByKey("palmfield:error_bound")
    np.testing.assert_allclose(np.array(primvar.Get(50))[chosen], _amplitude(points[chosen]), atol=1.01 * bound)
    assert np.ptp(points[:, 1]) < 1e-9 and points[:, 2].max() > 0.18


def test_points_are_where_it_is_loud(stage):
    points = UsdGeom.Points(stage.GetPrimAtPath("/Scene/Field/Points"))
    level = stage.GetPrimAtPath("/Scene/Field").GetCustomDataByKey("palmfield:level_Pa")
    places = np.array(points.GetPointsAttr().Get(50), float)
    assert len(places) and (_amplitude(places) > 0.999 * level).all()


def test_the_isosurface_has_the_level(stage):
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Field/Isosurface"))
    level = mesh.GetPrim().GetCustomDataByKey("palmfield:level_Pa")
    places = np.array(mesh.GetPointsAttr().Get(50), float)
    assert len(places)
    # Linear between grid points a sixth of a wavelength apart
    assert np.abs(_amplitude(places) / level - 1.0).max() < 0.1


def test_an_isosurface_of_a_ball():
    """Its volume is positive: triangles are counter-clockwise from outside, where values are lower."""
    axis = np.linspace(-1.0, 1.0, 41)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    points, faces = isosurface(1.0 - np.sqrt(x**2 + y**2 + z**2), 0.4)
    a, b, c = (points[faces[:, k]] * 0.05 for k in range(3))
    assert np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6 == pytest.approx(4 / 3 * np.pi * 0.6**3, rel=1e-2)
    assert isosurface(np.zeros((3, 3, 3)), 1.0)[1].shape == (0, 3)


def test_levels_are_those_of_each_window(stage, result):
    """Windows of two periods of 200 Hz: 50 records, the first from the run's beginning."""
    skin = instances(result, "skin")["palm"]
    primvar = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(PALM)).GetPrimvar("level")
    told = {
        key: primvar.GetAttr().GetCustomDataByKey(f"palmfield:{key}") for key in ("observer", "window_s", "floor_dB")
    }
    assert told["observer"] == "bolanowski_1988" and told["window_s"] == pytest.approx(0.01)
    order = np.array(UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(PALM)).GetPrimvar("vertex_number").Get())
    bound = primvar.GetAttr().GetCustomDataByKey("palmfield:error_bound")
    normal, times = normal_component(skin).values, skin["time"].values
    for code, part in ((20, slice(0, 50)), (130, slice(100, 150)), (499, slice(450, 500))):
        exact = level_map(OBSERVERS["bolanowski_1988"], times[part], normal[part], [200.0])[order]
        read = np.array(primvar.Get(code), float)
        np.testing.assert_allclose(read, np.maximum(exact, told["floor_dB"]), atol=bound)
    assert np.ptp(exact) > 10.0


def test_levels_colour_from_the_threshold_on(stage):
    legend = stage.GetPrimAtPath("/Scene/Legend")
    assert (
        legend.GetCustomDataByKey("palmfield:low") == 0.0
        and legend.GetCustomDataByKey("palmfield:shown_units") == "dB SL"
    )


@pytest.mark.parametrize(
    ("shown", "words"),
    [
        (Shown("arpp"), "colour has value 'arpp' .did you mean 'arp'"),
        (Shown(quantities=("speed",)), "quantities has value 'speed'"),
        (Shown(field=("volume",)), "field has value 'volume'; allowed: slice, points, isosurface"),
        (Shown(limits=(1.0, 0.0)), "limits have values 1, 0"),
        (Shown(magnify=-1.0), "magnify has value -1"),
        (Shown(frames=0), "frames has value 0"),
        (Shown(level_Pa=float("nan")), "level_Pa has value nan"),
        (Shown(start_s=0.05, end_s=0.04), "from 50 to 40 ms; allowed: rising times within 0 to 99.8 ms"),
        (Shown("level", observer="nobody"), "'level' is not available for any skin.*observer 'nobody'"),
    ],
)
def test_what_cannot_be_shown_is_named(result, tmp_path, shown, words):
    with pytest.raises(OutputError, match=words):
        write_usd(result, tmp_path / "s.usdc", shown)
    assert list(tmp_path.iterdir()) == []


def test_a_part_of_the_run_with_limits(result, tmp_path):
    write_usd(result, tmp_path / "s.usdc", Shown("arp", limits=(0.0, 5.0), start_s=0.02, end_s=0.03, magnify=500.0))
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (100, 150)
    prim = stage.GetPrimAtPath(PALM)
    assert prim.GetCustomDataByKey("palmfield:magnification") == 500.0
    colour, arp = UsdGeom.Gprim(prim).GetDisplayColorPrimvar(), UsdGeom.PrimvarsAPI(prim).GetPrimvar("arp")
    assert colour.GetAttr().GetCustomDataByKey("palmfield:high") == 5.0
    loud = np.array(arp.Get(112)) > 5.2
    assert loud.any() and (np.array(colour.GetIndices(112))[loud] == 255).all()
