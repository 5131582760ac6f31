#!/usr/bin/env python3
"""Check the USD scenes of all shipped scenes from the USD files alone, with sizes, times and pictures.

    .venv/bin/python scripts/verification/check_usd.py [SCENE ...] [--runs out/usd] [--pictures FOLDER]
        [--duration 0.02] [--accuracy 0.5] [--write docs/bench/usd.md] [--commit HASH]

Each scene (a name in mjcf/scenes; all of them by default) is run at a coarse accuracy for a short time, unless --runs
already contains its run. For each scene.usdc it prints the findings of USD's validators, and the errors of

- force: radiation pressure times area over the body's surface, posed by the skeleton of the file, against the force in
  every frame (palmfield:force, which was applied in MuJoCo), and its mean over the steps against total_force_mean_N of
  summary.json, both in percent of the force;
- codes: a time code over timeCodesPerSecond, against the time in the result;
- transducers: positions in the world, against the sites in MuJoCo and the layout;
- skin: each quantity against the result, relative to the bound in the file (at most 1);
- legend: its ends against those of each skin's palette.

Pictures are drawn by draw_usd.py. A table at the end is for a field of 5,041 vertices and 500 frames (a focus on a
circle of 30 mm, 70 turns per second, 16 x 16 transducers; ARP and displacement of a lossy half space under it).
"""

import argparse
import json
import resource
import sys
import time
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import xarray as xr
from draw_usd import draw, skinned_points
from pxr import Usd, UsdGeom

import palmfield
from palmfield.acoustics import layout, pressure
from palmfield.acoustics.focus import focus
from palmfield.outputs import open_result
from palmfield.outputs.motion import normal_component
from palmfield.outputs.schema import instances, tree
from palmfield.outputs.usd import Shown, validate_usd, write_usd
from palmfield.outputs.usd.bodies import identifiers
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import keep_rows, processor
from palmfield.types import Air

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "mjcf" / "scenes"
RECORDED = {
    "normal_displacement": ("displacement", True), "normal_velocity": ("velocity", True), "arp": ("arp", False),
    "pressure": ("pressure", False),
}  # fmt: skip
COLUMNS = (
    "scene", "frames", "vertices", "MB", "write [s]", "findings", "force, worst frame [%]", "force, mean [%]",
    "codes [s]", "transducers [m]", "skin", "legend",
)  # fmt: skip
HEAD = f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|"
QUIET = 1e-3
"""Frames with a force below this share of the maximum are not used for relative errors."""


class Row(NamedTuple):
    """Results for a scene; shares in percent, lengths in metres, times in seconds."""

    name: str
    bytes: int
    write_s: float
    frames: int
    vertices: int
    findings: list[str]
    force_percent: float
    mean_percent: float
    code_s: float
    transducer_m: float
    skin_share: float
    legend: bool
    left_out: str


