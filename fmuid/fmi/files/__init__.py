"""The files of an FMU: archives and XML that nobody vouches for, the model description and its start values."""
