"""Run the command line by `python -m palmfield`."""

from palmfield.cli.app import start

start()