def check(name: str, run: Path, picture: Path | None) -> Row:
    path = run / "scene.usdc"
    started = time.perf_counter()
    with open_result(run) as result:
        write_usd(result, path)
    write_s = time.perf_counter() - started
    findings = validate_usd(path)
    stage = Usd.Stage.Open(str(path))
    summary = json.loads((run / "summary.json").read_text())
    with open_result(run) as result:
        codes = np.arange(stage.GetStartTimeCode(), stage.GetEndTimeCode() + 0.5)
        force, mean = _forces(stage, result, codes, summary)
        row = Row(
            name, path.stat().st_size, write_s, len(codes),
            sum(int(skin.sizes["vertex"]) for skin in instances(result, "skin").values()), findings, force, mean,
            _codes(stage, result, codes), _transducers(stage, result, name), _skins(stage, result, codes),
            _legend(stage), str(stage.GetRootLayer().customLayerData["palmfield"]["left_out"]),
        )  # fmt: skip
    if picture is not None:
        loudest = float(codes[len(codes) // 2])
        seconds = loudest / stage.GetTimeCodesPerSecond()
        draw(stage, loudest, picture, f"{name}, {1e3 * seconds:.2f} ms, drawn from the USD file alone")
    return row


def _places(result: xr.DataTree) -> dict[str, str]:
    """Return the names of the prims of bodies, by a skin on each."""
    bodies: dict[str, str] = {}
    for name, group in instances(result, "body").items():
        bodies.setdefault(str(group.attrs.get("body", name)), name)
    return {prim: bodies[body] for body, prim in identifiers(bodies).items()}


def _forces(stage: Usd.Stage, result: xr.DataTree, codes: np.ndarray, summary: dict) -> tuple[float, float]:
    """Return the largest differences in a frame, and of the mean over the steps, in percent."""
    worst, worst_mean = 0.0, 0.0
    by_name = {skin["name"]: skin for skin in summary["skins"]}
    steps = result.coords["step_time"].values
    length = float(np.median(np.diff(steps)))
    for prim, skin in _places(result).items():
        body = stage.GetPrimAtPath(f"/Scene/Bodies/{prim}")
        mesh = UsdGeom.Mesh(body.GetChild("Surface"))
        arp = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("arp")
        corners = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)

        def total(code: float, mesh=mesh, arp=arp, corners=corners) -> np.ndarray:
            points = skinned_points(stage, code).get(str(mesh.GetPath()))
            points = np.array(mesh.GetPointsAttr().Get(), float) if points is None else points
            a, b, c = (points[corners[:, k]] for k in range(3))
            turn = np.array(UsdGeom.Xformable(mesh).ComputeLocalToWorldTransform(code))[:3, :3]
            area = 0.5 * np.cross(b - a, c - a) @ turn
            return -(np.array(arp.Get(code), float)[:, None] * area).sum(axis=0)

        exact = np.array([np.array(body.GetAttribute("palmfield:force").Get(code)) for code in codes])
        sizes = np.linalg.norm(exact, axis=1)
        for code, force, size in zip(codes, exact, sizes, strict=True):
            if size > QUIET * sizes.max():
                worst = max(worst, 100.0 * float(np.linalg.norm(total(code) - force)) / size)
        # Time codes in the middle of the steps
        middle = np.interp(steps + 0.5 * length, codes / stage.GetTimeCodesPerSecond(), codes)
        mean = np.mean([total(code) for code in np.round(middle)], axis=0)
        summed = np.array(by_name[skin]["total_force_mean_N"])
        if np.linalg.norm(summed) > 0.0:
            worst_mean = max(worst_mean, 100.0 * float(np.linalg.norm(mean - summed) / np.linalg.norm(summed)))
    return worst, worst_mean


def _codes(stage: Usd.Stage, result: xr.DataTree, codes: np.ndarray) -> float:
    stride = int(stage.GetRootLayer().customLayerData["palmfield"]["stride"])
    times = result.coords["time"].values[::stride]
    return float(np.abs(codes / stage.GetTimeCodesPerSecond() - times).max())


def _transducers(stage: Usd.Stage, result: xr.DataTree, name: str) -> float:
    """Return the distance from the sites in MuJoCo's model of the scene, at the start of the run [m]."""
    sim = palmfield.Simulation(SCENES / f"{name}.xml", accuracy=0.5)
    mujoco.mj_kinematics(sim.model, sim.data)
    binding, worst = sim.runtime.binding, 0.0
    arrays = instances(result, "array")
    for site, (array, prim) in zip(binding.array_sites, identifiers(arrays).items(), strict=True):
        instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath(f"/Scene/Arrays/{prim}/Transducers"))
        matrix = np.array(UsdGeom.Xformable(instancer).ComputeLocalToWorldTransform(stage.GetStartTimeCode()))
        places = np.array(instancer.GetPositionsAttr().Get(), float) @ matrix[:3, :3] + matrix[3, :3]
        turn = sim.data.site_xmat[site].reshape(3, 3)
        exact = arrays[array]["transducer_position"].values @ turn.T + sim.data.site_xpos[site]
        worst = max(worst, float(np.linalg.norm(places - exact, axis=1).max()))
    return worst


