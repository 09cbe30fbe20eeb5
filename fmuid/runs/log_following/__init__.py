"""Records as a logger writes them: what is new in a folder or a growing file, and where reading is."""
