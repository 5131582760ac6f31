"""Maps of levels of a run against the summary's levels of one vertex, and against a motion of known multiples."""

import json

import numpy as np
import pytest
from unestimated import UNESTIMATED

import palmfield
from palmfield.errors import OutputError
from palmfield.outputs import open_result
from palmfield.outputs.levels import level_maps
from palmfield.outputs.motion import normal_component
from palmfield.perception.observers import OBSERVERS, threshold_m

pytestmark = pytest.mark.usefixtures("kept_operators")


@pytest.fixture(scope="module")
def run(module_scene, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    with UNESTIMATED:
        palmfield.run(module_scene(duration_s=0.03), out=out, plots=[])
    return out


def test_the_vertex_that_moves_most_has_the_summarys_level(run):
    summary = json.loads((run / "summary.json").read_text())["skins"][0]
    with open_result(run) as result:
        maps = level_maps(result)
        normal = np.asarray(normal_component(result["skin/skin"].to_dataset()))
    most = int(np.maximum(normal.max(axis=0), -normal.min(axis=0)).argmax())
    assert maps["level"].shape == (len(OBSERVERS), normal.shape[1])
    assert maps.attrs["frequencies_Hz"][0] == summary["main_frequency_Hz"]
    for name in ("bolanowski_1988", "afferent_human"):  # too little skin moves for that of a gripped handle
        told = summary[f"level_all_lines_{name}_dB_SL"]
        assert float(maps["level"].sel(observer=name)[most]) == pytest.approx(told, abs=1e-6)


@pytest.mark.parametrize("name", list(OBSERVERS))
def test_a_motion_of_known_multiples_of_the_threshold(run, name):
    """The run's motion is replaced by 1, 2 and 10 thresholds at 200 Hz along the normals, and by none elsewhere."""
    with open_result(run) as result:
        skin = result["skin/skin"].to_dataset().load()
        factors = np.zeros(skin.sizes["vertex"])
        factors[:3] = 1.0, 2.0, 10.0
        sine = np.sin(2 * np.pi * 200 * skin["time"].values)[:, None] * factors
        motion = float(threshold_m(OBSERVERS[name], 200.0)) * sine[:, :, None] * skin["rest_normal"].values
        result["skin/skin"]["displacement"] = skin["displacement"].copy(data=motion.astype(np.float32))
        levels = level_maps(result)["level"].sel(observer=name).values
    if OBSERVERS[name].least_area_m2 > 0.0:
        assert np.isnan(levels).all()  # three vertices are less skin than under a gripped handle
        return
    assert levels[:3] == pytest.approx([0.0, 6.0206, 20.0], abs=1e-2)
    assert np.all(levels[3:] < -80.0)


def test_an_unknown_skin_is_refused(run):
    with open_result(run) as result, pytest.raises(OutputError, match=r"skin 'skinn'.* is unknown; allowed: skin"):
        level_maps(result, "skinn")


@UNESTIMATED
def test_a_record_that_is_too_short_is_refused(module_scene, tmp_path):
    palmfield.run(module_scene(duration_s=0.004), out=tmp_path / "short", plots=[])
    with open_result(tmp_path / "short") as result, pytest.raises(OutputError, match="two periods of 200 Hz"):
        level_maps(result)
