"""Files of results: the types of their values."""
