"""What a shell offers after TAB."""


def plugins(incomplete: str) -> list[str]:
    """Short names of the plugins that begin so."""
    from palmfield.config import CONFIGS

    short = (config.plugin.removeprefix("palmfield.") for config in CONFIGS)
    return [name for name in short if name.startswith(incomplete.removeprefix("palmfield."))]


def settings(incomplete: str) -> list[str]:
    """Keys, as `--set` takes them, that begin so; after a whole key its values, where they are words."""
    from palmfield.config import CONFIGS, allowed

    name, equals, _ = incomplete.partition("=")
    offered = []
    for config in CONFIGS:
        for key in config.model_fields:
            full = f"{config.plugin.removeprefix('palmfield.')}.{key}"
            words = allowed(config, key).split(" | ") if equals and full == name else []
            offered += [f"{full}={word}" for word in words if len(words) > 1] if equals else [f"{full}="]
    return [text for text in offered if text.startswith(incomplete)]
