"""The command line."""

from fmuid.cli.app import main as main
