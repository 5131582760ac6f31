"""Determine, before a sweep runs, the labels of its dimensions, its times, size and memory."""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from palmfield import cache
from palmfield.errors import SceneError
from palmfield.perception.registry import ALL_OBSERVERS
from palmfield.session.duration import step_count
from palmfield.session.preview import Preview, preview
from palmfield.session.simulation import check_duration
from palmfield.skin.costs import memory_bytes
from palmfield.studies.sweeps.design import Design
from palmfield.studies.sweeps.keys import SceneKeys
from palmfield.studies.sweeps.point import sensor_names
from palmfield.studies.sweeps.store import Labels
from palmfield.types import Float


@dataclass(frozen=True)
class Overview:
    """Properties of a sweep.

    name: name of the scene
    labels: see `palmfield.studies.sweeps.store.Labels`
    times: times of the time series [s], shape (t,)
    duration_s: duration of each point [s]
    device: device of the fields, "cpu" or "cuda:N"
    memory_bytes: estimated memory of a worker [bytes]
    point_bytes: memory of each further point that is a world of the same simulation [bytes]
    scene_digest: identifies the scene
    """

    name: str
    labels: Labels
    times: Float
    duration_s: float
    device: str
    memory_bytes: int
    point_bytes: int
    scene_digest: str


def overview(
    scene: Path,
    design: Design,
    keys: SceneKeys,
    *,
    device: str | None,
    accuracy: float | None,
    duration_s: float | None,
) -> Overview:
    """Examine the first and the last point of a sweep, without simulation.

    Raises the error of the first point if neither is valid, and SceneError for a duration that is not > 0.
    """
    if duration_s is not None:
        check_duration(duration_s)
    views: list[Preview] = []
    failure: SceneError | None = None
    for number in dict.fromkeys((0, design.count - 1)):
        try:
            views.append(preview(scene, device=device, accuracy=accuracy, keys=keys.of_point(design.point(number))))
        except SceneError as error:
            failure = failure or error
    if not views:
        assert failure is not None
        raise failure
    view = views[0]
    timestep_s = view.runtime.spec.timestep_s
    duration = view.duration_s if duration_s is None else duration_s
    steps = step_count(duration, timestep_s)
    substeps = max(view.runtime.model.substeps for view in views)
    times: Float = timestep_s / substeps * np.arange(1 + steps * substeps, dtype=np.float64)
    spec = view.runtime.spec
    labels = {
        "skin": np.array([skin.name for skin in spec.skins]),
        "sensor": np.array(sensor_names(view), dtype=str),
        "stimulus": np.array([stimulus.name for stimulus in spec.stimuli]),
        "observer": np.array(list(ALL_OBSERVERS)),
        "time": times,
        "step_time": timestep_s * np.arange(steps, dtype=np.float64),
    }
    memory = max(_memory_bytes(view, len(times)) for view in views)
    digest = _digest(scene, view, design, keys)
    point = max(_point_bytes(view, len(times)) for view in views)
    return Overview(view.name, labels, times, duration, spec.device, memory, point, digest)


def _memory_bytes(view: Preview, records: int) -> int:
    skins = view.runtime.model.skins
    layers = memory_bytes([(skin.layer.dofs, skin.choice.solver.factorises) for skin in skins])
    return layers + _point_bytes(view, records)


def _point_bytes(view: Preview, records: int) -> int:
    """Return the memory of the skin states, and of the recorded motion of all vertices in single precision."""
    layers = [skin.layer for skin in view.runtime.model.skins]
    return sum(8 * records * layer.mesh.surface_nodes + 8 * layer.state_room for layer in layers)


def _digest(scene: Path, view: Preview, design: Design, keys: SceneKeys) -> str:
    """Return a hash of the compiled scene and of the files that its plugins read."""
    model = view.data.model
    image = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, image)
    files = [scene.parent / name for name in keys.files(design)]
    # The folder is not included, so that scene and results may be moved together
    scene_bytes = image.tobytes().replace(str(scene.parent).encode(), b"")
    return cache.digest(scene_bytes, [path.read_bytes() for path in files if path.is_file()])
