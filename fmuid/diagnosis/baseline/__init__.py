"""The healthy machine, as records are compared with it."""
