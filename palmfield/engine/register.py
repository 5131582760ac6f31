"""Entry point of the group `mujoco.plugins`: MuJoCo calls it on import, so it stays light."""


def register() -> None:
    """Register the palmfield modules with MuJoCo."""
    from palmfield.engine import host
    from palmfield.engine.afferents_plugin import AfferentsModule
    from palmfield.engine.array_plugin import ArrayModule
    from palmfield.engine.motion_plugin import MotionModule
    from palmfield.engine.skin_plugin import SkinModule
    from palmfield.engine.stimulus_plugin import DriverModule, StimulusModule

    for module in (ArrayModule, StimulusModule, DriverModule, SkinModule, MotionModule, AfferentsModule):
        host.register(module)
