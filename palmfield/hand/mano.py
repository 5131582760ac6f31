"""Read a MANO model file with an unpickler that cannot run code named in the file."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError, reason_of
from palmfield.hand.rigged import Joints, SkinRig
from palmfield.types import Float, Int

# Order of the 16 joints: Romero et al. 2017, "Embodied Hands".
JOINT_NAMES = (
    "wrist",
    *(f"{digit}_{i}" for digit in ("index", "middle", "little", "ring", "thumb") for i in (1, 2, 3)),
)
NEEDED = ("v_template", "f", "weights", "kintree_table")


class Record:
    """Stored data of an object of a foreign class, without its code."""


class SparseRecord(Record):
    """Stored data of a SciPy sparse matrix or array; row and coordinate forms have their own classes."""

    made = sparse.csc_array


class RowRecord(SparseRecord):
    """Stored data of a csr_matrix or csr_array."""

    made = sparse.csr_array


class PlacesRecord(SparseRecord):
    """Stored data of a coo_matrix or coo_array."""

    made = sparse.coo_array


def read_mano(file: Path) -> tuple[Float, Int, SkinRig]:
    """Read template vertices [m], shape (n, 3), faces and rig (16 joints) of a MANO .pkl file.

    Raises SceneError for another file, for a missing part, and for classes other than arrays of NumPy, Chumpy and SciPy
    (refused by name before they are loaded).
    """
    try:
        with file.open("rb") as stream:
            model = _Unpickler(stream, encoding="latin1").load()
    except SceneError:
        raise
    # A damaged pickle causes many kinds of exceptions in the unpickler and NumPy
    except Exception as error:
        reason = reason_of(error, 120)
        raise SceneError(f"mesh {file} cannot be read as a MANO pickle ({reason}); download it again") from error
    if not isinstance(model, dict):
        raise SceneError(f"mesh {file} holds a {type(model).__name__}, not the dictionary of a MANO model")
    lacking = [name for name in NEEDED if name not in model]
    if not lacking and "J" not in model and "J_regressor" not in model:
        lacking = ["J_regressor"]
    if lacking:
        raise SceneError(f"mesh {file} is not a MANO model: {', '.join(lacking)} missing; give MANO_RIGHT or MANO_LEFT")
    try:
        return _model(model)
    except Exception as error:  # a record may contain any data, or none
        reason = reason_of(error, 120)
        raise SceneError(f"mesh {file}: its arrays do not fit together ({reason}); download it again") from error


def _model(model: dict[str, Any]) -> tuple[Float, Int, SkinRig]:
    vertices = _array(model["v_template"]).astype(np.float64)
    faces = _array(model["f"]).astype(np.int32)
    weights = _array(model["weights"]).astype(np.float64)
    parents = _array(model["kintree_table"])[0].astype(np.int64)
    positions = _array(model["J"] if "J" in model else model["J_regressor"]).astype(np.float64)
    if "J" not in model:
        positions = positions @ vertices
    number = len(parents)
    if weights.shape != (len(vertices), number) or positions.shape != (number, 3) or vertices.shape[1] != 3:
        raise ValueError(f"vertices {vertices.shape}, weights {weights.shape}, joints {positions.shape}")
    if (weights < 0.0).any() or (weights.sum(axis=1) <= 0.0).any():
        raise ValueError("weights must be positive")
    rest = np.tile(np.eye(4), (number, 1, 1))
    rest[:, :3, 3] = positions
    # The parent of the root is -1, stored as an unsigned number
    parents[(parents < 0) | (parents >= number)] = -1
    names = JOINT_NAMES if number == len(JOINT_NAMES) else tuple(f"joint_{i}" for i in range(number))
    return vertices, faces, SkinRig(Joints(names, parents.astype(np.int32), rest), sparse.csr_array(weights))


def _array(value: Any) -> np.ndarray:
    """Return a plain array from an array, a sparse matrix or Chumpy data (array `x`, or selection `idxs` of `a`)."""
    if isinstance(value, SparseRecord):
        parts = vars(value)
        shape = parts.get("_shape", parts.get("shape"))
        if isinstance(value, PlacesRecord):
            places = parts["coords"] if "coords" in parts else (parts["row"], parts["col"])
            return value.made((parts["data"], places), shape=shape).toarray()
        matrix = value.made((parts["data"], parts["indices"], parts["indptr"]), shape=shape)
        matrix.check_format(full_check=True)  # without it, SciPy would write to any index
        return matrix.toarray()
    if isinstance(value, Record):
        parts = vars(value)
        if "x" in parts:
            return _array(parts["x"])
        if {"a", "idxs", "preferred_shape"} <= parts.keys():
            return _array(parts["a"]).ravel()[np.asarray(parts["idxs"])].reshape(parts["preferred_shape"])
        raise ValueError(f"a Chumpy object holds {', '.join(sorted(parts))}, not an array")
    return np.asarray(value)


def _reconstruct(kind: type, base: type, state: object) -> Record:
    if not (isinstance(kind, type) and issubclass(kind, Record)) or base is not object or state is not None:
        raise pickle.UnpicklingError("only Chumpy and SciPy objects may be rebuilt")
    return kind()


_MULTIARRAY = np.empty(0).__reduce__()[0]
_SCALAR = np.float64(0.0).__reduce__()[0]
_ALLOWED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("__builtin__", "object"): object,
    ("builtins", "object"): object,
    ("copy_reg", "_reconstructor"): _reconstruct,
    ("copyreg", "_reconstructor"): _reconstruct,
    ("_codecs", "encode"): lambda text, encoding: text.encode("latin1"),
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _MULTIARRAY for core in ("core", "_core")},
    **{(f"numpy.{core}.multiarray", "scalar"): _SCALAR for core in ("core", "_core")},
    **{
        (f"scipy.sparse.{private}{kind}", f"{kind}_{form}"): record
        for kind, record in {"csc": SparseRecord, "csr": RowRecord, "coo": PlacesRecord}.items()
        for private in ("", "_")
        for form in ("matrix", "array")
    },
}


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if module.split(".")[0] == "chumpy":
            return Record
        if (module, name) not in _ALLOWED:
            raise SceneError(
                f"MANO pickle names {module}.{name}, which could run code; no MANO file needs this, so the file is "
                "refused"
            )
        return _ALLOWED[module, name]
