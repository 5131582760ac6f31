"""Read a user's hand mesh from a file, and repair or refuse it before any computation."""

import io
import pickle
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy import sparse

from palmfield.errors import SceneError, reason_of
from palmfield.files import read_bytes, regular
from palmfield.hand.chirality import fingertips, way_from_wrist
from palmfield.hand.holes import plane_axes
from palmfield.hand.joint_tree import joined
from palmfield.hand.repair import Finding, Repair, repair
from palmfield.hand.rigged import Joints, RiggedMesh, SkinRig, scaled, strongest
from palmfield.hand.split_edges import split_long_edges
from palmfield.hand.triangles import edge_lengths, vertex_normals
from palmfield.hand.units import DIGITS, Unit, choose_unit
from palmfield.types import Float, Int, Surface

PLAIN, GLTF, MANO = (".obj", ".ply", ".stl"), (".glb", ".gltf"), (".pkl",)
SUFFIXES = PLAIN + GLTF + MANO
MOST_FACES, ENOUGH_FACES = 1_000_000, 50_000
# Order of the 16 joints: Romero et al. 2017, "Embodied Hands".
JOINT_NAMES = (
    "wrist",
    *(f"{digit}_{i}" for digit in ("index", "middle", "little", "ring", "thumb") for i in (1, 2, 3)),
)
NEEDED = ("v_template", "f", "weights", "kintree_table")


@dataclass(frozen=True)
class Examined:
    """A mesh after repair, in metres; it may be used if no finding is refused.

    vertices: shape (n, 3); faces: shape (m, 3); unit: unit of the file; findings: findings with places in metres;
    rig: weights at these vertices and joints in metres, or None; file_vertices, file_faces: counts in the file
    """

    vertices: Float
    faces: Int
    unit: Unit
    findings: list[Finding]
    rig: SkinRig | None
    file_vertices: int
    file_faces: int


def load_mesh(path: str | Path, unit: str) -> Surface:
    """Read a closed surface from an OBJ, PLY, STL, glTF, GLB or MANO .pkl file, in metres, with outward normals.

    unit: unit of the file, "m", "dm", "cm", "mm" or "in"; "auto" is metres for glTF and MANO, and otherwise the only
    unit in which a mesh with five fingertips has the size of a hand or forearm
    Faults are repaired as in `palmfield.hand.repair.repair`.

    Raises SceneError for an unknown unit or format; for a file that is missing, unreadable or empty; and for a mesh
    that cannot be repaired: without size, not finite, with holes, with several bodies, or not 20 to 600 mm long.
    """
    return _surface(_accepted(path, unit))


def load_rigged(path: str | Path, unit: str = "auto", longest_edge_m: float | None = None) -> RiggedMesh:
    """Read a closed surface with joints and weights from a glTF, GLB or MANO .pkl file; otherwise like `load_mesh`.

    Edges longer than longest_edge_m [m] are halved, and weights are interpolated.
    Raises SceneError like `load_mesh`, and for a file without joints.
    """
    examined = _accepted(path, unit, longest_edge_m)
    if examined.rig is None:
        raise SceneError(f"mesh {path} has no joints and weights; give a glTF, GLB or MANO file with a skin")
    weights, indices = strongest(examined.rig.weights)
    return RiggedMesh(_surface(examined), examined.rig.joints, weights, indices)


def examine(path: str | Path, unit: str = "auto", longest_edge_m: float | None = None) -> Examined:
    """Read and repair a mesh, and report the findings; edges longer than longest_edge_m [m] are halved.

    Raises SceneError if there is no usable mesh: unknown unit or format, a missing, unreadable or empty file, more than
    MOST_FACES faces, or a size outside that of hands.
    """
    file = Path(path)
    vertices, faces, by_format, rig = _read(file)
    finite = vertices[np.isfinite(vertices).all(axis=1)]
    extent = float(np.ptp(finite, axis=0).max()) if len(finite) else 0.0
    if extent == 0.0:
        raise SceneError(f"mesh {file}: all {len(vertices)} vertices lie in one point; export it again")
    repaired = repair(vertices, faces)
    # After dropping parts, because a separate fragment would change the length of the hand
    used = repaired.vertices[np.unique(repaired.faces)] if len(repaired.faces) else finite
    length, breadth, _ = np.ptp(used @ plane_axes(used).T, axis=0)
    tips = DIGITS
    if unit == "auto" and by_format is None:
        tips = len(fingertips(repaired.vertices, repaired.faces)) if len(repaired.faces) else 0
    scale = choose_unit(unit, by_format, float(length), float(breadth), f"mesh {file}", tips)
    if rig is not None:
        rig = SkinRig(rig.joints, repaired.carry @ rig.weights)
        if not repaired.refused:
            rig = _in_a_tree(rig, repaired)
    points, corners = repaired.vertices * scale.metres, repaired.faces
    findings = [Finding(f.name, f.count, f.outcome, f.places * scale.metres, f.text) for f in repaired.findings]
    if longest_edge_m is not None and not repaired.refused:
        long = edge_lengths(points, corners)[1] > longest_edge_m
        if long.any():
            finer, corners = split_long_edges(points, corners, longest_edge_m)
            text = f"edges longer than {longest_edge_m * 1e3:.2g} mm were halved until all were shorter"
            findings.append(Finding("long edges", int(long.sum()), "repaired", np.zeros((0, 3)), text))
            points = finer @ points
            rig = None if rig is None else SkinRig(rig.joints, finer @ rig.weights)
    if rig is not None:
        rig = SkinRig(scaled(rig.joints, scale.metres), rig.weights)
    return Examined(points, corners, scale, findings, rig, len(vertices), len(faces))


