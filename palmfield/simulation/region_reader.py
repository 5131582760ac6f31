"""Read the regions of skins whose rates of spikes sensors read; only few scenes have them."""

from collections.abc import Sequence

from palmfield.config import AfferentsConfig
from palmfield.errors import SceneError
from palmfield.mujoco_host.mujoco_view import ModelView
from palmfield.simulation.spec import RegionSpec, SkinSpec
from palmfield.transforms import relative


def region(
    name: str, config: AfferentsConfig, model: ModelView, skins: Sequence[SkinSpec], owners: Sequence[tuple[int, ...]]
) -> RegionSpec:
    """Return a region by its keys; owners: for each skin the MuJoCo numbers of its body and its bones.

    Raises SceneError for an unknown skin, body or site, and for a skin without afferents.
    """
    element, names = AfferentsConfig.element(name), [skin.name for skin in skins]
    requested = config.skin or (names[0] if len(names) == 1 else "")
    if requested not in names:
        raise SceneError(f"{element}: key 'skin' has value '{requested}'; allowed: {', '.join(names)}")
    number = names.index(requested)
    bodies, bone = owners[number], -1
    if skins[number].config.receptors == "off":
        raise SceneError(f"{element} needs afferents, but receptors is 'off' at skin '{requested}': set it to on")
    if config.body is not None:
        body = model.find("body", config.body, f"{element}: key 'body'")
        if body not in bodies:
            allowed = ", ".join(model.names("body")[owner] for owner in bodies)
            raise SceneError(f"{element}: key 'body' has value '{config.body}'; allowed: {allowed}")
        bone = bodies.index(body) - 1
    centre, radius_m = None, 0.0
    if config.site is not None:
        site = model.find("site", config.site, f"{element}: key 'site'")
        radius = model.sphere_m(site)
        if radius is None:
            raise SceneError(f"{element}: key 'site' has value '{config.site}'; allowed: a site of type sphere")
        frame, radius_m = model.reference_pose("body", bodies[0]), radius
        x, y, z = relative(frame, model.reference_pose("site", site)).position.tolist()
        centre = x, y, z
    return RegionSpec(name, config, number, None if bone < 0 else bone, centre, radius_m)
