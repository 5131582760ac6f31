"""`python -m palmfield` is the command line."""

from palmfield.cli.app import start

start()
