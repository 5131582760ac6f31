"""Accelerations of the bones that carry a skin, from the scripts that move them."""

from collections.abc import Callable

import numpy as np

from palmfield.engine.host import World
from palmfield.engine.motion_plugin import MotionModule
from palmfield.errors import SceneError
from palmfield.simulation.scene_reader import SkinBodies
from palmfield.transforms import relative
from palmfield.types import Float

Accelerations = Callable[[float], Float]
"""Function from time [s] to the array `palmfield.motion.rates.FrameRates.numbers` of each bone, shape (bones, 12)."""


def bone_accelerations(world: World, skin: int) -> Accelerations | None:
    """Return the accelerations of the bones of a skin, or of its body if it has no bones.

    Returns None if key inertia is off, and for a body at rest. Raises SceneError for a body that no script sets
    directly, and for a script whose accelerations may jump.
    """
    spec, bound = world.scene.model.skins[skin].spec, world.scene.binding.skins[skin]
    if spec.config.inertia == "off":
        return None
    with spec.naming("inertia"):
        return _accelerations(world, bound)


def _accelerations(world: World, bound: SkinBodies) -> Accelerations | None:
    model, raw = world.model, world.model.raw
    moving = {part for part in {*model.ancestors(bound.body), *bound.bones} if model.can_move(part)}
    if not moving:
        return None
    body = f"body '{model.names('body')[bound.body]}'"
    for script in (module for module in world.modules.values() if isinstance(module, MotionModule)):
        joints = [] if script.root is None else [script.root, *script.joints]
        placed = {part for part in moving if int(raw.body_mocapid[part]) == script.mocap}
        if not moving <= (placed or {int(raw.jnt_bodyid[joint]) for joint in joints}) or not (placed or bound.bones):
            continue
        if not placed and script.settings.follow != "exact":
            raise SceneError(
                f"{body} follows {script.element} by springs and servos, whose acceleration is not scripted; set "
                "follow of that plugin to exact, or inertia to off"
            )
        if (rates := script.motion.rates) is None:
            raise SceneError(
                f"the acceleration of {script.element} may jump; allowed: keyframes with interpolation smooth, or a "
                "function with attribute `rates`; or set inertia to off"
            )
        if not placed:
            hand = script.motion.hand
            assert hand is not None
            return lambda time_s: np.array([bone.numbers() for bone in rates(time_s).bones(hand)])
        offset = relative(*(model.reference_pose("body", part) for part in (*placed, bound.body)))
        return lambda time_s: rates(time_s).frame.fixed(offset).numbers()[None]
    raise SceneError(
        f"{body} has joints, or a mocap body, that no {MotionModule.name} sets; "
        "allowed: a body at rest or moved by a script; or set inertia to off"
    )
