from .rows import Row as Row
from .scene_plan import Plan as Plan
from .scene_plan import warnings as warnings
