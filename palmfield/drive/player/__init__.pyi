from .caller import Player as Player
from .report import PlayReport as PlayReport
