"""``python -m fmuid`` is the command ``fmuid``."""

from fmuid.apps.cli import main

main()
