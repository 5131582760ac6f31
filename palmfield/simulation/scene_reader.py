"""Read the spec of a scene from the compiled MuJoCo model. Only this file reads keys.

It also returns the numbers of the MuJoCo bodies and sites that belong to the parts of the spec, to read poses.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from palmfield.config import (
    AfferentsConfig,
    ArrayConfig,
    Config,
    DriverConfig,
    MotionConfig,
    SkinConfig,
    StimulusConfig,
)
from palmfield.config.base import naming_keys
from palmfield.config.skin import OF_SHAPES
from palmfield.data import find_file
from palmfield.device import resolve
from palmfield.errors import PalmfieldError, SceneError, did_you_mean, naming
from palmfield.hand.preset import load_preset
from palmfield.mujoco_host.mujoco_view import ModelView
from palmfield.simulation.spec import ArraySpec, ObstacleSpec, SceneSpec, SkinSpec, StimulusSpec, Triple
from palmfield.skin.materials.catalogue import preset
from palmfield.transforms import IDENTITY, Placement, Transform, relative

if TYPE_CHECKING:
    from palmfield.acoustics.calibration_file import Calibration
    from palmfield.acoustics.transducer_file import TransducerTable
    from palmfield.hand.collision_shapes import Obstacle
    from palmfield.stimulus.am_table import AmTable
    from palmfield.stimulus.focus_table import FocusTable

DURATION = "palmfield_duration_s"
"""Custom numeric of a scene: duration of `palmfield run` [s]."""
DEFAULT_DURATION_S = 0.1
MOST_STEPS = 1e9
"""Largest number of MuJoCo steps in a run."""
DEVICE = "palmfield_device"
"""Custom text of a scene: device on which fields are computed, auto, cpu or cuda:N."""
CUSTOM = {DURATION: "numeric", DEVICE: "text"}
"""Entries of <custom> in a scene that palmfield reads, each with its kind."""
NEAR_MISS = 0.85
"""Similarity of a name to an entry above which it counts as a misspelling. A name with the same prefix always does."""
REST_M, REST_RAD = 1e-4, 1e-3
"""Largest allowed distance and rotation of a body relative to its joint: a tenth of an element, plus rounding."""
SAME_AIR = ("temperature_C", "humidity_percent", "pressure_Pa", "precision")
"""Keys that must be equal for all arrays of a scene."""

T = TypeVar("T")
AnyConfig = TypeVar("AnyConfig", bound=Config)


@dataclass(frozen=True)
class SkinBodies:
    """MuJoCo numbers of the body of a skin, of its bones (none for a body in one piece) and of its obstacles."""

    instance: int
    body: int
    bones: tuple[int, ...]
    obstacles: tuple[int, ...]


@dataclass(frozen=True)
class SceneBinding:
    """MuJoCo numbers of the objects that a SceneSpec names, in the same order. array_instances: plugin instances

    array_instances, region_instances: plugin instances. array_sites: the frame of each array.
    transducer_sites: transducer sites of each array, empty except for layout `sites`. frame_sites: of each stimulus.
    """

    array_instances: tuple[int, ...]
    array_sites: tuple[int, ...]
    transducer_sites: tuple[tuple[int, ...], ...]
    frame_sites: tuple[int, ...]
    skins: tuple[SkinBodies, ...]
    region_instances: tuple[int, ...] = ()


def read_scene(model: ModelView) -> tuple[SceneSpec, SceneBinding]:
    """Read the spec of the scene and the MuJoCo numbers of its objects.

    Raises SceneError for any inconsistent key; the message has element, key, value and what is allowed.
    """
    _check_custom(model)
    arrays, stimuli, skins, drivers, regions = (
        [
            (i, name, with_files_found(model.keys(config, i), config.element(name)))
            for i, plugin, name in model.instances()
            if plugin == config.plugin
        ]
        for config in (ArrayConfig, StimulusConfig, SkinConfig, DriverConfig, AfferentsConfig)
    )
    if not skins:
        raise SceneError("the scene has no plugin 'palmfield.skin'; needed: at least one")
    if not arrays:
        raise SceneError("plugin 'palmfield.skin': the scene has no 'palmfield.array'; needed: at least one")
    if not stimuli:
        raise SceneError(
            f"plugin 'palmfield.skin' instance '{skins[0][1]}': the scene has no 'palmfield.stimulus' and would be "
            "silent; needed: at least one"
        )
    if len(drivers) > 1:
        raise SceneError(f"the scene has {len(drivers)} of 'palmfield.driver'; allowed: one")
    driver = drivers[0][2] if drivers else DriverConfig.model_validate({})
    array_specs, array_sites, transducers = _arrays(arrays, model)
    skin_specs, skin_bindings = _skins(skins, model, array_sites[0])
    stimulus_specs, frame_sites = _stimuli(stimuli, model, array_specs, array_sites, skin_specs, skin_bindings)
    _check_still(array_specs, skin_bindings, array_sites, model)
    made = []
    for _, name, config in regions:
        from palmfield.simulation.region_reader import region

        made.append(region(name, config, model, skin_specs, [(one.body, *one.bones) for one in skin_bindings]))
    spec = SceneSpec(
        arrays=array_specs,
        stimuli=stimulus_specs,
        skins=skin_specs,
        driver=driver,
        device=_device(model),
        timestep_s=_timestep(model),
        duration_s=_duration(model),
        regions=tuple(made),
    )
    binding = SceneBinding(
        array_instances=tuple(i for i, _, _ in arrays),
        array_sites=array_sites,
        transducer_sites=transducers,
        frame_sites=frame_sites,
        skins=skin_bindings,
        region_instances=tuple(i for i, _, _ in regions),
    )
    return spec, binding


def with_files_found(config: AnyConfig, element: str) -> AnyConfig:
    """Return the keys of a module. File names are replaced by absolute paths.

    Raises SceneError like `palmfield.data.find_file`, with element and key.
    """
    paths = {}
    for key in config.files:
        name = getattr(config, key)
        if name is None:
            continue
        with naming_keys(element, setting=key):
            paths[key] = str(find_file(name))
    return config.model_copy(update=paths) if paths else config


def first_array_frame(model: ModelView) -> Transform:
    """Return the world frame of the first array in the reference configuration; the world frame without an array."""
    for number, plugin, name in model.instances():
        if plugin == ArrayConfig.plugin:
            site = model.keys(ArrayConfig, number).site
            return model.reference_pose("site", model.find("site", site, f"{ArrayConfig.element(name)}: key 'site'"))
    return IDENTITY


# -- the parts of a scene ------------------------------------------------------------------------------------------


def _arrays(
    instances: list[tuple[int, str, Any]], model: ModelView
) -> tuple[tuple[ArraySpec, ...], tuple[int, ...], tuple[tuple[int, ...], ...]]:
    """Return specs, frame sites and transducer sites of the arrays. Each array has its own frame site."""
    first_name, first = instances[0][1:]
    for _, name, config in instances[1:]:
        for key in SAME_AIR:
            if getattr(config, key) != getattr(first, key):
                raise SceneError(
                    f"{ArrayConfig.element(name)}: key '{key}' has value {getattr(config, key)}, and "
                    f"{getattr(first, key)} at instance '{first_name}'; allowed: the same for all arrays"
                )
    sites = tuple(
        model.find("site", config.site, f"{ArrayConfig.element(name)}: key 'site'") for _, name, config in instances
    )
    transducers = tuple(transducer_sites(config, name, model) for _, name, config in instances)
    origin = model.reference_pose("site", sites[0])
    specs = []
    for (_, name, config), site, numbers in zip(instances, sites, transducers, strict=True):
        pose = model.reference_pose("site", site)
        own = []
        for number in numbers:
            transducer = relative(pose, model.reference_pose("site", number))
            own.append((tuple(transducer.position.tolist()), tuple(transducer.rotation[:, 2].tolist())))
        placement = Placement.of(relative(origin, pose), tuple(own))
        specs.append(ArraySpec(name, config, placement, *array_files(config, ArrayConfig.element(name))))
    return tuple(specs), sites, transducers


def array_files(config: ArrayConfig, element: str) -> "tuple[Calibration | None, TransducerTable | None]":
    """Return the contents of the files of keys calibration and transducers, None for a key that is not set.

    Raises SceneError like `read_file` and `check_calibrated_once`.
    """
    if config.calibration is None and config.transducers is None:
        return None, None
    from palmfield.acoustics.calibration_file import read_calibration
    from palmfield.acoustics.transducer_file import read_transducers

    calibration = read_file(read_calibration, config, "calibration", element)
    if calibration is not None:
        check_calibrated_once(calibration, config, element)
    return calibration, read_file(read_transducers, config, "transducers", element)


def read_file(read: Callable[[str], T], config: Config, key: str, element: str) -> T | None:
    """Return the content of the file of a key, None if the key is not set. Raises SceneError with element and key."""
    name = getattr(config, key)
    with naming_keys(element, setting=key):
        return None if name is None else read(name)


def check_calibrated_once(calibration: "Calibration", config: ArrayConfig, element: str) -> None:
    """Raise SceneError if a key and the calibration set the same quantity."""
    for key, calibrated in (("p0_Pa_m", calibration.p0), ("quality", calibration.quality)):
        if calibrated is not None and getattr(config, key) is not None:
            raise SceneError(
                f"{element}: key '{key}' has value {getattr(config, key):g}, but the file of key 'calibration' has "
                f"{calibrated.value:g}; remove one of them"
            )


def transducer_sites(config: ArrayConfig, name: str, model: ModelView) -> tuple[int, ...]:
    """Return the numbers of the sites of the transducers of an array; empty for layouts other than `sites`.

    A site that a key names is never a transducer, whatever the prefix of its name.
    """
    if config.sites is None:
        return ()
    keys = ["site", "frame", "patch_site"]
    used = {config.site} | {text for i, _, _ in model.instances() for text in model.values(i, keys).values()}
    names = [site for site in model.names("site") if site.startswith(config.sites) and site not in used]
    element = f"{ArrayConfig.element(name)}: key 'sites'"
    if not names:
        raise SceneError(
            f"{element} has value '{config.sites}'; allowed: the beginning of the names of sites that no key "
            f"names; the scene has: {', '.join(model.names('site'))}"
        )
    return tuple(model.find("site", site, element) for site in names)


def _skins(
    instances: list[tuple[int, str, Any]], model: ModelView, array_site: int
) -> tuple[tuple[SkinSpec, ...], tuple[SkinBodies, ...]]:
    origin = model.reference_pose("site", array_site)
    moves = any(plugin == MotionConfig.plugin for _, plugin, _ in model.instances())
    specs, bindings = [], []
    for instance, name, config in instances:
        element = SkinConfig.element(name)
        body = model.find("body", config.body, f"{element}: key 'body'")
        frame = model.reference_pose("body", body)
        _check_presets(config, element)
        bones = bones_of(config, element, model)
        obstacles = obstacles_of(config, element, model, bones)
        centre: Triple = (0.0, 0.0, 0.0)
        if config.patch_site is not None:
            centre = _on_body(model, frame, config.patch_site, f"{element}: key 'patch_site'")
        placed = tuple(
            ObstacleSpec(shape, Placement.of(relative(frame, model.reference_pose("body", number))))
            for shape, number in obstacles
        )
        specs.append(SkinSpec(name, config, Placement.of(relative(origin, frame)), centre, placed, moves))
        bindings.append(SkinBodies(instance, body, tuple(bones), tuple(number for _, number in obstacles)))
    return tuple(specs), tuple(bindings)


def _check_still(
    arrays: tuple[ArraySpec, ...], skins: tuple[SkinBodies, ...], sites: tuple[int, ...], model: ModelView
) -> None:
    """Raise SceneError for a rigid array face and a movable body, because echoes are computed for one distance only."""
    for array, site in zip(arrays, sites, strict=True):
        if array.config.array_face == "absorbing":
            continue
        scripted = any(plugin == MotionConfig.plugin for _, plugin, _ in model.instances())
        board = model.ancestors(model.site_body(site))
        apart = [body for skin in skins for body in model.ancestors(skin.body) ^ board]
        if scripted or any(map(model.can_move, apart)):
            from palmfield.simulation.array_face import refused

            raise refused(array, "the body can move relative to the array", "a body without joints, mocap and motion")


def _check_presets(config: SkinConfig, element: str) -> None:
    """Raise SceneError, with element and key, for an unknown material or hand."""
    with naming_keys(element, setting="materials" if config.materials else "material"):
        for name in config.materials or (config.material,):
            preset(name)
    if config.shape in OF_SHAPES["hand"]:
        with naming_keys(element, setting="hand"):
            load_preset(config.hand)


def _stimuli(
    instances: list[tuple[int, str, Any]],
    model: ModelView,
    arrays: tuple[ArraySpec, ...],
    array_sites: tuple[int, ...],
    skins: tuple[SkinSpec, ...],
    bindings: tuple[SkinBodies, ...],
) -> tuple[tuple[StimulusSpec, ...], tuple[int, ...]]:
    driven = _driven_arrays(instances, [array.name for array in arrays])
    origin = model.reference_pose("site", array_sites[0])
    specs, frames = [], []
    for (_, name, config), own in zip(instances, driven, strict=True):
        element = StimulusConfig.element(name)
        frame_site = array_sites[own[0]]
        if config.frame != "array":
            frame_site = model.find("site", config.frame, f"{element}: key 'frame'")
        on_skin = _path_skin(config, element, skins)
        sites: tuple[Triple, ...] = ()
        if on_skin is not None:
            frame = model.reference_pose("body", bindings[on_skin].body)
            sites = tuple(_on_body(model, frame, site, f"{element}: key 'path_sites'") for site in config.path_sites)
        aimed = bindings[on_skin].body if on_skin is not None else model.site_body(frame_site)
        boards = [model.site_body(array_sites[number]) for number in own]
        # Array and body on a common carrier do not move relative to each other.
        frame_moves = any(
            model.can_move(body) for board in boards for body in model.ancestors(aimed) ^ model.ancestors(board)
        )
        placement = Placement.of(relative(origin, model.reference_pose("site", frame_site)))
        table = am_table_of(config, element)
        foci = focus_table_of(config, element)
        specs.append(StimulusSpec(name, config, own, placement, on_skin, sites, frame_moves, table, foci))
        frames.append(frame_site)
    return tuple(specs), tuple(frames)


def am_table_of(config: StimulusConfig, element: str) -> "AmTable | None":
    """Return the waveform in the file of key am_file; None without a file.

    Raises SceneError, with element and key, for errors of `palmfield.stimulus.am_file.read_am_table`. Raises it also
    for a periodic waveform without a frequency, and for a waveform over time with a frequency.
    """
    if config.modulation != "am" or config.am_file is None:
        return None
    from palmfield.stimulus.am_file import read_am_table

    table = read_file(read_am_table, config, "am_file", element)
    if table is None or (table.of == "period") == (config.am_frequency_Hz is not None):
        return table
    if table.of == "period":
        raise SceneError(
            f"{element}: key 'am_file' has value '{config.am_file}', which contains one period (column turn); "
            "am_frequency_Hz is missing; give its repetition frequency"
        )
    raise SceneError(
        f"{element}: key 'am_frequency_Hz' has value '{config.am_frequency_Hz:g}', but '{config.am_file}' has "
        "times in seconds (column time_s); remove am_frequency_Hz, or give a period (column turn)"
    )


def focus_table_of(config: StimulusConfig, element: str) -> "FocusTable | None":
    """Return the foci in the file of key path_file; None without a file.

    Raises SceneError, with element and key, like `palmfield.stimulus.focus_table_file.read_focus_table`, and for a
    table in another frame than that of key `frame`.
    """
    if config.path != "file":
        return None
    from palmfield.stimulus.focus_table_file import read_focus_table

    table = read_file(read_focus_table, config, "path_file", element)
    if table is None or (table.frame != "world" and (table.frame == "array") == (config.frame == "array")):
        return table
    mend = {
        "array": "remove key 'frame'",
        "skin": "set key 'frame' to the site of the hand whose frame the table uses",
        "world": "use `palmfield stimulus import`, which converts it to the array frame",
    }[table.frame]
    raise SceneError(
        f"{element}: key 'path_file' has value '{config.path_file}' with frame {table.frame} in its head, but key "
        f"'frame' has value '{config.frame}'; {mend}"
    )


def _driven_arrays(instances: list[tuple[int, str, Any]], names: list[str]) -> list[tuple[int, ...]]:
    """Return the arrays that each stimulus drives: those it names, or all that no other stimulus names."""
    owner: dict[str, str] = {}
    for _, stimulus, config in instances:
        element = f"{StimulusConfig.element(stimulus)}: key 'arrays'"
        for array in config.arrays:
            if array not in names:
                raise SceneError(
                    f"{element} names '{array}'{did_you_mean(array, names)}; the scene's arrays are: {', '.join(names)}"
                )
            if array in owner:
                raise SceneError(
                    f"{element} names '{array}', which instance '{owner[array]}' already drives; allowed: one "
                    "stimulus per array"
                )
            owner[array] = stimulus
    free = tuple(i for i, name in enumerate(names) if name not in owner)
    rest = [stimulus for _, stimulus, config in instances if not config.arrays]
    if len(rest) > 1:
        raise SceneError(
            f"{StimulusConfig.element(rest[1])}: it names no arrays, and neither does instance '{rest[0]}'; "
            "set key 'arrays' of each stimulus"
        )
    if rest and not free:
        raise SceneError(
            f"{StimulusConfig.element(rest[0])}: every array is driven by another stimulus; name one by key "
            "'arrays', or remove this stimulus"
        )
    return [
        tuple(sorted(names.index(array) for array in config.arrays)) if config.arrays else free
        for _, _, config in instances
    ]


def _path_skin(config: StimulusConfig, element: str, skins: tuple[SkinSpec, ...]) -> int | None:
    """Return the number of the skin on which a path runs."""
    names = [skin.name for skin in skins]
    if config.on_skin is not None and config.on_skin not in names:
        near = did_you_mean(config.on_skin, names)
        raise SceneError(f"{element}: key 'on_skin' has value '{config.on_skin}'{near}; allowed: {' | '.join(names)}")
    if config.path_on != "skin":
        return None
    if config.on_skin is not None:
        return names.index(config.on_skin)
    if len(names) > 1:
        raise SceneError(
            f"{element}: key 'path_on' has value 'skin' and the scene has several; name one by key 'on_skin': "
            f"{' | '.join(names)}"
        )
    return 0


def _on_body(model: ModelView, frame: Transform, site: str, element: str) -> Triple:
    x, y, z = relative(frame, model.reference_pose("site", model.find("site", site, element))).position.tolist()
    return x, y, z


def _check_custom(model: ModelView) -> None:
    """Raise SceneError for custom entries whose names look like those of palmfield but would have no effect."""
    for kind, name, length in model.custom() if model.complete else ():
        near = did_you_mean(name, CUSTOM, NEAR_MISS)
        if name not in CUSTOM and (near or name.lower().startswith("palmfield")):
            near = near or did_you_mean(name, CUSTOM)
            known = " and ".join(f"{own} '{one}'" for one, own in CUSTOM.items())
            raise SceneError(f"{kind} '{name}' is unknown to palmfield{near}; allowed: {known}")
        if name in CUSTOM and kind != CUSTOM[name]:
            raise SceneError(
                f"{kind} '{name}' has the wrong element type; allowed: <{CUSTOM[name]} name=\"{name}\" .../>"
            )
        if name == DURATION and length != 1:
            raise SceneError(f"numeric '{name}' has {length} numbers; allowed: one, in seconds")


def _device(model: ModelView) -> str:
    requested = model.text(DEVICE, "auto") if model.complete else "cpu"
    try:
        return resolve(requested)
    except PalmfieldError as error:
        raise SceneError(f"text '{DEVICE}' has value '{requested}': {error}") from None


def _timestep(model: ModelView) -> float:
    step = model.timestep
    if not 0.0 < step < math.inf:
        raise SceneError(f"option 'timestep' has value {step:g}; allowed: seconds > 0")
    return step


def _duration(model: ModelView) -> float:
    # MuJoCo fills numerics later, so the value is not available yet
    value = model.numeric(DURATION, DEFAULT_DURATION_S) if model.complete else DEFAULT_DURATION_S
    if not 0.0 < value < math.inf:
        raise SceneError(f"numeric '{DURATION}' has value {value:g}; allowed: seconds > 0")
    steps = value / model.timestep
    if steps > MOST_STEPS:
        raise SceneError(
            f"option 'timestep' has value {model.timestep:g}: a run of {value:g} s would take {steps:.2g} steps; "
            f"allowed: at most {MOST_STEPS:.2g}; set timestep larger, or numeric '{DURATION}' smaller"
        )
    return value


# -- bones and obstacles -------------------------------------------------------------------------------------------


def bones_of(skin: SkinConfig, element: str, model: ModelView) -> list[int]:
    """Return the bodies that carry the skin of a hand, in the order of its bones; empty for shapes in one piece.

    Raises SceneError in three cases: a body is missing; key `body` is neither the palm of an articulated hand nor a
    joint of a rigged mesh; the bodies of a rigged mesh are not at its joints in the reference pose.
    """
    if skin.shape not in ("articulated", "rigged"):
        return []
    element = f"{element}: key 'shape' has value '{skin.shape}'"
    prefix, bones = _bones(skin, element)
    numbers = [model.find("body", prefix + bone.name, element) for bone in bones]
    advice = "write its MJCF by `palmfield hand MESH --mjcf FILE.xml`"
    if skin.shape == "articulated":
        advice = f"name the preset of that hand by key 'hand' ('{skin.hand}' now)"
    frame = model.reference_pose("body", model.find("body", skin.body, element))
    for bone, number in zip(bones, numbers, strict=True):
        pose = model.reference_pose("body", number)
        check_rest(bone, frame, pose, f"{element}: body '{prefix}{bone.name}'", advice)
    return numbers


def _bones(skin: SkinConfig, element: str) -> tuple[str, list[Any]]:
    """Return the prefix of the body names, and the bones in the frame of key `body`."""
    if skin.shape == "rigged":
        from palmfield.hand.rigged import joint_of_body
        from palmfield.hand.skinning import bones_of_mesh, rigged_file

        assert skin.mesh
        mesh = rigged_file(skin.mesh, skin.unit)
        with naming(element, "key 'body'"):
            joint, prefix = joint_of_body(skin.body, mesh.joints)
        return prefix, bones_of_mesh(mesh, mesh.joints.rest[joint, :3, 3])
    if not skin.body.endswith("hand"):
        raise SceneError(f"{element}: key 'body' has value '{skin.body}'; allowed: the palm, [prefix]hand")
    from palmfield.hand.articulated import articulate

    return skin.body.removesuffix("hand"), articulate(load_preset(skin.hand)).bones


def check_rest(bone: Any, frame: Transform, pose: Transform, element: str, advice: str) -> None:
    """Raise SceneError, with the remedy, if a body is not at its joint, or is not parallel to the axes of the hand."""
    place = relative(frame, pose)
    distance = float(np.linalg.norm(place.position - bone.origin))
    angle = float(np.arccos(np.clip(0.5 * (np.trace(place.rotation) - 1.0), -1.0, 1.0)))
    if distance > REST_M or angle > REST_RAD:
        raise SceneError(
            f"{element} is {1e3 * distance:.3g} mm and {np.rad2deg(angle):.3g} degrees away from the joint of the "
            f"mesh; {advice}"
        )


def obstacles_of(skin: SkinConfig, element: str, model: ModelView, bones: list[int]) -> "list[tuple[Obstacle, int]]":
    """Return the bodies of key `obstacles` and their child bodies, with geoms and body numbers.

    bones: result of `bones_of`.
    Raises SceneError for unknown bodies, for the body of the skin itself, and if none of the bodies has a geom.
    """
    element = f"{element}: key 'obstacles'"
    named = {model.find("body", name, element) for name in skin.obstacles}
    own = {model.find("body", skin.body, element), *bones}
    if not named:
        return []
    from palmfield.hand.collision_shapes import Obstacle

    result = []
    for number in range(model.raw.nbody):
        if not named & model.ancestors(number):
            continue
        if number in own:
            raise SceneError(
                f"{element} has value '{' '.join(skin.obstacles)}'; allowed: bodies other than the body of the skin"
            )
        geoms = model.geoms(number, element)
        if geoms:
            result.append((Obstacle(geoms), number))
    if not result:
        raise SceneError(f"{element} has value '{' '.join(skin.obstacles)}', but none of these has a geom")
    return result
