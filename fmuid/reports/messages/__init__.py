"""Sentences for people on what was found: the one place where they are made."""
