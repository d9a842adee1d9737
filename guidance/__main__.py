"""`python -m guidance` is the command `guidance`."""

from guidance.cli import main

main()
