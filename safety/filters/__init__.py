"""Filters: conditions on the input, and resolutions that say which input is taken."""
