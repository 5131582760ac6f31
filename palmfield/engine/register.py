"""Entry point of the group `mujoco.plugins`: MuJoCo calls it on import, so it stays light."""


def register() -> None:
    """Make the four modules known to MuJoCo."""
    from palmfield.engine import host, modules

    for module in modules.MODULES:
        host.register(module)
