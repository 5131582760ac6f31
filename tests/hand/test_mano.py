import os
import pickle
import pickletools
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
import trimesh

from palmfield.errors import SceneError
from palmfield.hand.meshfile import JOINT_NAMES, load_mesh, load_rigged
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface

PARENTS = [-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14]


@cache
def open_hand():
    """A hand that is cut off at the wrist, and 16 places for joints in it."""
    hand = hand_surface(load_preset("open_men_p50"), 0.004)
    vertices, faces = hand.surface.vertices, hand.surface.faces
    kept = faces[vertices[faces].mean(axis=1)[:, 1] > vertices[:, 1].min() + 0.025]
    used, local = np.unique(kept, return_inverse=True)
    vertices, marks = vertices[used], hand.landmarks
    joints = [marks["wrist"]]
    for digit in ("index", "middle", "little", "ring", "thumb"):
        tip, base = marks[f"{digit}_tip"], marks[f"{digit}_knuckle"]
        joints += [base + share * (tip - base) for share in (0.0, 0.4, 0.7)]
    return vertices, local.reshape(-1, 3), np.array(joints)


def model():
    vertices, faces, joints = open_hand()
    distance = np.linalg.norm(vertices[:, None] - joints, axis=2)
    weights = np.exp(-distance / 0.01)
    # Each joint is the mean of the vertices around it, as a regressor has it.
    near = np.argsort(distance, axis=0)[:12].T
    regressor = scipy.sparse.csc_matrix(
        (np.full(near.size, 1 / 12), (np.repeat(np.arange(16), 12), near.ravel())), shape=(16, len(vertices))
    )
    return {
        "v_template": vertices,
        "f": faces.astype(np.uint32),
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "J_regressor": regressor,
        "kintree_table": np.array([PARENTS, range(16)]).astype(np.uint32),
        "bs_style": "lbs",
    }


def written(path, content, protocol=2):
    path.write_bytes(pickle.dumps(content, protocol=protocol))
    return path


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_a_mano_file_gives_a_closed_rigged_hand(tmp_path, protocol):
    data = model()
    path = written(tmp_path / "MANO_RIGHT.pkl", data, protocol)
    hand = load_rigged(path)
    assert hand.joints.names == JOINT_NAMES
    assert hand.joints.parents.tolist() == PARENTS
    np.testing.assert_allclose(hand.joints.rest[:, :3, 3], data["J_regressor"] @ data["v_template"])
    closed = trimesh.Trimesh(hand.surface.vertices, hand.surface.faces, process=False)
    assert closed.is_watertight and closed.volume > 0.0
    number = len(data["v_template"])
    np.testing.assert_allclose(hand.surface.vertices[:number], data["v_template"])
    np.testing.assert_allclose(hand.weights.sum(axis=1), 1.0)
    strongest = np.argmax(data["weights"], axis=1)
    np.testing.assert_array_equal(hand.indices[:number, 0], strongest)
    # The stump follows the wrist's joint.
    assert (hand.indices[number:, 0] == 0).all()
    assert len(hand.surface.vertices) > number


@pytest.mark.parametrize("kind", [f"{kind}_{form}" for kind in ("csc", "csr", "coo") for form in ("matrix", "array")])
def test_a_regressor_is_read_in_each_of_scipys_forms(tmp_path, kind):
    data = model()
    joints = data["J_regressor"] @ data["v_template"]
    data["J_regressor"] = getattr(scipy.sparse, kind)(data["J_regressor"])
    read = load_rigged(written(tmp_path / "MANO_RIGHT.pkl", data)).joints
    np.testing.assert_allclose(read.rest[:, :3, 3], joints)


@pytest.mark.parametrize("kind", ["csc_matrix", "csr_array", "coo_matrix"])
@pytest.mark.parametrize("number", [-7, 1 << 30])
def test_indices_of_a_sparse_matrix_that_lead_out_of_it_are_refused(tmp_path, kind, number):
    data = model()
    data["J_regressor"] = getattr(scipy.sparse, kind)(data["J_regressor"])
    (data["J_regressor"].col if kind.startswith("coo") else data["J_regressor"].indices)[5] = number
    with pytest.raises(SceneError, match="do not fit together"):
        load_mesh(written(tmp_path / "MANO_RIGHT.pkl", data), "auto")


class Ch:
    """Pickles as chumpy.ch.Ch does: an object with an array x."""

    def __init__(self, **state):
        self.__dict__.update(state)


def test_chumpy_objects_are_read_as_arrays(tmp_path):
    data = model()
    plain = data["v_template"]
    data["v_template"] = Ch(x=plain)
    data["weights"] = Ch(
        a=Ch(x=data["weights"]), idxs=np.arange(data["weights"].size), preferred_shape=(len(plain), 16)
    )
    # Protocol 0 and 2 name the class in a line of its own.
    raw = pickle.dumps(data, protocol=2).replace(f"c{Ch.__module__}\nCh\n".encode(), b"cchumpy.ch\nCh\n")
    assert any(op.name == "GLOBAL" and arg == "chumpy.ch Ch" for op, arg, _ in pickletools.genops(raw))
    path = tmp_path / "MANO_LEFT.pkl"
    path.write_bytes(raw)
    np.testing.assert_allclose(load_mesh(path, "auto").vertices[: len(plain)], plain)


class Evil:
    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_a_malicious_pickle_is_refused_and_does_nothing(tmp_path, protocol):
    trace = tmp_path / "trace"
    for evil, name in (
        (Evil(os.system, f"touch {trace}"), "posix.system"),
        (Evil(eval, f"open({str(trace)!r}, 'w')"), "eval"),
        (Evil(np.fromfile, str(trace)), "fromfile"),
        (Evil(Path.touch, trace), "pathlib|getattr"),
    ):
        path = written(tmp_path / "evil.pkl", {"v_template": [evil]}, protocol)
        with pytest.raises(SceneError, match=f"{name}.*refused"):
            load_mesh(path, "auto")
        assert not trace.exists()
    # The files are dangerous: plain pickle runs them.
    pickle.loads(pickle.dumps(Evil(os.system, f"touch {trace}"), protocol=protocol))
    assert trace.exists()


def test_rebuilding_is_confined_to_stand_ins(tmp_path):
    path = tmp_path / "odd.pkl"
    path.write_bytes(b"ccopy_reg\n_reconstructor\n(cnumpy\nndarray\nc__builtin__\nobject\nNtR.")
    with pytest.raises(SceneError, match="only Chumpy and SciPy objects"):
        load_mesh(path, "auto")


def test_what_is_no_mano_model_is_named(tmp_path):
    path = tmp_path / "a.pkl"
    path.write_bytes(b"nonsense")
    with pytest.raises(SceneError, match="cannot be read as a MANO pickle"):
        load_mesh(path, "auto")
    with pytest.raises(SceneError, match="holds a list"):
        load_mesh(written(path, [1, 2]), "auto")
    data = model()
    del data["weights"]
    with pytest.raises(SceneError, match="not a MANO model: weights missing"):
        load_mesh(written(path, data), "auto")
    data = model()
    data["weights"] = data["weights"][:, :3]
    with pytest.raises(SceneError, match="do not fit together"):
        load_mesh(written(path, data), "auto")
    path.write_bytes(pickle.dumps(model(), protocol=2)[:5000])
    with pytest.raises(SceneError, match="cannot be read as a MANO pickle"):
        load_mesh(path, "auto")
