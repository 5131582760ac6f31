"""What a scene says: its modules' keys with the sites and bodies that they name, as the setting of a rig."""

from typing import Any

import numpy as np

from palmfield.config import (
    ArrayConfig,
    Config,
    DriverConfig,
    MotionConfig,
    SkinConfig,
    StimulusConfig,
    known_keys,
    parse,
)
from palmfield.errors import SceneError
from palmfield.hand.collision_shapes import Obstacle
from palmfield.mujoco_host.mujoco_view import ModelView
from palmfield.types import Float, Int

DURATION = "palmfield_duration_s"
"""Custom numeric of a scene: how long `palmfield run` runs it [s]."""
REST_M, REST_RAD = 1e-4, 1e-3
"""So far a body may stand from the joint whose skin it carries: a tenth of a layer's element, and rounding."""


def _single(config: type[Config], model: ModelView) -> Any:
    found = [i for i, plugin, _ in model.instances() if plugin == config.plugin]
    if not found and config is DriverConfig:
        return DriverConfig.model_validate({})
    if len(found) != 1:
        raise SceneError(
            f"plugin 'palmfield.skin': the scene has {len(found)} of '{config.plugin}'; exactly one is needed"
        )
    return _keys(config, model, found[0])


def frame_site(stimulus: StimulusConfig, model: ModelView) -> int | None:
    if stimulus.frame == "array":
        return None
    return model.find("site", stimulus.frame, "plugin 'palmfield.stimulus': key 'frame'")


def array_site(config: ArrayConfig, model: ModelView) -> int:
    return model.find("site", config.site, "plugin 'palmfield.array': key 'site'")


def _boards(model: ModelView) -> tuple[Any, ...]:
    """The scene's arrays, in the reference pose; each has a site of its own, the first one's is the array frame."""
    from palmfield.emitter import Board
    from palmfield.engine.pose import placements

    found = [i for i, plugin, _ in model.instances() if plugin == ArrayConfig.plugin]
    if not found:
        raise SceneError("plugin 'palmfield.skin': the scene has no 'palmfield.array'; at least one is needed")
    configs: list[Any] = [_keys(ArrayConfig, model, i) for i in found]
    for config in configs[1:]:
        for key in ("temperature_C", "humidity_percent", "pressure_Pa", "compute", "precision"):
            if getattr(config, key) != getattr(configs[0], key):
                raise SceneError(
                    f"plugin 'palmfield.array': key '{key}' has value {getattr(config, key)} at site '{config.site}' "
                    f"and {getattr(configs[0], key)} at site '{configs[0].site}'; allowed: the same for all arrays"
                )
    poses = [model.reference_pose("site", array_site(config, model)) for config in configs]
    sites = [reference_sites(transducer_sites(config, model), model) for config in configs]
    return tuple(Board(*pair) for pair in zip(configs, placements(poses, sites), strict=True))


def transducer_sites(config: ArrayConfig, model: ModelView) -> Int:
    """Numbers of the sites that are an array's transducers, shape (n,); none for another layout than `sites`.

    A site that a key names serves another purpose, however its name begins.
    """
    if config.sites is None:
        return np.zeros(0, np.int32)
    keys = ["site", "frame", "patch_site"]
    named = {config.site} | {text for i, _, _ in model.instances() for text in model.values(i, keys).values()}
    names = [name for name in model.names("site") if name.startswith(config.sites) and name not in named]
    if not names:
        raise SceneError(
            f"plugin 'palmfield.array': key 'sites' has value '{config.sites}'; allowed: how names of sites begin that "
            f"no key names; the scene has: {', '.join(model.names('site'))}"
        )
    element = "plugin 'palmfield.array': key 'sites'"
    return np.array([model.find("site", name, element) for name in names], dtype=np.int32)


def reference_sites(numbers: Int, model: ModelView) -> tuple[Float, Float]:
    """World positions [m] and z axes of sites in the reference pose, shapes (n, 3)."""
    poses = [model.reference_pose("site", int(number)) for number in numbers]
    return (
        np.array([position for position, _ in poses]).reshape(-1, 3),
        np.array([turn[:, 2] for _, turn in poses]).reshape(-1, 3),
    )


def bones_of(skin: SkinConfig, model: ModelView) -> list[int]:
    """Numbers of the bodies that carry a hand's skin, in the order of its bones; none for shapes in one piece.

    Raises SceneError where one is missing, where key `body` is none of an articulated hand's palm and a rigged mesh's
    joints, and where the bodies of a rigged mesh don't stand in the reference pose as its joints do.
    """
    if skin.shape not in ("articulated", "rigged"):
        return []
    element = f"plugin 'palmfield.skin': key 'shape' has value '{skin.shape}'"
    prefix, bones = _bones(skin, element)
    numbers = [model.find("body", prefix + bone.name, element) for bone in bones]
    mend = "write its MJCF by `palmfield hand MESH --mjcf FILE.xml`"
    if skin.shape == "articulated":
        mend = f"name the preset of that hand by key 'hand' ('{skin.hand}' now)"
    frame = model.reference_pose("body", model.find("body", skin.body, element))
    for bone, number in zip(bones, numbers, strict=True):
        pose = model.reference_pose("body", number)
        check_rest(bone, frame, pose, f"{element}: body '{prefix}{bone.name}'", mend)
    return numbers


