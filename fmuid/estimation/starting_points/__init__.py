"""Better starts for a search: numerics of the remedies, which know no FMU."""
