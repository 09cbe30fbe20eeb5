"""FMUs in a process of their own."""