def _bones(skin: SkinConfig, element: str) -> tuple[str, list[Any]]:
    """How the names of the bodies begin, and the bones in the frame of key `body`."""
    from palmfield.hand.articulated import articulate
    from palmfield.hand.preset import load_preset
    from palmfield.hand.rigged import joint_of_body
    from palmfield.hand.skinning import bones_of_mesh, rigged_file

    if skin.shape == "rigged":
        assert skin.mesh and skin.mesh_unit
        mesh = rigged_file(skin.mesh, skin.mesh_unit)
        joint, prefix = joint_of_body(skin.body, mesh.joints)
        return prefix, bones_of_mesh(mesh, mesh.joints.rest[joint, :3, 3])
    if not skin.body.endswith("hand"):
        raise SceneError(f"{element}: key 'body' has value '{skin.body}'; allowed: the palm, [prefix]hand")
    return skin.body.removesuffix("hand"), articulate(load_preset(skin.hand)).bones


def check_rest(bone: Any, frame: tuple[Float, Float], pose: tuple[Float, Float], element: str, mend: str) -> None:
    """Raises SceneError, with what mends it, where a body isn't at its joint's place, parallel to the hand's axes."""
    from palmfield.engine.pose import relative

    at, turn = relative(frame, pose)
    away = float(np.linalg.norm(at - bone.origin))
    off = float(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)))
    if away > REST_M or off > REST_RAD:
        raise SceneError(
            f"{element} stands {1e3 * away:.3g} mm and {np.rad2deg(off):.3g} degrees off the mesh's joint; {mend}"
        )


def obstacles_of(skin: SkinConfig, model: ModelView, bones: list[int]) -> list[tuple[Obstacle, int]]:
    """Bodies named by key `obstacles` and those that hang on them, with their geoms, and their numbers.

    bones: as `bones_of` gives them
    Raises SceneError for unknown bodies, for the skin's own, and where none of them has a geom.
    """
    element = "plugin 'palmfield.skin': key 'obstacles'"
    named = {model.find("body", name, element) for name in skin.obstacles}
    own = {model.find("body", skin.body, element), *bones}
    found = []
    for number in range(model.raw.nbody):
        if not named & model.ancestors(number):
            continue
        if number in own:
            raise SceneError(
                f"{element} has value '{' '.join(skin.obstacles)}'; allowed: other bodies than the skin's own"
            )
        geoms = model.geoms(number, element)
        if geoms:
            found.append((Obstacle(geoms), number))
    if named and not found:
        raise SceneError(f"{element} has value '{' '.join(skin.obstacles)}', but none of these has a geom")
    return found


def rig_of(skin: SkinConfig, model: ModelView) -> Any:
    """The rig of the scene that this skin instance stands in."""
    from palmfield.emitter import Placement
    from palmfield.engine.pose import relative
    from palmfield.rig import rig
    from palmfield.setting import Setting

    boards = _boards(model)
    stimulus, driver = (_single(c, model) for c in (StimulusConfig, DriverConfig))
    array = model.reference_pose("site", array_site(boards[0].config, model))
    body = model.reference_pose("body", model.find("body", skin.body, "plugin 'palmfield.skin': key 'body'"))
    bones = bones_of(skin, model)

    def placed(seen_from: tuple[Float, Float], pose: tuple[Float, Float]) -> Placement:
        shift, turn = relative(seen_from, pose)
        return Placement(tuple(shift.tolist()), tuple(turn.ravel().tolist()))

    def on_body(site: str, element: str) -> tuple[float, float, float]:
        pose = model.reference_pose("site", model.find("site", site, element))
        x, y, z = relative(body, pose)[0].tolist()
        return x, y, z

    frame = frame_site(stimulus, model)
    patch = "plugin 'palmfield.skin': key 'patch_site'"
    path = "plugin 'palmfield.stimulus': key 'path_sites'"
    setting = Setting(
        boards,
        stimulus,
        skin,
        driver,
        model.timestep,
        placed(array, array if frame is None else model.reference_pose("site", frame)),
        (0.0, 0.0, 0.0) if skin.patch_site is None else on_body(skin.patch_site, patch),
        placed(array, body),
        model.numeric(DURATION, 0.1),
        tuple(on_body(site, path) for site in stimulus.path_sites),
        tuple(
            (obstacle, placed(body, model.reference_pose("body", number)))
            for obstacle, number in obstacles_of(skin, model, bones)
        ),
        any(plugin == MotionConfig.plugin for _, plugin, _ in model.instances()),
        _aim_moves(stimulus, skin, boards[0].config, model),
    )
    return rig(setting)


def _aim_moves(stimulus: StimulusConfig, skin: SkinConfig, array: ArrayConfig, model: ModelView) -> bool:
    """Whether the stimulus's frame, or the skin that its path runs on, can move against the first array."""
    if stimulus.path_on == "skin":
        aimed = model.find("body", skin.body, "plugin 'palmfield.skin': key 'body'")
    else:
        frame = frame_site(stimulus, model)
        if frame is None:
            return False
        aimed = model.site_body(frame)
    board = model.site_body(array_site(array, model))
    # What carries both moves neither against the other.
    return any(model.can_move(body) for body in model.ancestors(aimed) ^ model.ancestors(board))


def _keys(config: type[Config], model: ModelView, instance: int) -> Any:
    name = next(n for i, _, n in model.instances() if i == instance)
    values = model.values(instance, known_keys(config))
    return parse(config, values, f"plugin '{config.plugin}' instance '{name}'")
