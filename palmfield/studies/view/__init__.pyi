from .run import view as view
