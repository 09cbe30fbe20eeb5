"""``python -m fmuid`` is the command ``fmuid``."""

from fmuid.cli import main

main()
