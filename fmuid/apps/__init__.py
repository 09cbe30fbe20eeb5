"""Command line and workbench."""
