"""Whatever touches an FMU: its description, its archive, its binary."""
