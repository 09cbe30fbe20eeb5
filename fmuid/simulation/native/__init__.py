"""The core in C: compiled, loaded."""
