"""Write reference arrays of the shipped scenes with the program as it was at commit f6cb3e2.

Usage: PYTHONPATH=<checkout of f6cb3e2> python make_scene_reference.py OUT {small|shipped} [SCENE ...]
"""

import json
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
from palmfield.engine.motion import place
from palmfield.skin.stepping import ReducedSkin

import palmfield
from palmfield.data import folder
from palmfield.engine.host import raise_errors

STARTS = {
    "approach_withdraw": 0.1,
    "hover_explore": 0.19,
    "tap_button": 0.13,
    "follow_fingertip": 0.1,
    "trace_shape": 0.15,
    "two_hands": 0.2,
    "grasp_object": 0.1,
}
SMALL = {"skin.accuracy": 0.5, "skin.max_frequency_Hz": 250.0, "skin.element_m": None}
EXTRA = {
    "hover_explore": {"skin.patch_radius_m": 0.012, "skin.accuracy": 0.4},
    "trace_shape": {"skin.patch_radius_m": 0.012, "skin.accuracy": 0.4},
}
SCENES = [
    "palm_am200",
    "palm_circle",
    "phantom_step",
    "phantom_am200",
    "phantom_stm70",
    "palm_step_sonicsurface",
    "palm_circle_sonicsurface",
    *STARTS,
    "stroke_palm",
]
STEPS, NODES = 30, 24


def make(name, size, out):
    """Step one scene and write its arrays. size: small or shipped"""
    keys = {} if size == "shipped" else {**SMALL, **EXTRA.get(name, {})}
    t0 = time.perf_counter()
    scene = palmfield.load(folder("mjcf") / "scenes" / f"{name}.xml", device="cpu", keys=keys)
    model, data, skin = scene.model, scene.data, scene.skin
    rig, chain = skin.rig, skin.chain
    start = STARTS.get(name, 0.0)
    if start:
        mujoco.mj_resetData(model, data)
        data.time = start
        place(data)
    mujoco.mj_forward(model, data)
    raise_errors(data)
    begin = chain.skin.begin
    surface = rig.mesh.surface_nodes
    nodes = np.linspace(0, surface - 1, NODES).round().astype(int)
    rows = {k: [] for k in ("time_s", "sensordata", "displacement_m", "velocity_m_s", "force_N", "qpos")}
    for _ in range(STEPS):
        mujoco.mj_step(model, data)
        raise_errors(data)
        motion = chain.skin.read(skin.world.state(skin.instance), chain.surface_operator)
        rows["time_s"].append(data.time)
        rows["sensordata"].append(data.sensordata.copy())
        rows["displacement_m"].append(motion[0][nodes])
        rows["velocity_m_s"].append(motion[1][nodes])
        rows["force_N"].append(skin.applied.copy())
        rows["qpos"].append(data.qpos.copy())
    ended = chain.skin.of(skin.world.state(skin.instance))
    step = rig.sizes[4]
    facts = dict(
        scene=name,
        keys=keys,
        start_s=start,
        steps=STEPS,
        commit="f6cb3e2",
        began="reduced" if isinstance(begin, ReducedSkin) else "wedges",
        ended="reduced" if isinstance(ended, ReducedSkin) else "wedges",
        vectors=begin.model.order if isinstance(begin, ReducedSkin) else None,
        step_s=step,
        unknowns=rig.system.ndof,
        mesh_nodes=len(rig.mesh.nodes),
        surface_nodes=int(surface),
        response=bool(rig.response.on),
    )
    emitted = chain.emitted(skin.world.state(skin.instance)) if rig.response.on else np.zeros(0, complex)
    np.savez_compressed(
        out / f"{name}.npz",
        nodes=nodes,
        rest_m=rig.mesh.nodes[nodes],
        emitted=emitted,
        facts=np.array(json.dumps(facts)),
        **{k: np.array(v) for k, v in rows.items()},
    )
    print(name, size, facts, f"{time.perf_counter() - t0:.1f} s", flush=True)


out = Path(sys.argv[1]) / sys.argv[2]
out.mkdir(parents=True, exist_ok=True)
for name in sys.argv[3:] or SCENES:
    make(name, sys.argv[2], out)
