"""First study file for an FMU and data files."""
