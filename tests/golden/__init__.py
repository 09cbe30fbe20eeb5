"""Numbers of whole runs, kept while the code beneath them moves."""
