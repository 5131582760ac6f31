"""ctypes copies of MuJoCo's C structs, built from the descriptions in the wheel of MuJoCo."""

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
from mujoco.introspect import ast_nodes
from mujoco.introspect.structs import STRUCTS

from palmfield.errors import PalmfieldError

_SCALARS: dict[str, Any] = {
    "mjtNum": ctypes.c_double,
    "mjtByte": ctypes.c_uint8,
    "mjtBool": ctypes.c_bool,
    "mjtSize": ctypes.c_int64,
    "int": ctypes.c_int,
    "float": ctypes.c_float,
    "double": ctypes.c_double,
    "char": ctypes.c_char,
    "size_t": ctypes.c_size_t,
    "uintptr_t": ctypes.c_size_t,
    "uint64_t": ctypes.c_uint64,
    "unsigned int": ctypes.c_uint,
}


def _ctype(node: Any) -> Any:
    if isinstance(node, ast_nodes.PointerType):
        inner = _SCALARS.get(getattr(node.inner_type, "name", ""))
        return ctypes.POINTER(inner) if inner else ctypes.c_void_p
    if isinstance(node, ast_nodes.ArrayType):
        kind = _ctype(node.inner_type)
        for extent in reversed(node.extents):
            kind = kind * extent
        return kind
    if isinstance(node, ast_nodes.AnonymousStructDecl):
        return _struct(node, "anonymous")
    if node.name in _SCALARS:
        return _SCALARS[node.name]
    if node.name in STRUCTS:
        return mirror(node.name)
    return ctypes.c_int  # the remaining value types are enums


def _struct(declaration: Any, name: str) -> type[ctypes.Structure]:
    fields = [(f.name, _ctype(f.type if hasattr(f, "type") else f)) for f in declaration.fields]
    return type(name, (ctypes.Structure,), {"_fields_": fields})


@cache
def mirror(name: str) -> Any:
    """Return the ctypes.Structure with the layout of MuJoCo's struct `name`, e.g. `mjModel`."""
    return _struct(STRUCTS[name], name)


class Plugin(ctypes.Structure):
    """mjpPlugin of mjplugin.h; every callback is a void pointer, which fits all prototypes."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("nattribute", ctypes.c_int),
        ("attributes", ctypes.POINTER(ctypes.c_char_p)),
        ("capabilityflags", ctypes.c_int),
        ("needstage", ctypes.c_int),
        *((name, ctypes.c_void_p) for name in (
            "nstate", "nsensordata", "init", "destroy", "copy", "reset", "compute", "advance", "visualize",
            "actuator_act_dot", "sdf_distance", "sdf_gradient", "sdf_staticdistance", "sdf_attribute", "sdf_aabb",
        )),
    )  # fmt: skip


@cache
def library() -> ctypes.CDLL:
    """Return the shared library that `import mujoco` has loaded.

    Raises PalmfieldError if it is not found or computes in single precision.
    """
    if mujoco.MJTNUM_DTYPE.__name__ != "float64":
        raise PalmfieldError("this MuJoCo computes in float32; palmfield needs the usual float64 build of mujoco")
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll"):
        for path in sorted(folder.glob(pattern)):
            lib = ctypes.CDLL(str(path))
            void, integer, text = ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p
            numbers = ctypes.POINTER(ctypes.c_double)
            lib.mjp_defaultPlugin.argtypes = [void]
            lib.mjp_registerPlugin.argtypes, lib.mjp_registerPlugin.restype = [void], integer
            lib.mjp_getPlugin.argtypes, lib.mjp_getPlugin.restype = [text, void], void
            lib.mj_getPluginConfig.argtypes, lib.mj_getPluginConfig.restype = [void, integer, text], text
            lib.mj_name2id.argtypes, lib.mj_name2id.restype = [void, integer, text], integer
            lib.mj_id2name.argtypes, lib.mj_id2name.restype = [void, integer, integer], text
            lib.mj_applyFT.argtypes = [void, void, numbers, numbers, numbers, integer, numbers]
            lib.mju_warning.argtypes = [text, text]
            return lib
    raise PalmfieldError(f"no libmujoco in {folder}; reinstall with pip install --force-reinstall mujoco mujoco-core")
