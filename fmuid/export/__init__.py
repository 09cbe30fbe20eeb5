"""Modelica to FMU: needs the extra dependencies `fmuid[export]`, not needed to identify."""
