from .shown import Shown as Shown
from .validation import validate_usd as validate_usd
from .write import write_usd as write_usd
