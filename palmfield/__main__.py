"""`python -m palmfield` is the command line."""

from palmfield.cli import main

main()