def _skins(stage: Usd.Stage, result: xr.DataTree, codes: np.ndarray) -> float:
    """Return the largest error of any quantity at any vertex in any frame, relative to the stated bound."""
    worst = 0.0
    stride = int(stage.GetRootLayer().customLayerData["palmfield"]["stride"])
    found = {prim.GetName(): prim for prim in stage.Traverse() if prim.GetParent().GetName() == "Skins"}
    for name, prim_name in identifiers(instances(result, "skin")).items():
        skin = instances(result, "skin")[name]
        api = UsdGeom.PrimvarsAPI(found[prim_name])
        order = np.array(api.GetPrimvar("vertex_number").Get())
        for quantity, (variable, along) in RECORDED.items():
            primvar = api.GetPrimvar(quantity)
            bound = primvar.GetAttr().GetCustomDataByKey("palmfield:error_bound")
            exact = (normal_component(skin, variable) if along else skin[variable]).values[::stride]
            read = np.array([primvar.Get(code) for code in codes])
            if bound > 0.0:
                worst = max(worst, float(np.abs(read - exact[:, order]).max()) / bound)
    return worst


def _legend(stage: Usd.Stage) -> bool:
    legend = stage.GetPrimAtPath("/Scene/Legend")
    ends = [legend.GetCustomDataByKey(f"palmfield:{end}") for end in ("low", "high")]
    return bool(legend) and all(
        [prim.GetAttribute("primvars:displayColor").GetCustomDataByKey(f"palmfield:{end}") for end in ("low", "high")]
        == ends
        for prim in stage.Traverse()
        if prim.GetParent().GetName() == "Skins"
    )


def large() -> xr.DataTree:
    """Return a focus on a circle over 71 x 71 points, 500 frames: ARP of a 16 x 16 array, and a half space."""
    side, turns_Hz, frames = 71, 70.0, 143
    axis = np.linspace(-0.035, 0.035, side)
    x, y = np.meshgrid(axis, axis)
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.2)])
    array, air, arp = layout("uhev1"), Air(), []
    for angle in 2.0 * np.pi * np.arange(frames) / frames:
        place = [0.015 * np.cos(angle), 0.015 * np.sin(angle), 0.2]
        field = pressure(points, array, focus(array, air, place), air, device="cpu")
        arp.append(np.abs(field.pressure) ** 2 / (1.204 * 343.2**2))
    load = np.zeros((frames, 2 * side + 1, 2 * side + 1))
    load[:, :side, :side] = np.reshape(arp, (frames, side, side))
    omega = 2.0 * np.pi * np.fft.fftfreq(frames, 1.0 / (turns_Hz * frames))[:, None, None]
    wave = 2.0 * np.pi * np.fft.fftfreq(2 * side + 1, axis[1] - axis[0])
    k = np.hypot(wave[:, None], wave[None, :])[None] + 100.0
    answer = 1.0 / (2e4 * (1.0 - 0.3j * np.sign(omega)) * k - 1e3 * omega**2 / k)
    push = -np.real(np.fft.ifftn(np.fft.fftn(load) * answer))[:, :side, :side].reshape(frames, -1)
    order = np.arange(500) % frames
    displacement = np.zeros((500, side * side, 3), np.float32)
    displacement[..., 2] = -push[order]
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = [[corner, corner + side, corner + 1], [corner + 1, corner + side, corner + side + 1]]
    return tree(
        {
            "/": {"time": np.arange(500) / (turns_Hz * frames)},
            "/skin/palm": {
                "rest_position": points, "rest_normal": np.tile([0.0, 0.0, -1.0], (side * side, 1)),
                "face": np.concatenate([np.stack(one, axis=1) for one in faces]).astype(np.int32),
                "displacement": displacement, "arp": np.asarray(arp, np.float32)[order],
            },
        }
    )  # fmt: skip


def large_rows(out: Path) -> list[str]:
    result, rows = large(), []
    both = ("arp", "normal_displacement")
    for colour, magnify in (("none", 0.0), ("arp", 0.0), ("normal_displacement", 0.0), ("normal_displacement", 500.0)):
        started = time.perf_counter()
        write_usd(result, out / "large.usdc", Shown(colour=colour, quantities=both, magnify=magnify))
        size, spent = (out / "large.usdc").stat().st_size, time.perf_counter() - started
        words = colour + (", and magnified points" if magnify else "")
        rows.append(f"| {words} | {size / 1e6:.2f} | {spent:.1f} |")
    (out / "large.usdc").unlink()
    return rows


