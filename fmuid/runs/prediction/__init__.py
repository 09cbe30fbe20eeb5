"""Studies of results: the study that a result was made by, and its predictions of other records."""