def _in_a_tree(rig: SkinRig, repaired: Repair) -> SkinRig:
    """Return the rig with its joints in a tree; a change is added to the findings."""
    rig, moved, how = joined(rig, repaired.vertices, way_from_wrist(repaired.vertices, repaired.faces))
    places, children = (
        rig.joints.rest[moved, :3, 3],
        f"{len(moved)} joints had no hierarchy; the parent of each was set to",
    )
    if how == "names":
        repaired.note("sibling joints", len(moved), "repaired", places, f"{children} the previous joint by name")
    elif how == "skin":
        text = "the joint with which it shares most skin (its name gives no order); check the bodies in the MJCF"
        repaired.note("sibling joints", len(moved), "noted", places, f"{children} {text}")
    return rig


def refusal(path: str | Path, findings: list[Finding]) -> str:
    """Return one line on the first refused finding, with up to three places."""
    worst = next(finding for finding in findings if finding.outcome == "refused")
    where = ", ".join(f"({p[0]:.1f}, {p[1]:.1f}, {p[2]:.1f})" for p in 1e3 * worst.places[:3])
    at = f", at {where}{' and elsewhere' if len(worst.places) > 3 else ''} mm" if where else ""
    return f"mesh {path}: {worst.count} x {worst.name}{at}: {worst.text}"


def _accepted(path: str | Path, unit: str, longest_edge_m: float | None = None) -> Examined:
    examined = examine(path, unit, longest_edge_m)
    if any(finding.outcome == "refused" for finding in examined.findings):
        raise SceneError(refusal(path, examined.findings))
    return examined


def _surface(examined: Examined) -> Surface:
    return Surface(examined.vertices, examined.faces, vertex_normals(examined.vertices, examined.faces))


def _read(file: Path) -> tuple[Float, Int, str | None, SkinRig | None]:
    """Read vertices, faces, the unit that the format defines, and the rig."""
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise SceneError(
            f"mesh {file}: format {file.suffix or '(none)'!r} is not supported; export it as {', '.join(SUFFIXES)}"
        )
    try:
        regular(file)
    except FileNotFoundError:
        raise SceneError(f"mesh {file} does not exist; give the path of a {', '.join(SUFFIXES)} file") from None
    except OSError as error:
        raise SceneError(f"mesh {file}: {error.strerror}; give the path of a {', '.join(SUFFIXES)} file") from None
    _check_count(file, announced_faces(file))
    rig: SkinRig | None = None
    if suffix in GLTF:
        from palmfield.hand.gltf import read_gltf

        vertices, faces, rig = read_gltf(file, partial(_check_count, file))
    elif suffix in MANO:
        vertices, faces, rig = read_mano(file)
    else:
        vertices, faces = _read_plain(file)
    if len(vertices) == 0 or len(faces) == 0:
        raise SceneError(
            f"mesh {file} is empty ({len(vertices)} vertices, {len(faces)} faces); export it with its faces"
        )
    _check_count(file, len(faces))
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise SceneError(f"mesh {file}: a face names vertex {faces.max()} of {len(vertices)}; export it again")
    return vertices, faces, None if suffix in PLAIN else "m", rig


def _check_count(file: Path, count: int) -> None:
    if count > MOST_FACES:
        raise SceneError(
            f"mesh {file} has {count} faces; allowed: at most {MOST_FACES}; {ENOUGH_FACES} with edges of about 1.5 "
            "mm are enough: make it coarser in the modelling program (in Blender the modifier Decimate, in "
            "MeshLab Quadric Edge Collapse Decimation)"
        )


def announced_faces(file: Path) -> int:
    """Return the declared or estimated number of faces of a file without reading them; 0 if only the reader counts."""
    suffix, size = file.suffix.lower(), file.stat().st_size
    with file.open("rb") as stream:
        head = stream.read(4096)
        if suffix == ".ply":
            match = re.search(rb"element face (\d+)", head)
            return int(match[1]) if match else 0
        if suffix == ".stl" and len(head) >= 84:
            count = int.from_bytes(head[80:84], "little")
            if size == 84 + 50 * count:
                return count
        if suffix in (".stl", ".obj"):
            # One line per face; blocks end at any byte, so a few faces in a million may be missed
            mark = b"endfacet" if suffix == ".stl" else b"\nf "
            stream.seek(0)
            return sum(block.count(mark) for block in iter(partial(stream.read, 1 << 24), b""))
    return 0


def _read_plain(file: Path) -> tuple[Float, Int]:
    try:
        mesh = trimesh.load_mesh(io.BytesIO(read_bytes(file)), file_type=file.suffix[1:].lower(), process=False)
    # The parsers of trimesh raise many kinds of exceptions (ValueError, IndexError, struct.error, ...).
    except Exception as error:
        reason = reason_of(error, 120)
        if isinstance(error, ImportError):
            # trimesh guesses the encoding of other texts by a package that may be missing
            reason = f"it is not a {file.suffix[1:].upper()} file, or its text is not UTF-8"
        raise SceneError(f"mesh {file} cannot be read ({reason}); export it again") from error
    vertices = np.asarray(getattr(mesh, "vertices", np.zeros((0, 3))), dtype=np.float64)
    return vertices, np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), dtype=np.int32)


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
