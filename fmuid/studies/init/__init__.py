"""A first study file for an FMU and tables: what the columns are, and which parameters are worth to be freed."""
