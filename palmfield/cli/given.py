"""Values of keys that are given on the command line, option --set."""

from palmfield.errors import SceneError


def given_keys(keys: list[str] | None) -> dict[str, str]:
    """Keys as `palmfield.load` takes them. Raises SceneError for one without a value, and for one given twice."""
    result: dict[str, str] = {}
    for text in keys or ():
        name, equals, value = text.partition("=")
        if not equals:
            raise SceneError(f"--set {text} has no value; write INSTANCE.KEY=VALUE, e.g. stimulus.path_speed_m_s=11")
        if not value.strip():
            raise SceneError(
                f"--set {text} has no value behind the =; write INSTANCE.KEY=VALUE, or leave it out for what the scene "
                "has"
            )
        if name in result:
            raise SceneError(f"--set gives {name} twice, '{result[name]}' and '{value}'; allowed: each key once")
        result[name] = value
    return result
