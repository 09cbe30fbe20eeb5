"""The command line."""

from fmuid.apps.cli.app import main as main
