"""Entry point of the group `mujoco.plugins`: MuJoCo calls it on import, so it stays light."""


def register() -> None:
    """Register the palmfield modules with MuJoCo."""
    from palmfield.engine import host
    from palmfield.engine.modules import MODULES

    for module in MODULES:
        host.register(module)
