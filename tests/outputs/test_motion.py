import numpy as np
import pytest
import xarray as xr

from palmfield.outputs import motion
from palmfield.outputs.motion import at_vertices, extremes, normal_component, pieces
from palmfield.outputs.schema import instances, tree
from palmfield.outputs.store import Store, open_result

RANDOM = np.random.default_rng(4)
DISPLACEMENT = RANDOM.normal(size=(50, 7, 3)).astype(np.float32)
NORMALS = RANDOM.normal(size=(7, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1)[:, None]
STATIC = {"/skin/p": {"rest_normal": NORMALS}}
BLOCK = {"/": {"time": 1e-3 * np.arange(50.0)}, "/skin/p": {"displacement": DISPLACEMENT}}
EXACT = np.einsum("tvi,vi->tv", DISPLACEMENT.astype(np.float64), NORMALS)


@pytest.fixture(params=["memory", "file", "small pieces"])
def skin(request, tmp_path, monkeypatch):
    if request.param == "memory":
        yield instances(tree({"/": BLOCK["/"], "/skin/p": STATIC["/skin/p"] | BLOCK["/skin/p"]}), "skin")["p"]
        return
    if request.param == "small pieces":
        monkeypatch.setattr(motion, "PIECE_BYTES", 7 * 3 * 4 * 3)
    store = Store(tmp_path, STATIC)
    store.append(BLOCK)
    with open_result(store.finish({}, True)) as result:
        yield instances(result, "skin")["p"]


@pytest.mark.parametrize("times", [slice(None), slice(3, 40, 7), slice(12, 13), slice(0, 0)])
def test_the_normal_component_is_the_dot_product(skin, times):
    found = normal_component(skin, times=times)
    np.testing.assert_allclose(found.values, EXACT[times], atol=1e-6)
    assert found.dims == ("time", "vertex") and found.dtype == np.float32
    np.testing.assert_array_equal(found["time"], BLOCK["/"]["time"][times])
    assert found.attrs["units"] == "m" and "push is negative" in found.attrs["sign"]


def test_pieces_are_the_whole(skin):
    parts = list(pieces(skin, "displacement", slice(1, None, 2)))
    np.testing.assert_array_equal(np.concatenate([values for _, values in parts]), DISPLACEMENT[1::2])
    assert [place.start for place, _ in parts] == [0, *(place.stop for place, _ in parts)][:-1]


def test_extremes_over_time(skin):
    found = extremes(skin)
    np.testing.assert_allclose(found.peak, np.abs(EXACT).max(axis=0), atol=1e-6)
    np.testing.assert_array_equal(found.when, np.abs(EXACT).argmax(axis=0))
    np.testing.assert_allclose(found.mean, EXACT.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(found.mean_square, (EXACT**2).mean(axis=0), rtol=1e-5)


def test_a_few_vertices_over_time(skin):
    np.testing.assert_allclose(at_vertices(skin, [5, 2]), EXACT[:, [5, 2]], atol=1e-6)


def test_it_is_what_xarray_says(skin):
    expected = xr.dot(skin["displacement"], skin["rest_normal"], dim="xyz")
    xr.testing.assert_allclose(normal_component(skin).drop_attrs(), expected.astype(np.float32), atol=1e-6)
