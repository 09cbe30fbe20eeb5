"""What is done with a table before it is an experiment: columns computed, transformed, filtered, cut, resampled."""
