"""Validate a USD file with the validators of USD and additional checks."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdValidation

from palmfield.errors import OutputError


def validate_usd(path: Path) -> list[str]:
    """Return errors of a USD file: from the validators of USD and additional checks; [] if valid.

    Every mesh must have a valid topology, with all indices in range. Every primvar of meshes, points and instancers
    must have, at each time sample, the number of values that its interpolation requires, and indices within its values.
    Each variant is checked. Raises OutputError if the file cannot be opened.
    """
    try:
        stage = Usd.Stage.Open(str(path))
    except Exception as error:
        raise OutputError(f"{path} cannot be opened as USD: {str(error).splitlines()[0]}; write it again") from error
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    problems = []
    for choose in _variants(stage):
        choose()
        problems += [e.GetErrorAsString() for e in UsdValidation.ValidationContext(validators).Validate(stage)]
        for prim in stage.TraverseAll():
            if prim.IsA(UsdGeom.Mesh):
                problems += _mesh_errors(UsdGeom.Mesh(prim))
            elif prim.IsA(UsdGeom.PointInstancer):
                problems += _primvar_errors(
                    prim, _vertex_lengths(len(UsdGeom.PointInstancer(prim).GetPositionsAttr().Get()))
                )
    return list(dict.fromkeys(problems))


def _variants(stage: Usd.Stage) -> list[Callable[[], None]]:
    """Return functions that select the first variant of all sets, the second, and so on. The file does not change."""
    sets = [
        (prim.GetPath(), name, prim.GetVariantSets().GetVariantSet(name).GetVariantNames())
        for prim in stage.TraverseAll()
        for name in prim.GetVariantSets().GetNames()
    ]

    def choose(number: int) -> None:
        stage.SetEditTarget(stage.GetSessionLayer())
        for path, name, variants in sets:
            stage.GetPrimAtPath(path).GetVariantSets().GetVariantSet(name).SetVariantSelection(
                variants[number % len(variants)]
            )

    return [partial(choose, k) for k in range(max([1, *(len(variants) for _, _, variants in sets)]))]


def _vertex_lengths(points: int) -> dict[str, int]:
    return {"constant": 1, "uniform": 1, "varying": points, "vertex": points, "faceVarying": points}


def _mesh_errors(mesh: UsdGeom.Mesh) -> list[str]:
    where = mesh.GetPath()
    indices, counts = mesh.GetFaceVertexIndicesAttr().Get(), mesh.GetFaceVertexCountsAttr().Get()
    points = len(mesh.GetPointsAttr().Get())
    valid, reason = UsdGeom.Mesh.ValidateTopology(indices, counts, points)
    problems = [] if valid else [f"{where}: {reason}"]
    numbers = np.array(indices)
    if numbers.size and (numbers.min() < 0 or numbers.max() >= points):
        problems.append(f"{where}: face index {numbers.min()}..{numbers.max()} outside 0..{points - 1}")
    lengths = {"constant": 1, "uniform": len(counts), "varying": points, "vertex": points, "faceVarying": len(indices)}
    return problems + _primvar_errors(mesh.GetPrim(), lengths)


def _primvar_errors(prim: Usd.Prim, lengths: dict[str, int]) -> list[str]:
    problems = []
    for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithValues():
        name, length = primvar.GetPrimvarName(), lengths[primvar.GetInterpolation()] * primvar.GetElementSize()
        for code in _samples(primvar):
            value = primvar.Get(code)
            has = 1 if isinstance(value, Gf.Matrix4d) else len(value)
            if primvar.IsIndexed():
                numbers = np.array(primvar.GetIndices(code))
                if numbers.size and (numbers.min() < 0 or numbers.max() >= has):
                    problems.append(
                        f"{prim.GetPath()}: primvar {name} has index {numbers.min()}..{numbers.max()} at {code}, "
                        f"outside 0..{has - 1}"
                    )
                    break
                has = len(numbers)
            if has != length:
                problems.append(f"{prim.GetPath()}: primvar {name} has {has} values at {code}, not {length}")
                break
    return problems


def _samples(primvar: UsdGeom.Primvar) -> list[Usd.TimeCode | float]:
    times = {*primvar.GetTimeSamples()}
    if primvar.IsIndexed():
        times |= {*primvar.GetIndicesAttr().GetTimeSamples()}
    return sorted(times) or [Usd.TimeCode.Default()]