def page(rows: list[Row], large: list[str], options: argparse.Namespace, command: str) -> str:
    lines = [
        f"| {r.name} | {r.frames} | {r.vertices} | {r.bytes / 1e6:.2f} | {r.write_s:.1f} | {len(r.findings)} | "
        f"{r.force_percent:.2f} | {r.mean_percent:.2f} | {r.code_s:.0e} | {r.transducer_m:.0e} | {r.skin_share:.3f} | "
        f"{'yes' if r.legend else 'NO'} |"
        for r in rows
    ]
    findings = [f"- {r.name}: {line}" for r in rows for line in r.findings] or ["Validators find nothing in any scene."]
    left: dict[str, list[str]] = {}
    for r in rows:
        if r.left_out:
            left.setdefault(r.left_out, []).append(r.name)
    kept = keep_rows(options.write, [*HEAD.splitlines(), *lines]) if options.write else "none"
    found = sum(len(r.findings) for r in rows)
    silent = ", ".join(r.name for r in rows if r.skin_share == 0.0)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    return f"""# USD scenes of all shipped scenes

For developers. Written by `{command}`, commit {options.commit or git_commit()}, {processor()}. Each scene
was run for {1e3 * options.duration:g} ms at accuracy {options.accuracy:g}. Its `scene.usdc` has all quantities,
and magnified points if they take 8 MB or less. The values are read from the files. {kept} has each scene.

| check of {len(rows)} scenes | largest value |
|---|---|
| findings of USD's validators and `palmfield.outputs.usd.validate_usd`, both variants | {found} |
| ARP times area compared with the force on the body, worst frame | {max(r.force_percent for r in rows):.2f} % |
| mean of ARP times area compared with `total_force_mean_N` | {max(r.mean_percent for r in rows):.2f} % |
| time code / timeCodesPerSecond compared with the time of the run | {max(r.code_s for r in rows):.0e} s |
| transducers compared with MuJoCo's sites | {max(r.transducer_m for r in rows):.0e} m |
| error of any quantity of the skin / stated bound | {max(r.skin_share for r in rows):.3f} |
| legends with other end values than the palettes | {sum(not r.legend for r in rows)} |
| file size | {max(r.bytes for r in rows) / 1e6:.2f} MB |
| time to write (shared machine) | {max(r.write_s for r in rows):.1f} s |

{chr(10).join(findings)}

Force and skin of silent scenes are not tested: {silent or "none"}. Quantities that a run does not have:

{chr(10).join(f"- {', '.join(names)}: {why}" for why, names in left.items()) or "none"}

## 5,041 vertices, 500 frames

The scene has ARP and normal displacement under a focus on a circle of 30 mm. Rounding changes ARP and displacement by
at most 1/255 of their ranges.

| colour | file size [MB] | time to write [s] |
|---|---|---|
{chr(10).join(large)}

The peak memory of the program is {peak:.0f} MiB. This includes the data of the runs and the libraries of USD.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", help="names in mjcf/scenes [default: all with skins]")
    parser.add_argument("--runs", type=Path, default=ROOT / "out" / "usd")
    parser.add_argument("--pictures", type=Path, default=None)
    parser.add_argument("--duration", type=float, default=0.02)
    parser.add_argument("--accuracy", type=float, default=0.5)
    parser.add_argument("--write", type=Path, default=None)
    parser.add_argument("--commit", default=None)
    options = parser.parse_args()
    names = options.scenes or sorted(p.stem for p in SCENES.glob("*.xml") if not p.stem.startswith("plain_"))
    rows = []
    for name in names:
        run = options.runs / name
        if not (run / "summary.json").exists():
            simulation = palmfield.Simulation(SCENES / f"{name}.xml", accuracy=options.accuracy)
            palmfield.run(simulation, run, duration_s=options.duration, plots=[], overwrite=True)
        picture = None if options.pictures is None else options.pictures / f"{name}.png"
        rows.append(check(name, run, picture))
        print(rows[-1]._replace(left_out=""), flush=True)
    options.runs.mkdir(parents=True, exist_ok=True)
    command = "python scripts/verification/check_usd.py " + " ".join(sys.argv[1:])
    text = page(rows, large_rows(options.runs), options, command.strip())
    if options.write is not None:
        options.write.write_text(text)
    print(text)
    if any(r.findings or r.force_percent > 1.0 or r.transducer_m > 1e-6 or r.skin_share > 1.0 for r in rows):
        sys.exit(1)


if __name__ == "__main__":
    main()
