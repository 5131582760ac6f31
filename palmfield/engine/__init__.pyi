from .host import Module as Module
from .host import World as World
from .host import raise_errors as raise_errors
from .host import world_of as world_of
from .motion_plugin import place as place
