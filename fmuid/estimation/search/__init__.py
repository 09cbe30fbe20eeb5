"""The one loop of a search, and Marquardt's method (1.16) as its steps."""
